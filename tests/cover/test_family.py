import numpy as np
import pytest

from tactiled.cover import layered
from tactiled.cover.family import CoverFamily
from tactiled.cover.stack import Layer, Stack
from tactiled.errors import PhysicsError

STACKS = {
    "rubber on a board": Stack((Layer(1.5, 0.6, 0.49), Layer(1.6, 20e3, 0.2))),
    "film on foam": Stack((Layer(0.05, 2e3, 0.4), Layer(2.0, 0.5, 0.45), Layer(6.0, 0.1, 0.2)), sensing=2),
    "no substrate, loose": Stack((Layer(0.4, 1.0, 0.3), Layer(0.7, 0.2, 0.499)), sensing=2, bonds=(False, True)),
    "stiff on soft": Stack((Layer(0.3, 100.0, 0.3), Layer(4.0, 0.5, 0.48))),
}


@pytest.mark.parametrize("name", STACKS)
def test_gain_is_the_exact_one_of_the_scaled_stack(name):
    stack = STACKS[name]
    family = CoverFamily(stack)
    for factor in (0.25, 0.377, 1.0, 1.93, 4.0):  # ends and places between knots
        scaled = family.configured.thickened(factor)
        assert scaled.depth == pytest.approx(factor * stack.depth, rel=1e-12)
        assert scaled.layers[stack.sensing :] == stack.layers[stack.sensing :]
        q = np.concatenate([[0.0], np.geomspace(1e-4, 50, 400) / stack.depth])
        exact = layered.gain(scaled, q)
        assert np.abs(family.gain(q, factor) - exact).max() < 1e-5
        assert np.abs(family.kernel(factor).gain_at(q) - exact).max() < 1e-5


def test_gain_is_smooth_in_the_factor_and_takes_many_at_once():
    family = CoverFamily(STACKS["rubber on a board"])
    factors, q = np.geomspace(0.3, 3.5, 200), np.array([0.05, 0.2, 0.5])
    gains = family.gain(q[:, None], factors)
    assert gains.shape == (3, 200)
    assert (np.diff(gains, axis=1) < 0).all()  # a thicker cover passes less
    assert gains[1, 7] == family.gain(0.2, factors[7])


@pytest.mark.parametrize("factor", [0.24, 4.1, np.nan])
def test_a_factor_outside_the_family_is_refused(factor):
    with pytest.raises(PhysicsError, match=r"cover of .* times the configured thickness: give 0.25 to 4"):
        CoverFamily(STACKS["stiff on soft"]).gain(0.1, factor)
