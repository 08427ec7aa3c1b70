"""An open CAN bus: messages in, messages out, and what went wrong on the wire."""

import errno
import os
import socket
import sys
import time
from collections import deque
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np

from tactiled.bus import canbus, driver_errors
from tactiled.bus.batch import EXTENDED, Batch
from tactiled.bus.canbus import (
    VALID_INTERFACES,
    Bus,
    BusABC,
    CanMessage,
    SocketcanBus,
    can_message,
    filters_in_kernel,
    receive,
)
from tactiled.bus.redact import HARMLESS, redactor, reveal, seal
from tactiled.bus.socketcan import (
    BUS_OFF,
    ERROR,
    GATHER_S,
    KINDS,
    OTHER,
    REMOTE,
    RESTARTED,
    FrameReader,
    error_kinds,
)
from tactiled.errors import BusError
from tactiled.frames import Message

NO_PERMISSION = "no permission: give the user access to the interface"
HINTS = {
    errno.EPERM: NO_PERMISSION,
    errno.EACCES: NO_PERMISSION,
    errno.ENODEV: "no such interface: see `ip link show type can`",
    errno.ENETDOWN: "the interface is down: `ip link set CHANNEL up`",
    errno.EAFNOSUPPORT: "this machine's kernel has no SocketCAN: choose another interface",
    errno.ENOENT: "no such device",
    errno.ENOBUFS: "its queue is full: no other node acknowledges, or more is sent than the bus carries",
}
BUFFER_BYTES = 8 << 20  # that the kernel keeps for us: 0.6 s of two full 1 Mbit/s buses
SO_RCVBUFFORCE, SO_MEMINFO, MEMINFO = 33, 55, 9  # Linux's; the last of SO_MEMINFO's nine numbers counts drops
MULTICAST_ALL = {socket.AF_INET: (socket.IPPROTO_IP, 49), socket.AF_INET6: (socket.IPPROTO_IPV6, 29)}  # Linux's
BUS_OFF_HINT = (
    "bus-off: too many errors on the wire: check wiring, termination and bit rate; `ip link set CHANNEL type can "
    "restart-ms 100` brings it back by itself"
)
XELA_SERVER = "websocket"  # an interface beside python-can's
STANDARD_ID, EXTENDED_ID = 0x7FF, 0x1FFFFFFF


