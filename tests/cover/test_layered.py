import numpy as np
import pytest

from tactiled.cover.layered import gain, tangential
from tactiled.cover.stack import Layer, Stack
from tactiled.errors import PhysicsError

PAPER = [  # cover, cycles/mm, gains
    ({"thickness": 0.1}, [0.25, 0.5, 1, 1.5, 2, 3, 4], [0.995, 0.978, 0.922, 0.852, 0.772, 0.594, 0.417]),
    ({"thickness": 0.2}, [0.25, 0.5, 1, 1.5, 2, 3, 4], [0.979, 0.923, 0.772, 0.594, 0.417, 0.170, 0.061]),
    ({"thickness": 0.4}, [0.25, 0.5, 1, 1.5, 2, 3, 4], [0.929, 0.774, 0.417, 0.170, 0.061, 0.007, 0.001]),
    ({"thickness": 0.6}, [0.25, 0.5, 1, 1.5, 2, 3, 4], [0.863, 0.596, 0.170, 0.036, 0.007, 0.000, 0.000]),
    ({"young": 490}, [1, 2], [0.702, 0.343]),
    ({"young": 980}, [1, 2], [0.642, 0.285]),
    ({"young": 4903}, [1, 2], [0.411, 0.125]),
    ({"young": 9807}, [1, 2], [0.288, 0.074]),
    ({"poisson": 0.2}, [1, 2], [0.791, 0.414]),
    ({"poisson": 0.4}, [1, 2], [0.755, 0.427]),
    ({"poisson": 0.45}, [1, 2], [0.747, 0.436]),
]


@pytest.mark.parametrize(("cover", "q", "expected"), PAPER)
def test_gains_are_those_of_the_paper(paper, cover, q, expected):
    np.testing.assert_allclose(gain(paper(**cover), np.array(q, float)), expected, atol=5.1e-4)


@pytest.mark.parametrize("poisson", [0.0, 0.3, 0.4999])
def test_deep_base_is_boussinesq(poisson):
    stack = Stack((Layer(2.0, 5.0, poisson), Layer(500.0, 5.0, poisson)))
    kz = 2 * np.pi * 2.0 * np.linspace(0.05, 1, 20)
    np.testing.assert_allclose(gain(stack, kz / (4 * np.pi)), (1 + kz) * np.exp(-kz), atol=1e-9)
    cerruti = np.array([1 - kz, np.ones(20), kz, -kz]) * np.exp(-kz)
    np.testing.assert_allclose(tangential(stack, kz / (4 * np.pi)), cerruti, atol=1e-9)


def test_cutting_a_layer_in_two_changes_nothing():
    full = Stack((Layer(0.5, 1.0, 0.49), Layer(3.0, 200.0, 0.2)))
    cut = Stack(
        (Layer(0.01, 1.0, 0.49), Layer(0.49, 1.0, 0.49), Layer(1.0, 200.0, 0.2), Layer(2.0, 200.0, 0.2)), sensing=2
    )
    q = np.logspace(-4, 1, 60)
    np.testing.assert_allclose(gain(cut, q), gain(full, q), atol=1e-9)
    np.testing.assert_allclose(tangential(cut, q), tangential(full, q), atol=1e-9)


def test_gain_at_zero_is_one_and_far_out_is_zero(paper):
    q = np.array([0.0, 1e-12, 1e-7, 1e4, 1e9])
    result, (along, across, apart, tilt) = gain(paper(), q), tangential(paper(), q)
    for each in (result, along, across):
        np.testing.assert_allclose(each, [1, 1, 1, 0, 0], atol=1e-9)
    np.testing.assert_allclose([apart, tilt], 0, atol=1e-5)


def test_rubber_that_cannot_be_compressed_couples_pressure_and_shear_by_half():
    q = np.linspace(0.01, 3, 300) / 2.0
    along, _, apart, tilt = tangential(Stack((Layer(2.0, 0.3, 0.4999), Layer(1.0, 20_000.0, 0.3))), q)
    assert apart.max() == pytest.approx(0.46, abs=0.005)
    np.testing.assert_allclose(tilt, -apart, atol=0.002)
    assert along.min() < -0.19  # a wave of a few thicknesses is felt against its own direction


def test_a_layer_that_slides_holds_no_tangential_load():
    stack = Stack((Layer(2.0, 0.5, 0.49), Layer(1.0, 200.0, 0.3)), bonds=(False, True))
    with pytest.raises(PhysicsError, match="slides on the next without friction"):
        tangential(stack, 0.1)
