"""Pressure finer than the grid: what taxels feel of it beyond what their cells' means say."""

from functools import partial

import numpy as np
import pytest

from tactiled.cover.kernel import solve
from tactiled.cover.operator import cached, stencil
from tactiled.cover.stack import Layer, Stack
from tactiled.geometry import grid
from tactiled.restore.aliases import Aliases
from tactiled.restore.blur import Blur

SHAPE = (9, 12)
PARTS = 4


def finer(thickness):
    return partial(
        cached, stencil, solve(Stack((Layer(thickness, 0.6, 0.48),)), "layered"), grid(*SHAPE, 1.0, 0.8)
    )


@pytest.mark.parametrize("thickness", [0.5, 1.0])
def test_what_is_missed_is_what_random_pressure_shows(thickness):
    """White pressure on quarters of cells, blurred, against the blur of its means, far from the border."""
    fine, smooth = finer(thickness), Blur.grid(finer(thickness)(1), SHAPE, finer=finer(thickness))
    random = np.random.default_rng(0).normal(size=(2000, SHAPE[0] * PARTS, SHAPE[1] * PARTS))
    means = random.reshape(-1, SHAPE[0], PARTS, SHAPE[1], PARTS).mean(axis=(2, 4))
    left = Blur.grid(fine(PARTS), SHAPE, PARTS).forward(random) - smooth.forward(means)
    told = Aliases(fine(PARTS), SHAPE, PARTS).missed(np.ones_like)
    assert left[:, 4, 5:7].var() / means.var() == pytest.approx(told.mean(), rel=0.1)


def test_a_smooth_scene_misses_next_to_nothing():
    told = Aliases(finer(1.0)(PARTS), SHAPE, PARTS).missed(lambda q: (1 + (q / 0.05) ** 2) ** -3)
    assert told[0, 0] < 1e-6
    assert told[0, 0] < told[0, 3] < told[0, 6] < told[0, 9] < 0.1
