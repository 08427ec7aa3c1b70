"""Frames of contacts out of any recording of a grid: their scenes, the zero around each, means, and the noise."""

import numpy as np

from tactiled.arrays import Floats, Floats32, Ints
from tactiled.calibrate.counts.means import unknown_taxels
from tactiled.calibrate.cover.presses import MAX_UNLOADED_FRAMES, SETTLING_FRAMES, slow_drift, unloaded
from tactiled.restore.noise import MAD_TO_SIGMA, detection_threshold

Images = Floats32

MAX_FRAMES = 16  # that are deblurred
SCENE_CHANGE = 0.3  # of a frame's square: a step that changes more begins another scene
CLEAR = 20.0  # times the noise: a frame with a lower peak says nothing about a cover
LIFTED = 0.1  # of the highest peak: what rubber that creeps leaves after a lift is less
STILL_PITCHES = 0.1  # that a contact may move in frames that are averaged: 0.2 % of a cover of half a pitch
MAX_NEAR_FRAMES = 8  # on either side that are averaged
MAX_CHANGE = 3.0  # mean square of a second difference, over the noise's: a contact that comes or goes changes more
NOISE_FRAMES = 2000  # of the middle of a recording, that shared noise is measured from
Shared = tuple[float, float, float]  # of what a row, a column, and all taxels of a frame have in common


def over_zeros(frames: Images, noise_kpa: float) -> tuple[Images, Floats]:
    """Frames (T, *shape) over the zero around them: of a contact, what was read just before and after it.

    Also the variance (T,) of that zero, over the noise's. ConfigError where no frame is without a load.
    """
    flat = frames.reshape(len(frames), -1)
    over = (flat - unloaded(flat, noise_kpa)).astype(np.float32)
    over -= slow_drift(over, np.full(flat.shape[1], noise_kpa))
    peaks, variance = np.nan_to_num(over).max(axis=1), np.zeros(len(flat))
    loaded = peaks > max(detection_threshold(noise_kpa, flat.shape[1]), LIFTED * float(peaks.max()))
    free = np.flatnonzero(~loaded)
    beside = np.convolve(loaded, np.ones(2 * SETTLING_FRAMES + 1), "same") > 0
    settled = free[~beside[free]] if (~beside).any() else free
    turns = np.flatnonzero(np.diff(np.concatenate([[False], loaded, [False]]).astype(int))).reshape(-1, 2)
    for start, end in turns if len(settled) else ():
        sides = settled[settled < start][-MAX_UNLOADED_FRAMES:], settled[settled >= end][:MAX_UNLOADED_FRAMES]
        sides = sides if all(map(len, sides)) else (sides[not len(sides[0])],) * 2
        with unknown_taxels():
            before, after = (np.nanmean(over[side], axis=0) for side in sides)
        first, last = (side.mean() for side in sides)
        share = np.clip((np.arange(start, end) - first) / max(last - first, 1), 0, 1)  # both may be on one side
        variance[start:end] = (1 - share) ** 2 / len(sides[0]) + share**2 / len(sides[1])
        over[start:end] -= before + share[:, None].astype(np.float32) * (after - before)
    return over.reshape(frames.shape), variance


def find_scenes(frames: Images, noise_kpa: float) -> list[Ints]:
    """Frames of each scene with a clear contact, in order of time."""
    flat = np.nan_to_num(frames.reshape(len(frames), -1))
    square = np.einsum("ti,ti->t", flat, flat)
    step = np.diff(flat, axis=0)
    noise = 2 * noise_kpa**2 * flat.shape[1]
    changed = np.einsum("ti,ti->t", step, step) > noise + SCENE_CHANGE * np.maximum(square[1:], square[:-1])
    peaks = flat.max(axis=1)
    reach = max(CLEAR * noise_kpa, detection_threshold(noise_kpa, flat.shape[1]), LIFTED * float(peaks.max()))
    clear = peaks > reach
    begins = np.concatenate([[True], changed | ~clear[:-1]])
    number = np.cumsum(begins & clear)
    return [np.flatnonzero(clear & (number == n)) for n in np.unique(number[clear])]


def spread(scenes: list[Ints]) -> tuple[Ints, Ints]:
    """At most MAX_FRAMES frames (T,), as many of each scene, far apart in it, and the scene (T,) of each."""
    scenes = [scenes[n] for n in np.linspace(0, len(scenes) - 1, min(len(scenes), MAX_FRAMES)).round().astype(int)]
    each = max(1, MAX_FRAMES // len(scenes))
    places = (np.arange(each) + 0.5) / each
    picked = [np.unique(scene[(places * len(scene)).astype(int)]) for scene in scenes]
    return np.concatenate(picked), np.repeat(np.arange(len(picked)), [len(one) for one in picked])


def still_means(frames: Images, scenes: list[Ints], places: Ints, noise_kpa: float) -> tuple[Images, Floats]:
    """Means (T, *shape) of the frames around each of `places` while what presses moves less than STILL_PITCHES.

    Also the noise (T,) of each mean, kPa. Frames are of the same one of `scenes`.
    """
    means, counts = frames[places].copy(), np.ones(len(places))
    scene_of = {int(each): scene for scene in scenes for each in scene}
    for n, place in enumerate(places):
        frame, scene = frames[place], scene_of[int(place)]
        near = frames[scene[np.abs(scene - place) <= MAX_NEAR_FRAMES]]
        slopes = sum(np.nansum(each**2) for each in np.gradient(np.nan_to_num(frame))) / 2  # along either axis
        moved = np.nansum((near - frame) ** 2, axis=(1, 2)) - 2 * noise_kpa**2 * frame.size
        still = near[moved < STILL_PITCHES**2 * slopes]
        means[n], counts[n] = still.mean(axis=0), len(still)
    return means, noise_kpa / np.sqrt(counts)


def shared_noise(frames: Images, noise_kpa: float) -> Shared:
    """Variances (kPa^2) of noise that a row, a column and all taxels of a grid's frames (T, R, C) share.

    From second differences in time, which a steady or evenly moving load leaves alone, split by rows and columns.
    """
    start = max(0, (len(frames) - NOISE_FRAMES) // 2)
    with unknown_taxels():
        change = np.diff(frames[start : start + NOISE_FRAMES].astype(np.float64), 2, axis=0) / np.sqrt(6)
        change = change[np.nanmean(change**2, axis=(1, 2)) < MAX_CHANGE * noise_kpa**2]
        common = np.nanmean(change, axis=(1, 2), keepdims=True)
        by_row = np.nanmean(change, axis=2, keepdims=True) - common
        by_column = np.nanmean(change, axis=1, keepdims=True) - common
        rest = change - common - by_row - by_column
    rows, columns = frames.shape[1:]
    own = _variance(rest) * rows * columns / ((rows - 1) * (columns - 1))
    of_rows = max(_variance(by_row) * rows / (rows - 1) - own / columns, 0.0)
    of_columns = max(_variance(by_column) * columns / (columns - 1) - own / rows, 0.0)
    of_all = _variance(common) - of_rows / rows - of_columns / columns - own / (rows * columns)
    return of_rows, of_columns, max(of_all, 0.0)


def _variance(values: Floats) -> float:
    """That of normal deviates around 0, by their median size, so that a step counts little."""
    sizes = np.abs(values[np.isfinite(values)])
    return float((MAD_TO_SIGMA * np.median(sizes)) ** 2) if sizes.size else 0.0
