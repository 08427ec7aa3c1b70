import numpy as np
import pytest

from tactiled.calibrate.cover.edge import edge_touch
from tactiled.calibrate.cover.result import fit_cover
from tactiled.calibrate.cover.unknowns import Unknowns
from tactiled.errors import ConfigError
from tactiled.geometry import grid, layout
from tests.touched import Skin, World, rubber

GRID = grid(14, 14, 1.0, 0.9)
SCATTERED = layout(np.random.default_rng(8).uniform(-0.2, 0.2, (196, 2)) + GRID.positions)


def laid(array, thickness, seed, width=np.inf, beyond=True, count=5):
    """Edges at slants of 5 to 40 degrees to the rows or columns, with a pressure that varies along them."""
    random = np.random.default_rng(seed)
    world, skin = World(array, rubber(thickness)), Skin(array.size, random, noise=0.3)
    presses = []
    for number in range(count):
        angle = np.pi / 2 * (number % 4) + np.radians(random.uniform(5, 40))
        offset = random.uniform(-2, 2)
        pressure = world.edge(angle, offset, width, beyond, random.uniform(-0.02, 0.02))
        presses.append(skin.press(pressure, array))
    return presses


@pytest.mark.parametrize(
    ("array", "thickness", "width", "beyond"),
    [(GRID, 0.5, np.inf, True), (GRID, 1.2, np.inf, False), (SCATTERED, 0.9, 1.0, False)],
    ids=["thin", "load ends at the border", "ridge, no grid"],
)
def test_five_edges_give_the_thickness_within_three_percent_and_its_interval(array, thickness, width, beyond):
    presses = laid(array, thickness, 11, width, beyond)
    exact = Unknowns(size_mm=0.01, aperture_mm=0, poisson=0, curvature=0, profile=0)
    touch = edge_touch(presses, array, rubber(0.7 * thickness), 0.01, None if np.isinf(width) else width, exact)
    fit = fit_cover(touch, presses, "edge")
    assert fit.thickness_mm == pytest.approx(thickness, rel=0.03)
    low, high = fit.interval_mm
    assert abs(thickness - (low + high) / 2) < 1.5 * (high - low) / 2 < 0.05 * thickness
    assert 0.8 < fit.residual < 1.2
    x, measured, model = fit.line
    assert np.abs(measured - model).mean() < 0.02
    if np.isinf(width):
        assert np.abs(model[x < -4]).max() < 0.1
        assert np.abs(model[x > 4] - 1).max() < 0.1  # the load's own pressure is the unit


def test_too_few_edges_and_arrays_of_one_line_are_refused():
    presses = laid(GRID, 0.9, 1, count=1)
    with pytest.raises(ConfigError, match="1 of 1 presses can be used: lay the edge at least 2 times, better 5"):
        edge_touch(presses, GRID, rubber(1.0), 0.01)
    with pytest.raises(
        ConfigError, match=r"the ridge is -1 mm wide: give more than 0 and less than the array's 18\.4 mm"
    ):
        edge_touch(presses * 2, GRID, rubber(1.0), 0.01, -1.0)
    line = grid(1, 14, 1.0)
    with pytest.raises(ConfigError, match="array is one line of taxels: an edge needs two dimensions"):
        edge_touch(
            [Skin(14, np.random.default_rng(0), dead=0).press(np.ones(14), line)] * 2, line, rubber(1.0), 0.01
        )
