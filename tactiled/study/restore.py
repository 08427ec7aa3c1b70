"""Restorations side by side with scikit-image's: speed in one run, and error with the truth in hand."""

import statistics
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import fft
from skimage import restoration

from tactiled.cover.operator import cached as cached_table
from tactiled.cover.operator import stencil
from tactiled.geometry import grid
from tactiled.restore.blur import Blur, GridBlur
from tactiled.restore.methods import Restorer, make
from tactiled.simulate.array import Surface
from tactiled.simulate.scenes import SCENES
from tactiled.study.truth import Press, kernel, presses

OURS = ("wiener", "rl", "rl-fast", "nnls", "tv", "points", "auto")
FIXED = tuple(name for name in OURS if name != "auto")
LUCY = 30  # iterations, of both sides
# scikit-image has no types.
wiener: Callable[..., NDArray[Any]] = restoration.wiener
richardson_lucy: Callable[..., NDArray[Any]] = restoration.richardson_lucy

NOISE = 0.01  # of the frame's peak, where speed is measured
COVER = 1.0  # t/pitch, where speed is measured
RATE_HZ = 100.0  # of the moving scenes
PASSES = 3  # through all films, from the start
MOVING = ("ring", "indenters", "sphere", "edge", "fingertip")
ROUNDS = 5  # over which the least median counts: others may be using the machine

# What skimage's two are tuned over, with the truth in hand.
BALANCES = tuple(10.0 ** (0.5 * n) for n in range(-12, 5))
STOPS = (1, 2, 3, 5, 8, 12, 20, 30, 50, 80, 120, 200)
SLIPS = 1.02  # times the raw image's error: more is a failure

_Film = tuple[float, NDArray[np.float32]]  # a taxel's noise (kPa), and frames


@dataclass(frozen=True, slots=True)
class Speed:
    """Median microseconds of one frame over and over, of everything timed at one size.

    Jitter is the 99.9th percentile over the median of all runs, whatever else the machine did meanwhile.
    """

    size: int
    times: dict[str, float]
    jitter: dict[str, float]

    def ratio(self, slow: str, fast: str) -> float:
        """How many times `fast` is as fast as `slow`."""
        return self.times[slow] / self.times[fast]


@dataclass(frozen=True, slots=True)
class Moving:
    """`auto` on moving scenes: microseconds a frame, and what it chose how often; the jitter of the others.

    Jitter is the 99.9th percentile over the median of a scene's frames but the first, on the worst scene.
    """

    size: int
    median: float
    p99: float
    worst: float
    idle: float
    chosen: dict[str, int]
    jitter: dict[str, float]


@dataclass(slots=True)
class Accuracy:
    """NRMSE of every method over the presses, in their order; `best` is scikit-image's better one each time."""

    presses: list[tuple[str, float, float]] = field(default_factory=list)  # scene, t/pitch, noise
    errors: dict[str, list[float]] = field(default_factory=dict)

    def mean(self, method: str, scene: str | None = None) -> float:
        """Mean NRMSE over all presses or those of a scene."""
        found = zip(self.presses, self.errors[method], strict=True)
        return statistics.fmean(error for (name, *_), error in found if scene in (None, name))

    def worst(self, method: str) -> float:
        """Largest error over the raw image's."""
        return max(e / raw for e, raw in zip(self.errors[method], self.errors["raw"], strict=True))

    def slips(self, method: str) -> int:
        """How many presses are worse than raw by more than 2 %."""
        return sum(e > SLIPS * raw for e, raw in zip(self.errors[method], self.errors["raw"], strict=True))


def timed(run: Callable[[], Any], seconds: float) -> NDArray[np.float64]:
    """Microseconds of each of as many runs as fit in `seconds`, ten at least, after three to warm up."""
    for _ in range(3):
        run()
    times: list[float] = []
    end = perf_counter() + seconds
    while len(times) < 10 or perf_counter() < end:
        start = perf_counter()
        run()
        times.append(perf_counter() - start)
    return 1e6 * np.array(times)


def speed(size: int, seconds: float) -> Speed:
    """Time everything at size x size in turn, for `seconds` each."""
    press = next(press for press in presses(size, (COVER,), (NOISE,)) if press.scene == "punches")
    runs = _skimage(press) | {"FFT pair": _pair(size)}
    for method in OURS:
        restorer = make(method, press.blur, press.sigma)
        runs[method] = lambda restorer=restorer: restorer(press.frame)  # type: ignore[misc]
    rounds = [{name: timed(run, seconds / ROUNDS) for name, run in runs.items()} for _ in range(ROUNDS)]
    medians = {name: min(float(np.median(each[name])) for each in rounds) for name in runs}
    return Speed(size, medians, {name: _jitter(np.concatenate([each[name] for each in rounds])) for name in runs})


def _skimage(press: Press) -> dict[str, Callable[[], Any]]:
    frame = (press.frame / press.frame.max()).astype(np.float32)
    psf = press.psf.astype(np.float32)
    positive = np.maximum(frame, 0)
    return {
        "skimage wiener": lambda: wiener(frame, psf, 0.01, clip=False),
        "skimage rl": lambda: richardson_lucy(positive, psf, LUCY, clip=False),
    }


