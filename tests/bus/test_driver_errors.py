"""What a bus's interface cannot decode is one message lost, and counted; only a bus that is gone is gone."""

import os
import socket
import time

import can
import msgpack
import numpy as np
import pytest

from tactiled.bus.driver_errors import MAX_LINE_BYTES, MAX_UNREADABLE_IN_A_ROW, is_gone
from tactiled.bus.reader import Reader, open_bus
from tactiled.config import parse
from tactiled.errors import BusError
from tactiled.live.service import Service
from tests.conftest import CONFIG, pressed, until

GROUP = "239.74.163.91"


def packed(**changes):
    fields = {"arbitration_id": 0x500, "is_extended_id": False, "dlc": 2, "data": b"ab", "timestamp": 1.0}
    return msgpack.packb(fields | changes)


JUNK = {
    "nothing": b"",
    "text": b"junk",
    "half a map": packed()[:20],
    "a number": msgpack.packb(7),
    "another map": msgpack.packb({"id": 7}),
    "a negative id": packed(arbitration_id=-3),
    "an id of 12 bits": packed(arbitration_id=0x800),
    "no whole id": packed(arbitration_id=1280.5),
    "another length": packed(dlc=8),
    "no data": packed(data=7),
    "bytes that are no text": b"\x81\xa5\xff\xff\xff\xff\xff\x01",
}


def take(reader, count, unreadable=0):
    """What is received until it is so many, and so much was unreadable."""
    got = []

    def enough():
        got.extend(reader.batch(0.05))
        return len(got) >= count and reader.unreadable >= unreadable

    until(enough)
    return got


def test_a_datagram_that_is_no_message_is_counted_and_the_sensor_stays_live(udp_port):
    bus = f'interface = "udp_multicast"\nchannel = "{GROUP}"\nport = {udp_port}'
    text = CONFIG.replace('interface = "virtual"\nchannel = "{channel}"', bus)
    service = Service(parse(text.format().replace("stale_after_s = 0.3", "stale_after_s = 60")))
    sensor, counts = service.sensor("palm"), pressed().ravel().astype(np.uint16)
    sender = open_bus(interface="udp_multicast", channel=GROUP, port=udp_port)
    with service.running(), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        for n, junk in enumerate(JUNK.values()):
            other.sendto(junk, (GROUP, udp_port))
            for each in sensor.codec.encode(counts, n, 0.0):
                sender.send(each)
            until(lambda n=n: (image := sensor.hub.latest()) and image.sequence == n)
        until(lambda: sensor.status().loss.unreadable == len(JUNK))
        assert sensor.status().state == "live"
        assert sensor.hub.latest().loss.unreadable == len(JUNK)  # it travels with the data
        assert sensor.hub.latest().loss.lost == 0
        assert "sensor_down" not in {each.kind for each in service.events.after(0)}
    sender.close()


@pytest.fixture
def serial():
    """An slcan adapter on a pseudo-terminal: what it says, and its reader."""
    ours, theirs = os.openpty()
    reader = open_bus(interface="slcan", channel=os.ttyname(theirs), bitrate=500000, sleep_after_open=0)
    yield ours, reader
    reader.close()
    for each in (ours, theirs):
        os.close(each)


GARBLED = {
    "no hexadecimal id": b"tz002AABB\r",
    "no hexadecimal data": b"t5002AAxx\r",
    "cut short": b"t5002AA\r",
    "cut to its kind": b"t\r",
    "a length that there is not": b"d500\r",
    "an id with a sign": b"t-502AABB\r",
    "no text": b"t50\xff\xfe\r",
    "data with a gap": b"t5002AA  \r",
}


def test_a_garbled_line_of_slcan_is_counted_and_the_next_message_comes(serial):
    adapter, reader = serial
    for n, (kind, line) in enumerate(GARBLED.items(), 1):
        os.write(adapter, line)
        os.write(adapter, b"t5001%02X\r" % n)
        assert [each.data for each in take(reader, 1, n)] == [bytes([n])], kind
    assert reader.unreadable == len(GARBLED)


def test_a_line_of_slcan_without_an_end_fills_no_memory(serial):
    adapter, reader = serial
    for n in range(1, 4):
        os.write(adapter, b"x" * (MAX_LINE_BYTES + 100))
        until(lambda n=n: not len(reader.batch(0.05)) and reader.unreadable >= n)
        assert len(reader._bus._buffer) < MAX_LINE_BYTES
    os.write(adapter, b"\r")
    until(lambda: not len(reader.batch(0.05)) and not reader._bus._buffer)
    os.write(adapter, b"t5001AA\r")
    assert [each.data for each in take(reader, 1)] == [b"\xaa"]


def test_an_adapter_that_is_unplugged_is_gone(serial):
    adapter, reader = serial
    closed, other = os.openpty()
    os.dup2(other, adapter)  # its end of the terminal is another's now
    with pytest.raises(BusError, match=r"^bus slcan"):
        until(lambda: len(reader.batch(0.05)))
    assert reader.unreadable == 0
    for each in (closed, other):
        os.close(each)


class Failing(can.BusABC):
    """A bus whose driver raises the same for ever, or, of no error, is silent."""

    def __init__(self, error, descriptor=None):
        self.error, self.descriptor, self.calls = error, descriptor, 0
        self._is_shutdown = True

    def fileno(self):
        if self.descriptor is None:
            raise NotImplementedError
        return self.descriptor

    def _recv_internal(self, timeout):
        self.calls += 1
        if self.error:
            raise self.error
        assert self.calls < 1000, "it does not end"
        time.sleep(min(timeout, 0.01))
        return None, False

    def send(self, *_):
        pass


def test_a_driver_that_fails_without_end_is_a_bus_that_is_gone():
    bus = Failing(ValueError("no such thing"))
    reader = Reader(bus, "it")
    with pytest.raises(BusError, match="bus it: no such thing"):
        list(map(reader.receive, [0.0] * (MAX_UNREADABLE_IN_A_ROW + 1)))
    assert (reader.unreadable, bus.calls) == (MAX_UNREADABLE_IN_A_ROW, MAX_UNREADABLE_IN_A_ROW + 1)


def test_a_clock_that_steps_back_while_a_silent_bus_is_read_does_not_hold_it_up(monkeypatch):
    bus, now = Failing(None), iter([1e9])
    monkeypatch.setattr("can.bus.time", lambda: next(now, 1e9 - 3600))
    assert Reader(bus, "it").frame(0.05) is None
    assert bus.calls < 100


def caused(error, cause):
    error.__cause__ = cause
    return error


@pytest.mark.parametrize(
    ("error", "expected"),
    [
        (OSError(19, "No such device"), True),
        (caused(can.CanOperationError("Could not read"), OSError(5, "Input/output error")), True),
        (can.CanOperationError("the driver's own", 7), True),
        (caused(can.CanOperationError("could not unpack"), TypeError("no such argument")), False),
        (can.CanOperationError("invalid delimiter byte"), False),
        (TypeError("ord() expected a character"), False),
        (ValueError("not hexadecimal"), False),
    ],
)
def test_a_bus_is_gone_when_its_file_or_socket_is(error, expected):
    ours, theirs = socket.socketpair(type=socket.SOCK_DGRAM)
    with theirs:
        with ours:
            assert is_gone(error, Failing(error, ours.fileno())) == expected
            closed = ours.fileno()
        assert is_gone(error, Failing(error, closed)) == (not isinstance(error, ValueError))
