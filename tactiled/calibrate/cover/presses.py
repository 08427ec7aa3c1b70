"""The presses in a recording: contact rises above the noise, stays, and falls."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from tactiled.arrays import Floats, Floats32, Ints, Mask, Reals
from tactiled.calibrate.counts.tare import load_description
from tactiled.errors import ConfigError
from tactiled.geometry import Array, tiling
from tactiled.restore.noise import detection_threshold

CHUNK_FRAMES = 2000  # of which running means are made at once: 16 MB
SMOOTHED_FRAMES = 5  # whose mean is compared with the noise
PLATEAU_LEVEL = 0.8  # of a press's high level: frames above it are its plateau
STILL_PITCHES = 0.1  # largest motion of a contact; it makes a cover of half a pitch look 0.2 % thicker
MIN_PLATEAU_FRAMES = 3
MIN_PEAK = 20.0  # over the error of the mean
MAX_UNLOADED_FRAMES = 25  # on each side, whose mean is a press's zero
SETTLING_FRAMES = 2  # beside a press, that are not part of its zero
QUIET_FRACTION = 0.2  # of the highest peak: frames below it may be without a load, and their zero may drift
DRIFT_FRAMES, MIN_DRIFT_FRAMES = 200, 10  # of which the quieter half makes one mean of the zero
UNLOADED_FRACTION = 0.05  # of the frames: at least so many count as those with the lowest total
MAX_OPEN_ANGLE = 2.5  # rad: a taxel without a neighbour over a wider angle is at the border
NEIGHBOUR_PITCHES = 1.6


@dataclass(frozen=True, slots=True, eq=False)
class Press:
    """One press: the mean over its plateau, over the frames without a load before and after it."""

    start: int  # first frame of the plateau
    end: int  # the frame behind its last
    mean: Floats  # (N,) kPa, NaN where a taxel is unknown
    error: Floats  # (N,) kPa, standard error of the mean
    force_n: float
    place_mm: tuple[float, float]  # centre of the readings above a third of the peak
    reason: str = ""  # why it cannot be used; "" where it can


def find_presses(
    pressure: Reals, array: Array, noise_kpa: Floats | float, saturated: Mask | None = None, border: bool = False
) -> list[Press]:
    """Every press in frames (T, N) of kPa, NaN: unknown; the unusable ones say why.

    `saturated` (T, N) marks readings at their ceiling; `border` lets contacts reach over the array's border.
    ConfigError where no frame is without a load.
    """
    frames = np.asarray(pressure, np.float32).reshape(len(pressure), -1)
    noise = np.broadcast_to(np.asarray(noise_kpa, float), frames.shape[1:])
    over_zero = frames - unloaded(frames, float(np.median(noise))).astype(np.float32)
    over_zero -= slow_drift(over_zero, noise)
    loaded = _peaks(over_zero, noise) > detection_threshold(1.0, frames.shape[1])
    turns = np.flatnonzero(np.diff(np.concatenate([[False], loaded, [False]]).astype(int)))
    area, presses = float(tiling(array).areas.mean()), []
    for start, end in turns.reshape(-1, 2):
        if end - start < SMOOTHED_FRAMES:
            continue  # an outlier of one frame is smeared over as many
        plateau = start + _plateau(over_zero[start:end], array)
        mean, error = _mean(frames, loaded, plateau, noise)
        before = "" if start else "lay there before the first frame"
        reason = before or _unusable(mean, error, plateau, array, border)
        if saturated is not None and not reason:
            reason = _ceiling(saturated.reshape(frames.shape)[plateau])
        first, last = int(plateau.min(initial=end)), int(plateau.max(initial=start))
        x, y = _centre(mean[None], array)[0]
        force = float(np.nansum(mean)) * area / 1e3
        presses.append(Press(first, last + 1, mean, error, force, (float(x), float(y)), reason))
    return presses


def usable_presses(presses: Sequence[Press], min_count: int, advice: str) -> list[int]:
    """Numbers of the presses that can be used; ConfigError with `advice` where they are too few."""
    usable = [at for at, each in enumerate(presses) if not each.reason]
    if len(usable) < min_count:
        reasons = "; ".join(sorted({each.reason for each in presses if each.reason}))
        raise ConfigError(
            f"{len(usable)} of {len(presses)} presses can be used{f' ({reasons})' if reasons else ''}: {advice}"
        )
    return usable


def unloaded(frames: Reals, noise: float) -> Floats:
    """Reading (N,) of the array without a load: a mean of the frames (T, N) with the lowest total.

    ConfigError where these have a load.
    """
    taxels = np.isfinite(frames).sum(axis=1)
    totals = np.where(taxels > 0, np.nansum(frames, axis=1) / np.maximum(taxels, 1), np.inf)
    count = max(int(UNLOADED_FRACTION * len(frames)), min(len(frames), 4))
    lowest = frames[np.argsort(totals)[:count]]
    readings = np.isfinite(lowest).sum(axis=0)
    zero = np.asarray(np.nansum(lowest, axis=0) / np.maximum(readings, 1), float)
    if load := load_description([np.where(readings, zero, np.nan).astype(np.float32)], noise):
        raise ConfigError(f"no frame is without a load ({load}): lift everything off between presses")
    return zero


def _peaks(frames: Floats32, noise: Floats) -> Floats:
    """Highest reading (T,) of a running mean of frames (T, N), over its own noise."""
    half, peaks = SMOOTHED_FRAMES // 2, []
    for start in range(0, len(frames), CHUNK_FRAMES):
        at = np.clip(np.arange(start - half, min(start + CHUNK_FRAMES, len(frames)) + half), 0, len(frames) - 1)
        chunk = np.nan_to_num(frames[at])
        count = len(at) - 2 * half
        total = sum(chunk[shift : shift + count] for shift in range(SMOOTHED_FRAMES))
        peaks.append((total / noise).max(axis=1) / np.sqrt(SMOOTHED_FRAMES))
    return np.concatenate(peaks)


def slow_drift(frames: Floats32, noise: Floats) -> Floats32:
    """Slow change of the zero (T, N), between means of frames that are far from the strongest press."""
    peaks = _peaks(frames, noise)
    quiet = peaks < max(detection_threshold(1.0, frames.shape[1]), QUIET_FRACTION * peaks.max())
    totals, middles, means = np.nansum(frames, axis=1), [], []
    for start in range(0, len(frames), DRIFT_FRAMES):
        block = start + np.flatnonzero(quiet[start : start + DRIFT_FRAMES])
        block = block[totals[block] <= np.median(totals[block])] if len(block) else block
        if len(block) >= MIN_DRIFT_FRAMES:
            counts = np.isfinite(frames[block]).sum(axis=0)
            middles.append(block.mean())
            means.append(np.nansum(frames[block], axis=0) / np.maximum(counts, 1))
    if not middles:
        return np.zeros_like(frames)
    at = np.interp(np.arange(len(frames)), middles, np.arange(len(middles)))
    low = at.astype(int)
    share = (at - low)[:, None].astype(np.float32)
    block_means = np.array(means, np.float32)
    return np.asarray(block_means[low] * (1 - share) + block_means[np.minimum(low + 1, len(means) - 1)] * share)


def _centre(frames: Reals, array: Array) -> Floats:
    """Centres (T, 2) in mm of what is above a third of each frame's peak."""
    values = np.nan_to_num(frames)
    above = np.maximum(values - values.max(axis=1, keepdims=True) / 3, 0)
    return np.asarray(above @ array.positions / np.maximum(above.sum(axis=1, keepdims=True), 1e-30))


