from threading import Event, get_ident

import numpy as np
import pytest

from tactiled.bench.load import configuration
from tactiled.live.sensor import Sensor
from tactiled.live.service import Service
from tests.conftest import BUSY_S, Clock, until
from tests.live.conftest import Timed, frame


def test_status_is_silent_then_live_then_stale_and_down_while_the_bus_is(plan):
    timed = Timed(plan)
    sensor = timed.sensor
    assert (sensor.status().state, sensor.status().age_s) == ("silent", None)
    for n in range(200):
        timed.now += 0.01
        sensor.offer(frame(n))
    status = sensor.status()
    assert (status.state, status.age_s, status.detail) == ("live", 0, "")
    assert status.rate_hz == pytest.approx(100, rel=0.01)
    timed.now += 1.25
    status = sensor.status()
    assert (status.state, status.rate_hz, status.detail) == ("stale", 0, "no frame for 1.2 s")
    assert status.age_s == pytest.approx(1.25)
    for n in range(200, 203):
        timed.now += 0.01
        sensor.offer(frame(n))
    assert sensor.status().rate_hz == pytest.approx(100)  # a break is no period
    for n in range(203, 503):  # two of three frames come late, as frames do that have lost messages
        timed.now += (0.05, 0.09, 0.01)[n % 3]
        sensor.offer(frame(n))
    assert sensor.status().rate_hz == pytest.approx(20, rel=0.05)
    sensor.health.down = "bus can0: gone"
    assert (sensor.status().state, sensor.status().detail) == ("down", "bus can0: gone")


def test_a_slow_sensor_delays_no_other_and_restores_its_newest_frame_next(plan, monkeypatch):
    slow, other = Sensor(plan), Sensor(plan)
    begun, go_on, process, sequences = Event(), Event(), slow.pipeline.process, []

    def process_later(frame, *_):
        begun.set()
        assert go_on.wait(BUSY_S)
        return process(frame)

    monkeypatch.setattr(slow.pipeline, "process", process_later)
    slow.hub.subscribe(lambda image: sequences.append((image.sequence, image.loss.skipped)))
    for sensor in (slow, other):
        sensor.start()
        sensor.offer(frame(0))
    assert begun.wait(BUSY_S)
    for n in range(1, 5):
        slow.offer(frame(n))
        other.offer(frame(n))
        until(lambda n=n: (image := other.hub.latest()) and image.sequence == n)
    assert sequences == []
    go_on.set()
    until(lambda: len(sequences) == 2)
    slow.stop()
    other.stop()
    assert sequences == [(0, 0), (4, 3)]
    assert slow.status().loss.skipped == 3


def test_frames_but_the_first_are_restored_on_the_bus_s_thread_unless_they_take_long(plan, monkeypatch):
    sensor, threads, process = Sensor(plan), [], Sensor(plan).pipeline.process
    monkeypatch.setattr(sensor.pipeline, "process", lambda *a: (threads.append(get_ident()), process(*a))[1])

    def take(sequence):
        sensor.offer(frame(sequence), wake=False)
        sensor.hand_over.take_turn()
        until(lambda: sensor.hand_over.turns is None)
        assert sensor.hub.latest().sequence == sequence
        return threads.pop() == get_ident()

    sensor.start()
    assert [take(0), take(1), take(2)] == [False, True, True]
    with monkeypatch.context() as slow:
        slow.setattr("tactiled.live.hand_over.QUICK_S", 0.0)
        assert not take(3)
    assert take(4)
    sensor.stop()


def test_a_frame_that_comes_while_the_sensor_s_own_thread_restores_is_left_to_it(plan, monkeypatch):
    sensor, begun, go_on, process = Sensor(plan), Event(), Event(), Sensor(plan).pipeline.process
    monkeypatch.setattr(sensor.pipeline, "process", lambda *a: (begun.set(), go_on.wait(), process(*a))[2])
    sensor.start()
    sensor.offer(frame(0))
    assert begun.wait(BUSY_S)
    sensor.hand_over._took_s = 0.0
    sensor.offer(frame(1), wake=False)
    sensor.hand_over.take_turn()
    assert sensor.hub.latest() is None
    go_on.set()
    until(lambda: (image := sensor.hub.latest()) and image.sequence == 1)
    sensor.stop()
    assert sensor.status().loss.skipped == 0


def test_a_frame_that_cannot_be_restored_makes_the_sensor_stale_until_the_next(plan, monkeypatch):
    sensor = Timed(plan).sensor
    sensor.start()
    with monkeypatch.context() as broken:
        broken.setattr(sensor.pipeline, "process", lambda *_: 1 / 0)
        sensor.offer(frame(0))
        until(lambda: sensor.status().state == "stale")
    assert sensor.status().detail == "restoration failed: ZeroDivisionError: division by zero"
    sensor.offer(frame(1))
    until(lambda: sensor.status().state == "live")
    sensor.stop()
    assert sensor.hub.latest().sequence == 1


def test_jitter_and_skew_are_by_the_clock_of_the_bus(plan, monkeypatch):
    timed = Timed(plan)
    sensor = timed.sensor

    def offer(sequence, at):
        sensor.offer(frame(sequence, time=at, skew=0.003))

    assert (sensor.status().jitter_s, sensor.status().skew_s) == (None, None)
    for n in range(101):
        offer(n, 5.0 + n / 100 + (0.001 if n % 2 else 0.0))
    status = sensor.status()
    assert status.jitter_s == pytest.approx(0.001, rel=0.01)  # 11 ms and 9 ms by turns
    assert status.skew_s == 0.003
    offer(105, 6.05)  # lost frames between are no jitter
    assert sensor.status().jitter_s == status.jitter_s
    offer(106, 600.0)  # nor is a pause: it begins anew
    assert sensor.status().jitter_s is None
    for n in range(4):
        offer(107 + n, 600.01 + n / 100 + n**2 / 1000)
    with monkeypatch.context() as computed_once_a_frame:
        computed_once_a_frame.setattr(np, "std", None)
        assert sensor.status().jitter_s == pytest.approx(np.sqrt(14.75 / 3) / 1000)  # of 10, 11, 13 and 15 ms
    timed.now += 10.0
    assert (sensor.status().jitter_s, sensor.status().skew_s) == (None, 0.003)


def test_more_than_four_sensors_of_a_service_share_the_time_for_restoring():
    for count, budget_s in ((1, 1e-3), (4, 1e-3), (8, 0.5e-3)):
        for sensor in Service(configuration(count)).sensors.values():
            clock = Clock()
            sensor.health._clock = clock.monotonic
            for n in range(400):
                clock.now += 0.01
                sensor._note_arrival(frame(n))
            assert sensor._budget_s() == pytest.approx(budget_s, rel=0.01)
