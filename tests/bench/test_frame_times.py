import time

import numpy as np

from tests.bench import frame_times


class Slow:
    """Takes two milliseconds of the processor for the first frame."""

    def __init__(self, *_):
        self.image = None

    def prepare(self):
        pass

    def __call__(self, frame, *_):
        end = time.thread_time() + 0.002 * (self.image is None)
        while time.thread_time() < end:
            self.image = frame
        self.image = frame


def test_cold_frames_are_timed_apart_from_those_that_follow(monkeypatch):
    monkeypatch.setattr(frame_times, "make", Slow)
    for name in ("ROUNDS", "AGAIN"):
        monkeypatch.setattr(frame_times, name, 4)
    times = frame_times.measure(8, 500, 1)
    assert {"cold", "jump", "jump to spots", "warm", "idle"} == set(times)
    assert min(times["cold"]) > 2000 > np.median(times["warm"])
    assert 500 <= sum(len(each) for label, each in times.items() if label != "cold") < 1000
    assert (times["jump"] > 2000).sum() + (times["warm"] > 2000).sum() < 50
