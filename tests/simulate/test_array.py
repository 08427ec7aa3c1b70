import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from tactiled.calibrate.calibration import Calibration
from tactiled.cover.kernel import solve
from tactiled.cover.stack import Layer, Stack
from tactiled.geometry import grid, layout
from tactiled.simulate.array import FINER, Surface, Taxels

COVER = Stack((Layer(1.2, 0.6, 0.48), Layer(1.0, 980, 0.3)))


@pytest.fixture(scope="module")
def kernel():
    return solve(COVER, "layered")


def points(side, count):
    """Gauss-Legendre points (n^2, 2) in a centred square and their weights, which sum to 1."""
    place, weight = np.polynomial.legendre.leggauss(count)
    x, y = np.meshgrid(place, place)
    return np.column_stack([x.ravel(), y.ravel()]) * side / 2, np.outer(weight, weight).ravel() / 4


def direct(kernel, array, surface, pressure, taxel):
    """Mean over the aperture of g convolved with piecewise constant pressure, summed in space."""
    middle = (array.positions.min(axis=0) + array.positions.max(axis=0)) / 2
    cells = np.column_stack([surface.x.ravel(), surface.y.ravel()]) + middle
    spread, weights = points(surface.grain, 3)
    aperture, shares = points(array.width, 5)
    if array.aperture == "round":
        aperture, shares = disc(array.width)
    total = 0.0
    g = CubicSpline(kernel.r, kernel.g)
    for at, share in zip(array.positions[taxel] + aperture, shares, strict=True):
        r = np.linalg.norm(cells[:, None] + spread - at, axis=-1)
        total += share * (pressure.ravel() @ (g(r) @ weights)) * surface.grain**2
    return total


def disc(width):
    """The same for a centred disc: equal rings, equal angles."""
    place, weight = np.polynomial.legendre.leggauss(4)
    radius = width / 2 * np.sqrt((place + 1) / 2)
    angle = np.arange(8) * np.pi / 4
    x, y = np.outer(radius, np.cos(angle)), np.outer(radius, np.sin(angle))
    return np.column_stack([x.ravel(), y.ravel()]), np.repeat(weight / 2, 8) / 8


ARRAYS = {
    "grid": grid(4, 5, 1.0, 0.8),
    "round": grid(3, 3, 1.3, 1.0, "round"),
    "layout": layout(np.array([[0, 0], [1.5, 0.2], [0.4, 1.6], [2.5, 2.0]]), 1.0),
}


@pytest.mark.parametrize("name", ARRAYS)
def test_what_taxels_sense_agrees_with_a_direct_quadrature(kernel, name):
    array = ARRAYS[name]
    surface = Surface(kernel, array)
    pressure = np.random.default_rng(4).uniform(0, 100, surface.x.shape)
    sensed = surface.sense(pressure)
    assert sensed.shape == (array.size,)
    for taxel in range(array.size):
        assert sensed[taxel] == pytest.approx(direct(kernel, array, surface, pressure, taxel), rel=1e-3)


def test_cells_are_finer_than_taxels_and_cover_the_array(kernel):
    surface = Surface(kernel, ARRAYS["grid"])
    assert surface.x.shape == surface.y.shape == (4 * FINER, 5 * FINER)
    assert surface.grain == 1.0 / FINER
    assert surface.size == 4.0
    assert surface.x.max() + surface.grain / 2 == pytest.approx(2.5)
    assert surface.x.mean() == pytest.approx(0)


def test_taxels_round_to_counts_and_stop_at_both_ends():
    taxels = Taxels(Calibration(kpa_per_count=0.5, no_load=10), 255, 0.0, 0)
    counts = taxels.count(np.array([-100.0, -0.2, 0.0, 0.3, 1.0, 1e6]))
    assert counts.tolist() == [0, 10, 10, 11, 12, 255]
    assert counts.dtype == np.uint16


def test_counts_fall_with_pressure_where_the_calibration_says_so():
    taxels = Taxels(Calibration(kpa_per_count=-1.0, no_load=245), 255, 0.0, 0)
    assert taxels.count(np.array([-50.0, 0.0, 7.0, 1000.0])).tolist() == [255, 245, 238, 0]


def test_noise_is_as_strong_as_asked_for_and_repeats_from_its_seed():
    calibration = Calibration(kpa_per_count=0.01, no_load=30_000)
    first, second, other = (Taxels(calibration, 65_535, 0.4, seed).count(np.zeros(20_000)) for seed in (1, 1, 2))
    assert np.std(first * 0.01) == pytest.approx(0.4, rel=0.02)
    np.testing.assert_array_equal(first, second)
    assert np.any(first != other)
