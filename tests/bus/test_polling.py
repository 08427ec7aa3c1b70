"""Skins that must be asked or started: what is sent to them, and when; end to end on the virtual bus."""

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
from tactiled.errors import BusError
from tactiled.frames import Message
from tactiled.runtime.service import Service
from tactiled.simulate import answer, player
from tests.conftest import BUSY_S, until

FIRST, SECOND = (Poll(Message(0.0, 0x27, bytes((each, 0xC6))), 0.1, range(1)) for each in (0xB1, 0xB2))
SET, GO, STOP = (Message(0.0, 0x20D, bytes((each,))) for each in (1, 2, 3))
STARTED = Polling(start=((0.5, GO), (0.0, SET)), polls=(FIRST,), stop=(STOP,))


class Wire:
    """A bus that takes messages, or does not."""

    def __init__(self):
        self.messages, self.takes = [], True

    def send(self, message):
        if not self.takes:
            raise BusError("full")
        self.messages.append(message)


def test_requests_leave_when_they_are_due():
    wire, poller = Wire(), Poller([Polling(polls=(FIRST, SECOND._replace(period_s=0.25)))])
    poller.start(10.0)
    requests = []
    for now in (10.0, 10.05, 10.1, 10.2, 10.25, 10.3):
        wire.messages.clear()
        assert poller.send_due(wire.send, now) == 0
        requests.append([each.data[0] for each in wire.messages])
    assert requests == [[0xB1, 0xB2], [], [0xB1], [0xB1], [0xB2], [0xB1]]
    assert poller.wait_s(10.3) == pytest.approx(0.1)


def test_requests_that_were_held_up_do_not_burst():
    wire, poller = Wire(), Poller([Polling(polls=(FIRST,))])
    poller.start(0.0)
    for now in (0.0, 5.0, 5.05, 5.1):
        poller.send_due(wire.send, now)
    assert len(wire.messages) == 3
    assert poller.wait_s(5.1) == pytest.approx(0.1)


def test_a_skin_is_set_up_then_started_then_asked_and_stopped_at_the_end():
    wire, poller = Wire(), Poller([STARTED, STARTED])  # two arrays of one board: started once
    poller.start(0.0)
    poller.send_due(wire.send, 0.0)
    assert (wire.messages, poller.wait_s(0.0)) == ([SET], 0.5)
    poller.send_due(wire.send, 0.5)
    assert wire.messages == [SET, GO, FIRST.message, FIRST.message]
    poller.stop(wire.send)
    assert wire.messages[4:] == [STOP]


def test_a_start_that_the_bus_does_not_take_is_counted_and_sent_again():
    wire, poller = Wire(), Poller([STARTED])
    poller.start(0.0)
    wire.takes = False
    assert poller.send_due(wire.send, 0.0) == 1
    wire.takes = True
    assert poller.send_due(wire.send, 0.9) == 0
    assert poller.wait_s(0.9) == pytest.approx(START_AGAIN_S - 0.9)
    assert poller.send_due(wire.send, START_AGAIN_S) == 0
    assert wire.messages == [SET]


def test_most_skins_are_sent_nothing():
    poller = Poller(codec.polling for codec in (Packed(4), Icub(1, (0,)), Xela(), Linker(poll_hz=0)))
    poller.start(0.0)
    assert poller.wait_s(0.0) == float("inf")


@pytest.mark.parametrize(
    ("codec", "start", "stop"),
    [
        (
            Icub(13, (5,), start=True),  # as the robot's own software
            [(0.0, 0x20D, "4d001ef0"), (0.0, 0x20D, "50000f00010022"), (0.5, 0x20D, "0700")],
            [(0x20D, "0701")],
        ),
        (
            Icub(2, (5,), start=True, period_ms=20),
            [(0.0, 0x202, "4d0014f0"), (0.0, 0x202, "50000f00010022"), (0.5, 0x202, "0700")],
            [(0x202, "0701")],
        ),
        (Xela("4x4-old", controller=2, start=True), [(0.0, 0x202, "0700")], [(0x202, "0701")]),
    ],
)
def test_golden_start_and_stop_messages(codec, start, stop):
    polling = codec.polling
    assert [(after, each.id, each.data.hex()) for after, each in polling.start] == start
    assert [(each.id, each.data.hex()) for each in polling.stop] == stop
    assert polling.polls == ()


def test_golden_requests():
    polls = Linker("right", (2, 1), poll_hz=50).polling.polls
    assert [(each.message.id, each.message.data.hex()) for each in polls] == [(0x27, "b2c6"), (0x27, "b1c6")]
    assert [(each.segments, each.period_s) for each in polls] == [(range(12), 0.02), (range(12, 24), 0.02)]


