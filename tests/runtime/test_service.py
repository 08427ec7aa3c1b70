import threading
import time
from dataclasses import replace

import numpy as np
import pytest

from tactiled.build import sensor_plan
from tactiled.bus.reader import open_bus
from tactiled.config import parse
from tactiled.errors import BusError, ConfigError, UnknownSensorError
from tactiled.frames import Loss, Message, RawFrame
from tactiled.runtime.bus_thread import Listener
from tactiled.runtime.sensor import Sensor
from tactiled.runtime.service import Service
from tests.conftest import CONFIG, NO_LOAD, pressed, until


@pytest.fixture
def plan():
    return sensor_plan("palm", parse(CONFIG.format(channel="none")).sensor["palm"])


def frame(sequence, counts=None):
    counts = pressed() if counts is None else counts
    return RawFrame(
        sequence, 1.0, 0.0, np.asarray(counts, np.uint16).ravel(), np.zeros(64, np.uint8), Loss(lost=2)
    )


def test_a_sensor_says_how_it_is_doing(plan):
    now = [100.0]
    sensor = Sensor(plan, lambda: now[0])
    assert (sensor.status().state, sensor.status().age_s) == ("silent", None)
    for n in range(200):
        now[0] += 0.01
        sensor.offer(frame(n))
    status = sensor.status()
    assert (status.state, status.age_s, status.detail) == ("live", 0, "")
    assert status.rate_hz == pytest.approx(100, rel=0.01)
    now[0] += 1.25
    status = sensor.status()
    assert (status.state, status.rate_hz, status.detail) == ("stale", 0, "no frame for 1.2 s")
    assert status.age_s == pytest.approx(1.25)
    sensor.down = "bus can0: gone"
    assert (sensor.status().state, sensor.status().detail) == ("down", "bus can0: gone")


def test_a_frame_that_waits_when_the_next_one_comes_is_skipped_and_counted(plan):
    sensor = Sensor(plan)
    for n in range(5):
        sensor.offer(frame(n))
    sensor.start()
    until(sensor.hub.latest)
    image = sensor.hub.latest()
    sensor.stop()
    assert image.sequence == 4
    assert (image.loss.skipped, image.loss.lost) == (4, 2)
    assert sensor.status().loss.skipped == 4


def test_a_frame_that_cannot_be_restored_is_told_and_ends_nothing(plan, monkeypatch):
    sensor = Sensor(plan, lambda: 0.0)
    sensor.start()
    process = sensor._pipeline.process
    monkeypatch.setattr(sensor._pipeline, "process", lambda _: 1 / 0)
    sensor.offer(frame(0))
    until(lambda: sensor.status().state == "stale")
    assert sensor.status().detail == "restoration failed: ZeroDivisionError: division by zero"
    monkeypatch.setattr(sensor._pipeline, "process", process)
    sensor.offer(frame(1))
    until(lambda: sensor.status().state == "live")
    sensor.stop()
    assert sensor.hub.latest().sequence == 1


class Bus:
    """A bus that is there or not, as a test says; stands in for an adapter that is unplugged."""

    def __init__(self):
        self.there = True
        self.opened = 0
        self.closed = 0
        self.messages = []
        self.off = None
        self.counted = {}
        self.kinds = {}
        self.unsent = 0
        self.clock = "python-can adapter"

    def counts(self):
        return self.counted

    def open(self, **_):
        if not self.there:
            raise BusError("bus adapter: no such device")
        self.opened += 1
        return self

    def batch(self, timeout):
        if not self.there:
            raise BusError("bus adapter: no such device")
        if not self.messages:
            time.sleep(timeout / 10)
            return []
        return [self.messages.pop(0)]

    def send(self, message):
        raise AssertionError(f"nothing is to be said to this skin: {message}")

    def close(self):
        self.closed += 1


def test_a_bus_that_goes_away_is_told_and_opened_again_when_it_is_back(plan, monkeypatch):
    bus, sensor = Bus(), Sensor(plan, lambda: 0.0)
    monkeypatch.setattr("tactiled.runtime.bus_thread.open_bus", bus.open)
    listener = Listener("can0", {}, {"palm": sensor})
    sensor.start()
    listener.start()

    def show(sequence):
        bus.messages += sensor.codec.encode(pressed().ravel().astype(np.uint16), sequence, time.time())
        until(lambda: (image := sensor.hub.latest()) and image.sequence == sequence)

    show(0)
    assert sensor.status().state == "live"
    bus.there = False
    until(lambda: sensor.status().state == "down")
    assert sensor.status().detail == "bus adapter: no such device"
    assert sensor.hub.latest().sequence == 0  # still there, but no longer served as live
    bus.there = True
    until(lambda: sensor.down is None)
    show(1)
    assert sensor.status().state == "live"
    assert (bus.opened, bus.closed) == (2, 1)
    listener.stop()
    sensor.stop()


