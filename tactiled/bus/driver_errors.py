"""Tells errors of a driver about one message from those of the bus itself."""

import os
import select
import struct
from collections.abc import Iterator
from math import isfinite

from tactiled.bus.canbus import BusABC, CanMessage, unended_line

MAX_UNREADABLE_IN_A_ROW = 1000  # without a frame or a silence between; more means that the driver fails
MAX_LINE_BYTES = 1024  # of a line of slcan without its end; its longest message has 138
CONTENT_ERRORS = (ValueError, IndexError, struct.error)  # what malformed bytes make a driver raise
HUNG_UP = select.POLLHUP | select.POLLERR | select.POLLNVAL


def is_gone(error: Exception, bus: BusABC) -> bool:
    """Whether a fault is the bus's: its file or socket fails, or its driver names a code of its own."""
    causes = tuple(_causes(error))
    if any(isinstance(each, OSError) or getattr(each, "error_code", None) is not None for each in causes):
        return True
    return not isinstance(causes[-1], CONTENT_ERRORS) and not _open(bus)


def is_sound(message: CanMessage | None, bus: BusABC) -> bool:
    """Whether a decoded frame is possible: a driver may read a garbled line as a message."""
    if message is None:
        return len(unended_line(bus)) < MAX_LINE_BYTES
    id_, dlc = message.arbitration_id, message.dlc
    if type(id_) is not int or type(dlc) is not int or not isfinite(message.timestamp):
        return False
    if not 0 <= id_ < (1 << 29 if message.is_extended_id else 1 << 11) or not 0 <= dlc <= 64:
        return False
    return message.is_error_frame or len(message.data) == (0 if message.is_remote_frame else dlc)


def skip(bus: BusABC) -> None:
    """Skip bytes that could not be decoded; slcan's driver would read them again."""
    unended_line(bus).clear()


def _causes(error: BaseException | None) -> Iterator[BaseException]:
    """A fault and what caused it, to the first."""
    while error is not None:
        yield error
        error = error.__cause__ or error.__context__


def _open(bus: BusABC) -> bool:
    """Whether a bus's file or socket is still there; False where it has none that can be asked."""
    try:
        poll = select.poll()
        poll.register(bus.fileno(), 0)
        return os.fstat(bus.fileno()) is not None and not any(events & HUNG_UP for _, events in poll.poll(0))
    except Exception:  # of a driver that has none, or has lost it
        return False
