"""Skins that must be asked or started: what is sent to them, and when."""

import pytest

from tactiled.bus.codecs.barrett import Barrett
from tactiled.bus.codecs.icub import Icub
from tactiled.bus.codecs.linker import Linker
from tactiled.bus.codecs.packed import Packed
from tactiled.bus.codecs.xela import Xela
from tactiled.bus.polling import START_AGAIN_S, Poll, Poller, Polling
from tactiled.config import parse
from tactiled.errors import BusError
from tactiled.frames import Message
from tactiled.live.service import Service
from tests.conftest import until
from tests.live.test_bus_thread import OPEN_BUS, Bus

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


def test_requests_leave_when_they_are_due_and_do_not_burst_after_a_delay():
    wire, poller = Wire(), Poller([Polling(polls=(FIRST, SECOND._replace(period_s=0.25)))])
    poller.start(10.0)
    requests = []
    for now in (10.0, 10.05, 10.1, 10.2, 10.25, 10.3, 15.3, 15.35, 15.4):
        wire.messages.clear()
        assert poller.send_due(wire.send, now) == 0
        requests.append([each.data[0] - 0xB0 for each in wire.messages])
    assert requests == [[1, 2], [], [1], [1], [2], [1], [1, 2], [], [1]]
    assert poller.wait_s(15.4) == pytest.approx(0.1)


def test_a_skin_that_takes_one_request_at_a_time_gets_them_apart_after_a_delay_too():
    wire, poller = Wire(), Poller([Polling(polls=(FIRST, SECOND._replace(after_s=0.02)))])
    poller.start(10.0)
    requests = []
    for now in (10.0, 10.02, 10.1, 10.12, 15.0, 15.1, 15.12):
        wire.messages.clear()
        poller.send_due(wire.send, now)
        requests.append([each.data[0] - 0xB0 for each in wire.messages])
    assert requests == [[1], [2], [1], [2], [1, 2], [1], [2]]


def test_skins_are_exchanged_without_a_pause_for_those_that_stay():
    wire, poller = Wire(), Poller([Polling(polls=(FIRST,)), STARTED._replace(polls=(), start=())])
    poller.start(10.0)
    poller.send_due(wire.send, 10.0)
    wire.messages.clear()
    other = poller.exchanged(
        [Polling(polls=(FIRST,)), Polling(start=((0.5, GO), (0.0, SET)), polls=(SECOND,))], wire.send, 10.05
    )
    assert wire.messages == [STOP]
    turns = []
    for now in (10.05, 10.1, 10.54, 10.55):
        wire.messages.clear()
        other.send_due(wire.send, now)
        turns.append(wire.messages.copy())
    assert turns == [[SET], [FIRST.message], [FIRST.message], [GO, SECOND.message]]
    again = poller.exchanged([STARTED], wire.send, 10.6).exchanged([STARTED], wire.send, 10.6)
    wire.messages.clear()
    again.send_due(wire.send, 11.1)
    assert wire.messages == [SET, GO, FIRST.message]  # its start goes on where it was


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
    poller = Poller(codec.polling for codec in (Packed(4), Icub(1, (0,)), Xela(), Barrett(11), Linker(poll_hz=0)))
    poller.start(0.0)
    assert poller.wait_s(0.0) == float("inf")


STOPS = ["0701"]
STARTS = ["4d001ef0", "50050502010022", "0700"]  # as the robot's own software


@pytest.mark.parametrize(
    ("codec", "id_", "start", "delays", "stop", "polls"),
    [
        (Icub(13, (5,), start=True), 0x20D, STARTS, [0.0, 0.0, 0.5], STOPS, []),
        (
            Icub(2, (5,), start=True, period_ms=20),
            0x202, ["4d0014f0", "50050502010022", "0700"], [0.0, 0.0, 0.5], STOPS, [],
        ),
        (  # robots-configuration: iCubGenova09/hardware/skin/left_upperarm-eb2-skinSpec.xml
            Icub(8, (0, 1, 2, 13), start=True, skin_type=8, period_ms=50),
            0x208, ["4d0832f0", "50000202010022", "500d0d02010022", "0700"], [0.0, 0.0, 0.0, 0.5], STOPS, [],
        ),
        (  # ergoCubSN001/hardware/skin/left_arm-eb4-j2_3-skinSpec.xml
            Icub(2, (9, 8, 7, 6, 5, 4, 3, 2, 1, 0), True, 3, True, 50, shift=1, cdc_offset=0),
            0x202, ["4d0332f0", "50000901010000", "0700"], [0.0, 0.0, 0.5], STOPS, [],
        ),
        (
            Linker("right", (2, 1), poll_hz=50), 0x27, [], [], [],
            [("b2c6", range(12), 0.02), ("b1c6", range(12, 24), 0.02)],
        ),
    ],
)  # fmt: skip
def test_golden_messages_to_skins(codec, id_, start, delays, stop, polls):
    polling = codec.polling
    assert [(after, each.data.hex()) for after, each in polling.start] == list(zip(delays, start, strict=True))
    assert [each.data.hex() for each in polling.stop] == stop
    assert [(each.message.data.hex(), each.segments, each.period_s) for each in polling.polls] == polls
    messages = [each for _, each in polling.start] + [each.message for each in polling.polls] + [*polling.stop]
    assert {each.id for each in messages} == {id_}


CONFIG = """
[bus.can0]
interface = "virtual"
[sensor.hand]
bus = "can0"
stale_after_s = 600
codec = { name = "linker", hand = "left", fingers = [2, 1], poll_hz = 50 }
array = { rows = 24, columns = 6, pitch_mm = 1.0 }
cover = { thickness_mm = 2.0, young_mpa = 0.3, poisson = 0.45 }
kernel = { model = "layered" }
[sensor.board]
bus = "can0"
codec = { name = "icub", board = 13, triangles = [5], start = true }
array = { aperture_mm = 3.6 }
cover = { thickness_mm = 2.0, young_mpa = 0.3, poisson = 0.45 }
kernel = { model = "layered" }
"""


def test_skins_are_started_and_asked_again_when_the_bus_is_back_and_unsent_messages_are_counted(monkeypatch):
    wire, bus = Wire(), Bus()
    bus.send = wire.send

    def payloads_on(id_):
        return [each.data.hex() for each in list(wire.messages) if each.id == id_]

    monkeypatch.setattr(OPEN_BUS, bus.open)
    service = Service(parse(CONFIG))
    hand = service.sensor("hand")
    with service.running():
        until(lambda: payloads_on(0x20D) == STARTS and len(payloads_on(0x28)) >= 4)
        wire.takes = False
        until(lambda: hand.status().loss.unsent >= 2)
        bus.plugged = False
        until(lambda: hand.status().state == "down")
        unsent = hand.status().loss.unsent
        wire.messages.clear()
        wire.takes = bus.plugged = True
        until(lambda: payloads_on(0x20D) == STARTS and len(payloads_on(0x28)) >= 4)
        assert bus.opened == 2
        assert hand.status().loss.unsent == unsent
    assert payloads_on(0x20D) == STARTS + STOPS
