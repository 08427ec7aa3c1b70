"""A cover whose thickness is hardly known: on the tour's scenes, which shaped no constant of a filter."""

from copy import copy

import numpy as np
import pytest

from tactiled.bench.skin import nrmse, rubber, sense
from tactiled.restore.methods import make
from tactiled.simulate.scenes import SCENES

SIZE = 20


def pressed(factors, thicknesses=(0.6, 1.5), noise=0.002):
    """Blur of the configured cover, a taxel's noise, frame and truth under a cover `factors` times as thick."""
    random = np.random.default_rng(0)
    for thickness in thicknesses:
        for factor in factors:
            true = rubber(round(factor * thickness, 4), SIZE)
            field = true.surface
            for name in ("ring", "indenters", "sphere", "edge", "fingertip"):
                clean, truth = sense(true, SCENES[name](field.x, field.y, 1.0, field.size, field.grain))
                sigma = noise * clean.max()
                frame = (clean + random.normal(0, sigma, clean.shape)).astype(np.float32)
                yield copy(rubber(thickness, SIZE).blur), sigma, frame, truth


def errors(method, thickness_error, factors):
    values = []
    for blur, sigma, frame, truth in pressed(factors):
        blur.thickness_error = thickness_error
        values.append(nrmse(make(method, blur, sigma)(frame).image, truth))
    return values


@pytest.mark.parametrize(("method", "gain"), [("auto", 1.0), ("wiener", 0.98), ("nnls", 0.98)])
def test_a_filter_that_knows_how_wrong_the_thickness_may_be_is_less_wrong(method, gain):
    """Covers 15 % thinner and thicker than configured alike."""
    aware, unaware = (np.mean(errors(method, known_to, (1 / 1.15, 1.15))) for known_to in (0.15, 0.03))
    assert aware < gain * unaware


@pytest.mark.parametrize("method", ["auto", "wiener"])
def test_the_deviation_holds_the_error_where_something_is_pressed(method):
    """If it does not follow the image, 48 % of the pressed cells are within two deviations."""
    shares = []
    for blur, sigma, frame, truth in pressed((1 / 1.15, 1.15)):
        blur.thickness_error = 0.15
        restorer = make(method, blur, sigma)
        image = restorer(frame).image
        where = np.maximum(truth, image) > 0.02 * truth.max()
        shares.append(np.mean((np.abs(image - truth) < 2 * restorer.deviation())[where]))
    assert np.mean(shares) > 0.8


def test_a_thickness_known_as_well_as_without_calibration_changes_no_image():
    for blur, sigma, frame, _ in pressed((1.0,), (1.0,)):
        images = []
        for known_to in (0.03, 0.01):
            blur.thickness_error = known_to
            images.append(make("auto", blur, sigma)(frame).image)
        np.testing.assert_array_equal(*images)