CONFIG = """
[bus.can0]
interface = "virtual"
channel = "{channel}"
[sensor.skin]
bus = "can0"
method = "raw"
stale_after_s = 600
codec = {{ {codec} }}
array = {{ {array} }}
cover = {{ thickness_mm = 2.0, young_mpa = 0.3, poisson = 0.45 }}
kernel = {{ model = "layered" }}
calibration = {{ kpa_per_count = 0.5 }}
"""
HAND = 'name = "linker", hand = "left", fingers = [2, 1], poll_hz = 50', "rows = 24, columns = 6, pitch_mm = 1.0"
BOARD = 'name = "icub", board = 13, triangles = [5], start = true', "aperture_mm = 3.6"
STARTS = ["4d001ef0", "50000f00010022", "0700"]


@pytest.fixture
def other(request):
    """The other end of the bus."""
    bus = open_bus(interface="virtual", channel=request.node.name)
    yield bus
    bus.close()


def config(request, settings):
    return parse(CONFIG.format(channel=request.node.name, codec=settings[0], array=settings[1]))


def test_a_polled_hand_is_asked_and_its_answers_are_served(request, other):
    """The simulator stands in for the hand: it sends nothing but when it is asked."""
    settings = config(request, HAND)
    (sensor,) = settings.sensor.values()
    kernel = solve(Stack((Layer(2.0, 0.3, 0.45),)), "layered")
    hand = player(make_array(sensor), kernel, make_codec(sensor), Calibration(0.5), "sphere", 0.0)
    stop, answered = Event(), []
    thread = Thread(target=lambda: answered.append(answer(hand, other.receive, other.send, stop)))
    thread.start()
    service = Service(settings)
    service.start()
    try:
        until(lambda: (i := service.sensor("skin").hub.latest()) and i.sequence >= 5 and not i.flags.any())
        image = service.sensor("skin").hub.latest()
    finally:
        service.stop()
        stop.set()
        thread.join()
    assert image.raw.shape == (24, 6)
    assert np.nanmax(image.raw) > 1
    assert (image.loss.malformed, image.loss.unsent) == (0, 0)
    assert answered[0] >= 10  # two fingers, five frames
    while other.receive(0.0) is not None:
        pass
    assert other.receive(0.2) is None  # after the service has ended nothing is asked


def test_a_board_is_started_by_the_service_and_stopped_at_its_end(request, other):
    service = Service(config(request, BOARD))
    began = time.monotonic()
    service.start()
    starts = [other.receive(BUSY_S).data.hex() for _ in range(3)]
    assert time.monotonic() - began > 0.4
    service.stop()
    assert [*starts, other.receive(BUSY_S).data.hex()] == [*STARTS, "0701"]


@pytest.fixture
def adapter(monkeypatch):
    """A bus that is present or not, what was sent on it, and the times that it was opened."""
    wire, present, opened = Wire(), [True], []

    class Bus:
        off, clock, send, close = None, "python-can fake", staticmethod(wire.send), staticmethod(lambda: None)

        def __init__(self):
            self.unsent, self.kinds = 0, {}

        def counts(self):
            return {"unsent": self.unsent}

        def batch(self, timeout):
            time.sleep(min(timeout, 0.01))
            if not present[0]:
                raise BusError("gone")
            return []

    def reopen(**_):
        if not present[0]:
            raise BusError("gone")
        opened.append(Bus())
        return opened[-1]

    monkeypatch.setattr("tactiled.runtime.bus_thread.open_bus", reopen)
    return wire, present, opened


def test_a_board_is_started_again_when_the_bus_is_back(request, adapter):
    wire, present, opened = adapter
    service = Service(config(request, BOARD))
    service.start()
    try:
        until(lambda: len(wire.messages) == 3)
        present[0] = False
        until(lambda: service.sensor("skin").status().state == "down")
        present[0] = True
        until(lambda: len(wire.messages) == 6)
    finally:
        service.stop()
    assert len(opened) == 2
    assert [each.data.hex() for each in wire.messages] == [*STARTS, *STARTS, "0701"]


def test_requests_begin_again_when_the_bus_is_back_and_unsent_ones_are_counted(request, adapter):
    wire, present, opened = adapter
    service = Service(config(request, HAND))
    service.start()
    try:
        until(lambda: len(wire.messages) >= 4)
        wire.takes = False
        until(lambda: service.sensor("skin").status().loss.unsent >= 2)
        present[0] = False
        until(lambda: service.sensor("skin").status().state == "down")
        unsent = service.sensor("skin").status().loss.unsent
        wire.messages.clear()
        wire.takes = present[0] = True
        until(lambda: len(wire.messages) >= 4)
        assert len(opened) == 2
        assert service.sensor("skin").status().loss.unsent == unsent
    finally:
        service.stop()
