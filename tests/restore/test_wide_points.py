"""Loads of any width off the grid, blurred exactly: where they are, how hard they press, and what is no load."""

from itertools import product

import numpy as np
import pytest

from tactiled.bench.scenes import TEST_SCENES
from tactiled.bench.skin import draw, nrmse, rubber, sense
from tactiled.restore.methods import make
from tactiled.restore.points import Points
from tactiled.restore.scene import Scene
from tests.plans import plan

SIZE = 20
PLACES = np.array([[4.2, 5.1], [5.4, 12.3], [13.3, 8.6]])  # row, column in pitches
DEVIATIONS = np.array([0.25, 0.32, 0.28])  # pitches
PEAKS_KPA = np.array([60.0, 100.0, 80.0])


def fields(skin, places=PLACES, deviations=DEVIATIONS, peaks=PEAKS_KPA):
    """Pressure (kPa) of Gaussian bumps on the skin's fine cells."""
    x, y = ((each + (SIZE - 1) / 2) for each in (skin.surface.x, skin.surface.y))
    squares = ((y - row) ** 2 + (x - column) ** 2 for row, column in places)
    shapes = (np.exp(-each / (2 * s**2)) for each, s in zip(squares, deviations, strict=False))
    return sum(peak * shape for peak, shape in zip(peaks, shapes, strict=False))


def fitted(skin, fine, share, seed, start=None):
    """The fit of a frame with noise of a share of its peak, the image it started from, and the truth."""
    clean, truth = sense(skin, fine)
    sigma = share * clean.max()
    frame = (clean + np.random.default_rng(seed).normal(0, sigma, clean.shape)).astype(np.float32)
    image = make("nnls", skin.blur, sigma)(frame).image.copy() if start is None else start.astype(np.float32)
    scene = Scene(skin.blur, sigma)
    scene.look(frame)
    fit = Points(scene)
    fit(frame, image)
    return fit, image, truth


@pytest.mark.parametrize(("thickness", "share"), [(2.0, 0.01), (2.0, 0.03), (3.0, 0.01)])
def test_wide_loads_have_their_places_forces_and_widths(thickness, share):
    skin = rubber(thickness, SIZE)
    fit, image, truth = fitted(skin, fields(skin), share, 11)
    order = np.argsort(fit.loads.places[:, 0])
    np.testing.assert_allclose(fit.loads.places[order], PLACES, atol=0.1)
    np.testing.assert_allclose(fit.loads.force[order], 2 * np.pi * DEVIATIONS**2 * PEAKS_KPA, rtol=0.1)
    np.testing.assert_allclose(fit.loads.spread[order].mean(axis=1), DEVIATIONS, atol=0.1)
    assert nrmse(fit.drawing.image, truth) < min(0.15, 0.7 * nrmse(image, truth))


def test_a_load_is_as_wide_as_it_is_drawn():
    skin = rubber(2.0, SIZE)
    for deviation in (0.2, 0.25, 0.3):
        fit, _, truth = fitted(skin, fields(skin, PLACES[:1], [deviation], [90.0]), 0.01, 12)
        assert fit.loads.spread.mean() == pytest.approx(deviation, rel=0.15)
        assert nrmse(fit.drawing.image, truth) < 0.1


def test_deviation_covers_the_error():
    skin, scores = rubber(2.0, SIZE), []
    for seed in range(8):
        fit, _, truth = fitted(skin, fields(skin), 0.01, 20 + seed)
        pressed = fit.drawing.image > 1.0
        scores.append(np.abs(fit.drawing.image - truth)[pressed] / fit.drawing.deviation()[pressed])
    assert np.mean(np.concatenate(scores) < 2) > 0.95


@pytest.mark.parametrize("scene", [name for name in TEST_SCENES if name not in ("points", "braille")])
def test_what_is_no_load_is_refused(scene):
    for thickness, share, seed in product((1.0, 3.0), (0.01, 0.05), (301, 302)):
        skin = rubber(thickness, SIZE)
        fit, image, truth = fitted(skin, draw(skin, scene, [seed]), share, seed)
        if fit.loads:
            assert nrmse(fit.drawing.image, truth) < 1.1 * nrmse(image, truth), (thickness, share, seed)


@pytest.mark.parametrize(
    ("thickness", "scene", "seed"),
    [(2.0, "rings", 312), (2.0, "rings", 318), (2.0, "rings", 327), (3.0, "rings", 324), (3.0, "punches", 317)],
)
def test_what_a_frame_cannot_tell_from_loads_is_refused(thickness, scene, seed):
    """A chain of neighbours; another image than the non-negative one; a width that nothing tells."""
    skin = rubber(thickness, SIZE)
    fine = draw(skin, scene, [seed])
    fit, _, _ = fitted(skin, fine, 0.05, seed, start=sense(skin, fine)[1])
    assert fit.loads is None


def test_a_fit_that_leaves_more_than_noise_is_refused():
    skin = rubber(2.0, SIZE)
    fewer = sense(skin, fields(skin, PLACES[:2]))[1]
    fit, _, _ = fitted(skin, fields(skin, peaks=[60.0, 100.0, 12.0]), 0.01, 15, start=fewer)
    assert fit.loads is None


def test_under_a_thin_cover_no_narrow_load_is_placed():
    skin = rubber(0.5, SIZE)
    fit, image, truth = fitted(skin, draw(skin, "points", [305]), 0.05, 305)
    assert fit.loads is None or nrmse(fit.drawing.image, truth) < nrmse(image, truth)


def test_an_array_of_two_rows_has_no_points():
    points = Points(Scene(plan((2, 8), 1.0).blur, 0.1))
    assert points.unavailable
    assert points(np.ones((2, 8), np.float32), np.ones((2, 8), np.float32)) == 0
