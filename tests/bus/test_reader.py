import errno
import socket

import can
import pytest

from tactiled.bus.reader import Reader, open_bus
from tactiled.errors import BusError
from tactiled.frames import Message


@pytest.fixture
def wire(request):
    ends = [open_bus(interface="virtual", channel=request.node.name) for _ in range(2)]
    yield ends
    for each in ends:
        each.close()


class Broken(can.BusABC):
    """A bus that fails in one way at everything."""

    def __init__(self, error):
        self.error = error
        self._is_shutdown = True  # keeps python-can from warning of a bus that was never opened

    def _recv_internal(self, **_):
        raise self.error

    def send(self, *_):
        raise self.error

    def shutdown(self):
        raise self.error


@pytest.mark.parametrize(
    "message",
    [
        Message(0.0, 0x500, b"\x01\x02\x03"),
        Message(0.0, 0x1ABCDEF0, b"", extended=True),
        Message(0.0, 0x7FF, bytes(range(64)), fd=True),
    ],
)
def test_what_is_sent_is_received(wire, message):
    sender, reader = wire
    sender.send(message)
    got = reader.receive(1.0)
    assert got.time > 0
    assert got._replace(time=0.0) == message


def test_a_silent_bus_gives_none_after_the_timeout(wire):
    assert wire[0].receive(0.01) is None


def test_error_and_remote_frames_carry_no_taxels_and_are_counted(request):
    name = request.node.name
    reader = open_bus(interface="virtual", channel=name)
    with can.Bus(interface="virtual", channel=name) as raw:
        raw.send(can.Message(is_error_frame=True))
        raw.send(can.Message(arbitration_id=0x500, is_remote_frame=True, is_extended_id=False))
        assert (reader.receive(1.0), reader.receive(1.0), reader.errors) == (None, None, 2)
    reader.close()


def test_closing_twice_or_after_the_bus_is_gone_is_no_error(request):
    reader = open_bus(interface="virtual", channel=request.node.name)
    reader.close()
    reader.close()
    Reader(Broken(OSError(errno.ENODEV, "No such device")), "can0").close()


def one_line(error):
    assert "\n" not in str(error)
    return str(error)


def test_an_unknown_interface_is_refused_with_those_there_are():
    with pytest.raises(BusError) as caught:
        open_bus(interface="sockecan", channel="can0")
    assert one_line(caught.value).startswith(
        "bus sockecan can0: python-can has no interface of that name: choose one"
    )
    assert "socketcan," in str(caught.value)


def test_a_missing_device_is_named():
    with pytest.raises(BusError, match=r"^bus slcan /dev/gone: .*No such file") as caught:
        open_bus(interface="slcan", channel="/dev/gone", sleep_after_open=0)
    one_line(caught.value)


def test_an_interface_without_its_driver_is_one_line():
    with pytest.raises(BusError, match=r"^bus kvaser 0: ") as caught:
        open_bus(interface="kvaser", channel=0)
    one_line(caught.value)


@pytest.mark.parametrize(
    ("code", "hint"),
    [
        (errno.EPERM, "no permission: give the user access to the interface"),
        (errno.EACCES, "no permission: give the user access to the interface"),
        (errno.ENODEV, "no such interface: see `ip link show type can`"),
        (errno.ENETDOWN, "the interface is down: `ip link set CHANNEL up`"),
        (errno.EAFNOSUPPORT, "this machine's kernel has no SocketCAN: choose another interface"),
        (errno.ENOBUFS, "its queue is full"),
    ],
)
@pytest.mark.parametrize("wrapped", [False, True])
def test_an_error_of_the_bus_says_what_to_do(monkeypatch, code, hint, wrapped):
    cause = OSError(code, "it says so")
    error = can.CanOperationError("it says\nso", code) if wrapped else cause

    def fail(**_):
        raise error

    broken = Reader(Broken(error), "socketcan can0")
    monkeypatch.setattr(can, "Bus", fail)
    for act in (
        lambda: open_bus(interface="socketcan", channel="can0"),
        lambda: broken.receive(0),
        lambda: broken.send(Message(0.0, 1, b"")),
    ):
        with pytest.raises(BusError) as caught:
            act()
        assert one_line(caught.value).startswith("bus socketcan can0: ")
        assert "it says so" in str(caught.value)
        assert hint in str(caught.value)


def has_socketcan():
    try:
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except OSError:
        return False
    return True


def test_this_machines_own_kernel_refuses_what_it_does_not_have():
    hint = "no such interface" if has_socketcan() else "has no SocketCAN"
    with pytest.raises(BusError, match=hint):
        open_bus(interface="socketcan", channel="gone0")
