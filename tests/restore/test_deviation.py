"""The deviation and the noise gain of an image against its true error, under a cover not quite as believed."""

from copy import copy

import numpy as np
import pytest

from tactiled.bench.skin import rubber
from tactiled.cover.operator import matrix
from tactiled.restore import wiener
from tactiled.restore.methods import make
from tests.bench.presses import presses
from tests.plans import plan

SIZE = 12


def ratios(
    method, noise, thicker=1.0, thicknesses=(0.5, 1.0, 2.0), repeats=1, points=False, only=None, wrong=None
):
    """True errors over deviations, root mean squares; scenes are blurred exactly and drawn off the grid."""
    values = []
    for press in presses(SIZE, thicknesses, (noise,), repeats, seed=9, beyond=False):
        if (press.scene == "points") is points:
            blur = copy(rubber(thicker * press.thickness, SIZE).blur)
            blur.thickness_error = wrong or blur.thickness_error
            blur.wide = None  # all pressure ends at the border
            restorer = make(method, blur, press.sigma)
            done = restorer(press.frame)
            if done.method == (only or done.method):
                values.append(np.linalg.norm(done.image - press.truth) / np.linalg.norm(restorer.deviation()))
    return values


@pytest.mark.parametrize("thicker", [1.0, 1.03])
@pytest.mark.parametrize("noise", [0.001, 0.01, 0.05])
def test_deviation_counts_what_the_model_misses(noise, thicker):
    """Of noise alone it was 4.6 times too small at 0.1 %."""
    values = ratios("wiener", noise, thicker)
    assert 0.7 < np.median(values) < 1.3
    assert np.quantile(values, 0.9) < 3


def test_deviation_grows_with_what_the_thickness_may_be_wrong_by():
    narrow, wide = (
        np.median([ratios("wiener", 0.002, thicker, wrong=wrong) for thicker in (1 / 1.15, 1.15)])
        for wrong in (0.03, 0.15)
    )
    assert narrow > 1.3
    assert 0.8 < wide < 1.2


@pytest.mark.parametrize("noise", [0.002, 0.01, 0.05])
def test_deviation_of_the_raw_image_counts_what_the_cover_did(noise):
    """The linear image's, which is restored, was 3.6 times too small at 0.2 %."""
    values = ratios("raw", noise)
    assert 0.7 < np.median(values) < 1.3
    assert np.quantile(values, 0.9) < 2


@pytest.mark.parametrize(("method", "noise"), [("wiener", 0.01), ("nnls", 0.002)])
def test_deviation_counts_that_small_spots_may_be_elsewhere(method, noise):
    """By a spectrum that is the same everywhere, it was 2.3 to 2.5 times too small."""
    values = ratios(method, noise, thicknesses=(0.5, 1.0), repeats=8, points=True)
    assert 0.7 < np.median(values) < 1.4
    assert np.quantile(values, 0.9) < 2.5


@pytest.mark.parametrize("method", ["points", "auto"])
def test_the_deviation_of_points_is_the_fits_own(method):
    values = ratios(method, 0.002, repeats=4, points=True, only="points")
    assert len(values) > 3
    assert 0.25 < np.median(values) < 1.3
    assert max(values) < 2


@pytest.mark.parametrize(("method", "within"), [("wiener", 1.1), ("nnls", 1.4), ("points", 2.0)])
def test_noise_gain_is_what_noise_becomes(method, within):
    scene = "points" if method == "points" else "punches"
    press = next(press for press in presses(SIZE, (1.0,), (0.001,), 1, seed=4) if press.scene == scene)
    random, sigma = np.random.default_rng(0), 10 * press.sigma
    restorer = make(method, press.blur, sigma)
    images, gains = [], []
    for _ in range(40):
        done = restorer(press.frame + random.normal(0, sigma, press.frame.shape).astype(np.float32))
        if done.method == method:
            images.append(done.image.copy())
            gains.append(done.noise_gain)
    assert len(images) > 30
    true = np.sqrt(np.var(images, axis=0, ddof=1).mean()) / sigma
    assert np.mean(gains) / within < true < within * np.mean(gains)


def test_the_deviation_of_a_raw_image_is_the_same_by_auto_and_makes_its_filter_once(monkeypatch):
    press = next(press for press in presses(16, (0.05,), (0.01,), beyond=False) if press.scene == "blobs")
    auto, raw = (make(method, press.blur, press.sigma) for method in ("auto", "raw"))
    assert auto(press.frame).method == raw(press.frame).method == "raw"
    deviations = auto.deviation(), raw.deviation()
    monkeypatch.setattr(wiener, "Filter", None)
    for each in (*deviations, auto.deviation(), raw.deviation()):
        np.testing.assert_array_equal(each, deviations[0])


def test_no_cell_is_uncertain_by_more_than_half_of_all_the_force():
    """The network gave two thirds of it at a small load on 4 x 6."""
    skin = plan((4, 6), 2.0, refine=2, pitch=4.0)
    frame = matrix(skin.kernel, skin.array, np.array([[7.0, 8.3]]), 1.0).reshape(4, 6)
    restorer = make("learned", skin.blur, 0.2)
    restorer(np.float32(100 * frame / frame.max()))
    image, spread = restorer.whole()
    assert 0.3 < spread.ravel()[image.argmax()] / image.sum() < 0.55
