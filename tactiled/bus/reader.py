"""The CAN bus, through python-can; nothing else in the package imports it."""

import errno
from typing import Any

import can

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


class Reader:
    """An open bus: messages out of `receive`, messages into `send`."""

    def __init__(self, bus: can.BusABC, label: str) -> None:
        self._bus, self.label = bus, label
        self.errors = 0  # error and remote frames seen, which carry no taxels

    def receive(self, timeout: float) -> Message | None:
        """The next data frame, or None after `timeout` (s); BusError where the bus is gone."""
        try:
            got = self._bus.recv(timeout)
        except (can.CanError, OSError, ValueError) as error:
            raise _blame(error, self.label) from error
        if got is None:
            return None
        if got.is_error_frame or got.is_remote_frame:
            self.errors += 1
            return None
        return Message(got.timestamp, got.arbitration_id, bytes(got.data), got.is_extended_id, got.is_fd)

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
        except (can.CanError, OSError, ValueError) as error:
            raise _blame(error, self.label) from error

    def close(self) -> None:
        """Let go of the bus; one that is gone already is no error."""
        try:
            self._bus.shutdown()
        except (can.CanError, OSError):
            return


def open_bus(interface: str, **settings: Any) -> Reader:
    """Open a bus by python-can's own names; BusError, one line that says what to do, where it cannot be."""
    label = f"{interface} {settings.get('channel', '')}".strip()
    if interface not in can.VALID_INTERFACES:
        known = ", ".join(sorted(can.VALID_INTERFACES))
        raise BusError(f"bus {label}: python-can has no interface of that name: choose one of {known}")
    try:
        return Reader(can.Bus(interface=interface, **settings), label)
    except Exception as error:  # an interface without its driver raises what it likes, NameError included
        raise _blame(error, label) from error


def _blame(error: Exception, label: str) -> BusError:
    """One line: the bus, what its driver says, what to do."""
    code = getattr(error, "errno", None) or getattr(error, "error_code", None)
    hint = HINTS.get(code, "") if isinstance(code, int) else ""
    says = " ".join(str(error).split()) or type(error).__name__
    return BusError(f"bus {label}: {says}{': ' + hint if hint else ''}")