def test_a_fault_of_a_codec_is_told_and_ends_no_bus(plan, monkeypatch, caplog):
    bus, sensor = Bus(), Sensor(plan)
    monkeypatch.setattr("tactiled.runtime.bus_thread.open_bus", bus.open)
    listener = Listener("can0", {}, {"palm": sensor})
    push, failed = listener._router.push, []

    def once_not(message, now):
        if not failed:
            failed.append(message)
            raise KeyError("byte 7")
        return push(message, now)

    monkeypatch.setattr(listener._router, "push", once_not)
    sensor.start()
    listener.start()
    bus.messages += sensor.codec.encode(pressed().ravel().astype(np.uint16), 0, time.time())
    until(lambda: sensor.status().state == "down")
    assert sensor.status().detail == "bus can0: the service failed at it: KeyError: 'byte 7'"
    assert "KeyError" in caplog.text
    until(lambda: sensor.down is None)
    bus.messages += sensor.codec.encode(pressed().ravel().astype(np.uint16), 1, time.time())
    until(lambda: (image := sensor.hub.latest()) and image.sequence == 1)
    listener.stop()
    sensor.stop()


@pytest.fixture
def listening(plan, monkeypatch):
    bus, sensor = Bus(), Sensor(plan)
    monkeypatch.setattr("tactiled.runtime.bus_thread.open_bus", bus.open)
    listener = Listener("can0", {}, {"palm": sensor})
    sensor.start()
    listener.start()
    yield bus, sensor
    listener.stop()
    sensor.stop()


@pytest.mark.parametrize("ahead", [0.0, 3600.0, -3600.0, -1.7e9])
@pytest.mark.parametrize("busy", [False, True])
def test_a_half_frame_before_a_silence_is_shown_whatever_the_buss_clock_says(listening, ahead, busy):
    bus, sensor = listening
    whole, half = (sensor.codec.encode(np.full(64, 100, np.uint16), n, time.time() + ahead) for n in (0, 1))
    bus.messages += [*whole, half[0]]
    until(lambda: (image := sensor.hub.latest()) and image.sequence == 0)

    def shown():
        if busy:  # another's messages come without end
            bus.messages.append(Message(time.time() + ahead, 0x123, b""))
        return sensor.hub.latest().sequence == 1

    until(shown)
    assert sensor.hub.latest().loss.incomplete == 1


def test_a_sender_that_begins_anew_after_its_clock_stepped_back_is_followed_at_once(listening):
    bus, sensor = listening
    for n, when in ((100, 1e9), (0, 1e9 - 3600), (1, 1e9 - 3599.99)):
        bus.messages += sensor.codec.encode(np.full(64, 100 + n, np.uint16), n, when)
        until(lambda n=n: (image := sensor.hub.latest()) and image.raw[0, 0] == n / 2)
        time.sleep(0.4 if n == 100 else 0.0)  # a silence, by which a restart is known
    loss = sensor.status().loss
    assert (loss.late, loss.lost) == (0, 0)


@pytest.mark.parametrize(("longest_s", "logged"), [(60.0, 1), (0.0, 3)])
def test_the_same_fault_of_a_bus_is_logged_again_after_a_healthy_stretch(
    plan, monkeypatch, caplog, longest_s, logged
):
    bus = Bus()
    monkeypatch.setattr("tactiled.runtime.bus_thread.open_bus", bus.open)
    monkeypatch.setattr("tactiled.runtime.bus_thread.BACK_OFF_S", (0.0, longest_s))
    listener = Listener("can0", {}, {"palm": Sensor(plan)})
    monkeypatch.setattr(listener._router, "push", lambda *_: {}["byte 7"])
    bus.messages += [Message(1.0, 0x123, b"")] * 3
    listener.start()
    until(lambda: bus.closed == 3)
    listener.stop()
    faults = [each for each in caplog.records if each.name == "tactiled.runtime.bus_thread"]
    assert [each.exc_info[0] for each in faults] == [KeyError] * logged


