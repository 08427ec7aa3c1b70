"""Small contacts on a large grid, moved, grown and joined by others: in a window and out of it."""

import itertools

import numpy as np
import pytest

from tactiled.cover.operator import matrix
from tactiled.restore.auto import Auto
from tactiled.restore.methods import make
from tactiled.restore.scene import Scene
from tactiled.restore.window import SIDE, Windowed, fits
from tests.plans import plan

SHAPE = (48, 52)
SIGMA = 0.5


def disc(row, column, radius=3.0, peak=100.0):
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    return peak * np.clip(radius + 0.5 - np.hypot(y - row, x - column), 0, 1)


@pytest.fixture
def sensed(covered):
    """Noisy frames of a scene under a cover as thick as the pitch."""
    random = np.random.default_rng(5)

    def frame(truth):
        clean = covered(SHAPE).forward(np.asarray(truth, float))
        return (clean + random.normal(0, SIGMA, SHAPE)).astype(np.float32)

    return frame


@pytest.fixture
def both(covered):
    """Restores a frame through windows and by the full grid alone; gives both and the windows."""
    blur = covered(SHAPE)
    scene, alone = Scene(blur, SIGMA), Scene(blur, SIGMA)
    windowed, full = Windowed(scene), Auto(alone)

    def restore(frame):
        for each in (scene, alone):
            each.high, each.low = frame.max().item(), frame.min().item()
        return windowed(frame), full(frame), windowed

    return restore


def error(image, truth):
    return np.linalg.norm(image - truth) / np.linalg.norm(truth)


def test_windows_are_for_large_grids(covered):
    blurs = [covered(shape) for shape in ((48, 52), (32, 64), (32, 32), (24, 200))]
    assert [fits(each) for each in (*blurs, covered((6, 6), layout=True))] == [True, True, False, False, False]


@pytest.mark.parametrize("place", [(20, 30), (3, 4), (45, 49)], ids=["middle", "corner", "far corner"])
def test_in_a_window_a_contact_is_what_it_is_on_the_full_grid(sensed, both, place):
    truth = disc(*place)
    for _ in range(5):
        in_window, full_grid, windowed = both(sensed(truth))
        assert windowed.used
        assert in_window.method == full_grid.method == "learned"
        assert error(in_window.image, truth) < 1.1 * error(full_grid.image, truth)
        assert np.sqrt(np.mean((in_window.image - full_grid.image) ** 2)) < SIGMA
        assert in_window.image.sum() == pytest.approx(truth.sum(), rel=0.02)


def test_a_contact_that_crosses_is_never_cut(sensed, both):
    used, errors = [], []
    for step in np.arange(0, 42, 0.25):
        truth = disc(5 + 0.9 * step, 5 + step)
        in_window, full_grid, windowed = both(sensed(truth))
        used.append(windowed.used)
        errors.append((error(in_window.image, truth), error(full_grid.image, truth)))
    in_window, full_grid = np.array(errors).T
    assert np.mean(used) > 0.9
    assert sum(a != b for a, b in itertools.pairwise(used)) <= 4
    assert in_window.mean() < full_grid.mean()
    assert (in_window < 1.5 * full_grid).all()


def test_a_contact_that_grows_is_left_to_the_full_grid(sensed, both):
    used = []
    for radius in np.arange(3, 20, 0.25):
        in_window, full_grid, windowed = both(sensed(disc(24, 26, radius)))
        used.append(windowed.used)
    assert used[0]
    assert not used[-1]
    assert sum(a != b for a, b in itertools.pairwise(used)) <= 4
    assert error(in_window.image, disc(24, 26, radius)) < 1.05 * error(full_grid.image, disc(24, 26, radius))


LEAVING = {
    "another contact": lambda contact: contact + disc(40, 44),
    "wide and faint": lambda contact: contact + 1.0,
    "fainter": lambda contact: contact + 0.25 * SIGMA,
    "nothing": lambda contact: 0 * contact,
}


@pytest.mark.parametrize("case", LEAVING)
def test_no_window_for_what_is_not_one_small_contact(sensed, both, case):
    *_, windowed = both(sensed(disc(12, 12)))
    assert windowed.used
    truth = LEAVING[case](disc(12, 12))
    for _ in range(8):
        in_window, full_grid, windowed = both(sensed(truth))
        assert not windowed.used
        assert case != "nothing" or in_window.method == full_grid.method == "idle"
        if case == "another contact":
            np.testing.assert_array_equal(in_window.image, full_grid.image)
    assert case != "wide and faint" or in_window.image[36:, 36:].mean() > 0.3


def test_no_window_where_there_is_power_that_no_taxel_and_no_sum_shows(sensed, both):
    *_, windowed = both(sensed(disc(12, 12)))
    assert windowed.used
    ripple = (-1.0) ** np.add.outer(*map(np.arange, SHAPE))
    *_, windowed = both(sensed(disc(12, 12)) + (0.6 * SIGMA * ripple).astype(np.float32))
    assert not windowed.used


def test_points_and_deviation_are_where_the_window_is():
    sensor, truth, random = plan(SHAPE), np.zeros(SHAPE), np.random.default_rng(5)
    truth[31, 40] = 2000.0
    clean = matrix(sensor.kernel, sensor.array, [(40.0, 31.0)], 0.02)[:, 0].reshape(SHAPE) * 2000 / 0.02**2

    def sensed():
        return (clean + random.normal(0, SIGMA, SHAPE)).astype(np.float32)

    restorer = make("auto", sensor.blur, SIGMA)
    done = restorer(sensed())
    assert done.method == "points"
    assert done.image.argmax() == np.ravel_multi_index((31, 40), SHAPE)
    assert done.image.sum() == pytest.approx(2000, rel=0.02)
    spread = restorer.deviation()
    assert spread.shape == SHAPE
    assert 0 < spread[2, 2] < 0.2 * spread[31, 40]
    assert np.count_nonzero(spread > 0.5 * spread[31, 40]) <= SIDE**2
