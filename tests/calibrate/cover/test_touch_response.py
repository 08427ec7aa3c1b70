import numpy as np
import pytest

from tactiled.calibrate.cover.touch_response import TipResponse, quadrature, tip_transform
from tactiled.cover.family import CoverFamily
from tactiled.geometry import grid
from tests.touched import World, disc, rubber


@pytest.mark.parametrize("aperture", ["square", "round"])
@pytest.mark.parametrize("sphere", [False, True])
def test_a_tip_s_response_and_gradient_are_those_of_the_product_s_operator(aperture, sphere):
    array, family = grid(9, 9, 1.0, 0.9, aperture), CoverFamily(rubber(0.6))
    nodes = quadrature(family, (0.8, 1.3), 2.0)
    spectrum = (family.gain(nodes.q, 1.1) * tip_transform(nodes.q, 0.7, 0.5 * sphere))[:, None]
    place = np.array([3.73, 4.21])
    response, gradient = TipResponse(array, nodes)(spectrum, array.positions - place)
    pieces, weights = disc(0.7, sphere)
    exact = World(array, family.configured.thickened(1.1)).sensed(pieces + place, weights)
    assert np.abs(response[:, 0] - exact).max() < 2e-4 * exact.max()
    step = 1e-5
    for axis in (0, 1):
        shift = step * np.eye(2)[axis]
        ahead, behind = (
            TipResponse(array, nodes)(spectrum, array.positions - place + side * shift)[0][:, 0]
            for side in (1, -1)
        )
        slope = (ahead - behind) / (2 * step)
        assert np.abs(gradient[:, axis] - slope).max() < 1e-5 * np.abs(slope).max()
