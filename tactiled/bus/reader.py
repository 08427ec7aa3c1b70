"""The CAN bus, through python-can; nothing else in the package imports it."""

import errno
import os
import socket
import sys
import time
from collections import deque
from collections.abc import Callable, Iterable
from contextlib import suppress
from typing import Any

import can
from can.interfaces.socketcan import SocketcanBus

from tactiled.bus import decoding, faults
from tactiled.bus.burst import ERROR, EXTENDED, REMOTE, Burst
from tactiled.bus.redact import HARMLESS, redactor, reveal, seal
from tactiled.errors import BusError
from tactiled.frames import Message

HINTS = {
    errno.EPERM: "no permission: give the user access to the interface",
    errno.EACCES: "no permission: give the user access to the interface",
    errno.ENODEV: "no such interface: see `ip link show type can`",
    errno.ENETDOWN: "the interface is down: `ip link set CHANNEL up`",
    errno.EAFNOSUPPORT: "this machine's kernel has no SocketCAN: choose another interface",
    errno.ENOENT: "no such device",
    errno.ENOBUFS: "its queue is full: no other node acknowledges, or more is sent than the bus carries",
}

BUFFER = 8 << 20  # bytes that the kernel keeps for us: 0.6 s of two full 1 Mbit/s buses
SO_RCVBUFFORCE, SO_MEMINFO, MEMINFO = 33, 55, 9  # Linux's; the last of SO_MEMINFO's nine numbers counts drops
OFF = (
    "bus-off: too many errors on the wire: check wiring, termination and bit rate; `ip link set CHANNEL type can "
    "restart-ms 100` brings it back by itself"
)
STANDARD_ID, EXTENDED_ID = 0x7FF, 0x1FFFFFFF


class Reader:
    """An open bus: messages out of `batch` or `receive`, messages into `send`."""

    def __init__(self, bus: can.BusABC, label: str, redact: Callable[[str], str] = str) -> None:
        self._bus, self.label, self._redact = bus, label, redact
        self._socket = _socket(bus)
        self._burst = _burst(bus, self._socket)
        self._waiting: deque[Message] = deque()  # taken, and not yet asked for
        self._told = 0  # messages dropped, when last asked
        self.errors = 0  # error frames seen
        self.remote = 0  # remote frames seen, which carry no taxels
        self.unsent = 0  # messages to skins that the bus did not take
        self.unreadable = 0  # what came and could not be decoded
        self._in_a_row = 0  # of it, without a frame or a silence between
        self.kinds = dict.fromkeys(faults.KINDS, 0)  # what the error frames told; never grows: threads read it
        self.off: str | None = None  # that it is off the bus now, and what to do

    @property
    def clock(self) -> str:
        """Which clock gives the messages' times: the kernel's, or that of an interface's driver."""
        return "kernel" if isinstance(self._bus, SocketcanBus) else f"python-can {self.label.split()[0]}"

    def frame(self, timeout: float) -> can.Message | None:
        """The next frame of any kind, or None after `timeout` (s) at the latest; BusError where the bus is gone.

        What cannot be decoded is counted, and no frame. It knows nothing of what `batch` or `receive` have taken:
        use it instead of them, not beside them.
        """
        try:
            got = self._recv(timeout)
            if decoding.sound(got, self._bus):
                self._in_a_row = 0
                return got
        except Exception as error:  # a driver whose device was unplugged raises what it likes
            if decoding.is_gone(error, self._bus) or self._in_a_row >= decoding.MAX_UNREADABLE_IN_A_ROW:
                raise _blame(error, self.label, self._redact) from error
        decoding.skip(self._bus)
        self.unreadable += 1
        self._in_a_row += 1
        return None

    def _recv(self, timeout: float) -> can.Message | None:
        """What python-can's `recv` does, by a clock that nobody sets: its own hangs where that steps back."""
        end = time.monotonic() + timeout
        while True:
            got, filtered = self._bus._recv_internal(timeout=max(0.0, end - time.monotonic()))
            if got is not None and (filtered or self._bus._matches_filters(got)):
                return got
            if time.monotonic() >= end:
                return None

    def receive(self, timeout: float) -> Message | None:
        """The next data frame, or None after `timeout` (s); BusError where the bus is gone."""
        if not self._waiting:
            self._waiting.extend(self.batch(timeout))
        return self._waiting.popleft() if self._waiting else None

    def batch(self, timeout: float) -> list[Message]:
        """The data frames that have come, or come first within `timeout` (s); BusError where the bus is gone."""
        if self._burst is None:
            return self._one(timeout)
        try:
            frames = self._burst.take(timeout)
        except OSError as error:
            raise _blame(error, self.label, self._redact) from error
        taken = []
        for stamp, id_, data, fd in frames:
            if id_ & (ERROR | REMOTE):
                self._special(id_ & EXTENDED_ID, data, error=id_ & ERROR != 0)
                continue
            self.off = None
            extended = id_ & EXTENDED != 0
            taken.append(Message(stamp, id_ & (EXTENDED_ID if extended else STANDARD_ID), data, extended, fd))
        return taken

    def _one(self, timeout: float) -> list[Message]:
        """The same by python-can, which takes one frame at a time."""
        got = self.frame(timeout)
        if got is None:
            return []
        if got.is_error_frame or got.is_remote_frame:
            self._special(got.arbitration_id, bytes(got.data), got.is_error_frame)
            return []
        self.off = None
        return [Message(got.timestamp, got.arbitration_id, bytes(got.data), got.is_extended_id, got.is_fd)]

    def send(self, message: Message) -> None:
        """Put one data frame on the bus; BusError where it does not take it."""
        try:
            self._bus.send(
                can.Message(
                    arbitration_id=message.id,
                    data=message.data,
                    is_extended_id=message.extended,
                    is_fd=message.fd,
                    bitrate_switch=message.fd,
                )
            )
        except Exception as error:  # a driver whose device was unplugged raises what it likes
            raise _blame(error, self.label, self._redact) from error

    def _special(self, id_: int, data: bytes, error: bool) -> None:
        """Count an error frame, of which only SocketCAN's tell their kinds, or a remote frame."""
        if not error:
            self.remote += 1
            return
        self.errors += 1
        told = faults.kinds(id_, data) if isinstance(self._bus, SocketcanBus) else (faults.OTHER,)
        for kind in told:
            self.kinds[kind] += 1
        if faults.BUS_OFF in told:
            self.off = f"bus {self.label}: {OFF}"
        elif faults.RESTARTED in told:
            self.off = None

    @property
    def dropped(self) -> int:
        """Messages that the kernel threw away since the bus was opened, because they were not taken in time."""
        if (open_ := self._socket) is not None and sys.platform == "linux":
            with suppress(OSError):  # closed meanwhile by another thread
                told = open_.getsockopt(socket.SOL_SOCKET, SO_MEMINFO, 4 * MEMINFO)
                self._told = int.from_bytes(told[-4:], sys.byteorder) if len(told) == 4 * MEMINFO else 0
        return self._told

    def counts(self) -> dict[str, int]:
        """What went wrong on the bus itself, by the names of `Loss`."""
        return {
            "dropped": self.dropped,
            "errors": self.errors,
            "bus_off": self.kinds[faults.BUS_OFF],
            "unsent": self.unsent,
            "unreadable": self.unreadable,
        }

    def close(self) -> None:
        """Let go of the bus; one that is gone already is no error."""
        if self._socket is not None:
            self._told = self.dropped
            self._socket.close()
            self._socket = None
        try:
            self._bus.shutdown()
        except Exception:  # of a device that is gone
            return


