from tactiled.live.sensor import Sensor
from tests.bench import sensors


def test_images_of_every_size_are_timed_and_what_is_missing_is_counted():
    for seconds in (0.5, 2.0, 8.0, 32.0):  # a busy machine restores nothing for a while
        result = sensors.live([8, 8, 12], seconds)
        received = {side: len(each) for side, each in result.ages_ms.items()}
        if all(received.values()):
            break
    due = 3 * seconds * sensors.RATE_HZ
    assert set(received) == {8, 12}
    assert min(each.min() for each in result.ages_ms.values()) > 0
    assert abs(result.missed - (1 - sum(received.values()) / due)) < 1e-9
    assert result.cores > 0


def test_processor_time_is_of_frames_that_are_all_restored_in_order(monkeypatch):
    sequences, restore = {}, Sensor.restore

    def counted(sensor, frame):
        sequences.setdefault(sensor.name, []).append(frame.sequence)
        restore(sensor, frame)

    monkeypatch.setattr(Sensor, "restore", counted)
    assert sensors.frame_us([8, 8], rounds=1) > 0
    frames = [*range(len(sensors.recorded(8)))]  # half of them in each round
    assert sequences == {"s0": frames, "s1": frames}
