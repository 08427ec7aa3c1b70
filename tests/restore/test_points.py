"""Isolated loads off the grid, blurred exactly: where they are and how hard they press."""

from functools import cache
from itertools import product

import numpy as np
import pytest

from tactiled.core import points
from tactiled.cover.operator import matrix
from tactiled.restore.methods import make
from tactiled.restore.nonnegative import Nonnegative
from tactiled.restore.point_image import PointImage, PointLoads
from tactiled.restore.point_response import PHASES
from tactiled.restore.points import Points
from tactiled.restore.scene import Scene
from tactiled.restore.wiener import Wiener
from tests.plans import plan

SHAPE = (16, 20)
PITCH = 2.0
SIDE = 0.02 * PITCH  # of the square that stands for a point
PLACES = np.array([[7.3, 8.9], [20.6, 21.7], [30.1, 5.2]])  # x, y in mm
FORCES = np.array([0.4, 0.25, 0.3])  # N
APART = [28.9, 24.7]  # far from the others


def blur_of(thickness, refine=1):
    return plan(SHAPE, thickness, refine=refine, pitch=PITCH).blur


@cache
def response(thickness, places):
    """(taxels, places): the pressure on every taxel for unit pressure at each place."""
    sensor = plan(SHAPE, thickness, pitch=PITCH)
    return matrix(sensor.kernel, sensor.array, np.array(places), SIDE)


def touched(thickness, places=PLACES, forces=FORCES, share=0.01, seed=0):
    """A frame under loads at places (mm) of forces (N), with noise of a share of the peak; and that noise."""
    clean = response(thickness, tuple(map(tuple, places))) @ (1e3 * np.asarray(forces) / SIDE**2)
    sigma = share * clean.max()
    noisy = clean + np.random.default_rng(seed).normal(0, sigma, clean.size)
    return noisy.reshape(SHAPE).astype(np.float32), sigma


def fitted(thickness, frame, sigma):
    """Places (mm) and forces (N) of the loads that a frame supports, from left to right."""
    scene = Scene(blur_of(thickness), sigma)
    scene.look(frame)
    nonnegative, points = Nonnegative(scene), Points(scene)
    nonnegative(Wiener(scene)())
    if not points(frame, scene.inside(nonnegative.image)):
        return np.empty((0, 2)), np.empty(0)
    order = np.argsort(points.loads.places[:, 1])
    return points.loads.places[order, ::-1] * PITCH, 1e-3 * PITCH**2 * points.loads.force[order]


def pair(middle, half_mm, turn):
    """Two loads about a middle (mm), and one far from them."""
    half = half_mm * np.array([np.cos(turn), np.sin(turn)])
    return np.array([middle - half, middle + half, APART])


def truth_of(places, forces):
    """Means over the cells (kPa) of loads at places (mm)."""
    image = np.zeros(SHAPE)
    columns, rows = np.floor(np.asarray(places) / PITCH + 0.5).astype(int).T
    np.add.at(image, (rows, columns), 1e3 * forces / PITCH**2)
    return image


@pytest.mark.parametrize(("thickness", "share"), [(0.7, 0.002), (1.0, 0.002), (1.0, 0.01), (2.0, 0.01)])
def test_points_are_placed_below_the_pitch(thickness, share):
    places, forces = fitted(thickness, *touched(thickness, share=share))
    order = np.argsort(PLACES[:, 0])
    np.testing.assert_allclose(places, PLACES[order], atol=0.1 * PITCH)
    np.testing.assert_allclose(forces, FORCES[order], rtol=0.05)


@pytest.mark.parametrize("refine", [1, 2, 3])
@pytest.mark.parametrize("method", ["points", "auto"])
def test_the_image_carries_the_force_where_it_is(method, refine):
    frame, sigma = touched(1.0)
    done = make(method, blur_of(1.0, refine), sigma)(frame)
    image, cell = done.image, PITCH / refine
    assert done.method == "points"
    assert image.sum() * cell**2 == pytest.approx(1e3 * FORCES.sum(), rel=0.05)
    column, row = ((PLACES[0] + PITCH / 2) / cell).astype(int)
    assert image.argmax() == row * image.shape[1] + column


@pytest.mark.parametrize("refine", [1, 2])
def test_a_narrow_load_of_uncertain_width_is_no_more_uncertain_than_its_cells(refine):
    drawing = PointImage((4 * refine, 6 * refine), refine, noise=0.2)
    for spread in (0.05, 0.1, 0.2, 0.4):
        errors, place = np.array([[0.01, 1e-4, 1e-4]]), np.array([[1.3, 1.5]])
        drawing(PointLoads(place, np.array([65.0]), np.full((1, 2), spread), errors, width=0.01, noise=1.0))
        assert 0.2 * drawing.noise_gain < np.sqrt(np.mean(drawing.deviation() ** 2))


def test_two_that_touch_the_same_taxels_are_separated():
    two = np.array([[15.0, 15.0], [18.2, 16.4]])
    places, _ = fitted(1.0, *touched(1.0, two, [0.3, 0.3], 0.002))
    np.testing.assert_allclose(places, two, atol=0.1 * PITCH)


