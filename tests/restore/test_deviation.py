"""What is said of an image's error and noise, against what they are, under a cover not quite as believed."""

import numpy as np
import pytest

from tactiled.restore import wiener
from tactiled.restore.methods import make
from tactiled.study.skin import rubber
from tests.study.presses import presses

SIZE = 12


def ratios(method, noise, thicker, repeats, points=False):
    """True errors over claimed ones, root mean squares; scenes are blurred exactly and drawn off the grid."""
    for press in presses(SIZE, (0.5, 1.0, 2.0), (noise,), repeats, seed=9):
        if (press.scene == "points") is not points:
            continue
        restorer = make(method, rubber(thicker * press.thickness, SIZE).blur, press.sigma)
        done = restorer(press.frame)
        if done.method == ("points" if points else method):
            yield np.linalg.norm(done.image - press.truth) / np.linalg.norm(restorer.deviation())


@pytest.mark.parametrize("thicker", [1.0, 1.03])
@pytest.mark.parametrize("noise", [0.001, 0.01, 0.05])
def test_deviation_counts_what_the_model_misses(noise, thicker):
    """Of noise alone it was 4.6 times too small at 0.1 %."""
    found = list(ratios("wiener", noise, thicker, 1))
    assert 0.7 < np.median(found) < 1.3
    assert np.quantile(found, 0.9) < 3


@pytest.mark.parametrize("noise", [0.002, 0.01, 0.05])
def test_deviation_of_the_raw_image_counts_what_the_cover_did(noise):
    """Told the linear image's, which was restored, it was 3.6 times too small at 0.2 %."""
    found = list(ratios("raw", noise, 1.0, 1))
    assert 0.7 < np.median(found) < 1.3
    assert np.quantile(found, 0.9) < 2


def test_deviation_of_a_frame_left_raw_is_the_raw_images():
    press = next(press for press in presses(16, (0.05,), (0.01,)) if press.scene == "points")
    auto, raw = (make(method, press.blur, press.sigma) for method in ("auto", "raw"))
    assert auto(press.frame).method == raw(press.frame).method == "raw"
    np.testing.assert_array_equal(auto.deviation(), raw.deviation())


@pytest.mark.parametrize("method", ["wiener", "nnls"])
@pytest.mark.parametrize("noise", [0.002, 0.01])
def test_deviation_counts_that_small_spots_may_be_elsewhere(method, noise):
    """Told that the spectrum is the same everywhere, it was 2.3 to 2.5 times too small."""
    found = []
    for press in presses(SIZE, (0.5, 1.0), (noise,), 8, seed=9):
        if press.scene == "points":
            restorer = make(method, press.blur, press.sigma)
            error = restorer(press.frame).image - press.truth
            found.append(np.linalg.norm(error) / np.linalg.norm(restorer.deviation()))
    assert 0.7 < np.median(found) < 1.4
    assert np.quantile(found, 0.9) < 2.5


@pytest.mark.parametrize("method", ["points", "auto"])
def test_the_deviation_of_points_is_the_fits_own(method):
    found = list(ratios(method, 0.002, 1.0, 3, points=True))
    assert len(found) > 4
    assert 0.25 < np.median(found) < 1.3
    assert max(found) < 2


@pytest.mark.parametrize(("method", "within"), [("wiener", 1.1), ("nnls", 1.4), ("points", 2.0)])
def test_noise_gain_is_what_noise_becomes(method, within):
    noise = 0.01
    wanted = "points" if method == "points" else "punches"
    cases = presses(SIZE, (1.0,), (noise / 10,), 1, seed=4)
    press = next(press for press in cases if press.scene == wanted)
    random = np.random.default_rng(0)
    restorer = make(method, press.blur, 10 * press.sigma)
    images, told = [], []
    for _ in range(40):
        restorer.reset()
        done = restorer(press.frame + random.normal(0, 10 * press.sigma, press.frame.shape).astype(np.float32))
        if done.method == method:
            images.append(done.image.copy())
            told.append(done.noise_gain)
    assert len(images) > 30
    true = np.sqrt(np.var(images, axis=0, ddof=1).mean()) / (10 * press.sigma)
    assert np.mean(told) / within < true < within * np.mean(told)


@pytest.mark.parametrize("method", ["auto", "raw"])
def test_what_deviations_of_raw_images_need_is_made_once(method, monkeypatch):
    press = next(press for press in presses(16, (0.05,), (0.01,)) if press.scene == "points")
    restorer = make(method, press.blur, press.sigma)
    assert restorer(press.frame).method == "raw"
    first = restorer.deviation()
    monkeypatch.setattr(wiener, "Filter", None)
    np.testing.assert_array_equal(restorer.deviation(), first)