class Reader:
    """An open bus: messages out of `batch` or `receive`, messages into `send`."""

    def __init__(self, bus: BusABC, label: str, redact: Callable[[str], str] = str) -> None:
        self._bus, self.label, self._redact = bus, label, redact
        self._socket = _socket(bus)
        self._frames: FrameReader | None = None  # faster, but ignores filters that python-can applies itself
        if self._socket and filters_in_kernel(bus):
            self._frames = FrameReader(self._socket.fileno()) if FrameReader.supported(self._socket) else None
        self._waiting: deque[Message] = deque()  # taken from the bus, not yet received
        self._dropped = 0  # messages, when last counted
        self.errors = 0  # error frames
        self.remote = 0  # remote frames, which carry no taxels
        self.unsent = 0  # messages to skins that the bus did not take
        self.unreadable = 0  # what came and could not be decoded
        self._unreadable_in_a_row = 0  # without a frame or a silence between
        self.kinds = dict.fromkeys(KINDS, 0)  # of error frames; its keys never change: other threads read it
        self.off: str | None = None  # in words: it is bus-off now, and what to do; None: it is not

    @property
    def clock(self) -> str:
        """Which clock gives the messages' times: the kernel's, or that of an interface's driver."""
        return "kernel" if isinstance(self._bus, SocketcanBus) else f"python-can {self.label.split()[0]}"

    def frame(self, timeout: float) -> CanMessage | None:
        """The next frame of any kind, or None after `timeout` (s) at the latest; BusError where the bus is gone.

        What cannot be decoded is counted, and gives None. Use either this or `batch` and `receive`: it does not
        return what they have taken from the bus.
        """
        try:
            frame = receive(self._bus, timeout)
            if driver_errors.is_sound(frame, self._bus):
                self._unreadable_in_a_row = 0
                return frame
        except Exception as error:  # a driver whose device was unplugged raises what it likes
            too_many = self._unreadable_in_a_row >= driver_errors.MAX_UNREADABLE_IN_A_ROW
            if too_many or driver_errors.is_gone(error, self._bus):
                raise _bus_error(error, self.label, self._redact) from error
        driver_errors.skip(self._bus)
        self.unreadable += 1
        self._unreadable_in_a_row += 1
        return None

    def receive(self, timeout: float) -> Message | None:
        """The next data frame, or None after `timeout` (s); BusError where the bus is gone."""
        if not self._waiting:
            self._waiting.extend(self.batch(timeout))
        return self._waiting.popleft() if self._waiting else None

    def batch(self, timeout: float, needed: int = 1) -> Batch:
        """The data frames that have come, or else the next within `timeout` (s); BusError where the bus is gone.

        After the first it waits up to GATHER_S for `needed` frames in all.
        """
        if self._frames is None:
            batch = self._gathered(timeout, needed)
        else:
            try:
                batch = self._frames.read(timeout, needed)
            except OSError as error:
                raise _bus_error(error, self.label, self._redact) from error
        flags = int(np.bitwise_or.reduce(batch.ids))
        if flags & (ERROR | REMOTE):
            batch = self._without(batch, np.flatnonzero(batch.ids & (ERROR | REMOTE)).tolist())
        elif len(batch):
            self.off = None
        if flags & ~(EXTENDED | STANDARD_ID):
            of_id = np.where(batch.ids & EXTENDED, EXTENDED | EXTENDED_ID, STANDARD_ID).astype(np.uint32)
            batch = replace(batch, ids=batch.ids & of_id)
        return batch

    def _gathered(self, timeout: float, needed: int) -> Batch:
        """What python-can's driver gives, frame after frame."""
        messages: list[Message] = []
        end = time.monotonic() + timeout
        while len(messages) < needed:
            try:
                frame = self.frame(max(0.0, end - time.monotonic()))
            except BusError:
                if messages:  # the next read raises it again
                    break
                raise
            if frame is None:
                break
            if not messages:
                end = min(end, time.monotonic() + GATHER_S)
            messages.append(_raw(frame))
        return Batch.of(messages)

    def _without(self, batch: Batch, specials: list[int]) -> Batch:
        """Count and leave out error and remote frames, the rows `specials`; any other frame ends bus-off."""
        after = 0  # the row after the last one counted
        for at in specials:
            self.off = None if at > after else self.off
            id_, data = int(batch.ids[at]), batch.data[at].tobytes()[: batch.lengths[at]]
            self._count_special(id_ & EXTENDED_ID, data, error=id_ & ERROR != 0)
            after = at + 1
        self.off = None if len(batch) > after else self.off
        return batch[np.delete(np.arange(len(batch)), specials)]

    def send(self, message: Message) -> None:
        """Put one data frame on the bus; BusError where it does not take it."""
        try:
            self._bus.send(can_message(message))
        except Exception as error:  # a driver whose device was unplugged raises what it likes
            raise _bus_error(error, self.label, self._redact) from error

    def set_filters(self, filters: list[dict[str, Any]]) -> None:
        """Have the kernel pass other ids (python-can's `can_filters`) from now on; no message is lost."""
        try:
            self._bus.set_filters(filters)  # type: ignore[arg-type]
        except Exception as error:  # a driver raises what it likes
            raise _bus_error(error, self.label, self._redact) from error
        if not filters_in_kernel(self._bus):
            self._frames = None

    def _count_special(self, id_: int, data: bytes, error: bool) -> None:
        """Count a remote frame, or an error frame with its kinds, which only SocketCAN reports."""
        if not error:
            self.remote += 1
            return
        self.errors += 1
        socketcan = isinstance(self._bus, SocketcanBus)
        kinds = error_kinds(id_, data) if socketcan else (OTHER,)
        for kind in kinds:
            self.kinds[kind] += 1
        if BUS_OFF in kinds:
            self.off = f"bus {self.label}: {BUS_OFF_HINT}"
        elif RESTARTED in kinds:
            self.off = None

    @property
    def dropped(self) -> int:
        """Messages that the kernel threw away since the bus was opened, because they were not taken in time."""
        if (open_ := self._socket) is not None and sys.platform == "linux":
            with suppress(OSError):  # closed meanwhile by another thread
                numbers = open_.getsockopt(socket.SOL_SOCKET, SO_MEMINFO, 4 * MEMINFO)
                self._dropped = int.from_bytes(numbers[-4:], sys.byteorder) if len(numbers) == 4 * MEMINFO else 0
        return self._dropped

    def counts(self) -> dict[str, int]:
        """What went wrong on the bus itself, by the names of `Loss`."""
        return {
            "dropped": self.dropped,
            "errors": self.errors,
            "bus_off": self.kinds[BUS_OFF],
            "unsent": self.unsent,
            "unreadable": self.unreadable,
        }

    def close(self) -> None:
        """Close the bus; no error if it is gone already."""
        if self._socket is not None:
            self._dropped = self.dropped
            self._socket.close()
            self._socket = None
        with suppress(Exception):  # of a device that is gone
            canbus.close(self._bus)


