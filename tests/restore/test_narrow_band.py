"""Modes that stand out of the spectrum picked for a frame."""

from weakref import WeakValueDictionary

import numpy as np
import pytest

from tactiled.bench.skin import nrmse, rubber, sense
from tactiled.core import coefficients
from tactiled.restore import prior
from tactiled.restore.methods import make
from tactiled.restore.narrow_band import FALSE_ALARMS, NarrowBand

SIDE = 32


def pad(skin, period, angle):
    """A round contact whose pressure goes up and down along one direction."""
    x, y = skin.surface.x, skin.surface.y
    u = x * np.cos(angle) + y * np.sin(angle)
    return (np.hypot(x, y) < 8) * (1 + 0.9 * np.sin(2 * np.pi * u / period))


FAULTS = {
    "wrong gains": lambda clean, random: clean * (1 + 0.05 * random.normal(size=clean.shape)),
    "row noise": lambda clean, random: clean + 0.05 * clean.max() * random.normal(size=(SIDE, 1)),
    "column noise": lambda clean, random: clean + 0.05 * clean.max() * random.normal(size=(1, SIDE)),
}


def error(method, periods, fault=lambda clean, _: clean):
    """Mean over some pads under t/pitch 2, in 1 % noise."""
    skin, random, errors = rubber(2.0, SIDE), np.random.default_rng(3), []
    for period in periods:
        for angle in (0.4, 1.2, 2.3):
            clean, truth = sense(skin, 100 * pad(skin, period, angle))
            sigma = 0.01 * float(clean.max())
            frame = fault(clean, random) + random.normal(0, sigma, clean.shape)
            errors.append(nrmse(make(method, skin.blur, sigma)(frame.astype(np.float32)).image, truth))
    return np.mean(errors)


def without_bands(monkeypatch):
    """No mode stands out of any spectrum, in filters made from now on."""
    monkeypatch.setattr(prior, "_STORES", WeakValueDictionary())
    monkeypatch.setattr(NarrowBand, "limit", lambda _, expected: np.full(expected.shape, np.inf, np.float32))


def weighed(band, c, weight):
    """The weights by which coefficients (K, L) are filtered, given those of a spectrum."""
    of_spectrum = np.array([band.limit(np.zeros(c.shape)), weight], np.float32)
    used, one, total = np.empty(c.shape, np.float32), np.eye(SIDE, dtype=np.float32), np.zeros(c.size, np.float32)
    fixed = band.of_modes, band.shared, total, one, one
    coefficients.filtered(c.astype(np.float32), 0.25, of_spectrum, *fixed, used, np.empty_like(used))
    return used


@pytest.mark.parametrize("method", ["wiener", "auto"])
def test_ridges_that_the_spectrum_takes_for_noise_are_restored(monkeypatch, method):
    with_bands = error(method, (2.2, 2.8, 3.4))
    without_bands(monkeypatch)
    assert with_bands < 0.9 * error(method, (2.2, 2.8, 3.4))


@pytest.mark.parametrize("fault", FAULTS.values(), ids=FAULTS)
def test_faults_that_raise_many_modes_are_no_texture(monkeypatch, fault):
    with_bands = error("wiener", (100.0,), fault)
    without_bands(monkeypatch)
    assert with_bands < 1.01 * error("wiener", (100.0,), fault)


def test_noise_alone_hardly_ever_stands_out():
    blur, random = rubber(2.0, SIDE).blur, np.random.default_rng(4)
    band, shape, frames = NarrowBand(blur.modes, np.zeros(blur.modes.gain.shape)), blur.modes.gain.shape, 4000
    seen = (weighed(band, random.normal(0, 0.5, shape), np.zeros(shape)).any() for _ in range(frames))
    assert sum(seen) < 3 * FALSE_ALARMS * frames


def test_a_mode_that_stands_out_is_weighed_by_its_own_power():
    modes = rubber(2.0, SIDE).blur.modes
    band, h = NarrowBand(modes, np.full(modes.gain.shape, 0.01)), modes.gain
    c = np.zeros(h.shape)
    c[8, 10] = 10.0
    weight = weighed(band, c, np.full(h.shape, 0.25))
    own = (100 / 25 / 0.25 - 1) / h**2  # over the noise's variance
    expected = h * own / (h**2 * own + 1 + 0.01 * own)
    about = slice(6, 11), slice(8, 13)
    np.testing.assert_allclose(weight[about], expected[about], rtol=1e-4)
    weight[about] = 0.25
    assert (weight == 0.25).all()
