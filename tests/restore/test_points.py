"""Isolated loads off the grid, blurred exactly: where they are and how hard they press."""

from functools import cache
from itertools import pairwise, product

import numpy as np
import pytest

from tactiled.cover.operator import matrix
from tactiled.restore.methods import make
from tactiled.restore.points import Points
from tests.plans import plan

SHAPE = (16, 20)
PITCH = 2.0
SIDE = 0.02 * PITCH  # of the square that stands for a point
PLACES = np.array([[7.3, 8.9], [20.6, 21.7], [30.1, 5.2]])  # x, y in mm
FORCES = np.array([0.4, 0.25, 0.3])  # N


def blur_of(thickness, refine=1):
    return plan(SHAPE, thickness, refine=refine, pitch=PITCH).blur


@cache
def felt(thickness, places):
    """(taxels, places): the pressure on every taxel for unit pressure at each place."""
    sensor = plan(SHAPE, thickness, pitch=PITCH)
    return matrix(sensor.kernel, sensor.array, np.array(places), SIDE)


@pytest.fixture
def touched():
    """Frames under loads at places (mm) of forces (N), with noise of a share of the peak; and that noise."""

    def frame(thickness, places=PLACES, forces=FORCES, share=0.01, seed=0):
        clean = felt(thickness, tuple(map(tuple, places))) @ (1e3 * forces / SIDE**2)
        sigma = share * clean.max()
        noisy = clean + np.random.default_rng(seed).normal(0, sigma, clean.size)
        return noisy.reshape(SHAPE).astype(np.float32), sigma

    return frame


def in_order(points):
    found = np.array(sorted(points))
    return found[:, :2], found[:, 2]


@pytest.mark.parametrize(
    ("thickness", "share", "method"),
    [
        (0.5, 0.002, "points"),
        *product((1.0,), (0.002, 0.01), ("points", "auto")),
        *product((2.0,), (0.01,), ("points", "auto")),
    ],
)
def test_points_are_found_below_the_pitch(touched, thickness, share, method):
    frame, sigma = touched(thickness, share=share)
    restorer = make(method, blur_of(thickness), sigma)
    done = restorer(frame)
    assert done.method == "points"
    places, forces = in_order(restorer.points)
    np.testing.assert_allclose(places, PLACES, atol=0.1 * PITCH)
    np.testing.assert_allclose(forces, FORCES, rtol=0.05)


@pytest.mark.parametrize("refine", [1, 2, 3])
def test_the_image_carries_the_force_where_it_is(touched, refine):
    frame, sigma = touched(1.0)
    image = make("points", blur_of(1.0, refine), sigma)(frame).image
    cell = PITCH / refine
    assert image.sum() * cell**2 == pytest.approx(1e3 * FORCES.sum(), rel=0.05)
    column, row = ((PLACES[0] + PITCH / 2) / cell).astype(int)
    assert image.argmax() == row * image.shape[1] + column


def test_two_that_touch_the_same_taxels_are_told_apart(touched):
    pair = np.array([[15.0, 15.0], [18.2, 16.4]])
    frame, sigma = touched(1.0, pair, np.array([0.3, 0.3]), 0.002)
    restorer = make("points", blur_of(1.0), sigma)
    assert restorer(frame).method == "points"
    np.testing.assert_allclose(in_order(restorer.points)[0], pair, atol=0.1 * PITCH)


@pytest.mark.parametrize("turn", [0.0, 0.8, 1.6])
def test_two_less_than_a_pitch_apart_are_not_told_as_one(touched, turn):
    middle, half = np.array([21.0, 16.6]), 0.28 * PITCH * np.array([np.cos(turn), np.sin(turn)])
    pair = np.array([middle - half, middle + half, [8.3, 9.1]])
    frame, sigma = touched(0.8, pair, np.array([0.3, 0.3, 0.4]), 0.0025)
    restorer = make("points", blur_of(0.8), sigma)
    restorer(frame)
    assert len(restorer.points) != 2


