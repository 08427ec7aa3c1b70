import pytest

from tactiled.live.timings import BOUNDS_S, Histogram


def test_a_time_is_counted_below_the_first_bound_that_it_does_not_exceed():
    assert (BOUNDS_S[0], BOUNDS_S[-1]) == (1e-5, 1.0)
    histogram = Histogram()
    histogram.count([0.0, 1e-5])
    histogram.count([1.1e-5, 1.0, 1.1])
    assert [histogram.counts[at] for at in (0, 1, len(BOUNDS_S) - 1, len(BOUNDS_S))] == [2, 1, 1, 1]
    assert sum(histogram.counts) == 5
    assert histogram.sum_s == pytest.approx(2.100021)
