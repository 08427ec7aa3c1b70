"""A log that a client cannot fill: of each kind of message a few a minute, and how many were left out."""

import logging
import re
import time
from collections.abc import Callable

MAX_A_MINUTE = 10  # of each kind
MINUTE_S = 60.0
NUMBER = re.compile(r"\d+")


class LogLimit(logging.Filter):
    """Passes the first messages of each kind in a minute; the next minute's first one tells how many were not."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        super().__init__()
        self._clock = clock
        self._minutes: dict[str, tuple[float, int]] = {}  # when it began, messages in it, by kind

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether to log a message; kinds differ by their text, but for numbers and values filled in."""
        kind, now = NUMBER.sub("#", str(record.msg)), self._clock()
        began, count = self._minutes.get(kind, (now, 0))
        suppressed = 0
        if now - began >= MINUTE_S:
            suppressed, began, count = max(0, count - MAX_A_MINUTE), now, 0
        self._minutes[kind] = began, count + 1
        if suppressed:
            record.msg = f"{record.msg} ({suppressed} like it were left out before)"
        return count < MAX_A_MINUTE