def test_what_a_bus_counts_is_told_and_kept_when_it_is_opened_again(plan, monkeypatch):
    bus, sensor = Bus(), Sensor(plan)
    monkeypatch.setattr("tactiled.runtime.bus_thread.open_bus", bus.open)
    listener = Listener("can0", {}, {"palm": sensor})
    listener.start()
    bus.counted = {"dropped": 3, "errors": 2, "bus_off": 1}
    bus.kinds = {"bus_off": 1, "no_ack": 2, "other": 0}
    bus.off = "bus adapter: bus-off"
    until(lambda: sensor.status().detail == "bus adapter: bus-off")
    assert sensor.status().state == "down"
    loss = sensor.status().loss
    assert (loss.dropped, loss.errors, loss.bus_off) == (3, 2, 1)
    assert sensor.status().errors == {"bus_off": 1, "no_ack": 2}
    bus.off = None
    until(lambda: sensor.status().state == "silent")
    bus.messages.append(Message(1.0, 0x123, b""))
    until(lambda: sensor.status().loss.foreign == 1)  # told without a frame
    bus.there = False
    until(lambda: bus.closed == 1)
    bus.there = True
    until(lambda: bus.opened == 2)
    assert sensor.status().loss.errors == 4  # the bus of this test begins with two
    assert sensor.status().errors["no_ack"] == 4
    bus.messages += sensor.codec.encode(pressed().ravel().astype(np.uint16), 0, time.time())
    sensor.start()
    until(sensor.hub.latest)
    assert sensor.hub.latest().loss.errors == 4
    listener.stop()
    sensor.stop()


def test_jitter_and_skew_are_told_by_the_buss_clock(plan):
    now = [0.0]
    sensor = Sensor(plan, lambda: now[0])

    def offer(sequence, at):
        sensor.offer(replace(frame(sequence), time=at, skew=0.003))

    assert (sensor.status().jitter_s, sensor.status().skew_s) == (None, None)
    for n in range(101):
        offer(n, 5.0 + n / 100 + (0.001 if n % 2 else 0.0))
    status = sensor.status()
    assert status.jitter_s == pytest.approx(0.001, rel=0.01)  # 11 ms and 9 ms by turns
    assert status.skew_s == 0.003
    offer(105, 6.05)  # frames lost between are no jitter
    assert sensor.status().jitter_s == status.jitter_s
    offer(106, 600.0)  # nor is a pause: it begins anew
    assert sensor.status().jitter_s is None
    for n in range(3):
        offer(107 + n, 600.01 + n / 100)
    assert sensor.status().jitter_s == pytest.approx(0, abs=1e-9)
    now[0] = 10.0
    assert (sensor.status().jitter_s, sensor.status().skew_s) == (None, 0.003)


def test_a_status_costs_no_look_at_all_the_periods(plan, monkeypatch):
    sensor = Sensor(plan, lambda: 0.0)
    for n in range(4):
        sensor.offer(replace(frame(n), time=5.0 + n / 100 + n**2 / 1000))
    monkeypatch.setattr(sensor, "_periods", None)
    assert sensor.status().jitter_s == pytest.approx(0.002)  # of 11, 13 and 15 ms


def test_several_sensors_on_several_buses(request):
    names = [f"{request.node.name}-{n}" for n in (0, 1)]
    text = CONFIG.format(channel=names[0]) + CONFIG.format(channel=names[1]).replace("can0", "can1").replace(
        "[sensor.palm]", "[sensor.thumb]"
    )
    both = text + CONFIG.format(channel="").split("[sensor.palm]")[1].join(["[sensor.index]", ""]).replace(
        'name = "packed"', 'name = "packed", array_id = 3'
    )
    service = Service(parse(both))
    ends = {"can0": open_bus("virtual", channel=names[0]), "can1": open_bus("virtual", channel=names[1])}
    service.start()
    for n, (name, sensor) in enumerate(service.sensors.items()):
        counts = np.full(64, NO_LOAD + 20 * n, np.uint16)
        for message in sensor.codec.encode(counts, 0, time.time()):
            ends[sensor.bus_name].send(message)
        until(service.sensor(name).hub.latest)
    service.stop()
    for end in ends.values():
        end.close()
    assert [float(each.hub.latest().raw[0, 0]) for each in service.sensors.values()] == [0, 10, 20]
    assert service.sensor("palm").hub.latest().loss.foreign == 0
    with pytest.raises(UnknownSensorError, match="sensor 'toe': no such sensor: there are palm, thumb, index"):
        service.sensor("toe")


def test_two_sensors_that_want_the_same_messages_are_refused():
    text = CONFIG.format(channel="none") + CONFIG.split("[sensor.palm]")[1].join(["[sensor.twin]", ""]).format()
    with pytest.raises(ConfigError, match="sensors palm and twin both listen to id 0x500"):
        Service(parse(text))


def test_a_bus_that_cannot_be_opened_leaves_nothing_running():
    service = Service(parse(CONFIG.format(channel="none").replace('"virtual"', '"slcan"')))
    threads = threading.active_count()
    with pytest.raises(BusError, match="bus slcan none: "):
        service.start()
    assert threading.active_count() == threads
