"""Restorations side by side with scikit-image's: speed, in one run."""

from functools import partial
from time import perf_counter

import numpy as np
from scipy import fft
from skimage.restoration import richardson_lucy, wiener

from tactiled.cli.bench import Reduced, print_table
from tactiled.restore.methods import make
from tactiled.simulate.scenes import SCENES
from tactiled.study.results import machine
from tactiled.study.skin import rubber
from tests.study.presses import presses

FIXED = ("wiener", "rl", "rl-fast", "nnls", "tv", "points")
OURS = (*FIXED, "auto")
RL_ITERATIONS = 30  # of both sides
SIZES = (16, 32, 64)
SPEED_NOISE, SPEED_COVER = 0.01, 1.0  # of the peak, t/pitch: where speed is measured
RATE_HZ = 100.0  # of the moving scenes
PASSES = 3  # through all moving scenes, from the start
MOVING = ("ring", "indenters", "sphere", "edge", "fingertip")
ROUNDS = 5  # over which the least median counts: others may be using the machine


def timed(run, seconds):
    """Microseconds of each of as many runs as fit in `seconds`, ten at least, after three to warm up."""
    for _ in range(3):
        run()
    times = []
    end = perf_counter() + seconds
    while len(times) < 10 or perf_counter() < end:
        start = perf_counter()
        run()
        times.append(perf_counter() - start)
    return 1e6 * np.array(times)


def speed(size, seconds):
    """Median microseconds of one still frame by method; `seconds` each."""
    press = next(each for each in presses(size, (SPEED_COVER,), (SPEED_NOISE,)) if each.scene == "punches")
    frame, psf = (press.frame / press.frame.max()).astype(np.float32), press.psf.astype(np.float32)
    positive = np.maximum(frame, 0)
    runs = {
        "skimage wiener": lambda: wiener(frame, psf, 0.01, clip=False),
        "skimage rl": lambda: richardson_lucy(positive, psf, RL_ITERATIONS, clip=False),
        "FFT pair": fft_pair(size),
    }
    runs |= {method: partial(make(method, press.blur, press.sigma), press.frame) for method in OURS}
    rounds = [{name: timed(run, seconds / ROUNDS) for name, run in runs.items()} for _ in range(ROUNDS)]
    return {name: min(float(np.median(each[name])) for each in rounds) for name in runs}


def fft_pair(size):
    """Transform, filter, inverse: the least that a linear filter by Fourier can do."""
    x = np.ones((size, size), np.float32)
    gain = fft.rfft2(x)

    def run():
        spectrum = fft.rfft2(x)
        np.multiply(spectrum, gain, out=spectrum)
        return fft.irfft2(spectrum, overwrite_x=True)

    return run


def jitter(times):
    """99.9th percentile over median."""
    return float(np.percentile(times, 99.9) / np.median(times))


def moving(size, frames):
    """Microseconds of `auto` on moving scenes and an idle pad; jitter on the worst scene but its first frame."""
    skin = rubber(SPEED_COVER, size)
    clips = list(moving_clips(skin, frames))
    times = np.concatenate(play("auto", skin.blur, clips))
    pad = np.random.default_rng(0).normal(0, 1, (size, size)).astype(np.float32)
    idle = make("auto", skin.blur, 1.0)
    figures = {
        "median": float(np.median(times)),
        "99th percentile": float(np.percentile(times, 99)),
        "worst": float(times.max()),
        "idle pad (aim: under 5)": min(float(np.median(timed(lambda: idle(pad), 0.05))) for _ in range(ROUNDS)),
    }
    for name in FIXED:
        jitters = [jitter(each[1:]) for each in play(name, skin.blur, clips)]
        figures[f"{name}: 99.9th percentile over median (aim: under 5)"] = max(jitters)
    return figures


def moving_clips(skin, frames):
    """A taxel's noise (kPa) and the frames of every moving scene."""
    surface, random = skin.surface, np.random.default_rng(0)
    for name in MOVING:
        pressures = (
            SCENES[name](surface.x, surface.y, n / RATE_HZ, surface.size, surface.grain) for n in range(frames)
        )
        clean = np.array([surface.sense(each).reshape(skin.array.frame_shape) for each in pressures])
        sigma = SPEED_NOISE * clean.max()
        yield sigma, (clean + random.normal(0, sigma, clean.shape)).astype(np.float32)


def play(method, blur, clips):
    """Microseconds of every frame of each clip, the least of PASSES."""
    return [np.min([_times_us(method, blur, *clip) for _ in range(PASSES)], axis=0) for clip in clips]


def _times_us(method, blur, sigma, frames):
    restorer = make(method, blur, sigma)
    restorer.prepare()
    times = []
    for frame in frames:
        start = perf_counter()
        restorer(frame)
        times.append(1e6 * (perf_counter() - start))
    return times


def restore(reduced: Reduced = False) -> None:
    """Time our methods and scikit-image's at 16, 32 and 64 squared."""
    sizes = [f"{size} x {size}" for size in SIZES]
    medians = [speed(size, 0.1 if reduced else 1.0) for size in SIZES]
    rows = [(name, *(f"{each[name]:.1f}" for each in medians)) for name in medians[0]]
    for name, slow, aim in (
        ("wiener", "skimage wiener", "8 at 32, 4 at 64"),
        ("wiener", "FFT pair", "over 1/3"),
        ("rl", "skimage rl", "8 at 32"),
    ):
        ratios = (f"{each[slow] / each[name]:.1f} x" for each in medians)
        rows.append((f"{name}: times as fast as {slow} (aim: {aim})", *ratios))
    print_table("Median µs a frame that stands still, one thread", ("method", *sizes), rows)
    moved = [moving(size, 60 if reduced else 400) for size in SIZES]
    rows = [(name, *(f"{each[name]:.1f}" for each in moved)) for name in moved[0]]
    print_table(f"auto on scenes moving at {RATE_HZ:g} Hz, µs, least of three passes; jitter", ("", *sizes), rows)
    print(machine())
