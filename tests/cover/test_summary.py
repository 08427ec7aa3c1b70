import numpy as np
import pytest

from tactiled.cover.kernel import solve
from tactiled.cover.layered import gain
from tactiled.cover.summary import summarise
from tactiled.errors import PhysicsError
from tactiled.geometry import grid


def test_the_paper_cover_over_half_millimetre_taxels(paper):
    kernel = solve(paper(), "layered")
    summary = summarise(kernel, grid(8, 8, 0.5))
    assert gain(paper(), summary.half_gain) == pytest.approx(0.5, abs=1e-5)
    assert gain(paper(), summary.tenth_gain) == pytest.approx(0.1, abs=1e-5)
    assert summary.nyquist == 1.0
    assert summary.nyquist_gain == pytest.approx(0.7722, abs=1e-4)
    assert summary.noise_gain == pytest.approx(1 / (0.7722 * 2 / np.pi), rel=1e-3)
    assert (summary.smallest_gap, summary.limit) == (0.5, "pitch")


def test_fine_taxels_leave_the_gap_to_the_cover(paper):
    summary = summarise(solve(paper(), "layered"), grid(8, 8, 0.01), noise=0.1)
    assert summary.limit == "cover"
    assert gain(paper(), 1 / (2 * summary.smallest_gap)) == pytest.approx(0.3, abs=1e-3)


def test_noise_above_everything_leaves_no_gap(paper):
    assert summarise(solve(paper(), "layered"), grid(8, 8, 1.0), noise=1.0).smallest_gap == np.inf


def test_a_cover_that_passes_nothing_amplifies_without_bound(paper):
    assert summarise(solve(paper(), "layered"), grid(8, 8, 0.01)).noise_gain == np.inf


@pytest.mark.parametrize("noise", [0.0, -1.0, float("nan")])
def test_noise_that_means_nothing_is_refused(paper, noise):
    with pytest.raises(PhysicsError, match="noise is"):
        summarise(solve(paper(), "layered"), grid(2, 2, 1.0), noise)
