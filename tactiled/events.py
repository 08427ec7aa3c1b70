"""What happened to the service, one line each, numbered; the last thousand of them."""

import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from itertools import count
from typing import Literal

Kind = Literal[
    "sensor_live", "sensor_stale", "sensor_silent", "sensor_down", "bus_up", "bus_down",
    "warning_raised", "warning_cleared", "method_set", "method_kept", "state_ignored",
    "tare_asked", "tare_done", "recording_started", "recording_ended",
]  # fmt: skip
MOST = 1000


@dataclass(frozen=True, slots=True)
class Event:
    """One thing that happened."""

    id: int  # 1, 2, 3, ... since the start
    time: float  # s, Unix
    kind: Kind
    sensor: str | None
    bus: str | None
    text: str


class Events:
    """The newest events; any thread may call it."""

    def __init__(self, most: int = MOST, clock: Callable[[], float] = time.time) -> None:
        self._lock = threading.Lock()
        self._kept: deque[Event] = deque(maxlen=most)
        self._ids, self._clock = count(1), clock
        self._listeners: list[Callable[[], None]] = []
        self.newest = 0  # id

    def add(self, kind: Kind, text: str, sensor: str | None = None, bus: str | None = None) -> None:
        """Note what happened, and wake who waits for it."""
        with self._lock:
            event = Event(next(self._ids), self._clock(), kind, sensor, bus, text)
            self._kept.append(event)
            self.newest = event.id
            listeners = tuple(self._listeners)
        for listener in listeners:
            listener()

    def after(self, last: int) -> tuple[Event, ...]:
        """Every event kept whose id is above `last`, oldest first."""
        with self._lock:
            return tuple(event for event in self._kept if event.id > last)

    def subscribe(self, listener: Callable[[], None]) -> Callable[[], None]:
        """Call `listener` after every event; it must return at once. Returns how to stop it."""
        with self._lock:
            self._listeners.append(listener)

        def unsubscribe() -> None:
            with self._lock:
                self._listeners.remove(listener)

        return unsubscribe
