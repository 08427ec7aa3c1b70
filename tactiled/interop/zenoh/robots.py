"""What one robot may use of a server of readers, and what is refused of it: none uses another's share."""

import asyncio
import threading
import time
from collections import deque

from tactiled.interop.zenoh.sensor import Line

MAX_NAMES, MAX_SESSIONS = 64, 4  # sensors of a robot; publishers of one sensor
MESSAGES_HZ = 20_000.0  # of 64 sensors with three images each at 100 Hz
BYTES_HZ = 128e6
EVENTS, EVENTS_HZ = 50, 0.5  # at once, and from then on
DESCRIBED_S = 30.0  # a robot that answers is described within this time
QUIET_S = 60.0  # after the last refusal: the next one is an event again
MAX_ASKING = 4  # descriptions of a robot's sensors that are waited for


class Budget:
    """A token bucket: `burst` at once, then `rate_hz` a second."""

    def __init__(self, rate_hz: float, burst: float) -> None:
        self._rate_hz, self._burst, self._level, self._at = rate_hz, burst, burst, 0.0

    def take(self, now: float, amount: float = 1.0) -> bool:
        """Whether there is as much left at `now` (s, monotonic)."""
        self._level = min(self._burst, self._level + self._rate_hz * max(0.0, now - self._at))
        self._at = now
        if self._level < amount:
            return False
        self._level -= amount
        return True


class Robot:
    """The sensors of one robot, and its budgets."""

    def __init__(self, name: str) -> None:
        self.name, self._appeared = name, time.monotonic()
        self.lines: dict[str, Line] = {}
        self.events, self.conflicts = Budget(EVENTS_HZ, EVENTS), Budget(1 / QUIET_S, MAX_SESSIONS)
        self.inbox: deque[bytes] = deque(maxlen=EVENTS)  # its events that are not read yet
        self.asking = 0  # descriptions that are waited for
        self.building = asyncio.Lock()  # one of its sensors at a time
        self.pieces = 0  # of its sensors' cells
        self.history_bytes = 0
        self._messages, self._bytes = Budget(MESSAGES_HZ, MESSAGES_HZ), Budget(BYTES_HZ, BYTES_HZ)
        self._refused_at = -QUIET_S
        self._lock = threading.Lock()

    @property
    def has_sensors(self) -> bool:
        """Whether one is listed."""
        return any(each.described for each in tuple(self.lines.values()))  # which another thread may change

    def is_mute(self, now: float) -> bool:
        """Whether it has not described any sensor in time."""
        return not self.has_sensors and now - self._appeared > DESCRIBED_S

    def allows(self, now: float, size: int) -> bool:
        """Whether a message of this size (bytes) is within its budgets."""
        with self._lock:
            return self._messages.take(now) and self._bytes.take(now, size)

    def refuse(self, now: float) -> bool:
        """A message is refused; whether that is an event."""
        with self._lock:
            quiet_s, self._refused_at = now - self._refused_at, now
        return quiet_s >= QUIET_S
