"""Damaged frames and odd arrays: never a NaN, never an explosion, never a warning (they are errors here)."""

import numpy as np
import pytest

from tactiled.frames import DEAD, SATURATED
from tactiled.restore.methods import METHODS, NO_DATA, make

SIGMA = 0.5
BOUND = 300.0  # times the largest pressure that a sensor could mean: no image may exceed it


def noise(shape):
    return np.random.default_rng(0).normal(0, SIGMA, shape).astype(np.float32)


def single(shape):
    frame = noise(shape)
    frame.flat[frame.size // 2] = 200
    return frame


def spoiled(shape, value):
    frame = single(shape)
    frame.flat[:: max(frame.size // 7, 2)] = value
    return frame


def full(shape, value, flag=None):
    flags = None if flag is None else np.full(shape, flag, np.uint8)
    return np.full(shape, value, np.float32), flags


FRAMES = {
    "all zero": lambda shape: full(shape, 0),
    "noise": lambda shape: (noise(shape), None),
    "uniform": lambda shape: full(shape, 100),
    "single taxel": lambda shape: (single(shape), None),
    "NaN": lambda shape: (spoiled(shape, np.nan), None),
    "Inf": lambda shape: (spoiled(shape, np.inf), None),
    "-Inf": lambda shape: (spoiled(shape, -np.inf), None),
    "nothing but NaN": lambda shape: full(shape, np.nan),
    "nothing but Inf": lambda shape: full(shape, np.inf),
    "absurd": lambda shape: (spoiled(shape, 1e30), None),
    "absurd both ways": lambda shape: (spoiled(shape, 3e38) * np.resize([1, -1], shape), None),
    "huge": lambda shape: (spoiled(shape, 1e9), None),
    "denormal": lambda shape: full(shape, 1e-42),
    "all saturated": lambda shape: full(shape, 200, SATURATED),
    "all dead": lambda shape: full(shape, 100, DEAD),
    "negative drift": lambda shape: (noise(shape) - 30, None),
    "half negative": lambda shape: ((100 * np.sign(noise(shape))).astype(np.float32), None),
    "chequered": lambda shape: (np.resize([100.0, 0.0, 0.0], shape).astype(np.float32), None),
}
ARRAYS = {
    "grid": {"shape": (12, 10)},
    "refined": {"shape": (7, 6), "refine": 2},
    "layout": {"shape": (6, 6), "layout": True},
    "one taxel": {"shape": (1, 1)},
    "one row": {"shape": (1, 16)},
    "one column, refined": {"shape": (9, 1), "refine": 3},
    "wider than the array": {"shape": (5, 4), "thickness": 8.0},
    "t/pitch 0.05": {"shape": (10, 10), "thickness": 0.05},
    "t/pitch 3": {"shape": (10, 10), "thickness": 3.0},
    "t/pitch 10": {"shape": (20, 20), "thickness": 10.0},
    "with windows": {"shape": (46, 46)},
}


def largest(frame):
    """The largest pressure of a frame that a sensor could mean."""
    return max(float(np.abs(frame[np.isfinite(frame)]).max(initial=0.0)), 4 * SIGMA)


@pytest.mark.parametrize("array", ARRAYS)
@pytest.mark.parametrize("method", METHODS)
def test_never_nan_never_an_explosion(covered, method, array):
    blur = covered(**ARRAYS[array])
    for case, made in FRAMES.items():
        restorer = make(method, blur, SIGMA)
        frame, flags = made(blur.frame_shape)
        for _ in range(2):
            done = restorer(frame, flags)
            assert done.image.shape == blur.surface_shape, case
            assert np.isfinite(done.image).all(), case
            assert float(np.abs(done.image).max()) <= BOUND * largest(frame), case
            assert np.isfinite([done.noise_gain, done.resolution_mm]).all(), case
            assert np.isfinite(restorer.deviation()).all() != (done.why == NO_DATA), case
        assert done.why != NO_DATA or not done.image.any()
        assert done.why == NO_DATA or case != "all dead"


@pytest.mark.parametrize("sigma", [1e-6, 1e-3, 1e3, 1e6])
@pytest.mark.parametrize("method", METHODS)
def test_any_noise_will_do(covered, pressed, method, sigma):
    blur = covered((12, 12))
    frame, _ = pressed(blur, 0.5)
    image = make(method, blur, sigma)(frame).image
    assert np.isfinite(image).all()
    assert float(np.abs(image).max()) <= BOUND * max(float(frame.max()), 4 * sigma)
