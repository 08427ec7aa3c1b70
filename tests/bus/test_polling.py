"""Skins that must be asked or started: what is said to them, and when; end to end on the virtual bus."""

import time
from threading import Event, Thread

import numpy as np
import pytest

from tactiled.build import make_array, make_codec
from tactiled.bus.codecs.icub import Icub
from tactiled.bus.codecs.linker import Linker
from tactiled.bus.codecs.packed import Packed
from tactiled.bus.codecs.xela import Xela
from tactiled.bus.polling import START_AGAIN_S, Poll, Poller, Polling
from tactiled.bus.reader import open_bus
from tactiled.calibrate.calibration import Calibration
from tactiled.config import parse
from tactiled.cover.kernel import solve
from tactiled.cover.stack import Layer, Stack
from tactiled.errors import BusError, ConfigError
from tactiled.frames import Message
from tactiled.runtime.service import Service
from tactiled.simulate import answer, player
from tests.conftest import BUSY_S, until

ASK, OTHER = Message(0.0, 0x27, b"\xb1\xc6"), Message(0.0, 0x27, b"\xb2\xc6")
SET, GO, STOP = (Message(0.0, 0x20D, bytes((each,))) for each in (1, 2, 3))
STARTED = Polling(start=((0.5, GO), (0.0, SET)), polls=(Poll(ASK, 0.1, range(1)),), stop=(STOP,))


class Wire:
    """A bus that takes messages, or does not."""

    def __init__(self):
        self.sent, self.takes = [], True

    def send(self, message):
        if not self.takes:
            raise BusError("full")
        self.sent.append(message)


def test_requests_leave_when_they_are_due():
    wire, talker = Wire(), Poller([Polling(polls=(Poll(ASK, 0.1, range(1)), Poll(OTHER, 0.25, range(1))))])
    talker.start(10.0)
    said = []
    for now in (10.0, 10.05, 10.1, 10.2, 10.25, 10.3):
        wire.sent.clear()
        assert talker.send_due(wire.send, now) == 0
        said.append([each.data[0] for each in wire.sent])
    assert said == [[0xB1, 0xB2], [], [0xB1], [0xB1], [0xB2], [0xB1]]
    assert talker.wait_s(10.3) == pytest.approx(0.1)


def test_requests_that_were_held_up_do_not_burst():
    wire, talker = Wire(), Poller([Polling(polls=(Poll(ASK, 0.1, range(1)),))])
    talker.start(0.0)
    for now in (0.0, 5.0, 5.05, 5.1):
        talker.send_due(wire.send, now)
    assert len(wire.sent) == 3
    assert talker.wait_s(5.1) == pytest.approx(0.1)


def test_a_skin_is_set_up_then_started_then_asked_and_stopped_at_the_end():
    wire, talker = Wire(), Poller([STARTED, STARTED])  # two arrays of one board: said once
    talker.start(0.0)
    talker.send_due(wire.send, 0.0)
    assert (wire.sent, talker.wait_s(0.0)) == ([SET], 0.5)
    talker.send_due(wire.send, 0.5)
    assert wire.sent == [SET, GO, ASK, ASK]
    talker.stop(wire.send)
    assert wire.sent[4:] == [STOP]


def test_a_start_that_the_bus_does_not_take_is_counted_and_said_again():
    wire, talker = Wire(), Poller([STARTED])
    talker.start(0.0)
    wire.takes = False
    assert talker.send_due(wire.send, 0.0) == 1
    wire.takes = True
    assert talker.send_due(wire.send, 0.9) == 0
    assert talker.wait_s(0.9) == pytest.approx(START_AGAIN_S - 0.9)
    assert talker.send_due(wire.send, START_AGAIN_S) == 0
    assert wire.sent == [SET]


def test_most_skins_are_told_nothing():
    talker = Poller([codec.polling for codec in (Packed(4), Icub(1, (0,)), Xela(), Linker(poll_hz=0))])
    talker.start(0.0)
    assert talker.wait_s(0.0) == float("inf")
    assert talker.send_due(Wire().send, 1.0) == 0


def test_an_icub_board_is_told_what_the_robots_software_tells_it():
    talk = Icub(13, (5,), start=True).polling
    assert [(after, each.id, each.data.hex()) for after, each in talk.start] == [
        (0.0, 0x20D, "4d001ef0"),
        (0.0, 0x20D, "50000f00010022"),
        (0.5, 0x20D, "0700"),
    ]
    assert [(each.id, each.data.hex()) for each in talk.stop] == [(0x20D, "0701")]
    assert Icub(13, (5,), start=True, period_ms=20).polling.start[0][1].data.hex() == "4d0014f0"


def test_an_older_xela_board_is_started_and_a_new_one_is_not():
    talk = Xela("4x4-old", controller=2, start=True).polling
    assert [(after, each.id, each.data.hex()) for after, each in talk.start] == [(0.0, 0x202, "0700")]
    assert [(each.id, each.data.hex()) for each in talk.stop] == [(0x202, "0701")]
    with pytest.raises(ConfigError, match=r"start = true: modules of the current profile send by themselves"):
        Xela(start=True)


