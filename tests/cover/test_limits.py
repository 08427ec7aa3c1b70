"""Where a cover cannot be solved: a clear error or an honest estimate, never a quiet wrong number."""

from itertools import count

import numpy as np
import pytest

from tactiled.cover import fem, layered
from tactiled.cover.kernel import solve
from tactiled.cover.stack import Layer, Profile, Stack
from tactiled.errors import PhysicsError

HARD = Layer(1.0, 980.0, 0.3)


@pytest.mark.parametrize("poisson", [0.5, 0.6, -0.1, float("nan")])
def test_poissons_ratio(poisson):
    with pytest.raises(PhysicsError, match=rf"layer Poisson's ratio is {poisson}: give 0 to less than 0\.5"):
        Layer(1.0, 1.0, poisson)


def test_poissons_ratio_too_near_a_half_for_double_precision():
    stack = Stack((Layer(0.5, 1.0, 0.5 - 1e-15), HARD))
    with pytest.raises(PhysicsError, match=r"Poisson's ratio further from 0\.5"):
        solve(stack, "fem")


@pytest.mark.parametrize("thickness", [0.0, -0.2, float("nan"), float("inf")])
def test_thickness(thickness):
    with pytest.raises(PhysicsError, match=f"layer thickness is {thickness} mm: give a finite number above 0"):
        Layer(thickness, 1.0, 0.3)


def test_a_domain_too_narrow_for_the_stack(paper):
    with pytest.raises(PhysicsError, match="domain radius 20 mm cuts the far field of a stack 11 mm thick"):
        fem.solve(paper(10.0), radius=20.0)


def test_moduli_too_far_apart_for_finite_elements():
    with pytest.raises(PhysicsError, match="finite elements are singular in double precision"):
        solve(Stack((Layer(1.0, 1e16, 0.3), Layer(1.0, 1.0, 0.49))), "fem")


def test_moduli_too_far_apart_for_the_exact_solution():
    stack = Stack((Layer(1.0, 1e-300, 0.49), Layer(1.0, 1e300, 0.3)))
    with pytest.raises(PhysicsError, match=r"layers' system is .*singular in double precision"):
        solve(stack, "layered")


@pytest.mark.parametrize("contrast", [1e6, 1e9, 1e12])
@pytest.mark.parametrize("sensing", [1, 2])
def test_moduli_far_apart_but_not_too_far_are_solved_as_well_as_any(contrast, sensing):
    stack = Stack((Layer(0.2, contrast, 0.3), Layer(1.0, 1.0, 0.4999), Layer(1.0, contrast, 0.3)), sensing)
    kernel = solve(stack, "fem")
    q = np.geomspace(kernel.q[1], kernel.q[-1], 500)
    exact = layered.gain(stack, q)
    error = np.abs(kernel.gain_at(q) - exact)[exact >= fem.FLOOR].max()
    assert error <= min(1e-3, 2 * kernel.error_estimate)


@pytest.mark.parametrize("bonded", [True, False])
def test_a_frequency_whose_exponentials_underflow(paper, bonded):
    stack = Stack(paper().layers, bonds=(bonded, bonded))
    gain = layered.gain(stack, np.logspace(3, 308, 400))
    assert (gain == 0).all()


@pytest.mark.parametrize("q", [np.inf, np.nan, -1.0])
def test_a_frequency_that_is_none(paper, q):
    with pytest.raises(PhysicsError, match="spatial frequency q must be finite and not negative"):
        layered.gain(paper(), q)


def test_an_accuracy_that_cannot_be_met(paper):
    with pytest.raises(
        PhysicsError, match=r"accuracy 1e-06 of the gain cannot be met: the error estimate stands at \d"
    ):
        fem.solve(paper(), 1e-6)


def test_a_time_that_is_too_short(paper):
    with pytest.raises(PhysicsError, match=r"accuracy 1e-05 is not met in the given time: the estimate is \d"):
        solve(paper(), "fem", 1e-5, clock=count().__next__, budget_s=5.5)


def test_a_time_that_is_too_short_for_an_estimate(paper):
    with pytest.raises(PhysicsError, match="not met in the given time: there is no estimate yet"):
        solve(paper(), "fem", clock=count().__next__, budget_s=0.5)


def test_a_time_that_is_too_short_to_find_the_far_field():
    stack = Stack((Layer(0.5, 10_000.0, 0.3), Layer(5.0, 0.05, 0.1)))
    with pytest.raises(PhysicsError, match="not met in the given time: the far field reaches past"):
        solve(stack, "fem", clock=count().__next__, budget_s=0.5)


@pytest.mark.parametrize("accuracy", [0.0, -1e-3, 1e-7, 1.0, float("nan")])
def test_an_accuracy_that_means_nothing(paper, accuracy):
    with pytest.raises(PhysicsError, match=r"accuracy is .*: give 1e-06 to less than 1"):
        fem.solve(paper(), accuracy)
    with pytest.raises(PhysicsError, match=r"accuracy is .*: give 1e-06 to less than 1"):
        fem.pressed(paper(), 1.0, accuracy)


@pytest.mark.parametrize("radius", [0.0, -1.0, float("nan"), float("inf")])
def test_a_footprint_that_is_none(paper, radius):
    with pytest.raises(PhysicsError, match=f"footprint radius is {radius} mm"):
        fem.pressed(paper(), radius)


def test_a_time_that_is_too_short_for_a_footprint(paper):
    with pytest.raises(PhysicsError, match="not met in the given time: there is no estimate yet"):
        fem.pressed(paper(), 1.0, late=lambda: True)


def test_an_accuracy_that_cannot_be_met_under_a_footprint(paper, monkeypatch):
    monkeypatch.setattr(fem, "LARGEST", 5000)
    with pytest.raises(PhysicsError, match="accuracy 1e-05 of the stress cannot be met: the estimate stands at"):
        fem.pressed(paper(), 1.0, 1e-5)


def test_a_dimple_through_the_cover(paper):
    with pytest.raises(PhysicsError, match=r"profile takes 0.2 mm from a cover 0.2 mm thick"):
        fem.solve(paper(), profile=Profile((0.0, 0.5), (-0.2, 0.0)))
