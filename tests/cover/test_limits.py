"""Where a cover cannot be solved: a clear error or an honest estimate, never a quiet wrong number."""

from itertools import count

import numpy as np
import pytest

from tactiled.cover import fem, layered
from tactiled.cover.kernel import solve
from tactiled.cover.stack import Layer, Profile, Stack
from tactiled.errors import PhysicsError

HARD = Layer(1.0, 980.0, 0.3)
PAPER = Stack((Layer(0.2, 98.0, 0.3), HARD))
NAN, INF = float("nan"), float("inf")


REFUSED = {
    "Poisson's ratio": (lambda x: Layer(1.0, 1.0, x), (0.5, 0.6, -0.1, NAN), "Poisson's ratio is {}: give 0 "),
    "thickness": (lambda x: Layer(x, 1.0, 0.3), (0.0, -0.2, NAN, INF), "layer thickness is {} mm: give a "),
    "modulus": (lambda x: Layer(1.0, x, 0.3), (0.0, -1.0, NAN, INF), "Young's modulus is {} MPa: give a "),
    "frequency": (lambda x: layered.gain(PAPER, x), (INF, NAN, -1.0), "frequency q must be finite and not"),
    "accuracy": (lambda x: fem.solve(PAPER, x), (0.0, -1e-3, 1e-7, 1.0, NAN), "accuracy is {}: give 1e-06"),
    "stress": (lambda x: fem.pressed(PAPER, 1.0, x), (0.0, 1.0), "accuracy is {}: give 1e-06"),
    "footprint": (lambda x: fem.pressed(PAPER, x), (0.0, -1.0, NAN, INF), "footprint radius is {} mm"),
}


@pytest.mark.parametrize(("case", "value"), [(case, value) for case in REFUSED for value in REFUSED[case][1]])
def test_a_value_without_a_meaning_is_refused(case, value):
    make, _, text = REFUSED[case]
    with pytest.raises(PhysicsError, match=text.format(value)):
        make(value)


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda: Stack(()), "stack has no layer"),
        (lambda: Stack((HARD,), sensing=2), "sensing plane is interface 2: give 1 to 1"),
        (lambda: Stack((HARD,), sensing=0), "sensing plane is interface 0"),
        (lambda: Stack((HARD, HARD), bonds=(True,)), "1 bonds for 2 interfaces"),
        (lambda: Profile((0.0, 1.0), (0.1,)), "2 radii and 1 rises"),
        (lambda: Profile((0.5, 1.0), (0.1, 0.0)), "start at 0"),
        (lambda: Profile((0.0, 1.0, 1.0), (0.1, 0.1, 0.0)), "let them grow"),
        (lambda: Profile((0.0, 1.0), (0.1, 0.1)), "let it end flat"),
        (lambda: fem.solve(PAPER, profile=Profile((0.0, 0.5), (-0.2, 0.0))), "takes 0.2 mm from a cover 0.2 mm"),
        (lambda: solve(PAPER, "layered", profile=Profile((0.0, 0.5), (0.1, 0.0))), "knows flat layers only"),
        (lambda: solve(PAPER, "exact"), "cover model is 'exact'"),
    ],
)
def test_what_makes_no_cover_is_refused(make, text):
    with pytest.raises(PhysicsError, match=text):
        make()


@pytest.mark.parametrize(
    ("layers", "model", "text"),
    [
        ((Layer(0.5, 1.0, 0.5 - 1e-15), HARD), "fem", r"Poisson's ratio further from 0\.5"),
        (
            (Layer(1.0, 1e16, 0.3), Layer(1.0, 1.0, 0.49)),
            "fem",
            "finite elements are singular in double precision",
        ),
        (
            (Layer(1.0, 1e-300, 0.49), Layer(1.0, 1e300, 0.3)),
            "layered",
            "system is .*singular in double precision",
        ),
    ],
)
def test_what_double_precision_cannot_solve_is_refused(layers, model, text):
    with pytest.raises(PhysicsError, match=text):
        solve(Stack(layers), model)


@pytest.mark.parametrize("contrast", [1e6, 1e12])
@pytest.mark.parametrize("sensing", [1, 2])
def test_moduli_far_apart_but_not_too_far_are_solved_as_well_as_any(contrast, sensing):
    stack = Stack((Layer(0.2, contrast, 0.3), Layer(1.0, 1.0, 0.4999), Layer(1.0, contrast, 0.3)), sensing)
    kernel = solve(stack, "fem")
    q = np.geomspace(kernel.q[1], kernel.q[-1], 500)
    exact = layered.gain(stack, q)
    error = np.abs(kernel.gain_at(q) - exact)[exact >= fem.FLOOR].max()
    assert error <= min(1e-3, 2 * kernel.error_estimate)


@pytest.mark.parametrize("bonded", [True, False])
def test_the_gain_is_zero_where_exponentials_underflow(bonded):
    assert (layered.gain(Stack(PAPER.layers, bonds=(bonded, bonded)), np.logspace(3, 308, 400)) == 0).all()


def test_an_accuracy_that_cannot_be_met(monkeypatch):
    monkeypatch.setattr(fem, "MAX_UNKNOWNS", 20_000)
    with pytest.raises(PhysicsError, match=r"accuracy 1e-06 of the gain cannot be met: the error estimate is \d"):
        fem.solve(PAPER, 1e-6)
    with pytest.raises(
        PhysicsError, match=r"accuracy 1e-05 of the stress cannot be met: the error estimate is \d"
    ):
        fem.pressed(PAPER, 1.0, 1e-5)


@pytest.mark.parametrize(
    ("run", "text"),
    [
        (lambda: solve(PAPER, "fem", 1e-5, late=map((5.5).__lt__, count(1)).__next__), r"the estimate is \d"),
        (lambda: solve(PAPER, "fem", late=lambda: True), "there is no estimate yet"),
        (lambda: fem.pressed(PAPER, 1.0, late=lambda: True), "there is no estimate yet"),
        (
            lambda: fem.solve(Stack((Layer(0.5, 1e4, 0.3), Layer(5.0, 0.05, 0.1))), late=lambda: True),
            "the far field reaches past",
        ),
    ],
)
def test_a_time_that_is_too_short(run, text):
    with pytest.raises(PhysicsError, match=f"not met in the given time: {text}"):
        run()
