"""How noisy is a taxel? Measured from frames, whatever is pressed on them meanwhile."""

from math import log, sqrt

import numpy as np
from numpy.typing import NDArray

from tactiled.arrays import Floats

IMPLAUSIBLE_KPA = 1e12  # beyond any sensor, and its square still fits float32
NORMAL_95 = 1.96  # standard deviations to either end of a 95 % interval
MAD_TO_SIGMA = 1.4826  # a normal deviate's standard deviation over its median absolute deviation
MIN_OVER_PEAK = 1e-4  # of the largest pressure: the noise assumed where the frames show none
UNRELATED_STEP = 0.5  # of the frames' mean square: successive frames that differ by more are not one recording
PRESSED_MEAN = 0.02  # of the mean square is the squared mean, at least, where something is pressed
NOISY_RATIO = 2.0  # to the common noise; of healthy taxels it was 1.5 at most on the tours of `tests.bench health`
QUIET_RATIO = 1.6  # below which a noisy taxel is so no more
SAME_SIZE = 1e-3  # of a size: a smaller difference is that of rounded arithmetic
ROUNDING_ERROR = 0.02  # of a step, by which float32 values miss a multiple of it
CHANGED_RATIO = 1.25  # by which a noisy taxel's noise changes before that matters


def estimate(frames: NDArray[np.floating]) -> float:
    """Standard deviation (kPa) of a taxel from frames (T, ...), unknown ones ignored; over 0 unless all are 0.

    From second differences in time between known values, which a steady or evenly moving load leaves alone, also
    where frames are missing. From one or two frames, or presses that have nothing to do with each other, from
    second differences along all of an array's axes in turn, which the cover keeps small; these do not see noise
    that whole rows share. The median discards the rest.
    """
    values = np.asarray(frames, float)
    values = np.where(np.abs(values) < IMPLAUSIBLE_KPA, values, np.nan)
    sigma = _sigma(bends(values), 1.0) if len(values) >= 3 else np.inf
    if len(values) < 3 or _unrelated(values):
        axes = [axis for axis in range(1, values.ndim) if values.shape[axis] >= 3]
        across = values
        for axis in axes:
            across = np.diff(across, 2, axis=axis)
        sigma = min(sigma, _sigma(across, 6.0 ** len(axes)) if axes else np.inf)
    finite = np.abs(values[np.isfinite(values)])
    return max(sigma if np.isfinite(sigma) else 0.0, MIN_OVER_PEAK * float(finite.max(initial=0.0)))


def estimate_with_rounding(frames: NDArray[np.floating], floor: float, rounds: bool) -> float:
    """Noise as of `estimate`; at least `floor`, that of rounding, where readings are rounded, or seem to be.

    They seem so where they differ in time by whole counts.
    """
    found = estimate(frames)
    rounded = rounds or are_multiples(np.diff(np.asarray(frames, float), axis=0), floor * 12**0.5)
    return max(found, floor) if rounded else found


def bends(values: NDArray[np.floating]) -> Floats:
    """Second differences (T - 2, ...) of each one's known values (T, ...) in time, over those of unit noise.

    NaN where no three are known. Of a value amid others h1 before and h2 after it (frames): (x2 - x1) / h2 - (x1 -
    x0) / h1, so that an even change is none however far they lie apart.
    """
    unknown = np.isnan(values)
    if not unknown.any():
        return np.asarray(np.diff(values, 2, axis=0), float) / sqrt(6.0)
    at = np.argsort(unknown, axis=0, kind="stable")
    ordered = np.asarray(np.take_along_axis(values, at, 0), float)
    with np.errstate(invalid="ignore", divide="ignore"):  # the unknown ones come last, in any order
        inverse = 1.0 / np.diff(at, axis=0)
        slopes = np.diff(ordered, axis=0) * inverse
        variance = inverse[1:] ** 2 + inverse[:-1] ** 2 + (inverse[1:] + inverse[:-1]) ** 2
    return np.asarray(np.diff(slopes, axis=0) / np.sqrt(variance))


def detection_threshold(noise_kpa: float, size: int) -> float:
    """Pressure (kPa) that noise alone reaches on hardly any of `size` taxels: their expected maximum, and 1.5."""
    return noise_kpa * (sqrt(2 * log(size + 1)) + 1.5)


def noise_ratio(noise_kpa: Floats, common_kpa: float, before: Floats | None = None) -> Floats | None:
    """Noise (N,) of clearly noisy taxels over the common one, 1 of the others; None where none is noisy.

    It is `before` itself where that still holds. The common noise is at least the median; NaN counts as common.
    """
    finite, old = np.isfinite(noise_kpa), np.ones(noise_kpa.shape) if before is None else before
    common = max(common_kpa, float(np.median(noise_kpa[finite]))) if finite.any() else common_kpa
    ratio = np.where(finite, noise_kpa, common) / common
    ratio[ratio <= np.where(old > 1, QUIET_RATIO, NOISY_RATIO)] = 1
    changed = (np.abs(np.log(ratio / old)) > np.log(CHANGED_RATIO)).any()
    return before if not changed else ratio if (ratio > 1).any() else None


def _sigma(differences: Floats, variance: float) -> float:
    """Standard deviation of what has differences of `variance` times its own; infinite where there are none."""
    size = np.abs(differences[np.isfinite(differences)])
    return MAD_TO_SIGMA * _median(size) / np.sqrt(variance) if size.size else np.inf


def _median(size: Floats) -> float:
    """Median of sizes (n,), not below 0; within its class where they are whole multiples of a step.

    As of grouped data: the sizes of a class are spread evenly between the middles to the next classes. Of rounded
    readings the plain median would be a whole number of steps.
    """
    middle = float(np.partition(size, (size.size - 1) // 2)[(size.size - 1) // 2])
    same = SAME_SIZE * middle
    below, above = size[size < middle - same], size[size > middle + same]
    low = (float(below.max()) + middle) / 2 if below.size else 0.0
    high = (float(above.min()) + middle) / 2 if above.size else middle
    rank = (size.size / 2 - below.size) / (size.size - below.size - above.size)
    return low + rank * (high - low)


def are_multiples(values: Floats, step: float) -> bool:
    """Whether all known values are whole multiples of a step."""
    multiples = values[np.isfinite(values)] / step
    return bool((np.abs(multiples - multiples.round()) < ROUNDING_ERROR).all())


def _unrelated(values: Floats) -> bool:
    """Whether pressed frames differ from one to the next as those of a recording never do."""
    step = np.diff(values, axis=0)
    finite, step = values[np.isfinite(values)], step[np.isfinite(step)]
    if not (finite.size and step.size):
        return False
    power = np.square(finite).mean()
    return bool(np.square(step).mean() > UNRELATED_STEP * power and finite.mean() ** 2 > PRESSED_MEAN * power)
