"""Modes that stand out of the spectrum picked for a frame."""

import numpy as np

from tactiled.restore.methods import make
from tactiled.restore.narrow_band import FALSE_ALARMS, NarrowBand
from tactiled.study.skin import nrmse, rubber, sense

SIDE = 32
PERIODS = (2.2, 2.8, 3.4)  # pitches


def ridges(skin, period, angle):
    """A round contact whose pressure goes up and down along one direction."""
    x, y = skin.surface.x, skin.surface.y
    u = x * np.cos(angle) + y * np.sin(angle)
    return (np.hypot(x, y) < 8) * (1 + 0.9 * np.sin(2 * np.pi * u / period))


def errors(method, thickness, noise):
    skin, random, result = rubber(thickness, SIDE), np.random.default_rng(3), []
    for period in PERIODS:
        for angle in (0.4, 1.2, 2.3):
            clean, truth = sense(skin, 100 * ridges(skin, period, angle))
            sigma = noise * float(clean.max())
            frame = (clean + random.normal(0, sigma, clean.shape)).astype(np.float32)
            result.append(nrmse(make(method, skin.blur, sigma)(frame).image, truth))
    return np.mean(result)


def test_ridges_that_the_spectrum_takes_for_noise_are_restored(monkeypatch):
    with_band = {name: errors(name, 2.0, 0.01) for name in ("wiener", "auto")}
    monkeypatch.setattr(NarrowBand, "__call__", lambda *_: False)
    for name, error in with_band.items():
        assert error < 0.9 * errors(name, 2.0, 0.01), name


def test_noise_alone_hardly_ever_stands_out():
    blur, random = rubber(2.0, SIDE).blur, np.random.default_rng(4)
    band = NarrowBand(blur.modes, 0.5, np.zeros(blur.modes.gain.shape))
    limit, weight = band.limit(np.zeros(blur.modes.gain.shape)), np.zeros(blur.modes.gain.shape, np.float32)
    frames = 4000
    squares = (random.normal(0, 0.5, (frames, *weight.shape)) ** 2).astype(np.float32)
    assert sum(band(each, limit, weight) for each in squares) < 3 * FALSE_ALARMS * frames


def test_a_mode_that_stands_out_is_weighed_by_its_own_power():
    modes = rubber(2.0, SIDE).blur.modes
    band, h = NarrowBand(modes, 0.5, np.full(modes.gain.shape, 0.01)), modes.gain
    squares = np.zeros(h.shape, np.float32)
    squares[8, 10] = 100.0
    weight = np.full(h.shape, 0.25, np.float32)
    assert band(squares, band.limit(np.zeros(h.shape)), weight)
    own = (100 / 25 / 0.25 - 1) / h**2  # over the noise's variance
    expected = h * own / (h**2 * own + 1 + 0.01 * own)
    about = slice(6, 11), slice(8, 13)
    np.testing.assert_allclose(band.weight[about], expected[about], rtol=1e-4)
    outside = band.weight.copy()
    outside[about] = 0.25
    assert (outside == 0.25).all()
