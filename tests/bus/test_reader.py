import errno
import socket

import can
import pytest
from can.interfaces.socketcan import SocketcanBus

from tactiled.bus.reader import BUS_OFF_HINT, Reader, only, open_bus
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


def test_error_and_remote_frames_carry_no_taxels_and_are_counted_by_kind(request):
    name = request.node.name
    reader = open_bus(interface="virtual", channel=name)
    with can.Bus(interface="virtual", channel=name) as raw:
        raw.send(can.Message(arbitration_id=0x40, is_error_frame=True))
        raw.send(can.Message(arbitration_id=0x500, is_remote_frame=True, is_extended_id=False))
        assert (reader.receive(1.0), reader.receive(1.0)) == (None, None)
    assert (reader.errors, reader.remote) == (1, 1)
    assert {kind: count for kind, count in reader.kinds.items() if count} == {
        "other": 1
    }  # SocketCAN alone tells more
    assert reader.counts() == {"dropped": 0, "errors": 1, "bus_off": 0, "unsent": 0, "unreadable": 0}
    reader.close()


class Noted(SocketcanBus):
    """SocketCAN without a kernel that has it: gives the frames it is given."""

    def __init__(self, frames):
        self.frames = list(frames)
        self._is_shutdown = True

    def fileno(self):
        raise NotImplementedError

    def _recv_internal(self, timeout):
        del timeout
        return self.frames.pop(0), True

    def shutdown(self):
        pass


def error(kinds):
    return can.Message(arbitration_id=kinds, is_extended_id=False, is_error_frame=True)


@pytest.mark.parametrize("back", [error(0x100), can.Message(arbitration_id=0x500, is_extended_id=False)])
def test_bus_off_is_counted_and_reported_until_the_bus_is_back(back):
    reader = Reader(Noted([error(0x4), error(0x48), error(0x80), back]), "socketcan can0")
    states = []
    for _ in range(4):
        reader.receive(1.0)
        states.append(reader.off)
    assert states == [None, f"bus socketcan can0: {BUS_OFF_HINT}", f"bus socketcan can0: {BUS_OFF_HINT}", None]
    assert (reader.errors, reader.kinds["bus_off"]) == (4 if back.is_error_frame else 3, 1)


def test_socketcan_is_asked_for_the_sensors_ids_only():
    ids = {(0x501, False), (0x500, False), (0x18FF0000, True)}
    assert only({"interface": "socketcan", "channel": "can0"}, ids) == {
        "interface": "socketcan",
        "channel": "can0",
        "can_filters": [
            {"can_id": 0x500, "can_mask": 0x7FF, "extended": False},
            {"can_id": 0x501, "can_mask": 0x7FF, "extended": False},
            {"can_id": 0x18FF0000, "can_mask": 0x1FFFFFFF, "extended": True},
        ],
    }


@pytest.mark.parametrize("settings", [{"interface": "virtual"}, {"interface": "socketcan", "can_filters": []}])
def test_other_interfaces_and_a_filter_of_ones_own_are_left_alone(settings):
    assert only(settings, {(0x500, False)}) is settings


class Wired(Noted):
    """A bus with a socket behind it."""

    def __init__(self, end):
        super().__init__([])
        self.end = end

    def fileno(self):
        return self.end.fileno()


def test_the_sockets_buffer_is_enlarged_and_a_closed_bus_still_tells_its_counts():
    ours, theirs = socket.socketpair(type=socket.SOCK_DGRAM)
    with ours, theirs:
        before = ours.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)
        reader = Reader(Wired(ours), "socketcan can0")
        after = ours.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)
        assert after >= before
        assert reader.dropped == 0
        reader.close()
        assert reader.counts() == {"dropped": 0, "errors": 0, "bus_off": 0, "unsent": 0, "unreadable": 0}
        assert ours.fileno() >= 0  # still theirs to close


def test_closing_twice_or_after_the_bus_is_gone_is_no_error(request):
    reader = open_bus(interface="virtual", channel=request.node.name)
    reader.close()
    reader.close()
    Reader(Broken(OSError(errno.ENODEV, "No such device")), "can0").close()


def one_line(error):
    assert "\n" not in str(error)
    return str(error)


@pytest.mark.parametrize(
    ("settings", "reason"),
    [
        (
            {"interface": "sockecan", "channel": "can0"},
            r"^bus sockecan can0: python-can has no interface of that name: choose one of .*socketcan,",
        ),
        (
            {"interface": "slcan", "channel": "/dev/gone", "sleep_after_open": 0},
            r"^bus slcan /dev/gone: .*No such file",
        ),
        ({"interface": "kvaser", "channel": 0}, r"^bus kvaser 0: "),  # without its driver
        ({"interface": "socketcan", "channel": "gone0"}, "no such interface|has no SocketCAN"),
    ],
)
def test_a_bus_that_cannot_be_opened_is_refused_in_one_line(settings, reason):
    with pytest.raises(BusError, match=reason) as caught:
        open_bus(**settings)
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
    monkeypatch.setattr("tactiled.bus.reader.Bus", fail)
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


@pytest.mark.parametrize("error", [TypeError("'NoneType' is no integer"), AttributeError("close"), KeyError(7)])
def test_whatever_a_driver_raises_is_an_error_of_its_bus(error):
    reader = Reader(Broken(error), "slcan tty0")
    for act in (lambda: reader.receive(0.1), lambda: reader.send(Message(0.0, 0x500, b""))):
        with pytest.raises(BusError, match=r"^bus slcan tty0: ") as caught:
            act()
        assert caught.value.__cause__ is error
    reader.close()
