import time
from itertools import count

import numpy as np
import pytest

from tactiled.bus.batch import Batch
from tactiled.bus.router import Router
from tactiled.errors import BusError
from tactiled.frames import Message
from tactiled.live.bus_thread import BusThread
from tactiled.live.sensor import Sensor
from tests.conftest import until

OPEN_BUS = "tactiled.live.bus_thread.open_bus"


class Bus:
    """A stand-in for an adapter that a test plugs and unplugs."""

    def __init__(self):
        self.plugged = True
        self.opened = self.closed = self.unsent = 0
        self.messages, self.counted, self.kinds = [], {}, {}
        self.off = None
        self.clock = "python-can adapter"

    def counts(self):
        return self.counted | {"unsent": self.unsent}

    def open(self, **_):
        if not self.plugged:
            raise BusError("bus adapter: no such device")
        self.opened += 1
        self.unsent = 0  # every reader counts anew
        return self

    def batch(self, timeout, needed=1):
        if not self.plugged:
            raise BusError("bus adapter: no such device")
        if not self.messages:
            time.sleep(timeout / 10)
            return Batch.of(())
        return Batch.of([self.messages.pop(0) for _ in range(min(needed, len(self.messages)))])

    def send(self, message):
        raise AssertionError(f"this skin needs no message: {message}")

    def close(self):
        self.closed += 1


class Line:
    """A bus, its sensor and the thread between."""

    def __init__(self, plan):
        self.bus, self.sensor = Bus(), Sensor(plan)
        self.listener = BusThread("can0", {}, {"palm": self.sensor})

    def send(self, sequence, when=None, counts=100):
        when = time.time() if when is None else when
        self.bus.messages += self.sensor.codec.encode(np.full(64, counts, np.uint16), sequence, when)

    def until_image(self, sequence):
        until(lambda: (image := self.sensor.hub.latest()) and image.sequence == sequence)

    def until_state(self, state):
        until(lambda: self.sensor.status().state == state)


@pytest.fixture
def line(plan, monkeypatch):
    line = Line(plan)
    monkeypatch.setattr(OPEN_BUS, line.bus.open)
    line.sensor.start()
    line.listener.start()
    yield line
    line.listener.stop()
    line.sensor.stop()


def test_of_frames_of_one_sensor_that_come_together_only_the_newest_is_restored(plan, monkeypatch):
    line = Line(plan)
    for sequence in range(4):
        line.send(sequence)
    monkeypatch.setattr(line.bus, "batch", lambda *_: (Batch.of(line.bus.messages), line.bus.messages.clear())[0])
    monkeypatch.setattr(OPEN_BUS, line.bus.open)
    line.sensor.hand_over._took_s = 0.0
    line.listener.start()
    line.until_image(3)
    line.listener.stop()
    assert line.sensor.hub.latest().loss.skipped == 3


@pytest.mark.parametrize("malformed", [0, 3])
def test_frames_that_fill_every_batch_are_restored_while_more_come(plan, monkeypatch, malformed):
    line, numbers = Line(plan), count()
    key = min(plan.codec.ids)[0]

    def batch(*_):
        line.send(next(numbers))
        messages, line.bus.messages = line.bus.messages, []
        return Batch.of(messages + malformed * [Message(0.0, key, b"")])

    monkeypatch.setattr("tactiled.live.bus_thread.MAX_FRAMES", plan.codec.segments + malformed)
    monkeypatch.setattr(line.bus, "batch", batch)
    monkeypatch.setattr(OPEN_BUS, line.bus.open)
    line.sensor.hand_over._took_s = 0.0
    line.listener.start()
    try:
        until(line.sensor.hub.latest)
    finally:
        line.listener.stop()


def test_a_bus_that_goes_away_is_opened_again_when_it_is_back(line):
    line.send(0)
    line.until_image(0)
    assert line.sensor.clock == "python-can adapter"
    line.bus.plugged = False
    line.until_state("down")
    assert line.sensor.status().detail == "bus adapter: no such device"
    assert line.sensor.hub.latest().sequence == 0  # still served, but not as live
    line.bus.plugged = True
    until(lambda: line.sensor.health.down is None)
    line.send(1)
    line.until_image(1)
    assert (line.bus.opened, line.bus.closed) == (2, 1)


def test_a_fault_of_the_service_is_the_detail_of_the_bus_which_goes_on(line, monkeypatch, caplog):
    with monkeypatch.context() as broken:
        broken.setattr(Router, "push", lambda *_: {}["byte 7"])
        line.send(0)
        line.until_state("down")
    assert line.sensor.status().detail == "bus can0: the service failed at it: KeyError: 'byte 7'"
    assert "KeyError" in caplog.text
    line.bus.messages.clear()
    until(lambda: line.sensor.health.down is None)
    line.send(1)
    until(line.sensor.hub.latest)


@pytest.mark.parametrize(("longest_s", "logged"), [(60.0, 1), (0.0, 3)])
def test_the_same_fault_is_logged_again_after_a_healthy_stretch(plan, monkeypatch, caplog, longest_s, logged):
    line = Line(plan)
    monkeypatch.setattr(OPEN_BUS, line.bus.open)
    monkeypatch.setattr("tactiled.live.bus_thread.BACK_OFF_S", (0.0, longest_s))
    monkeypatch.setattr(Router, "push", lambda *_: {}["byte 7"])
    line.send(0)
    messages, line.bus.messages = line.bus.messages[:1], []
    line.listener.start()
    for closed in (1, 2, 3):
        line.bus.messages += messages
        until(lambda closed=closed: line.bus.closed == closed)
    line.listener.stop()
    faults = [each for each in caplog.records if each.name == "tactiled.live.bus_thread"]
    assert [each.exc_info[0] for each in faults] == [KeyError] * logged


@pytest.mark.parametrize("ahead", [3600.0, -1.7e9])
@pytest.mark.parametrize("busy", [False, True])
def test_half_a_frame_before_a_silence_is_shown_whatever_the_clock_of_the_bus(line, ahead, busy):
    line.send(0, time.time() + ahead)
    line.send(1, time.time() + ahead)
    line.bus.messages.pop()
    line.until_image(0)

    def is_shown():
        if busy:  # other messages never stop
            line.bus.messages.append(Message(time.time() + ahead, 0x123, b""))
        return line.sensor.hub.latest().sequence == 1

    until(is_shown)
    assert line.sensor.hub.latest().loss.incomplete == 1


def test_counts_of_a_bus_add_up_when_it_is_opened_again(line):
    bus, sensor = line.bus, line.sensor
    bus.counted = {"dropped": 3, "errors": 2, "bus_off": 1}
    bus.kinds = {"bus_off": 1, "no_ack": 2, "other": 0}
    bus.off = "bus adapter: bus-off"
    until(lambda: sensor.status().detail == "bus adapter: bus-off")
    assert sensor.status().state == "down"
    loss = sensor.status().loss
    assert (loss.dropped, loss.errors, loss.bus_off) == (3, 2, 1)
    assert sensor.status().errors == {"bus_off": 1, "no_ack": 2}
    bus.off = None
    line.until_state("silent")
    bus.messages.append(Message(1.0, 0x123, b""))
    until(lambda: sensor.status().loss.foreign == 1)  # without a frame
    bus.plugged = False
    until(lambda: bus.closed == 1)
    bus.plugged = True
    until(lambda: bus.opened == 2)
    assert sensor.status().loss.errors == 4  # the bus of this test begins with two
    assert sensor.status().errors["no_ack"] == 4
    line.send(0)
    line.until_image(0)
    assert sensor.hub.latest().loss.errors == 4
