import numpy as np
import pytest

from tactiled.restore.noise import estimate


@pytest.fixture
def film():
    """Frames of a press that moves evenly, with noise."""

    def make(frames, sigma, peak=100.0, seed=0):
        y, x = np.mgrid[:20, :20]
        middle = 6 + 8 * np.arange(frames)[:, None, None] / max(frames, 60)
        clean = peak * np.exp(-((x - middle) ** 2 + (y - 10) ** 2) / 18)
        return clean + np.random.default_rng(seed).normal(0, sigma, clean.shape)

    return make


@pytest.mark.parametrize("sigma", [0.1, 1.0, 10.0])
@pytest.mark.parametrize("frames", [3, 10, 100])
def test_noise_is_found_under_a_moving_press(film, frames, sigma):
    assert estimate(film(frames, sigma)) == pytest.approx(sigma, rel=0.12)


@pytest.mark.parametrize("frames", [1, 2])
def test_one_frame_has_to_do(film, frames):
    assert estimate(film(frames, 2.0)) == pytest.approx(2.0, rel=0.5)


def test_what_is_not_known_is_left_out(film):
    frames = film(20, 1.0)
    frames[:, 3] = np.nan
    frames[5, 7, 7] = np.inf
    assert estimate(frames) == pytest.approx(1.0, rel=0.12)


def test_what_no_sensor_means_is_not_known(film):
    """One value of 1e30 made a noise of 1e26 kPa of a short film: nothing stood out of it."""
    frames = film(20, 1.0)
    frames[5:7, 7, 7] = 1e30, np.inf
    frames[6, 7, 8] = np.inf
    frames[5, 9, 9] = -1e300
    assert estimate(frames) == pytest.approx(1.0, rel=0.12)


def test_a_few_wild_taxels_do_not_count(film):
    frames = film(20, 1.0)
    frames[:, :1] = np.random.default_rng(1).normal(0, 1000, frames[:, :1].shape)
    assert estimate(frames) == pytest.approx(1.0, rel=0.2)


def test_frames_without_noise_still_have_some(film):
    assert estimate(np.repeat(film(1, 0.0), 5, axis=0)) == pytest.approx(100 * 1e-4, rel=0.01)


@pytest.mark.parametrize("shape", [(1, 1, 1), (2, 1, 5), (4, 7), (1, 2)])
def test_any_shape_will_do(shape):
    assert estimate(np.ones(shape)) == pytest.approx(1e-4)


def test_nothing_known_is_nothing_found():
    assert estimate(np.full((4, 3, 3), np.nan)) == 0
    assert estimate(np.zeros((4, 3, 3))) == 0


@pytest.mark.parametrize("sigma", [0.2, 1.0, 5.0])
def test_presses_that_have_nothing_to_do_with_each_other_are_no_noise(sigma):
    random = np.random.default_rng(3)
    y, x = np.mgrid[:20, :20]
    places = random.uniform(2, 18, (30, 2))
    clean = [100 * np.exp(-((x - a) ** 2 + (y - b) ** 2) / 18) for a, b in places]
    assert estimate(clean + random.normal(0, sigma, (30, 20, 20))) == pytest.approx(sigma, rel=0.12)


def test_noise_that_taxels_share_is_seen_on_an_idle_pad():
    """Nothing is pressed: that frames differ is all noise."""
    shared = np.random.default_rng(4).normal(0, 2.0, (200, 1, 1))
    assert estimate(np.repeat(np.repeat(shared, 12, axis=1), 12, axis=2)) == pytest.approx(2.0, rel=0.12)


def test_noise_that_taxels_share_is_seen_under_a_steady_press(film):
    frames = np.repeat(film(1, 0.0), 200, axis=0) + np.random.default_rng(5).normal(0, 3.0, (200, 1, 1))
    assert estimate(frames) == pytest.approx(3.0, rel=0.12)
