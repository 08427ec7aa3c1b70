"""A cover that is no stack of the configured layers: a soft skin over a stiff, wide one."""

import numpy as np

from tactiled.calibrate.cover.result import fit_cover
from tactiled.calibrate.cover.tip import Tip, tip_touch
from tactiled.calibrate.cover.unknowns import Unknowns
from tactiled.cover import layered
from tactiled.cover.stack import Layer, Stack
from tactiled.geometry import grid
from tests.touched import Skin, World, rubber

ARRAY = grid(16, 16, 1.0)
PLATED = Stack((Layer(0.5, 0.6, 0.49), Layer(0.08, 2000.0, 0.3), Layer(1.5, 0.3, 0.45), Layer(1.6, 20e3, 0.2)), 3)


def fitted(world, seed):
    random = np.random.default_rng(seed)
    skin = Skin(ARRAY.size, random)
    presses = [skin.press(world.tip(0.8, place), ARRAY) for place in world.places(20, random)]
    exact = Unknowns(aperture_mm=0, poisson=0, curvature=0, profile=0)
    touch = tip_touch(presses, ARRAY, rubber(1.0), Tip(1.6, 0.005), 0.01, None, exact)
    return fit_cover(touch, presses, "tip")


def test_a_free_kernel_is_near_the_true_gain_where_no_thickness_explains_the_presses():
    fit = fitted(World(ARRAY, PLATED), 4)
    assert fit.residual > 2
    assert fit.kernel is not None
    assert 'use kernel.model = "measured"' in fit.notes[0]
    q, gain = fit.kernel
    assert (q[0], gain[0]) == (0.0, 1.0)
    assert (gain >= 0).all()
    true = layered.gain(PLATED, q)
    band = q < 0.25  # what presses on this array hold
    assert np.abs(gain - true)[band].max() < 0.05
    assert np.abs(layered.gain(rubber(fit.thickness_mm), q) - true)[band].max() > 0.15


def test_the_stack_is_kept_where_it_is_right():
    fit = fitted(World(ARRAY, rubber(1.4)), 5)
    assert fit.kernel is None
    assert fit.residual < 1.2
