"""Regions of the sensors as clients set them, kept over a restart where there is a state file."""

from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from threading import Lock

from tactiled.contacts.regions import Region
from tactiled.errors import StateError, UnknownSensorError
from tactiled.live.events import Events
from tactiled.live.sensor import Sensor
from tactiled.live.state_file import StateFile


class KeptRegions:
    """Sets and removes the regions of a service's sensors."""

    def __init__(self, state: StateFile | None, events: Events, sensor: Callable[[str], Sensor]) -> None:
        self.state, self._events, self._sensor = state, events, sensor
        self._lock = Lock()  # one change at a time

    def take(self, names: Collection[str] | None) -> None:
        """Watch the kept regions of these sensors (None: of all); an event names those that no longer apply."""
        for name, regions in self.state.regions.items() if self.state else ():
            for region, each in regions.items() if names is None or name in names else ():
                try:
                    self._sensor(name).regions.put(region, each)
                except (UnknownSensorError, ValueError) as error:
                    self._events.add("region_ignored", f"sensor {name}, region {region}: {error}")

    def put(self, sensor: Sensor, name: str, region: Region) -> None:
        """Watch a region; ValueError where it does not fit, StateError where it cannot be kept."""
        with self._kept(sensor):
            sensor.regions.put(name, region)

    def remove(self, sensor: Sensor, name: str) -> None:
        """Watch a region no longer; KeyError where there is none, StateError where that cannot be kept."""
        with self._kept(sensor):
            sensor.regions.remove(name)

    @contextmanager
    def _kept(self, sensor: Sensor) -> Iterator[None]:
        """Keep a change; where that fails, nothing has changed."""
        with self._lock:
            before = sensor.regions.series
            thresholds = [(each, each.region, each.exceeded) for each in before.values()]
            yield
            try:
                if self.state is not None:
                    self.state.keep_regions(sensor.name, sensor.regions.regions)
            except StateError:
                sensor.regions.series = before
                for each, region, exceeded in thresholds:
                    each.region, each.exceeded = region, exceeded
                raise
