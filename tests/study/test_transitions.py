"""What a frame before does to the next: to its error, and to its time."""

import time
from types import SimpleNamespace

import numpy as np
import pytest

from tactiled.study.skin import rubber
from tests.study import frame_times, transitions
from tests.study.held_out_scenes import FINER
from tests.study.transitions import steps, summary


class Lagging:
    """Shows the frame before, if there is one."""

    def __init__(self, *_):
        self.image = None

    def prepare(self):
        pass

    def __call__(self, frame):
        self.image, image = frame, frame if self.image is None else self.image
        return SimpleNamespace(image=image)


def groups(method):
    judged = {}
    for group, step in steps(method, rubber(1.0, 16, FINER), 0.002, 1):
        judged.setdefault(group, []).append(step)
    return judged


def test_a_method_that_looks_back_is_told_from_one_that_does_not(monkeypatch):
    monkeypatch.setattr(transitions, "FRAMES", 2)
    monkeypatch.setattr(transitions, "MOVING_FRAMES", 5)
    for group, judged in groups("raw").items():
        assert summary(group, judged)[2:] == ("1.000", "1.00", "0", "0", "0", "0")
    monkeypatch.setattr(transitions, "make", Lagging)
    judged = groups("lagging")
    assert min(each.error / each.alone for each in judged["frame 1"]) > 1.1
    still = [each for each in judged["frame 2"] if "then growing" not in each.case]
    assert [each.error / each.alone for each in still] == pytest.approx([1] * 100, abs=0.1)
    assert int(summary("", judged["frame 1"])[6]) == len(judged["frame 1"]) == 11 * 10


class Slow(Lagging):
    """Takes two milliseconds of the processor for the first frame."""

    def __call__(self, frame, *_):
        end = time.thread_time() + 0.002 * (self.image is None)
        while time.thread_time() < end:
            self.image = frame
        self.image = frame


def test_cold_frames_are_timed_apart_from_those_that_follow(monkeypatch):
    monkeypatch.setattr(frame_times, "make", Slow)
    for name in ("ROUNDS", "AGAIN"):
        monkeypatch.setattr(frame_times, name, 4)
    times = frame_times.measure(8, 1000, 1)
    assert {"cold", "jump", "jump to spots", "warm", "idle", "wiener"} == set(times)
    assert min(times["cold"]) > 2000 > np.median(times["warm"])
    assert 1000 <= sum(len(each) for label, each in times.items() if label not in ("cold", "wiener")) < 2000
    assert (times["jump"] > 2000).sum() + (times["warm"] > 2000).sum() < 50