def _pair(size: int) -> Callable[[], Any]:
    """Transform, filter, inverse: what no linear filter by Fourier can do without."""
    x = np.ones((size, size), np.float32)
    gain = fft.rfft2(x)

    def run() -> Any:
        spectrum = fft.rfft2(x)
        np.multiply(spectrum, gain, out=spectrum)
        return fft.irfft2(spectrum, overwrite_x=True)

    return run


def moving(size: int, frames: int) -> Moving:
    """Run our methods over scenes that move at 100 Hz, and `auto` over an idle pad."""
    blur, films = _films(size, frames)
    took, methods = _passes("auto", blur, films)
    all_ = np.concatenate(took)
    jitter = {name: max(_jitter(each[1:]) for each in _passes(name, blur, films)[0]) for name in FIXED}
    pad = np.random.default_rng(0).normal(0, 1, (size, size)).astype(np.float32)
    restorer = make("auto", blur, 1.0)
    idle = min(float(np.median(timed(lambda: restorer(pad), 0.05))) for _ in range(ROUNDS))
    median, p99 = float(np.median(all_)), float(np.percentile(all_, 99))
    return Moving(size, median, p99, float(all_.max()), idle, Counter(methods), jitter)


def _films(size: int, frames: int) -> tuple[Blur, list[_Film]]:
    """The blur that restores, and a film of every moving scene, by a kernel that is another."""
    array = grid(size, size, 1.0, 0.8)
    surface = Surface(kernel(COVER, "layered"), array)
    finer = partial(cached_table, stencil, kernel(COVER, "fem"), array)
    random = np.random.default_rng(0)
    films = []
    for name in MOVING:
        pressures = (
            SCENES[name](surface.x, surface.y, n / RATE_HZ, surface.size, surface.grain) for n in range(frames)
        )
        clean = np.array([surface.sense(each).reshape(size, size) for each in pressures])
        sigma = NOISE * clean.max()
        films.append((sigma, (clean + random.normal(0, sigma, clean.shape)).astype(np.float32)))
    return GridBlur(finer, (size, size)), films


def _passes(method: str, blur: Blur, films: list[_Film]) -> tuple[list[NDArray[np.float64]], list[str]]:
    """Microseconds of every frame of each film, and what ran; each film from the start PASSES times.

    A frame's least time is its own, for what a method does at a frame it does at every pass; the rest is the
    machine's.
    """
    passes = [[_run(make(method, blur, sigma), film) for sigma, film in films] for _ in range(PASSES)]
    took = [np.min([took for took, _ in same], axis=0) for same in zip(*passes, strict=True)]
    return took, [method for _, methods in passes[0] for method in methods]


def _jitter(times: NDArray[np.float64]) -> float:
    return float(np.percentile(times, 99.9) / np.median(times))


def _run(restorer: Restorer, film: NDArray[np.float32]) -> tuple[list[float], list[str]]:
    """Microseconds and method of every frame of a film."""
    took, chosen = [], []
    restorer.prepare()
    for frame in film:
        start = perf_counter()
        done = restorer(frame)
        took.append(1e6 * (perf_counter() - start))
        chosen.append(done.method)
    return took, chosen


def accuracy(cases: Iterator[Press]) -> Accuracy:
    """Restore presses by our methods, told nothing but the noise, and by skimage's two, told the truth."""
    found = Accuracy()
    for press in cases:
        found.presses.append((press.scene, press.thickness, press.noise))
        images = {"raw": press.frame} | {
            name: make(name, press.blur, press.sigma)(press.frame).image for name in OURS
        }
        images["skimage rl 30"] = _plain(press)
        errors = {name: nrmse(image, press.truth) for name, image in images.items()} | _tuned(press)
        errors["best"] = min(errors["skimage wiener"], errors["skimage rl"])
        for name, error in errors.items():
            found.errors.setdefault(name, []).append(error)
    return found


def _plain(press: Press) -> NDArray[Any]:
    """Restore by scikit-image's Richardson-Lucy as one calls it who has no truth: clipped at 0, 30 iterations."""
    scale = float(press.frame.max())
    positive = np.maximum(press.frame.astype(float) / scale, 0)
    return np.asarray(scale * richardson_lucy(positive, press.psf, LUCY, clip=False))


def _tuned(press: Press) -> dict[str, float]:
    """The least errors that scikit-image's two reach over all their settings."""
    scale = float(press.frame.max())
    frame = press.frame.astype(float) / scale
    positive = np.maximum(frame, 0)
    linear = (wiener(frame, press.psf, balance, clip=False) for balance in BALANCES)
    lucy = (richardson_lucy(positive, press.psf, n, clip=False, filter_epsilon=1e-6) for n in STOPS)
    return {
        "skimage wiener": min(nrmse(scale * image, press.truth) for image in linear),
        "skimage rl": min(nrmse(scale * image, press.truth) for image in lucy),
    }


def nrmse(image: NDArray[Any], truth: NDArray[Any]) -> float:
    """||image - truth|| / ||truth||."""
    return float(np.linalg.norm(image - truth) / np.linalg.norm(truth))
