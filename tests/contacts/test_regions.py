from math import pi
from types import SimpleNamespace

import numpy as np
import pytest

from tactiled.contacts.regions import Region, RegionMeter, Threshold
from tactiled.geometry import grid, raster

CELLS = raster(grid(40, 60, 0.5), 1)  # 30 x 20 mm; the first taxel's centre is at 0, 0
SHAPES = [
    ("rectangle", [[9.75, 2.25], [4.25, 7.75]], 5.5 * 5.5, (7.0, 5.0)),
    ("ellipse", [[5.0, 3.0], [15.0, 9.0]], pi * 5 * 3, (10.0, 6.0)),
    ("polygon", [[2.25, 2.25], [14.45, 2.25], [2.25, 14.05]], 72.0, (6.32, 6.18)),
]


def restored(values, unit="kPa", shares=None):
    return SimpleNamespace(restored=values, shares=shares, cell_noise=0.1, unit=unit)


@pytest.mark.parametrize(("shape", "points", "area", "centre"), SHAPES)
def test_a_region_has_the_cells_inside_its_outline(shape, points, area, centre):
    inside = Region(shape=shape, points_mm=points).cells(CELLS)
    assert len(inside) * 0.25 == pytest.approx(area, rel=0.04)
    assert CELLS.positions[inside].mean(axis=0) == pytest.approx(centre, abs=0.12)


def test_force_mean_peak_and_contact_area_are_of_a_region_whose_every_cell_is_known():
    measure = RegionMeter(Region(shape="rectangle", points_mm=[[-0.25, -0.25], [4.75, 4.75]]), CELLS)
    image = np.full((40, 60), 7.0, np.float32)
    image[:10, :10] = 0.2
    image[2, 3], image[4, 4], image[15, 5] = 30.0, 10.0, np.nan
    values = measure(restored(image))
    total = (98 * 0.2 + 30 + 10) * 0.25
    assert values == pytest.approx((total * 1e-3, total / (100 * 0.25), 30.0, 0.5))
    assert measure(restored(image, "counts")).force == pytest.approx(total)
    shares = np.ones((40, 60), np.float32)
    shares[:10, 6:] = 0.5  # and all outside the region
    assert measure(restored(image, shares=shares)) == pytest.approx(values)
    shares[:10, 5:] = 0.5
    assert np.isnan(measure(restored(image, shares=shares))).all()
    image[5, 5] = np.nan  # a contact may be on it
    assert np.isnan(measure(restored(image))).all()


def test_a_threshold_that_is_left_out_has_few_digits():
    assert Threshold(quantity="force", above=8.2).below == 7.38  # 8.2 less a tenth is 7.379999999999999
    assert Threshold(quantity="force", above=-8.2).below == -9.02


@pytest.mark.parametrize(
    ("shape", "points", "above", "fault"),
    [
        ("polygon", [[0, 0], [1, 1]], 3, "a polygon has three corners at least, not 2"),
        ("ellipse", [[0, 0], [1, 1], [2, 0]], 3, "two corners make the ellipse, not 3"),
        ("rectangle", [[0, 0], [9, 9]], 1, "below = 2 is more than above = 1"),
        ("ellipse", [[100, 100], [110, 110]], 3, "no cell of the image has its centre in it"),
    ],
)
def test_what_is_no_region_is_refused_by_name(shape, points, above, fault):
    threshold = {"quantity": "force", "above": above, "below": 2}
    region = Region(shape=shape, points_mm=points, threshold=threshold)
    with pytest.raises(ValueError, match=fault):
        region.cells(CELLS)