def no_interface(name: str) -> str | None:
    """What is wrong with the name of an interface, and which there are; None where nothing is."""
    if name in can.VALID_INTERFACES:
        return None
    known = ", ".join(sorted(can.VALID_INTERFACES))
    return f"python-can has no interface of that name: choose one of {known}"


def open_bus(interface: str, **settings: Any) -> Reader:
    """Open a bus by python-can's own names; BusError, one line that says what to do, where it cannot be."""
    settings = seal(settings, HARMLESS)
    label, redact = f"{interface} {settings.get('channel', '')}".strip(), redactor(settings)
    if fault := no_interface(interface):
        raise BusError(f"bus {label}: {fault}")
    try:
        return Reader(can.Bus(interface=interface, **reveal(settings)), label, redact)
    except Exception as error:  # an interface without its driver raises what it likes, NameError included
        raise _blame(error, label, redact) from error


def only(settings: dict[str, Any], ids: Iterable[tuple[int, bool]]) -> dict[str, Any]:
    """A bus's settings with which the kernel holds back all but `ids`; as they are where it cannot or they say."""
    if settings.get("interface") != "socketcan" or "can_filters" in settings:
        return settings
    return settings | {
        "can_filters": [
            {"can_id": id_, "can_mask": 0x1FFFFFFF if extended else 0x7FF, "extended": extended}
            for id_, extended in sorted(ids)
        ]
    }


def _socket(bus: can.BusABC) -> socket.socket | None:
    """A second handle of the socket behind a bus, its buffer enlarged; None for a bus of another kind."""
    try:
        found = socket.socket(fileno=os.dup(bus.fileno()))
    except (OSError, NotImplementedError):
        return None
    if found.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) < BUFFER:
        for option in (socket.SO_RCVBUF, SO_RCVBUFFORCE):  # the second goes past the system's bound, if allowed
            with suppress(OSError):
                found.setsockopt(socket.SOL_SOCKET, option, BUFFER)
    return found


def _burst(bus: can.BusABC, found: socket.socket | None) -> Burst | None:
    """A faster way to read SocketCAN where there is one; python-can's own filters it does not know."""
    if found is None or not isinstance(bus, SocketcanBus) or not Burst.fits(found) or not bus._is_filtered:
        return None
    return Burst(found.fileno())


def _blame(error: Exception, label: str, redact: Callable[[str], str]) -> BusError:
    """One line: the bus, what its driver says, what to do; no secret."""
    code = getattr(error, "errno", None) or getattr(error, "error_code", None)
    hint = HINTS.get(code, "") if isinstance(code, int) else ""
    says = " ".join(redact(str(error)).split()) or type(error).__name__
    return BusError(f"bus {label}: {says}{': ' + hint if hint else ''}")
