"""Small contacts on a large grid, moved, grown and joined by others: in a window and out of it."""

import itertools

import numpy as np
import pytest

from tactiled.cover.operator import matrix
from tactiled.restore.auto import REVIEW_FRAMES, Auto
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
    """Restores a frame through windows and by the whole alone; gives both and the windows."""
    blur = covered(SHAPE)
    scene, alone = Scene(blur, SIGMA), Scene(blur, SIGMA)
    windowed, whole = Windowed(scene), Auto(alone)

    def restore(frame):
        for each in (scene, alone):
            each.high, each.low = frame.max().item(), frame.min().item()
        return windowed(frame), whole(frame), windowed

    return restore


def error(image, truth):
    return np.linalg.norm(image - truth) / np.linalg.norm(truth)


def test_windows_are_for_large_grids(covered):
    assert [fits(covered(shape)) for shape in ((48, 52), (32, 64), (32, 32), (24, 200))] == [
        True,
        True,
        False,
        False,
    ]
    assert not fits(covered((6, 6), layout=True))


@pytest.mark.parametrize("place", [(20, 30), (3, 4), (45, 49)], ids=["middle", "corner", "far corner"])
def test_in_a_window_a_contact_is_what_it_is_on_the_whole(sensed, both, place):
    truth = disc(*place)
    both(sensed(truth))
    for _ in range(5):
        mine, plain, windowed = both(sensed(truth))
        assert windowed.used
        assert mine.method == plain.method == "nnls"
        assert error(mine.image, truth) < 1.1 * error(plain.image, truth)
        assert np.sqrt(np.mean((mine.image - plain.image) ** 2)) < SIGMA
        assert mine.image.sum() == pytest.approx(truth.sum(), rel=0.02)


def test_a_contact_that_crosses_is_never_cut(sensed, both):
    shown, errors = [], []
    for step in np.arange(0, 42, 0.25):
        truth = disc(5 + 0.9 * step, 5 + step)
        mine, plain, windowed = both(sensed(truth))
        shown.append(windowed.used)
        errors.append((error(mine.image, truth), error(plain.image, truth)))
    mine, plain = np.array(errors).T
    assert np.mean(shown) > 0.9
    assert sum(a != b for a, b in itertools.pairwise(shown)) <= 3
    assert mine.mean() < plain.mean()
    assert (mine < 1.5 * plain).all()


def test_a_contact_that_grows_is_left_to_the_whole(sensed, both):
    shown = []
    for radius in np.arange(3, 20, 0.25):
        mine, plain, windowed = both(sensed(disc(24, 26, radius)))
        shown.append(windowed.used)
    assert shown[1]
    assert not shown[-1]
    assert sum(a != b for a, b in itertools.pairwise(shown)) <= 4
    assert error(mine.image, disc(24, 26, radius)) < 1.05 * error(plain.image, disc(24, 26, radius))


def test_two_far_apart_are_left_to_the_whole(sensed, both):
    near, truth = disc(8, 9), disc(8, 9) + disc(40, 44)
    for _ in range(3):
        *_, windowed = both(sensed(near))
    assert windowed.used
    for _ in range(2 * REVIEW_FRAMES):
        mine, plain, windowed = both(sensed(truth))
        assert not windowed.used
        assert error(mine.image, truth) < 1.1 * error(plain.image, truth)


def test_what_is_faint_but_wide_is_not_lost_around_a_window(sensed, both):
    for _ in range(3):
        *_, windowed = both(sensed(disc(12, 12)))
    assert windowed.used
    mine, _, windowed = both(sensed(disc(12, 12) + 1.0))
    assert not windowed.used
    assert mine.image[36:, 36:].mean() > 0.3


def test_a_window_closes_on_what_only_the_sum_or_the_power_shows(sensed, both):
    everywhere = np.full(SHAPE, 0.25 * SIGMA)
    ripple = 0.6 * SIGMA * (-1.0) ** np.add.outer(np.arange(SHAPE[0]), np.arange(SHAPE[1]))
    for faint in (everywhere, ripple):
        for _ in range(REVIEW_FRAMES + 3):
            *_, windowed = both(sensed(disc(12, 12)))
        assert windowed.used
        frame = sensed(disc(12, 12)) + faint.astype(np.float32)
        assert np.abs(frame[30:]).max() < windowed._peak
        *_, windowed = both(frame)
        assert not windowed.used


def test_an_empty_window_is_closed(sensed, both):
    for _ in range(3):
        *_, windowed = both(sensed(disc(12, 12)))
    assert windowed.used
    mine, _, windowed = both(sensed(disc(12, 12, peak=0)))
    assert not windowed.used
    assert mine.method == "idle"
    assert not mine.image.any()


def test_points_and_deviation_are_where_the_window_is():
    sensor, truth, random = plan(SHAPE), np.zeros(SHAPE), np.random.default_rng(5)
    truth[31, 40] = 2000.0
    clean = matrix(sensor.kernel, sensor.array, [(40.0, 31.0)], 0.02)[:, 0].reshape(SHAPE) * 2000 / 0.02**2

    def sensed():
        return (clean + random.normal(0, SIGMA, SHAPE)).astype(np.float32)

    restorer = make("auto", sensor.blur, SIGMA)
    alone = restorer(sensed()).image.copy()
    around = restorer.deviation()
    done = restorer(sensed())
    assert done.method == "points"
    assert error(done.image, truth) < 0.1 + error(alone, truth)
    assert done.image.argmax() == np.ravel_multi_index((31, 40), SHAPE)
    assert done.image.sum() == pytest.approx(2000, rel=0.02)
    spread = restorer.deviation()
    assert spread.shape == SHAPE
    assert spread[31, 40] > 0.5 * around[31, 40]
    assert 0 < spread[2, 2] < 0.2 * spread[31, 40]
    assert np.count_nonzero(spread > 0.5 * spread[31, 40]) <= SIDE**2
