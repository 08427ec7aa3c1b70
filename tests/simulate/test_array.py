import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from tactiled.calibrate.counts.calibration import Calibration
from tactiled.cover.kernel import solve
from tactiled.cover.stack import Layer, Stack
from tactiled.geometry import grid, layout
from tactiled.simulate.array import FINER, Surface, Taxels

COVER = Stack((Layer(1.2, 0.6, 0.48), Layer(1.0, 980, 0.3)))


KERNEL = solve(COVER, "layered")


def points(side, count):
    """Gauss-Legendre points (n^2, 2) in a centred square and their weights, which sum to 1."""
    place, weight = np.polynomial.legendre.leggauss(count)
    x, y = np.meshgrid(place, place)
    return np.column_stack([x.ravel(), y.ravel()]) * side / 2, np.outer(weight, weight).ravel() / 4


def disc(width, count):
    """The same for a centred disc: equal rings, equal angles."""
    place, weight = np.polynomial.legendre.leggauss(count)
    radius = width / 2 * np.sqrt((place + 1) / 2)
    angle = np.arange(8) * np.pi / 4
    x, y = np.outer(radius, np.cos(angle)), np.outer(radius, np.sin(angle))
    return np.column_stack([x.ravel(), y.ravel()]), np.repeat(weight / 2, 8) / 8


def direct(array, surface, pressure, taxel):
    """Mean over the aperture of g convolved with piecewise constant pressure, summed in space."""
    middle = (array.positions.min(axis=0) + array.positions.max(axis=0)) / 2
    cells = np.column_stack([surface.x.ravel(), surface.y.ravel()]) + middle
    spread, weights = points(surface.grain, 3)
    aperture, shares = disc(array.width, 4) if array.aperture == "round" else points(array.width, 5)
    total, g = 0.0, CubicSpline(KERNEL.r, KERNEL.g)
    for at, share in zip(array.positions[taxel] + aperture, shares, strict=True):
        r = np.linalg.norm(cells[:, None] + spread - at, axis=-1)
        total += share * (pressure.ravel() @ (g(r) @ weights)) * surface.grain**2
    return total


ARRAYS = {
    "grid": grid(4, 5, 1.0, 0.8),
    "round": grid(3, 3, 1.3, 1.0, "round"),
    "layout": layout(np.array([[0, 0], [1.5, 0.2], [0.4, 1.6], [2.5, 2.0]]), 1.0),
}


@pytest.mark.parametrize("name", ARRAYS)
def test_what_taxels_sense_agrees_with_a_direct_quadrature(name):
    array = ARRAYS[name]
    surface = Surface(KERNEL, array)
    pressure = np.random.default_rng(4).uniform(0, 100, surface.x.shape)
    sensed = surface.sense(pressure)
    assert sensed.shape == (array.size,)
    for taxel in range(array.size):
        assert sensed[taxel] == pytest.approx(direct(array, surface, pressure, taxel), rel=1e-3)


def test_cells_are_finer_than_taxels_and_cover_the_array():
    surface = Surface(KERNEL, ARRAYS["grid"])
    assert surface.x.shape == surface.y.shape == (4 * FINER, 5 * FINER)
    assert (surface.grain, surface.size) == (1.0 / FINER, 4.0)
    assert surface.x.max() + surface.grain / 2 == pytest.approx(2.5)
    assert surface.x.mean() == pytest.approx(0)


@pytest.mark.parametrize(
    ("kpa_per_count", "no_load", "pressure", "counts"),
    [
        (0.5, 10, [-100.0, -0.2, 0.0, 0.3, 1.0, 1e6], [0, 10, 10, 11, 12, 255]),
        (-1.0, 245, [-50.0, 0.0, 7.0, 1000.0], [255, 245, 238, 0]),
    ],
)
def test_taxels_round_to_counts_and_stop_at_both_ends(kpa_per_count, no_load, pressure, counts):
    got = Taxels(Calibration(kpa_per_count, no_load), 255, 0.0, 0).count(np.array(pressure))
    assert (got.tolist(), got.dtype) == (counts, np.uint16)


def test_noise_is_as_strong_as_asked_for_and_repeats_from_its_seed():
    calibration = Calibration(kpa_per_count=0.01, no_load=30_000)
    first, second, other = (Taxels(calibration, 65_535, 0.4, seed).count(np.zeros(20_000)) for seed in (1, 1, 2))
    assert np.std(first * 0.01) == pytest.approx(0.4, rel=0.02)
    np.testing.assert_array_equal(first, second)
    assert np.any(first != other)
