"""The events of the service, numbered, and its present faults."""

import logging
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Literal

from tactiled.frames import FrameWarning
from tactiled.live.hub import Publisher

Kind = Literal[
    "sensor_live", "sensor_stale", "sensor_silent", "sensor_down", "sensor_ended", "bus_up", "bus_down",
    "warning_raised", "warning_cleared", "method_set", "method_kept", "state_ignored",
    "tare_asked", "tare_done", "tare_lapsed", "tare_refused", "tare_undone", "tare_kept", "tare_ignored",
    "calibration_applied", "calibration_missing", "recording_started", "recording_ended", "recording_added",
    "calibration_started", "calibration_ended",
    "taxel_faulty", "taxel_healed", "creep_measured", "region_above", "region_below", "region_ignored",
    "publisher_conflict", "clock_skewed", "message_refused", "sensor_removed",
    "fault_raised", "fault_cleared", "replay_stepped", "config_reloaded", "config_refused",
]  # fmt: skip
MAX_EVENTS_KEPT = 1000
CLEAR_AFTER_S = 1.0  # without a fault: one that flickers makes one event
LOGGED_AS_WARNINGS: frozenset[Kind] = frozenset({
    "sensor_stale", "sensor_silent", "sensor_down", "bus_down", "warning_raised", "state_ignored", "tare_lapsed",
    "tare_refused", "tare_ignored", "message_refused", "calibration_missing", "taxel_faulty", "fault_raised",
    "config_refused",
})  # fmt: skip
LOG = logging.getLogger("tactiled.events")
LOG.addHandler(logging.NullHandler())  # a program that embeds the service and configures no log gets none


def duration(seconds: float) -> str:
    """A time in words: 40 s, 12 min, 3.2 h, 2.5 days."""
    for unit, length in (("days", 86400.0), ("h", 3600.0), ("min", 60.0)):
        if seconds >= 2 * length:
            return f"{seconds / length:.2g} {unit}"
    return f"{max(seconds, 0.0):.0f} s"


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


class Events(Publisher[Event]):
    """The newest events; any thread may call it."""

    def __init__(self) -> None:
        super().__init__()
        self._events: deque[Event] = deque(maxlen=MAX_EVENTS_KEPT)
        self.newest = 0  # id

    def add(
        self,
        kind: Kind,
        text: str,
        sensor: str | None = None,
        bus: str | None = None,
        warning: FrameWarning | None = None,
        error: Exception | None = None,
        failed: bool = False,
    ) -> None:
        """Note and log what happened, as a warning if it `failed`, and call the listeners."""
        with self._lock:
            event = Event(self.newest + 1, time.time(), kind, sensor, bus, text, warning)
            self._events.append(event)
            self.newest = event.id
        level = logging.WARNING if failed or kind in LOGGED_AS_WARNINGS else logging.INFO
        fields = {"event": kind, "sensor": sensor, "bus": bus, "code": warning and warning.code}
        LOG.log(level, "%s", text, exc_info=error, extra={"fields": fields})
        self.publish(event)

    def after(self, last: int) -> tuple[Event, ...]:
        """Every event kept whose id is above `last`, oldest first."""
        with self._lock:
            return tuple(event for event in self._events if event.id > last)


class Faults:
    """Parts of the service that fail and go on, and why; any thread may call it."""

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
        """Do one turn of a part's work: an error becomes a fault, unless it is one of `but`, which passes."""
        try:
            yield
        except but:
            raise
        except Exception as error:
            why = f"{type(error).__name__}: {error}"
            with self._lock:  # an event of a fault is added under the lock, so that they are in order
                is_new = part not in self._now
                self._now[part] = why, self._clock()
                if is_new:
                    self._events.add("fault_raised", f"{part}: {why}", error=error)

    def clear(self) -> None:
        """Clear every part that has not failed for CLEAR_AFTER_S; it may have no more turns."""
        if not self._now:  # nearly always: without the lock
            return
        with self._lock:
            now = self._clock()
            for part, (why, failed_at) in list(self._now.items()):
                if now - failed_at >= CLEAR_AFTER_S:
                    del self._now[part]
                    self._events.add("fault_cleared", f"{part}: {why}")
