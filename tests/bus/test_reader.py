import errno
import socket
from unittest.mock import Mock

import can
import pytest
from can.interfaces.socketcan import SocketcanBus

from tactiled.bus.reader import BUS_OFF_HINT, Reader, only, open_bus
from tactiled.errors import BusError
from tactiled.frames import Message
from tests.conftest import BUSY_S


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


NO_LOSS = {"dropped": 0, "errors": 0, "bus_off": 0, "unsent": 0, "unreadable": 0}


def test_what_is_sent_is_received_and_error_and_remote_frames_are_counted(request):
    bus = {"interface": "virtual", "channel": request.node.name}
    messages = [
        Message(0.0, 0x500, b"\x01\x02\x03"),
        Message(0.0, 0x1ABCDEF0, b"", extended=True),
        Message(0.0, 0x7FF, bytes(range(64)), fd=True),
    ]
    sender, reader = open_bus(**bus), open_bus(**bus)
    for each in messages:
        sender.send(each)
    received = [reader.receive(1.0) for _ in messages]
    assert [each._replace(time=0.0) for each in received] == messages
    assert received[0].time > 0
    assert reader.receive(0.01) is None
    with can.Bus(**bus) as raw:
        raw.send(can.Message(arbitration_id=0x40, is_error_frame=True))
        raw.send(can.Message(arbitration_id=0x500, is_remote_frame=True, is_extended_id=False))
    assert (reader.receive(1.0), reader.receive(1.0)) == (None, None)
    assert (reader.errors, reader.remote) == (1, 1)
    assert {kind: count for kind, count in reader.kinds.items() if count} == {"other": 1}  # SocketCAN tells more
    assert reader.counts() == NO_LOSS | {"errors": 1}
    sender.close()
    for _ in range(2):
        reader.close()


def test_a_multicast_bus_has_only_the_messages_of_its_group(udp_port):
    bus = {"interface": "udp_multicast", "port": udp_port, "hop_limit": 0}
    groups = "239.74.163.78", "239.74.163.79"
    readers, senders = ([open_bus(channel=group, **bus) for group in groups] for _ in range(2))
    for id_, sender in enumerate(senders):
        sender.send(Message(0.0, id_, b""))
    assert [each.receive(BUSY_S).id for each in readers[::-1]] == [1, 0]
    for each in (*readers, *senders):
        each.close()


class Socketcan(SocketcanBus):
    """SocketCAN without a kernel that has it: gives the frames it is given, and has a socket or none."""

    def __init__(self, frames, end=None):
        self.frames, self.end = list(frames), end
        self._is_shutdown, self._is_filtered = True, True

    def fileno(self):
        if self.end is None:
            raise NotImplementedError
        return self.end.fileno()

    def _recv_internal(self, timeout):
        del timeout
        return self.frames.pop(0), True

    def shutdown(self):
        pass


def error(kinds):
    return can.Message(arbitration_id=kinds, is_extended_id=False, is_error_frame=True)


@pytest.mark.parametrize("back", [error(0x100), can.Message(arbitration_id=0x500, is_extended_id=False)])
def test_bus_off_is_counted_and_reported_until_the_bus_is_back(back):
    reader = Reader(Socketcan([error(0x4), error(0x48), error(0x80), back]), "socketcan can0")
    states = []
    for _ in range(4):
        reader.receive(1.0)
        states.append(reader.off)
    assert states == [None, f"bus socketcan can0: {BUS_OFF_HINT}", f"bus socketcan can0: {BUS_OFF_HINT}", None]
    assert (reader.errors, reader.kinds["bus_off"]) == (4 if back.is_error_frame else 3, 1)


@pytest.mark.parametrize(
    ("settings", "filtered"),
    [
        ({"interface": "socketcan", "channel": "can0"}, True),
        ({"interface": "virtual"}, False),
        ({"interface": "socketcan", "can_filters": []}, False),  # has a filter of its own
    ],
)
def test_socketcan_is_asked_for_the_sensors_ids_only(settings, filtered):
    filters = [
        {"can_id": 0x500, "can_mask": 0x7FF, "extended": False},
        {"can_id": 0x501, "can_mask": 0x7FF, "extended": False},
        {"can_id": 0x18FF0000, "can_mask": 0x1FFFFFFF, "extended": True},
    ]
    expected = settings | {"can_filters": filters} if filtered else settings
    assert only(settings, {(0x501, False), (0x500, False), (0x18FF0000, True)}) == expected


def test_a_closed_bus_still_tells_its_counts():
    ours, theirs = socket.socketpair(type=socket.SOCK_DGRAM)
    with ours, theirs:
        reader = Reader(Socketcan([], ours), "socketcan can0")
        reader.close()
        assert reader.counts() == NO_LOSS
        assert ours.fileno() >= 0  # still theirs to close


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
    with pytest.raises(BusError, match=rf"{reason}[^\n]*$"):
        open_bus(**settings)


@pytest.mark.parametrize(
    ("error", "reason"),
    [
        *(
            (each, rf".*it says\sso.*: {hint}")
            for code, hint in (
                (errno.EPERM, "no permission: give the user access to the interface"),
                (errno.EACCES, "no permission: give the user access to the interface"),
                (errno.ENODEV, "no such interface: see `ip link show type can`"),
                (errno.ENETDOWN, "the interface is down: `ip link set CHANNEL up`"),
                (errno.EAFNOSUPPORT, "this machine's kernel has no SocketCAN: choose another interface"),
                (errno.ENOBUFS, "its queue is full"),
            )
            for each in (OSError(code, "it says so"), can.CanOperationError("it says\nso", code))
        ),
        # of a driver without its device
        (TypeError("'NoneType' is no integer"), "'NoneType' is no integer$"),
        (AttributeError("close"), "close$"),
        (KeyError(), "KeyError$"),
    ],
)
def test_whatever_a_driver_raises_is_an_error_of_its_bus_that_says_what_to_do(monkeypatch, error, reason):
    broken = Reader(Broken(error), "socketcan can0")
    monkeypatch.setattr("tactiled.bus.reader.Bus", Mock(side_effect=error))
    for act in (
        lambda: open_bus(interface="socketcan", channel="can0"),
        lambda: broken.receive(0),
        lambda: broken.send(Message(0.0, 1, b"")),
    ):
        with pytest.raises(BusError, match=f"^bus socketcan can0: {reason}") as caught:
            act()
        assert caught.value.__cause__ is error
        assert "\n" not in str(caught.value)
    broken.close()
