"""Sees when a sensor, a bus or a warning changes, and makes events of it."""

import threading
import time
from collections.abc import Iterable, Mapping
from typing import Protocol, get_args

from tactiled.frames import FrameWarning, Image
from tactiled.runtime.events import CLEAR_S, Events, Faults, Kind

LOOK_S = 0.1
KINDS: Mapping[str, Kind] = {kind: kind for kind in get_args(Kind)}


class Heard:
    """Warnings of one sensor's images since they were last asked for."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._warnings: dict[str, FrameWarning] = {}

    def add(self, image: Image) -> None:
        """Note the warnings of one image."""
        if not image.warnings:
            return
        with self._lock:
            self._warnings.update((each.code, each) for each in image.warnings)

    def drain(self) -> dict[str, FrameWarning]:
        """The newest warning of each code since the last call."""
        with self._lock:
            warnings, self._warnings = self._warnings, {}
        return warnings


class Health(Protocol):
    """How a sensor is doing."""

    @property
    def state(self) -> str:
        """Live, stale, silent or down."""

    @property
    def detail(self) -> str:
        """One line on it."""


class Watched(Protocol):
    """What is looked at of a sensor."""

    name: str
    bus_name: str
    down: str | None
    heard: Heard

    @property
    def tared(self) -> int:
        """How often it was tared."""

    @property
    def lapsed(self) -> int:
        """How often a tare was given up."""

    def lapse(self) -> None:
        """Give up a tare under way if frames no longer come."""

    def status(self) -> Health:
        """How it is doing."""


class Watch:
    """Looks at every sensor ten times a second, on a thread of its own."""

    def __init__(self, sensors: Iterable[Watched], events: Events, faults: Faults) -> None:
        self._sensors, self._events, self._faults = tuple(sensors), events, faults
        self._states = {each.name: "silent" for each in self._sensors}
        self._down: dict[str, str | None] = {each.bus_name: None for each in self._sensors}
        self._warned: dict[str, dict[str, tuple[FrameWarning, float]]] = {each.name: {} for each in self._sensors}
        self._tares = {each.name: (0, 0) for each in self._sensors}
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="watch", daemon=True)

    def start(self) -> None:
        """Start to look."""
        self._thread.start()

    def stop(self) -> None:
        """Stop, whether it was started or not."""
        self._stop.set()
        if self._thread.ident is not None:
            self._thread.join()

    def _run(self) -> None:
        while not self._stop.wait(LOOK_S):
            self.look(time.monotonic())

    def look(self, now: float) -> None:
        """Tell of every change since the last look; `now` in s; a sensor that cannot be looked at is a fault."""
        for bus in self._down:
            self._bus(bus)
        for sensor in self._sensors:
            with self._faults.turn(f"watch of {sensor.name}"):
                self._state(sensor)
                self._warnings(sensor, now)
                self._tare(sensor)
        self._faults.clear()

    def _tare(self, sensor: Watched) -> None:
        sensor.lapse()
        (tared, lapsed), now = self._tares[sensor.name], (sensor.tared, sensor.lapsed)
        self._tares[sensor.name] = now
        if now[0] != tared:
            self._events.add("tare_done", "the load of the last frames is the new zero", sensor.name)
        if now[1] != lapsed:
            self._events.add("tare_lapsed", "given up: not live until enough frames had come", sensor.name)

    def _bus(self, bus: str) -> None:
        down = next((each.down for each in self._sensors if each.bus_name == bus and each.down), None)
        if down == self._down[bus]:
            return
        self._down[bus] = down
        if down:
            self._events.add("bus_down", down, bus=bus)
        else:
            self._events.add("bus_up", "is there again", bus=bus)

    def _state(self, sensor: Watched) -> None:
        status = sensor.status()
        if status.state != self._states[sensor.name]:
            self._states[sensor.name] = status.state
            self._events.add(KINDS[f"sensor_{status.state}"], status.detail or "frames come", sensor.name)

    def _warnings(self, sensor: Watched, now: float) -> None:
        warned = self._warned[sensor.name]
        for code, warning in sensor.heard.drain().items():
            if code not in warned:
                self._events.add("warning_raised", warning.text, sensor.name, warning=warning)
            warned[code] = warning, now
        if self._states[sensor.name] != "live":
            return
        for code in [each for each, (_, raised) in warned.items() if now - raised > CLEAR_S]:
            warning, _ = warned.pop(code)
            self._events.add("warning_cleared", warning.text, sensor.name, warning=warning)
