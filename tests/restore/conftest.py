import numpy as np
import pytest

from tests.plans import SHAPE, plan


@pytest.fixture
def covered():
    """Blurs under a cover of `thickness` pitches: of a grid, or of the same taxels as a mere list of positions.

    The cover ends at the border, as the pressure of most tests does, unless it goes on `beyond` it.
    """

    def make(shape=SHAPE, thickness=1.0, refine=1, layout=False, beyond=False):
        return plan(shape, thickness, refine=refine, layout=layout, beyond=beyond).blur

    return make


@pytest.fixture
def pressed():
    """A frame of a few flat presses under a blur, its noise of `sigma` kPa, and the truth."""

    def make(blur, sigma=0.5, seed=0):
        random = np.random.default_rng(seed)
        truth = np.zeros(blur.surface_shape)
        rows, columns = truth.shape
        truth[rows // 4 : rows // 2, columns // 4 : columns // 2] = 80.0
        truth[2 * rows // 3 : 2 * rows // 3 + 2, 2 * columns // 3 : 2 * columns // 3 + 2] = 120.0
        clean = blur.forward(truth)
        return (clean + random.normal(0, sigma, clean.shape)).astype(np.float32), truth

    return make


@pytest.fixture
def sensed(covered):
    """Noisy frames of a scene under a cover."""
    random = np.random.default_rng(5)

    def make(truth, thickness=1.0, sigma=0.5):
        clean = covered(truth.shape, thickness).forward(np.asarray(truth, float))
        return (clean + random.normal(0, sigma, truth.shape)).astype(np.float32)

    return make
