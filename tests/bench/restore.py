"""Restorations side by side with scikit-image's: speed, in one run."""

from functools import partial
from time import perf_counter

import numpy as np
from skimage.restoration import wiener

from tactiled.bench.results import machine
from tactiled.cli.bench import Reduced, print_table
from tactiled.restore.methods import make
from tests.bench.presses import presses

OURS = ("wiener", "rl", "nnls", "tv", "points", "learned", "auto")
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
    runs = {"skimage wiener": lambda: wiener(frame, psf, 0.01, clip=False)}
    runs |= {method: partial(make(method, press.blur, press.sigma), press.frame) for method in OURS}
    rounds = [{name: timed(run, seconds / ROUNDS) for name, run in runs.items()} for _ in range(ROUNDS)]
    return {name: min(float(np.median(each[name])) for each in rounds) for name in runs}


def restore(reduced: Reduced = False) -> None:
    """Time our methods and scikit-image's at 16, 32 and 64 squared."""
    sizes = [f"{size} x {size}" for size in SIZES]
    medians = [speed(size, 0.1 if reduced else 1.0) for size in SIZES]
    rows = [(name, *(f"{each[name]:.1f}" for each in medians)) for name in medians[0]]
    ratios = (f"{each['skimage wiener'] / each['wiener']:.1f} x" for each in medians)
    rows.append(("wiener: times as fast as skimage wiener (aim: 8 at 32, 4 at 64)", *ratios))
    print_table("Median µs a frame that stands still, one thread", ("method", *sizes), rows)
    print(machine())
