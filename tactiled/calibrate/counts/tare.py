"""The zero of an array, and whether there is a load that a tare would take for the zero."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tactiled.arrays import Floats
from tactiled.core import readings
from tactiled.restore.noise import MAD_TO_SIGMA, NOISY_RATIO, bends, detection_threshold
from tactiled.units import PRESSURE, Unit, number_text

MAX_DRIFT_FACTOR = 2.0  # times the largest noise: a median above it is a load, not the drift of a tared array
ZERO_SIGMAS = 2.0  # noise standard deviations within which a taxel reads zero
SKIRT_FRACTION = 0.05  # of the highest reading: less may be the edge of a contact, and counts as zero
UNPRESSED_FRACTION = 0.1  # of the taxels: if so many read zero, zero is right
MIN_JITTER_FRAMES = 8  # that a taxel's own noise is measured from
JITTER_MARGIN = 1.5  # of a noise measured from so few frames
CLEARLY_NOISY = 4.0  # times the noise: of 100 000 healthy taxels none seemed to have 3.5 in 16 frames
MAX_NOISY_FRACTION = 0.01  # of the taxels, or one: if more are noisy at once, a load shakes them

BELOW_SIGMAS = 7.0  # of noise, and of the taxels' scatter, below zero
CLEARLY_BELOW = 3.5  # of the same
NEAREST = 0.125  # of the taxels, nearest to zero: loads, now or under the tare, may lie on all others
NEAREST_TO_SIGMA = 6.36  # standard deviation of a normal distribution over that quantile of what it is off
BELOW_SHARE = 0.1  # of the highest reading since the tare: a slowly recovering skin reads up to so much below zero

SPIKE_SIGMAS = 4.0  # robust standard deviations from a taxel's median: a reading beyond is a spike
SPIKE_COUNTS = 1.5  # of whole counts: neighbouring counts are noise, even where most readings are the same
MOVING_BLOCKS = 4  # of a tare's frames, whose means must agree


@dataclass(frozen=True, slots=True, eq=False)
class Zero:
    """What an array reads without a load."""

    counts: NDArray[np.float32]  # (N,)
    shear: NDArray[np.float32]  # (2, N) counts; NaN: not tared
    time: float | None = None  # s, Unix, of its tare; None: as configured, or as in the calibration file


def robust_mean(values: NDArray[np.floating]) -> Floats:
    """Mean (...) over time of counts (T, ...) without spikes; NaN where no count is known.

    A median of whole counts is only good to half a count, and a trimmed mean is biased where most readings are the
    same count. A mean of what is near the median is as good as a mean, and keeps spikes out: of 50 frames at a
    noise of 0.3 counts, with a spike of 300 counts in 2 %, it misses by 0.07 counts, a median by 0.29, a mean of
    the middle 80 % by 0.21 (tests/calibrate/counts/test_tare.py).
    """
    off = np.abs(values - _median(values))
    spread = _median(off)
    integers = bool((np.isnan(values) | (values == np.round(values))).all())
    near = off <= np.maximum(SPIKE_SIGMAS * MAD_TO_SIGMA * spread, SPIKE_COUNTS if integers else 0.0)
    count = np.count_nonzero(near, axis=0)
    total = np.where(near, values, 0.0).sum(axis=0, dtype=float)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _median(values: NDArray[np.floating]) -> NDArray[np.floating]:
    """Median (...) over time (T, ...); NaN where no value is known. `np.nanmedian` takes ten times as long."""
    ordered = np.sort(np.ascontiguousarray(np.moveaxis(values, 0, -1)))  # NaN last
    count = np.count_nonzero(~np.isnan(ordered), axis=-1)[..., None]
    lower, upper = (np.take_along_axis(ordered, each, -1) for each in (np.maximum(count - 1, 0) // 2, count // 2))
    middle = (lower + np.where(count % 2 == 0, upper, lower)) / 2
    return np.asarray(np.where(count > 0, middle, np.nan)[..., 0])


def blocks(values: NDArray[np.floating]) -> list[Floats]:
    """Means (...) of MOVING_BLOCKS runs of frames (T, ...): they differ where the readings move."""
    return [robust_mean(each) for each in np.array_split(values, MOVING_BLOCKS)]


def own_noise(frames: NDArray[np.floating], noise: float) -> Floats:
    """Noise (N,) of each taxel in successive frames (T, N): `noise`, more for the few that are clearly noisier.

    By second differences in time, so that what moves slowly is no noise.
    """
    own = np.full(frames.shape[1], noise, float)
    if len(frames) < MIN_JITTER_FRAMES:
        return own
    jitter = np.nan_to_num(MAD_TO_SIGMA * _median(np.abs(bends(frames))))
    clearly = np.count_nonzero(jitter > CLEARLY_NOISY * noise)
    if clearly <= max(1, MAX_NOISY_FRACTION * own.size):
        own = np.where(jitter > NOISY_RATIO * noise, JITTER_MARGIN * jitter, own)
    return own


def reads_below(lowest: float, noise: float) -> bool:
    """Whether the lowest reading is below zero, for a zero taken under a load or another reason."""
    return lowest < -BELOW_SIGMAS * noise


def below_zero(pressure: NDArray[np.floating], noise: float, highest: float) -> NDArray[np.bool_]:
    """Which taxels (NaN: unknown) read below zero since a load lay on them when their zero was taken.

    One must be far below; then its skirt, all that is clearly below, is wrong as well. An offset that all taxels
    share is none. `highest` is the highest reading since then.
    """
    nothing = np.zeros(pressure.shape, np.bool_)
    lowest, _, _ = readings.look(np.ascontiguousarray(pressure, np.float32).reshape(-1))
    if not reads_below(lowest, noise):
        return nothing
    known = pressure[np.isfinite(pressure)]
    at_zero = np.count_nonzero(np.abs(known) < ZERO_SIGMAS * noise)  # a load may have lain on most of the taxels
    level = 0.0 if at_zero >= UNPRESSED_FRACTION * known.size else min(float(np.median(known)), 0.0)
    scatter = NEAREST_TO_SIGMA * float(np.quantile(np.abs(known - level), NEAREST))
    clear = CLEARLY_BELOW * max(noise, scatter)
    far = max(BELOW_SIGMAS * max(noise, scatter), BELOW_SHARE * highest)
    return np.less(pressure, level - clear, out=nothing) if float(known.min()) < level - far else nothing


def load_description(
    frames: Sequence[NDArray[np.float32]], noise: float, unit: Unit = PRESSURE, own: Floats | None = None
) -> str:
    """The load in the newest frames (in `unit`, NaN: unknown), in words; "" where there is only an offset.

    An offset stands still and is all over the array, scattered as far below the array's median as above it. So a
    load is what stands above the median by more than the noise, and the scatter below the median, can reach, or
    what moves between frames by more than noise. The median of an array that is half pressed is no offset: where
    it is clearly above the noise, but a tenth of the taxels read zero and none less, zero takes its place.
    A steady load that leaves fewer free, or lies on half of an array whose zero is wrong, passes for an offset.
    A taxel is compared with its `own` noise (N,), measured from the frames where it is left out.
    """
    values = np.array([each.ravel() for each in frames], float)
    taxels = np.flatnonzero(np.isfinite(values).any(axis=0)) if values.size else np.zeros(0, int)
    if not taxels.size:
        return ""
    own = (own_noise(values, noise) if own is None else own)[taxels]
    values = values[:, taxels]
    level = np.nanmean(values, axis=0)
    above = level - _unloaded(level, noise)
    scatter = MAD_TO_SIGMA * float(np.median(-above[above < 0])) if (above < 0).any() else 0.0
    pressed = taxels[above > np.maximum(own, scatter) * detection_threshold(1.0, level.size)]
    if pressed.size:
        where = f"{pressed.size} taxels" if pressed.size > 1 else f"taxel {pressed[0]}"
        return f"contact of {number_text(above.max())} {unit} on {where}"
    moved = np.nanmax(np.abs(values - level), axis=0)
    moving = taxels[moved > own * detection_threshold(1.0, values.size)]
    if not moving.size:
        return ""
    where = f" on taxel {moving[0]}" if moving.size == 1 else ""
    return f"readings that move by {number_text(moved.max())} {unit}{where}"


def _unloaded(level: Floats, noise: float) -> float:
    """Reading of a taxel without a load."""
    median, reach = float(np.median(level)), detection_threshold(noise, level.size)
    at_zero = np.count_nonzero(np.abs(level) < max(ZERO_SIGMAS * noise, SKIRT_FRACTION * level.max()))
    pressed = (
        median > MAX_DRIFT_FACTOR * reach and level.min() > -reach and at_zero >= UNPRESSED_FRACTION * level.size
    )
    return 0.0 if pressed else median
