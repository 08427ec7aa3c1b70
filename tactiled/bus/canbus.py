"""All that the package uses of python-can; no other module imports it, or calls its private names."""

import time
from contextlib import suppress
from queue import Empty
from typing import Any, Self

from can import VALID_INTERFACES, Bus, BusABC
from can import Message as CanMessage
from can import io as formats
from can.interfaces.slcan import slcanBus as SlcanBus
from can.interfaces.socketcan import SocketcanBus
from can.interfaces.virtual import VirtualBus
from can.io import blf
from can.io.generic import MessageReader, MessageWriter
from can.util import channel2int, dlc2len

from tactiled.frames import Message

__all__ = [
    "VALID_INTERFACES", "Bus", "BusABC", "CanMessage", "MessageReader", "MessageWriter", "SlcanBus",
    "SocketcanBus", "blf", "can_message", "channel2int", "close", "dlc2len", "filters_in_kernel", "formats",
    "receive", "unended_line",
]  # fmt: skip


class _SentMessage(CanMessage):
    """A message that nobody changes: a virtual bus passes on the object itself, and makes no costly copy."""

    __slots__ = ()

    def __deepcopy__(self, memo: dict[int, Any] | None) -> Self:
        """Itself."""
        return self


def can_message(message: Message) -> CanMessage:
    """A data frame as python-can has it."""
    time_s, id_, fd = message.time, message.id, message.fd
    return _SentMessage(time_s, id_, message.extended, data=message.data, is_fd=fd, bitrate_switch=fd)


def receive(bus: BusABC, timeout: float) -> CanMessage | None:
    """As python-can's `recv`, but by the monotonic clock: python-can's hangs if the wall clock steps back."""
    end = time.monotonic() + timeout
    while True:
        frame, filtered = bus._recv_internal(timeout=max(0.0, end - time.monotonic()))
        if frame is not None and (filtered or bus._matches_filters(frame)):
            return frame
        if time.monotonic() >= end:
            return None


def close(bus: BusABC) -> None:
    """Close a bus. A sender that waits for room in a virtual one's queue goes on: python-can leaves it there."""
    bus.shutdown()
    if isinstance(bus, VirtualBus):
        with suppress(Empty):
            while True:
                bus.queue.get_nowait()


def filters_in_kernel(bus: BusABC) -> bool:
    """Whether the kernel of SocketCAN passes wanted ids alone, so that python-can need not look at them."""
    return isinstance(bus, SocketcanBus) and bus._is_filtered


def unended_line(bus: BusABC) -> bytearray:
    """The buffer of slcan's driver, with a line that has not ended; of any other driver a new empty one."""
    return bus._buffer if isinstance(bus, SlcanBus) else bytearray()