def _plateau(run: Floats32, array: Array) -> Ints:
    """Frames of a run (T, N) whose load is high and whose contact stands still."""
    pattern = np.nan_to_num(np.nan_to_num(run).mean(axis=0))
    level = np.nan_to_num(run) @ pattern
    high = np.flatnonzero(level >= PLATEAU_LEVEL * np.percentile(level, 90))
    centres = _centre(run[high], array)
    jitter = 1.5 * np.abs(np.diff(centres, 2, axis=0)).mean() if len(high) > 2 else 0.0  # 3 deviations of noise
    still = np.abs(centres - np.median(centres, axis=0)).max(axis=1) < STILL_PITCHES * array.pitch + jitter
    return np.asarray(high[still])


def _mean(frames: Floats32, loaded: Mask, plateau: Ints, noise: Floats) -> tuple[Floats, Floats]:
    """Mean (N,) of a plateau's frames over the frames without a load on both sides, and its standard error."""
    if not len(plateau):
        return np.full_like(noise, np.nan), noise
    values = frames[plateau]
    counts = np.isfinite(values).sum(axis=0)
    free = np.flatnonzero(~loaded)
    sides = free[free < plateau[0]][::-1], free[free > plateau[-1]]
    zeros = [frames[side[SETTLING_FRAMES:][:MAX_UNLOADED_FRAMES]] for side in sides]
    zeros = [each for each in zeros if len(each)]
    unloaded, sides_used = [np.isfinite(each).sum(axis=0) for each in zeros], max(len(zeros), 1)
    with np.errstate(divide="ignore", invalid="ignore"):
        zero = sum(np.nansum(each, axis=0) / n for each, n in zip(zeros, unloaded, strict=True)) / sides_used
        mean = np.nansum(values, axis=0) / counts - zero
        variance = 1 / counts + sum(1 / n for n in unloaded) / sides_used**2
    mean[~np.isfinite(variance)] = np.nan
    return mean, np.where(np.isfinite(variance), noise * np.sqrt(variance), np.inf)


def _unusable(mean: Floats, error: Floats, plateau: Ints, array: Array, border: bool) -> str:
    """Why a press cannot be used; "" where it can."""
    if len(plateau) < MIN_PLATEAU_FRAMES:
        count = len(plateau)
        return f"never stands still: full load stays in place for {count} frames, {MIN_PLATEAU_FRAMES} are needed"
    ratio = mean / error
    peak = int(np.nanargmax(mean))
    if ratio[peak] < MIN_PEAK:
        return f"hardly leaves the noise: its peak is {ratio[peak]:.0f} times the error of its mean"
    if not border and _at_border(array)[peak]:
        return "reaches over the array's border"
    return ""


def _ceiling(saturated: Mask) -> str:
    """Reason against a plateau with taxels at their ceiling in any of its frames (n, N)."""
    taxels = int(saturated.any(axis=0).sum())
    where = f"{taxels} taxels at their ceiling" if taxels > 1 else "1 taxel at its ceiling"
    return f"saturated: {where}, press less hard" if taxels else ""


@lru_cache(maxsize=8)  # of arrays: 0.1 s for 32 x 32 taxels, at every look at presses that come live
def _at_border(array: Array) -> Mask:
    """Which taxels (N,) have no neighbour over a wide angle."""
    spacing = NEIGHBOUR_PITCHES * float(np.sqrt(tiling(array).areas.mean()))
    border = np.ones(array.size, bool)
    for taxel, place in enumerate(array.positions):
        x, y = (array.positions - place)[np.arange(array.size) != taxel].T
        near = np.hypot(x, y) < spacing
        if near.sum() >= 3:
            angles = np.sort(np.arctan2(y[near], x[near]))
            border[taxel] = np.diff([*angles, angles[0] + 2 * np.pi]).max() > MAX_OPEN_ANGLE
    return border