CLOSE = {
    "less than a pitch": (0.8, [21.0, 16.6], 0.28, 0.0, (0.3, 0.3, 0.4), 0.0025, 1.0),
    "less than a pitch, aslant": (0.8, [21.0, 16.6], 0.28, 0.8, (0.3, 0.3, 0.4), 0.0025, 1.0),
    "less than a pitch, upright": (0.8, [21.0, 16.6], 0.28, 1.6, (0.3, 0.3, 0.4), 0.0025, 1.0),
    "across a border": (0.6, [15.5, 14.5], 0.3, 0.0, (0.35, 0.25, 0.2), 0.002, 1.25),
}


@pytest.mark.parametrize("case", CLOSE)
def test_two_close_together_are_hardly_worse_than_raw(case):
    """Whether they are fitted as one wide load, or not at all."""
    thickness, middle, half, turn, forces, share, bound = CLOSE[case]
    places, forces = pair(np.array(middle), half * PITCH, turn), np.array(forces)
    truth, ratios = truth_of(places, forces), []
    for seed in range(8):
        frame, sigma = touched(thickness, places, forces, share, seed)
        image = make("auto", blur_of(thickness), sigma)(frame).image
        ratios.append(np.linalg.norm(image - truth) / np.linalg.norm(frame - truth))
    assert max(ratios) < bound


@pytest.mark.parametrize("thickness", [0.5, 0.6])
def test_two_that_look_like_one_are_a_fifth_worse_than_raw_in_the_mean_at_most(thickness):
    """Half a pitch apart across a taxel's border: as one, they land in the taxel that has the more of them."""
    forces, ratios = np.array([0.3, 0.3, 0.2]), []
    for at, seed in product(np.arange(0.05, 0.5, 0.1), range(4)):
        row = 14.1 + 0.05 * seed
        places = np.array([[PITCH * (7.5 - at), row], [PITCH * (8 - at), row], APART])
        frame, sigma = touched(thickness, places, forces, 0.01, seed)
        truth = truth_of(places, forces)
        image = make("auto", blur_of(thickness), sigma)(frame).image
        ratios.append(np.linalg.norm(image - truth) / np.linalg.norm(frame - truth))
    assert np.mean(ratios) < 1.2


def test_a_disc_is_no_few_points():
    x, y = np.meshgrid(*(16.0 + np.arange(-6, 6.1, 0.5),) * 2)
    inside = np.hypot(x - 16, y - 16) < 5
    disc = np.column_stack([x[inside], y[inside]])
    for share in (0.01, 0.05):
        frame, sigma = touched(1.0, disc, np.full(len(disc), 0.01), share)
        done = make("points", blur_of(1.0), sigma)(frame)
        assert done.method == "nnls"
        assert "not a few point loads" in done.why


def test_the_deviation_after_an_idle_frame_is_not_the_points_before():
    frame, sigma = touched(1.0)
    restorer, fresh = (make("auto", blur_of(1.0), sigma) for _ in range(2))
    assert restorer(frame).method == "points"
    for each in (restorer, fresh):
        each(np.zeros(SHAPE, np.float32))
    np.testing.assert_array_equal(restorer.deviation(), fresh.deviation())


@pytest.mark.parametrize("thickness", [0.05, 0.1, 0.2, 0.35])
def test_no_points_are_placed_under_a_cover_too_thin_for_them(thickness):
    frame, sigma = touched(thickness, share=0.002)
    done = make("points", blur_of(thickness), sigma)(frame)
    assert done.method == "nnls"
    assert "too thin" in done.why
    assert make("auto", blur_of(thickness), sigma)(frame).method != "points"


def test_slopes_are_the_responses_own():
    step = 1 / 32
    moves = np.array([(0, 0), (1, 0), (-1, 0), (0, 1), (0, -1)])
    out = np.empty((4, len(moves), SHAPE[0] * SHAPE[1]), np.float32)
    response = blur_of(1.0).response
    at = (PHASES * (np.array([7.21, 8.83]) + step * moves)).round().astype(int)
    points.responses(response.down, response.across, at, 0, out)
    value, row, column, wider = out[:, 0]
    _, below, above, right, before = out[0]
    for slope, more, less in ((row, below, above), (column, right, before)):
        np.testing.assert_allclose((more - less) / (2 * step), slope, atol=0.02 * np.abs(slope).max())
    second = (below + above + right + before - 4 * value) / (2 * step**2)
    np.testing.assert_allclose(second, wider, atol=0.1 * np.abs(wider).max())


@pytest.mark.parametrize("share", [0.002, 0.01])
@pytest.mark.parametrize("radius", [0.3, 0.5, 0.8, 1.2])
@pytest.mark.parametrize("thickness", [0.5, 1.0, 2.0])
def test_small_discs_fare_no_worse_for_points(thickness, radius, share):
    """Under the cover a disc and a bump as wide look alike, so that it may be drawn as the other."""
    step = np.arange(-1.2, 1.21, 0.1) * PITCH
    x, y = (each.ravel() for each in np.meshgrid(step, step))
    inside = np.hypot(x, y) < radius * PITCH
    places = np.concatenate([place + np.column_stack([x, y])[inside] for place in PLACES])
    forces = np.repeat(FORCES / inside.sum(), inside.sum())
    frame, sigma = touched(thickness, places, forces, share)
    truth = truth_of(places, forces)
    errors = [
        np.linalg.norm(make(name, blur_of(thickness), sigma)(frame).image - truth) for name in ("points", "nnls")
    ]
    assert errors[0] < 1.3 * errors[1]
