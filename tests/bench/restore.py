"""Restorations side by side with scikit-image's: speed, in one run."""

from functools import partial
from time import perf_counter

import numpy as np
from scipy import fft
from skimage.restoration import richardson_lucy, wiener

from tactiled.bench.results import machine
from tactiled.cli.bench import Reduced, print_table
from tactiled.restore.methods import make
from tests.bench.presses import presses

OURS = ("wiener", "rl", "nnls", "tv", "points", "learned", "auto")
RL_ITERATIONS = 30  # of both sides
SIZES = (16, 32, 64)
SPEED_NOISE, SPEED_COVER = 0.01, 1.0  # of the peak, t/pitch: where speed is measured
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
    print(machine())