CONFIG = """
[bus.can0]
interface = "virtual"
channel = "{channel}"
[sensor.skin]
bus = "can0"
method = "raw"
stale_after_s = 2
codec = {{ {codec} }}
array = {{ {array} }}
cover = {{ thickness_mm = 2.0, young_mpa = 0.3, poisson = 0.45 }}
kernel = {{ model = "layered" }}
calibration = {{ kpa_per_count = 0.5 }}
"""
HAND = 'name = "linker", hand = "left", fingers = [2, 1], poll_hz = 50', "rows = 24, columns = 6, pitch_mm = 1.0"
BOARD = 'name = "icub", board = 13, triangles = [5], start = true', "aperture_mm = 3.6"


@pytest.fixture
def channel(request):
    return request.node.name


@pytest.fixture
def there(channel):
    bus = open_bus(interface="virtual", channel=channel)
    yield bus
    bus.close()


def config(channel, settings):
    return parse(CONFIG.format(channel=channel, codec=settings[0], array=settings[1]))


def test_a_polled_hand_is_asked_and_what_it_answers_is_served(channel, there):
    """The simulator stands in for the hand: it says nothing but when it is asked."""
    asked = config(channel, HAND)
    (sensor,) = asked.sensor.values()
    kernel = solve(Stack((Layer(2.0, 0.3, 0.45),)), "layered")
    calibration = Calibration(0.5)
    hand = player(make_array(sensor), kernel, make_codec(sensor), calibration, "sphere", 0.0)
    stop, answered = Event(), []
    thread = Thread(target=lambda: answered.append(answer(hand, there.receive, there.send, stop)))
    thread.start()
    service = Service(asked)
    service.start()
    try:
        until(lambda: (i := service.sensor("skin").hub.latest()) and i.sequence >= 5 and not i.flags.any(), 20)
        image = service.sensor("skin").hub.latest()
    finally:
        service.stop()
        stop.set()
        thread.join()
    assert image.raw.shape == (24, 6)
    assert np.nanmax(image.raw) > 1
    assert (image.loss.malformed, image.loss.unsent) == (0, 0)
    assert answered[0] >= 10  # two fingers, five frames


def test_after_the_service_ends_nothing_is_asked(channel, there):
    service = Service(config(channel, HAND))
    service.start()
    assert there.receive(BUSY_S).data.hex() == "b2c6"
    assert there.receive(BUSY_S).data.hex() == "b1c6"
    service.stop()
    while there.receive(0.0) is not None:
        pass
    assert there.receive(0.2) is None


def test_a_board_is_started_by_the_service_and_stopped_at_its_end(channel, there):
    service = Service(config(channel, BOARD))
    began = time.monotonic()
    service.start()
    said = [there.receive(BUSY_S).data.hex() for _ in range(3)]
    assert time.monotonic() - began > 0.4
    service.stop()
    assert [*said, there.receive(BUSY_S).data.hex()] == ["4d001ef0", "50000f00010022", "0700", "0701"]


@pytest.fixture
def adapter(monkeypatch):
    """A bus that is there or not, what was sent on it, and the times that it was opened."""
    wire, there, opened = Wire(), [True], []

    class Bus:
        off = None

        def __init__(self):
            self.unsent, self.kinds, self.closed = 0, {}, False
            self.clock = "python-can fake"

        def counts(self):
            return {"unsent": self.unsent}

        def batch(self, timeout):
            time.sleep(min(timeout, 0.01))
            if not there[0]:
                raise BusError("gone")
            return []

        def send(self, message):
            wire.send(message)

        def close(self):
            self.closed = True

    def reopen(**_):
        if not there[0]:
            raise BusError("gone")
        opened.append(Bus())
        return opened[-1]

    monkeypatch.setattr("tactiled.runtime.bus_thread.open_bus", reopen)
    return wire, there, opened


def test_a_board_is_started_again_when_the_bus_is_back(channel, adapter):
    wire, there, opened = adapter
    service = Service(config(channel, BOARD))
    service.start()
    try:
        until(lambda: len(wire.sent) == 3)
        there[0] = False
        until(lambda: service.sensor("skin").status().state == "down")
        there[0] = True
        until(lambda: len(wire.sent) == 6)
    finally:
        service.stop()
    assert len(opened) == 2
    assert wire.sent[:3] == wire.sent[3:6]
    assert wire.sent[6].data == b"\x07\x01"


def test_requests_begin_again_when_the_bus_is_back_and_unsent_ones_are_counted(channel, adapter):
    wire, there, opened = adapter
    service = Service(config(channel, HAND))
    service.start()
    try:
        until(lambda: len(wire.sent) >= 4)
        wire.takes = False
        until(lambda: service.sensor("skin").status().loss.unsent >= 2)
        there[0] = False
        until(lambda: service.sensor("skin").status().state == "down")
        unsent = service.sensor("skin").status().loss.unsent
        wire.sent.clear()
        wire.takes = there[0] = True
        until(lambda: len(wire.sent) >= 4)
        assert len(opened) == 2
        assert service.sensor("skin").status().loss.unsent == unsent
    finally:
        service.stop()
