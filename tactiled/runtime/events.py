"""What happened to the service, one line each, numbered, the last thousand of them; and what fails in it now."""

import logging
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import count
from typing import Literal

from tactiled.frames import FrameWarning

Kind = Literal[
    "sensor_live", "sensor_stale", "sensor_silent", "sensor_down", "bus_up", "bus_down",
    "warning_raised", "warning_cleared", "method_set", "method_kept", "state_ignored",
    "tare_asked", "tare_done", "tare_lapsed", "recording_started", "recording_ended",
    "fault_raised", "fault_cleared", "replay_stepped",
]  # fmt: skip
MOST = 1000
CLEAR_S = 1.0  # without a fault or a warning until it counts as cleared: one that flickers is told once
LOG = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Event:
    """One thing that happened."""

    id: int  # 1, 2, 3, ... since the start
    time: float  # s, Unix
    kind: Kind
    sensor: str | None
    bus: str | None
    text: str
    warning: FrameWarning | None = None  # that was raised or cleared


class Events:
    """The newest events; any thread may call it."""

    def __init__(self, most: int = MOST, clock: Callable[[], float] = time.time) -> None:
        self._lock = threading.Lock()
        self._kept: deque[Event] = deque(maxlen=most)
        self._ids, self._clock = count(1), clock
        self._listeners: list[Callable[[], None]] = []
        self.newest = 0  # id

    def add(
        self,
        kind: Kind,
        text: str,
        sensor: str | None = None,
        bus: str | None = None,
        warning: FrameWarning | None = None,
    ) -> None:
        """Note what happened, and wake who waits for it."""
        with self._lock:
            event = Event(next(self._ids), self._clock(), kind, sensor, bus, text, warning)
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


class Faults:
    """Which parts of the service fail, though they go on, and why; any thread may call it."""

    def __init__(self, events: Events, clock: Callable[[], float] = time.monotonic) -> None:
        self._events, self._clock = events, clock
        self._lock = threading.Lock()
        self._now: dict[str, tuple[str, float]] = {}  # by part: why, and when it last failed

    @property
    def now(self) -> dict[str, str]:
        """Why each part fails, of those that do."""
        with self._lock:
            return {part: why for part, (why, _) in self._now.items()}

    @contextmanager
    def turn(self, part: str, but: type[Exception] | tuple[type[Exception], ...] = ()) -> Iterator[None]:
        """Do one turn of a part's work; if it fails that is told, in the log, too, and the next turn may come.

        `but` is no fault, and passes.
        """
        try:
            yield
        except but:
            raise
        except Exception as error:
            self._raise(part, f"{type(error).__name__}: {error}")

    def _raise(self, part: str, why: str) -> None:
        with self._lock:
            known = part in self._now
            self._now[part] = why, self._clock()
            if not known:  # told under the lock, as what is cleared is: in the order in which it was
                self._events.add("fault_raised", f"{part}: {why}")
        if not known:
            LOG.exception("%s failed, and goes on", part)

    def clear(self) -> None:
        """Tell of every part that has not failed for CLEAR_S, and forget it; its turns may have ended for good."""
        if not self._now:  # nearly always: without the lock
            return
        with self._lock:
            now = self._clock()
            for part, (why, failed) in list(self._now.items()):
                if now - failed >= CLEAR_S:
                    del self._now[part]
                    self._events.add("fault_cleared", f"{part}: {why}")