def no_interface(name: str) -> str | None:
    """An error text with the interfaces that there are, if `name` is none of them; else None."""
    if name in (known := {*VALID_INTERFACES, XELA_SERVER}):
        return None
    return f"python-can has no interface of that name: choose one of {', '.join(sorted(known))}"


def open_bus(interface: str, **settings: Any) -> Reader:
    """Open a bus with python-can's settings; if that fails, BusError in one line that says what to do."""
    settings = seal(settings, HARMLESS)
    label, redact = f"{interface} {settings.get('channel', '')}".strip(), redactor(settings)
    if fault := no_interface(interface):
        raise BusError(f"bus {label}: {fault}")
    try:
        if interface == XELA_SERVER:
            from tactiled.bus.xela_server import XelaServerBus  # websockets, which no CAN bus needs

            return Reader(XelaServerBus(**reveal(settings)), label, redact)
        return Reader(Bus(interface=interface, **reveal(settings)), label, redact)
    except Exception as error:  # an interface without its driver raises what it likes, NameError included
        raise _bus_error(error, label, redact) from error


def only(settings: dict[str, Any], ids: Iterable[tuple[int, bool]]) -> dict[str, Any]:
    """A bus's settings with a filter in the kernel that passes `ids` alone.

    Unchanged if it is no SocketCAN bus, or they have `can_filters` already.
    """
    if settings.get("interface") != "socketcan" or "can_filters" in settings:
        return settings
    return settings | {
        "can_filters": [
            {"can_id": id_, "can_mask": EXTENDED_ID if extended else STANDARD_ID, "extended": extended}
            for id_, extended in sorted(ids)
        ]
    }


def _socket(bus: BusABC) -> socket.socket | None:
    """A second handle of the socket behind a bus; None for a bus of another kind.

    Its buffer is enlarged. It receives its own multicast group alone: by default Linux delivers every group on its
    port that any program has joined.
    """
    try:
        handle = socket.socket(fileno=os.dup(bus.fileno()))
    except (OSError, NotImplementedError):
        return None
    if handle.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) < BUFFER_BYTES:
        for option in (socket.SO_RCVBUF, SO_RCVBUFFORCE):  # the second goes past the system's bound, if allowed
            with suppress(OSError):
                handle.setsockopt(socket.SOL_SOCKET, option, BUFFER_BYTES)
    if sys.platform == "linux" and (every_group := MULTICAST_ALL.get(handle.family)):
        with suppress(OSError):
            handle.setsockopt(*every_group, 0)
    return handle


def _raw(frame: CanMessage) -> Message:
    """A message from python-can's frame of any kind; its id has the kernel's flags for error and remote."""
    flags = REMOTE * frame.is_remote_frame | ERROR * frame.is_error_frame
    id_ = frame.arbitration_id | flags
    return Message(frame.timestamp, id_, bytes(frame.data), frame.is_extended_id, frame.is_fd)


def _bus_error(error: Exception, label: str, redact: Callable[[str], str]) -> BusError:
    """One line: the bus, the driver's own words without secrets, what to do."""
    code = getattr(error, "errno", None) or getattr(error, "error_code", None)
    hint = HINTS.get(code, "") if isinstance(code, int) else ""
    reason = " ".join(redact(str(error)).split()) or type(error).__name__
    return BusError(f"bus {label}: {reason}{': ' + hint if hint else ''}")
