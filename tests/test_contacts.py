import numpy as np
import pytest

from tactiled.contacts import Contact, Finder, Tracker
from tactiled.cover.kernel import solve
from tactiled.cover.operator import stencil
from tactiled.cover.stack import Layer, Stack
from tactiled.geometry import Cells, grid, layout, tiling
from tactiled.restore.blur import Blur
from tactiled.restore.methods import make
from tactiled.simulate.array import Surface

SIDE, NOISE = 24, 0.3


@pytest.fixture(scope="module")
def array():
    return grid(SIDE, SIDE, 1.0, 0.8)


def discs(x, y, *places):
    """kPa of flat punches of radius 1.6 mm at (x, y, kPa)."""
    return sum(each[2] * np.clip(4 * (1.6 - np.hypot(x - each[0], y - each[1])) + 0.5, 0, 1) for each in places)


@pytest.fixture(scope="module")
def press(array):
    """Frames of punches under 2 mm of rubber, blurred exactly and 4 times finer; and their restorations."""
    stack = Stack((Layer(2.0, 0.6, 0.48), Layer(1.0, 980.0, 0.3)))
    exact = solve(stack, "layered")
    surface = Surface(exact, array)
    blur = Blur.grid(stencil(solve(stack, "fem"), array), (SIDE, SIDE))

    def press(*places, seed=0):
        middle = (SIDE - 1) / 2
        pressure = discs(surface.x + middle, surface.y + middle, *places)
        noise = np.random.default_rng(seed).normal(0, NOISE, (SIDE, SIDE))
        frame = (surface.sense(pressure).reshape(SIDE, SIDE) + noise).astype(np.float32)
        done = make("nnls", blur, NOISE)(frame)
        return frame, done.image.copy(), NOISE * max(done.noise_gain, 1), pressure.sum() * surface.grain**2 * 1e-3

    return press


def test_a_contact_is_where_it_is_and_weighs_what_it_weighs(array, press):
    find = Finder(array, tiling(array))
    for seed, place in enumerate([(7.3, 12.8, 80), (15.0, 6.5, 40), (11.7, 11.2, 120)]):
        frame, restored, noise, force = press(place, seed=seed)
        (felt,), (found,) = find(frame, NOISE), find(restored, noise)
        assert found.x_mm == pytest.approx(place[0], abs=0.05)
        assert found.y_mm == pytest.approx(place[1], abs=0.05)
        assert found.force_n == pytest.approx(force, rel=0.05)
        assert abs(found.force_n - force) < abs(felt.force_n - force)  # the raw one loses its skirt
        assert found.area_mm2 < felt.area_mm2
        assert found.id == 0


def test_two_that_touch_are_told_apart_where_the_raw_image_shows_one(array, press):
    find = Finder(array, tiling(array))
    frame, restored, noise, _ = press((9.6, 12.0, 80), (13.3, 12.3, 70))
    assert len(find(frame, NOISE)) == 1
    first, second = sorted(find(restored, noise), key=lambda contact: contact.x_mm)
    assert (first.x_mm, second.x_mm) == (pytest.approx(9.6, abs=0.2), pytest.approx(13.3, abs=0.2))


@pytest.mark.parametrize("values", [np.zeros, lambda shape: np.random.default_rng(1).normal(0, NOISE, shape)])
def test_nothing_is_found_where_nothing_is(array, values):
    assert Finder(array, tiling(array))(values((SIDE, SIDE)).astype(np.float32), NOISE) == []


def test_axes_and_refined_cells(array):
    y, x = np.mgrid[: 2 * SIDE, : 2 * SIDE] * 0.5 - 0.25
    u, v = (x - 8) * np.cos(0.5) + (y - 9) * np.sin(0.5), (y - 9) * np.cos(0.5) - (x - 8) * np.sin(0.5)
    (found,) = Finder(array, tiling(array, 2))((100 * np.exp(-(u**2) / 18 - v**2 / 2)).astype(np.float32), 0.1)
    assert (found.x_mm, found.y_mm) == (pytest.approx(8, abs=0.02), pytest.approx(9, abs=0.02))
    assert found.angle_rad == pytest.approx(0.5, abs=0.02)
    assert 2 < found.major_mm / found.minor_mm < 3.5
    assert found.force_n == pytest.approx(100 * 2 * np.pi * 3 * 1 * 1e-3, rel=0.11)  # less the skirt under a tenth


def test_what_rings_below_zero_around_a_contact_does_not_shrink_it(array):
    image = np.zeros((24, 24), np.float32)
    image[9:13, 9:13] = -6
    image[10:12, 10:12] = 20
    (found,) = Finder(array, tiling(array))(image, 0.1)
    assert (found.x_mm, found.y_mm) == (10.5, 10.5)
    assert found.major_mm == pytest.approx(2 / 12**0.5)  # of a square of 2 mm
    assert found.force_n == pytest.approx(1e-3 * (4 * 20 - 8 * 6))


@pytest.mark.parametrize(("rows", "columns"), [(1, 1), (1, 3), (4, 2)])
@pytest.mark.parametrize("refine", [1, 2])
def test_an_even_block_is_as_long_and_as_wide_as_it_is(array, rows, columns, refine):
    image = np.zeros((refine * SIDE, refine * SIDE), np.float32)
    image[8 : 8 + rows * refine, 6 : 6 + columns * refine] = 50
    (found,) = Finder(array, tiling(array, refine))(image, 0.1)
    width, height = sorted((rows, columns))
    assert (found.minor_mm, found.major_mm) == pytest.approx((width / 12**0.5, height / 12**0.5))


def test_a_layout_that_is_no_grid():
    ring = np.array([(3 * np.cos(t), 3 * np.sin(t)) for t in np.linspace(0, 2 * np.pi, 7)[:-1]])
    array = layout(np.concatenate([ring, ring + np.array([20, 0])]), 1.0)
    find = Finder(array, Cells(array.positions, 3.0, np.arange(12)))
    image = np.zeros(12, np.float32)
    image[[0, 1, 8]] = 10, 10, 30
    strong, weak = find(image, 0.1)
    assert (strong.x_mm, strong.force_n) == (pytest.approx(18.5), pytest.approx(30 * 9e-3))
    assert (weak.x_mm, weak.area_mm2) == (pytest.approx(2.25), pytest.approx(18))


def at(x, y):
    return Contact(0, x, y, 1, 1, 1, 1, 1, 0)


def test_a_contact_keeps_its_id_while_it_lasts():
    track = Tracker(3.0)
    assert [each.id for each in track([at(0, 0), at(10, 0)])] == [1, 2]
    assert [each.id for each in track([at(9, 0), at(1, 0)])] == [2, 1]  # the order may change
    assert [each.id for each in track([at(8, 0), at(1, 1), at(1, 9)])] == [2, 1, 3]
    assert [each.id for each in track([])] == []
    assert [each.id for each in track([at(8, 0)])] == [4]  # gone is gone
    assert [each.id for each in track([at(8, 9)])] == [5]  # too far for one frame
