from dataclasses import replace

import numpy as np
import pytest

from tactiled.calibrate.counts.curves import Curves
from tactiled.calibrate.counts.hysteresis import Loop
from tactiled.calibrate.counts.tare import Zero
from tactiled.live.pipeline import Pipeline
from tactiled.recorded.playback import PAST_EVERY_FRAMES, Playback
from tests.conftest import GAIN, NO_LOAD, SIDE
from tests.live.conftest import frame

COUNT = 2 * PAST_EVERY_FRAMES + 40


@pytest.fixture
def plan(plan):
    """A palm with hysteresis."""
    size = np.full(SIDE**2, 0.01)
    reach = np.tile([0.0, 1000.0], (SIDE**2, 1))
    gains = np.full((SIDE**2, 1), GAIN)
    curves = Curves("linear", gains, reach, size, size, size > 0, loop=Loop(0.02, 0.1, 0.4))
    calibration = replace(plan.calibration, curves=curves, noise_kpa=0.5, track_drift=False)
    return replace(plan, method="raw", calibration=calibration)


class Frames:
    """A recording in memory."""

    def __init__(self):
        self.read = 0
        load = 500 * np.sin(np.arange(COUNT) / 30) ** 2
        self._frames = [frame(n, np.full(SIDE**2, NO_LOAD + each)) for n, each in enumerate(load)]

    def frame(self, sensor, number):
        assert sensor == "palm"
        self.read += 1
        return self._frames[number]


def test_a_recording_played_in_any_order_is_what_was_live(plan):
    frames, pipeline = Frames(), Pipeline(plan)
    live = [pipeline.process(frames.frame("palm", n)).raw for n in range(COUNT)]
    up, down = 20, 74  # of nearly the same counts
    assert live[up].mean() - live[down].mean() > 50 * GAIN
    unloaded = np.full((2, SIDE**2), np.nan, np.float32)
    playback = Playback(plan, Zero(pipeline.zero.counts, unloaded), frames, ())
    for number in (COUNT - 1, 3, 74, 75, 75, PAST_EVERY_FRAMES + 9, PAST_EVERY_FRAMES - 1, 2, 500):
        np.testing.assert_array_equal(playback.image(number, "raw").raw, live[number])
    frames.read = 0
    playback.image(COUNT - 2, "raw")
    assert frames.read < PAST_EVERY_FRAMES


def test_a_tare_begins_at_no_load_and_another_calibration_goes_on(plan):
    frames, pipeline = Frames(), Pipeline(plan)
    for n in range(60):
        before = pipeline.process(frames.frame("palm", n))
    other = Pipeline(replace(plan, calibration=replace(plan.calibration, noise_kpa=0.4)), pipeline)
    other.take_over(pipeline)
    np.testing.assert_array_equal(other.process(frames.frame("palm", 59)).raw, before.raw)
    pipeline.set_zero(pipeline.zero)
    assert pipeline.process(frames.frame("palm", 59)).raw.mean() > before.raw.mean() + 10 * GAIN
