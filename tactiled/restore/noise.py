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
    return MAD_TO_SIGMA * float(np.median(size)) / np.sqrt(variance) if size.size else np.inf


def _unrelated(values: Floats) -> bool:
    """Whether pressed frames differ from one to the next as those of a recording never do."""
    step = np.diff(values, axis=0)
    finite, step = values[np.isfinite(values)], step[np.isfinite(step)]
    if not (finite.size and step.size):
        return False
    power = np.square(finite).mean()
    return bool(np.square(step).mean() > UNRELATED_STEP * power and finite.mean() ** 2 > PRESSED_MEAN * power)
