"""Makes events of what changes: states of sensors and buses, warnings, tares."""

import threading
import time
from collections.abc import Callable, Hashable, Iterable

import numpy as np

from tactiled.calibrate.upkeep.health import RULES, Change, Fault
from tactiled.contacts.regions import measure_units
from tactiled.frames import FrameWarning
from tactiled.live.events import Events, Faults, Kind
from tactiled.live.sensor import Sensor
from tactiled.live.status import State
from tactiled.threads import join_started

LOOK_EVERY_S = 0.1
WARNING_STAYS_S = 5.0  # after it last appeared, so that one that comes and goes is one event
QUIET = {"cut_short", "noise_unknown"}  # a little less sharp, or not measured yet: an event only if it lasts
LASTS_S, GAP_S = 10.0, 1.0  # it lasts if reported for so long, without such a gap
MAX_TAXELS_NAMED = 8  # in an event
STATE_EVENTS: dict[State, Kind] = {
    "live": "sensor_live", "stale": "sensor_stale", "silent": "sensor_silent", "down": "sensor_down",
    "ended": "sensor_ended",
}  # fmt: skip


class Watch:
    """Looks at every sensor ten times a second, on a thread of its own."""

    def __init__(
        self, sensors: Iterable[Sensor], events: Events, faults: Faults, keep_tare: Callable[[Sensor], str]
    ) -> None:
        """`keep_tare` keeps a tare that is done, and says in words whether it could."""
        self.sensors = tuple(sensors)  # any thread may replace it
        self._events, self._faults = events, faults
        self._watched = self.sensors  # at the last look
        self._keep_tare = keep_tare
        self._values: dict[tuple[str, str], Hashable] = {}  # at the last look, by kind, and by the sensor or bus
        self._silent_since: dict[str, float] = {}  # s, of sensors from which no frame has come yet
        self._raised: dict[tuple[str, str], tuple[FrameWarning, float]] = {}  # by sensor and code; last report, s
        self._quiet: dict[tuple[str, str], tuple[float, float]] = {}  # s, first and last report of one in QUIET
        self.turns = 0  # looks so far
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="watch", daemon=True)

    def start(self) -> None:
        """Start to look."""
        self._thread.start()

    def stop(self) -> None:
        """Stop, whether it was started or not."""
        self._stop.set()
        join_started(self._thread)

    def _run(self) -> None:
        while not self._stop.wait(LOOK_EVERY_S):
            self.look(time.monotonic())
            self.turns += 1

    def look(self, now: float) -> None:
        """Add an event for every change since the last look, at `now` (s); a sensor that raises is a fault."""
        sensors = self.sensors
        self._forget(set(self._watched) - set(sensors))
        self._watched = sensors
        for bus in dict.fromkeys(each.plan.bus for each in sensors):
            self._look_at_bus(bus)
        for sensor in sensors:
            with self._faults.turn(f"watch of {sensor.name}"):
                self._look_at_state(sensor, now)
                self._look_at_warnings(sensor, now)
                self._look_at_tare(sensor)
                self._look_at_taxels(sensor)
                self._look_at_regions(sensor)
            with self._faults.turn(f"search of the cover of {sensor.name}"):
                sensor.pipeline.cover.search(now)
        self._faults.clear()

    def _changed(self, what: str, whose: str, value: Hashable, at_start: Hashable) -> bool:
        """Whether a value differs from that of the last look; at the first look, from `at_start`."""
        before = self._values.get((what, whose), at_start)
        self._values[what, whose] = value
        return value != before

    def _forget(self, ended: set[Sensor]) -> None:
        """Clear the warnings of sensors that have ended, and start anew with other sensors of their names."""
        names = {each.name for each in ended}
        self._values = {
            key: value for key, value in self._values.items() if key[0] == "bus" or key[1] not in names
        }
        self._silent_since = {name: at for name, at in self._silent_since.items() if name not in names}
        for key in [key for key in self._raised if key[0] in names]:
            self._clear(*key)

    def _look_at_bus(self, bus: str) -> None:
        down = next(
            (each.health.down for each in self._watched if each.plan.bus == bus and each.health.down), None
        )
        if self._changed("bus", bus, down, None):
            if down:
                self._events.add("bus_down", down, bus=bus)
            else:
                self._events.add("bus_up", "is there again", bus=bus)

    def _look_at_state(self, sensor: Sensor, now: float) -> None:
        """A sensor without a frame yet is silent only once it has had the time that it needs to start and send."""
        status = sensor.status()
        patient = False
        if status.state == "silent":
            to_start = max((after for after, _ in sensor.codec.polling.start), default=0.0)
            since = self._silent_since.setdefault(sensor.name, now)
            patient = now - since <= to_start + sensor.plan.stale_after_s
        else:
            self._silent_since.pop(sensor.name, None)
        if self._changed("state", sensor.name, None if patient else status.state, None) and not patient:
            self._events.add(STATE_EVENTS[status.state], status.detail or "receiving frames", sensor.name)

    def _look_at_warnings(self, sensor: Sensor, now: float) -> None:
        for code, warning in sensor.drain_warnings().items():
            if code in QUIET and not self._lasts((sensor.name, code), now):
                continue
            if (sensor.name, code) not in self._raised:
                self._events.add("warning_raised", warning.text, sensor.name, warning=warning)
            self._raised[sensor.name, code] = warning, now
        if self._values["state", sensor.name] != "live":  # without frames no warning is cleared
            return
        for (name, code), (_, raised_at) in list(self._raised.items()):
            if name == sensor.name and now - raised_at > WARNING_STAYS_S:
                self._clear(name, code)

    def _clear(self, name: str, code: str) -> None:
        """Clear a sensor's warning."""
        warning, _ = self._raised.pop((name, code))
        self._events.add("warning_cleared", f"it was: {warning.text}", name, warning=warning)

    def _lasts(self, reported: tuple[str, str], now: float) -> bool:
        """Whether a warning that is reported `now` (s), given by sensor and code, has lasted."""
        since, until = self._quiet.get(reported, (now, now))
        since = since if now - until < GAP_S else now
        self._quiet[reported] = since, now
        return now - since >= LASTS_S

    def _look_at_tare(self, sensor: Sensor) -> None:
        sensor.lapse_tare()
        pipeline = sensor.pipeline
        if self._changed("tared", sensor.name, pipeline.tares.done, 0):
            text = f"the load of the last frames is the new zero; {self._keep_tare(sensor)}"
            self._events.add("tare_done", text, sensor.name)
        if self._changed("refused", sensor.name, pipeline.tares.refused, 0):
            text = f"given up, nothing changed: {pipeline.tares.load}"
            self._events.add("tare_refused", text, sensor.name)
        if self._changed("lapsed", sensor.name, pipeline.tares.lapsed, 0):
            self._events.add("tare_lapsed", "given up: not live until enough frames had come", sensor.name)

    def _look_at_regions(self, sensor: Sensor) -> None:
        for name, above, value in sensor.regions.drain_crossings():
            limit = sensor.regions.regions[name].threshold if name in sensor.regions.regions else None
            if limit is not None:
                unit = measure_units(sensor.plan.unit)[limit.quantity]
                bound = limit.above if above else limit.below
                side = "above" if above else "below"
                text = f"region {name}: {limit.quantity} {_apart(value, bound)} is {side} {bound:g} {unit}"
                self._events.add("region_above" if above else "region_below", text, sensor.name)

    def _look_at_taxels(self, sensor: Sensor) -> None:
        monitor = sensor.pipeline.monitor
        monitor.map.judge()
        for fault, taxels in _by_fault(monitor.drain_changes()).items():
            if fault == Fault.HEALTHY:
                self._events.add("taxel_healed", f"{taxels}: works again", sensor.name)
            else:
                self._events.add(
                    "taxel_faulty", f"{taxels} {fault.name.lower()}: {RULES[fault].reason}", sensor.name
                )
        creep = monitor.creep
        if self._changed("creep", sensor.name, creep is not None and creep.significant, False) and creep:
            text = (
                f"on {creep.taxels} taxels reads {creep.percent_per_decade:+.2g} % ± {creep.standard_error:.1g} %"
            )
            self._events.add("creep_measured", f"a load that stays {text} for each tenfold time", sensor.name)


def _by_fault(changes: Iterable[Change]) -> dict[Fault, str]:
    """The taxels whose states have changed, in words, by their new state."""
    taxels: dict[Fault, list[int]] = {}
    for each in changes:
        taxels.setdefault(each.after, []).append(each.taxel)
    return {fault: _listed(sorted(set(each))) for fault, each in taxels.items()}


def _listed(taxels: list[int]) -> str:
    more = f" and {len(taxels) - MAX_TAXELS_NAMED} more" if len(taxels) > MAX_TAXELS_NAMED else ""
    return f"taxel{'s' * (len(taxels) > 1)} {', '.join(map(str, taxels[:MAX_TAXELS_NAMED]))}{more}"


def _apart(value: float, bound: float) -> str:
    """Three digits of a value, all before the point, or as many as tell it from a bound."""
    least = max(3, len(f"{abs(value):.0f}"))
    texts = (np.format_float_positional(value, n, unique=False, fractional=False) for n in range(least, least + 6))
    shown = float(f"{bound:g}")
    return next((each.rstrip(".") for each in texts if float(each) != shown), f"{value}")
