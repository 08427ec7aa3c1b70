"""Taxels that are noisier than the others, against a pad on which none is; the true cover is 10 % thicker."""

from itertools import product

import numpy as np
import pytest

from tactiled.bench.scenes import TEST_SCENES
from tactiled.bench.skin import draw, misconfigured, nrmse, rubber, sense
from tactiled.frames import MISSING, SATURATED
from tactiled.restore.inpaint import Inpainter
from tactiled.restore.methods import make
from tactiled.restore.noise import detection_threshold

SIZE = 16
SCENES = [each for each in TEST_SCENES if each != "points"]  # whose fit stands or falls by one taxel


def noisy_taxels(random, share, gain):
    return random.permutation(np.where(np.arange(SIZE**2) < share * SIZE**2, gain, 1.0)).reshape(SIZE, SIZE)


def presses(thickness, gain, share=0.1, seed=77):
    """(blur, sigma, ratio, frame of quiet taxels, the same with some noisy, truth) of every scene."""
    skin = misconfigured(rubber(thickness, SIZE), thickness=1.1)
    for number, scene in enumerate(SCENES):
        random = np.random.default_rng([seed, number])
        clean, truth = sense(skin, draw(skin, scene, random))
        sigma, ratio = 0.01 * float(clean.max()), noisy_taxels(random, share, gain)
        white = random.normal(0, sigma, clean.shape)
        frames = [(clean + each).astype(np.float32) for each in (white, ratio * white)]
        yield skin.blur, sigma, ratio, *frames, truth


@pytest.mark.parametrize(("thickness", "cost"), [(0.5, 0.65), (3.0, 0.1)])
def test_noisy_taxels_cost_less_than_as_normal_or_as_dead_ones(thickness, cost):
    errors = []
    for gain, share in product((5, 10), (0.03, 0.1)):
        for blur, sigma, ratio, quiet, noisy, truth in presses(thickness, gain, share):
            dead = np.where(ratio > 1, np.float32(np.nan), noisy)
            cases = (quiet, None), (noisy, ratio), (noisy, None), (dead, None)
            errors.append([nrmse(make("auto", blur, sigma, each)(y).image, truth) for y, each in cases])
    quiet, weighed, normal, dead = np.mean(errors, axis=0)
    assert weighed - quiet < cost * (normal - quiet)
    assert weighed < dead + 0.001


def test_on_a_healthy_pad_nothing_is_inferred_and_no_bit_changes(monkeypatch):
    blur, sigma, _, frame, _, _ = next(presses(1.0, 5.0))
    image = make("auto", blur, sigma)(frame).image.copy()
    monkeypatch.setattr(Inpainter, "mask", None)
    np.testing.assert_array_equal(make("auto", blur, sigma, np.ones(SIZE**2))(frame).image, image)


@pytest.mark.parametrize(("ceiling", "part"), [(0.8, 0.97), (0.5, 0.85)])
def test_saturated_taxels_are_above_their_ceiling(ceiling, part, monkeypatch):
    errors = []
    for sweeps in (100, 0):
        monkeypatch.setattr("tactiled.restore.inpaint.SWEEPS", sweeps)
        for blur, sigma, _, frame, _, truth in presses(1.5, 1.0):
            top = ceiling * frame.max()
            flags = np.where(frame >= top, SATURATED, 0).astype(np.uint8)
            errors.append(nrmse(make("auto", blur, sigma)(np.minimum(frame, top), flags).image, truth))
    above, plain = np.mean(np.reshape(errors, (2, -1)), axis=1)
    assert above < part * plain


def test_a_dead_row_between_saturated_ones_is_pressed_as_they_are():
    blur, flags = rubber(1.0, SIZE).blur, np.full((SIZE, SIZE), SATURATED, np.uint8)
    flags[7] = MISSING
    image = make("raw", blur, 0.5)(np.where(flags == MISSING, 0, np.float32(50)), flags).image
    assert image[7].min() > 40


def test_noise_of_noisy_taxels_is_no_contact():
    blur, random = rubber(1.0, SIZE).blur, np.random.default_rng(5)
    ratio, contact = noisy_taxels(random, 0.05, 10.0), np.zeros((SIZE, SIZE), np.float32)
    noise = (ratio * random.normal(0, 0.5, (200, SIZE, SIZE))).astype(np.float32)
    contact[4:7, 4:7] = 1.5 * detection_threshold(0.5, SIZE**2)
    cases = (noise, ratio, 198, 200), (noise, None, 0, 20), (noise + contact, ratio, 0, 0)
    for frames, weights, low, high in cases:
        restorer = make("auto", blur, 0.5, weights)
        methods = [restorer(frame).method for frame in frames]
        assert low <= methods.count("idle") <= high


@pytest.mark.parametrize("unknown", [False, True])
def test_the_deviation_at_a_noisy_taxel_is_that_of_its_error(unknown):
    ratios = []
    for thickness in (0.5, 1.0, 3.0):
        for blur, sigma, ratio, _, noisy, truth in presses(thickness, 10.0, seed=78):
            at = ratio > 1
            restorer = make("wiener", blur, sigma, ratio)
            error = restorer(noisy, at.astype(np.uint8) * (MISSING if unknown else 0)).image - truth
            ratios.append(np.linalg.norm(error[at]) / np.linalg.norm(restorer.deviation()[at]))
    assert 0.6 < np.median(ratios) < 1.4
    assert np.quantile(ratios, 0.9) < 2.5
