from dataclasses import replace

import pytest

from tactiled.frames import StageTimes
from tactiled.runtime.pipeline import Pipeline
from tactiled.runtime.timings import BOUNDS_S, STAGES, Histogram, Timings
from tests.runtime.conftest import frame


def test_a_time_is_counted_below_the_first_bound_that_it_does_not_exceed():
    assert (BOUNDS_S[0], BOUNDS_S[-1]) == (1e-5, 1.0)
    histogram = Histogram()
    for seconds in (0.0, 1e-5, 1.1e-5, 1.0, 1.1):
        histogram.add(seconds)
    assert [histogram.counts[at] for at in (0, 1, len(BOUNDS_S) - 1, len(BOUNDS_S))] == [2, 1, 1, 1]
    assert sum(histogram.counts) == 5
    assert histogram.sum_s == pytest.approx(2.100021)


def test_each_stage_of_an_image_is_counted_and_restoring_by_its_method(plan):
    image = replace(
        Pipeline(plan).process(frame(0)), times=StageTimes(9.9, 10.0, 10.01, 10.03, 10.06, 10.1, 10.15)
    )
    timings = Timings()
    timings.add(image, 10.21)
    timings.add_send(image, 10.3)
    sums = {stage: each.sum_s for stage, each in timings.stages.items()}
    assert sums == pytest.approx(dict(zip(STAGES, (0.01, 0.02, 0.03, 0.04, 0.05, 0.06), strict=True)))
    assert {method: each.sum_s for method, each in timings.methods.items()} == pytest.approx({image.method: 0.04})
    assert {place: each.sum_s for place, each in timings.ages.items()} == pytest.approx(
        {"publish": 0.21, "send": 0.3}
    )