@pytest.mark.parametrize("seed", range(8))
def test_what_one_load_leaves_of_two_is_not_lost_among_all_taxels(touched, seed):
    """On both sides of a border, under a thin cover, they look like one but to the nearest taxels."""
    pair = np.array([[14.9, 14.5], [16.1, 14.5], [28.9, 24.7]])
    frame, sigma = touched(0.6, pair, np.array([0.35, 0.25, 0.2]), 0.002, seed)
    restorer = make("auto", blur_of(0.6), sigma)
    restorer(frame)
    assert len(restorer.points) in (0, 3)


@pytest.mark.parametrize("seed", range(3))
def test_two_half_a_pitch_apart_are_not_told_as_one_where_the_frame_shows_how_long_it_would_be(touched, seed):
    middle, half = np.array([14.7, 16.0]), 0.25 * PITCH * np.array([np.cos(2.9), np.sin(2.9)])
    pair = np.array([middle - half, middle + half, [28.9, 24.7]])
    frame, sigma = touched(0.6, pair, np.array([0.3, 0.3, 0.2]), 0.0015, seed)
    restorer = make("auto", blur_of(0.6), sigma)
    restorer(frame)
    assert len(restorer.points) in (0, 3)


def off(image, places, forces):
    """Error of an image (kPa) whose truth is loads at places (mm, x and y) of forces (N)."""
    truth = np.zeros(SHAPE)
    columns, rows = np.floor(places / PITCH + 0.5).astype(int).T
    np.add.at(truth, (rows, columns), 1e3 * forces / PITCH**2)
    return np.linalg.norm(image - truth)


@pytest.mark.parametrize("thickness", [0.5, 0.6])
def test_auto_does_not_tell_as_one_what_may_be_two(touched, thickness):
    """Half a pitch apart across a taxel's border: told as one in the taxel that has the more of them."""
    forces, worst = np.array([0.3, 0.3, 0.2]), {}
    for at, seed in product(np.arange(0.05, 0.5, 0.1), range(4)):
        row = 14.1 + 0.05 * seed
        pair = np.array([[PITCH * (7.5 - at), row], [PITCH * (8 - at), row], [28.9, 24.7]])
        frame, sigma = touched(thickness, pair, forces, 0.01, seed)
        raw = off(frame, pair, forces)
        for method in ("points", "auto"):
            image = make(method, blur_of(thickness), sigma)(frame).image
            worst[method] = max(worst.get(method, 0), off(image, pair, forces) / raw)
    assert worst["auto"] < 1.02 < worst["points"]


def test_what_a_fit_leaves_is_its_own_though_a_further_step_was_tried(touched, monkeypatch):
    """Else a load's neighbourhood would be judged by what another place leaves there."""
    refined, left = Points._refined, []

    def spied(points, y, places):
        done, fit = refined(points, y, places)
        left.append((float(points._residual @ points._residual), fit.left))
        return done, fit

    monkeypatch.setattr(Points, "_refined", spied)
    middle, half = np.array([15.3, 14.6]), 0.25 * PITCH * np.array([np.cos(0.8), np.sin(0.8)])
    for seed in range(8):
        pair = np.array([middle - half, middle + half, [28.9, 24.7]])
        frame, sigma = touched(0.6, pair, np.array([0.3, 0.25, 0.2]), 0.0005, seed)
        make("points", blur_of(0.6), sigma)(frame)
    np.testing.assert_allclose(*np.transpose(left), rtol=1e-3)


def test_what_is_no_few_points_is_not_told_as_some(touched):
    x, y = np.meshgrid(*(16.0 + np.arange(-2.5, 2.6, 0.25),) * 2)
    disc = np.column_stack([x[np.hypot(x - 16, y - 16) < 2.5], y[np.hypot(x - 16, y - 16) < 2.5]])
    restorer = make("points", blur_of(1.0), 1.0)
    for share in (0.01, 0.05):
        frame, sigma = touched(1.0, disc, np.full(len(disc), 0.01), share)
        restorer = make("points", blur_of(1.0), sigma)
        done = restorer(frame)
        assert done.method == "nnls"
        assert "not a few point loads" in done.why
        assert restorer.points == ()


def test_points_of_the_frame_before_are_not_those_of_this_one(touched):
    frame, sigma = touched(1.0)
    restorer = make("auto", blur_of(1.0), sigma)
    restorer(frame)
    assert len(restorer.points) == 3
    restorer(np.zeros(SHAPE, np.float32))
    assert restorer.points == ()


@pytest.mark.parametrize("thickness", [0.05, 0.1, 0.2, 0.35])
def test_no_places_are_told_under_a_cover_too_thin_for_them(touched, thickness):
    frame, sigma = touched(thickness, share=0.002)
    restorer = make("points", blur_of(thickness), sigma)
    done = restorer(frame)
    assert (done.method, restorer.points) == ("nnls", ())
    assert "so thin a cover" in done.why
    assert make("auto", blur_of(thickness), sigma)(frame).method != "points"


def test_slopes_are_the_responses_own():
    loads = blur_of(1.0).loads
    step = 1 / 32
    middle = np.array([7.21, 8.83])
    moves = np.array([(0, 0), (1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (-1, -1), (1, -1), (-1, 1)])
    out = np.empty((6, len(moves), SHAPE[0] * SHAPE[1]), np.float32)
    loads.jacobian(middle + step * moves, out)
    value, row, column, down, across, both = out[:, 0]
    _, ahead, behind, right, left, *corners = out[0]
    for slope, more, less in ((row, ahead, behind), (column, right, left)):
        np.testing.assert_allclose((more - less) / (2 * step), slope, atol=0.02 * np.abs(slope).max())
    for curve, more, less in ((down, ahead, behind), (across, right, left)):
        found = (more + less - 2 * value) / (2 * step**2)
        np.testing.assert_allclose(found, curve, atol=0.1 * np.abs(curve).max())
    mixed = (corners[0] + corners[1] - corners[2] - corners[3]) / (4 * step**2)
    np.testing.assert_allclose(mixed, both, atol=0.1 * np.abs(both).max())


@pytest.mark.parametrize("share", [0.002, 0.01])
@pytest.mark.parametrize("radius", [0.3, 0.5, 0.8, 1.2])
@pytest.mark.parametrize("thickness", [0.5, 1.0, 2.0])
def test_small_discs_fare_no_worse_for_points(touched, thickness, radius, share):
    """Before a width was asked for, discs of a third of a pitch came out as points of up to twice their peak."""
    step = np.arange(-1.2, 1.21, 0.1) * PITCH
    x, y = (each.ravel() for each in np.meshgrid(step, step))
    inside = np.hypot(x, y) < radius * PITCH
    places = np.concatenate([place + np.column_stack([x, y])[inside] for place in PLACES])
    forces = np.repeat(FORCES / inside.sum(), inside.sum())
    frame, sigma = touched(thickness, places, forces, share)
    rows, columns = np.round(places.T[::-1] / PITCH).astype(int)
    truth = np.zeros(SHAPE)
    np.add.at(truth, (rows, columns), 1e3 * forces / PITCH**2)
    error = {
        name: np.linalg.norm(make(name, blur_of(thickness), sigma)(frame).image - truth)
        for name in ("points", "nnls")
    }
    assert error["points"] < 1.1 * error["nnls"]


def test_points_that_are_hardly_certain_do_not_flicker(touched):
    """Held to as much in every frame, 26 changes of method in 150 frames."""
    frames = [touched(0.7, share=0.02, seed=seed) for seed in range(150)]
    restorer = make("points", blur_of(0.7), frames[0][1])
    methods = [restorer(frame).method for frame, _ in frames]
    assert sum(a != b for a, b in pairwise(methods)) < 6
    assert methods.count("points") > 140
