"""Plateaus of a signal that is held at one level after another, and what each taxel counts there."""

from dataclasses import dataclass

import numpy as np

from tactiled.arrays import Floats, Reals
from tactiled.frames import FrameSeries
from tactiled.restore.noise import MAD_TO_SIGMA, bends

START_FRAMES = 10  # whose median is the first guess of no load
CLEAR_SIGMAS, CLEAR_SHARE = 4.0, 0.05  # of noise, and of the largest reading: less is not counted in a sum
MAX_BINS = 1500  # of the signal: the search takes time with their square
MERGED_TOLERANCES = 2.0  # by which two neighbouring plateaus differ, at least: less is creep
TRIMMED = 0.15  # of a plateau's frames at each end: they may belong to the change of level


@dataclass(frozen=True, slots=True)
class Plateau:
    """A time of one level: frames start to end (exclusive), and the signal's mean."""

    start: int
    end: int
    level: float

    @property
    def core(self) -> slice:
        """Its frames without those at the ends."""
        cut = int(TRIMMED * (self.end - self.start))
        return slice(self.start + cut, self.end - cut)


def response(series: FrameSeries, weight: Floats | float | None = None) -> Floats:
    """Counts (T,) over those of the first frames: the median taxel's, or a weighted sum of clearly pressed ones.

    Drift and noise of a thousand taxels would sum to more than a press on some of them.
    """
    counts = series.counts - np.nanmedian(series.counts[:START_FRAMES], axis=0)
    if weight is not None:
        clear = np.maximum(CLEAR_SIGMAS * noise(series.counts), CLEAR_SHARE * float(np.nanmax(np.abs(counts))))
        return np.asarray(np.where(np.abs(counts) > clear, counts * weight, 0).sum(axis=1, dtype=np.float64))
    middle = np.median(counts, axis=1)
    unknown = np.isnan(middle)
    middle[unknown] = np.nanmedian(counts[unknown], axis=1) if unknown.any() else 0
    return np.asarray(np.nan_to_num(middle.astype(np.float64)))


def noise(values: Reals) -> Floats:
    """Standard deviation of white noise in values (T, ...), along time; NaN ignored, 0 of fewer than 3."""
    size = np.abs(bends(np.asarray(values)))
    if not len(size):
        return np.zeros(size.shape[1:])
    middle = np.nanmedian(size, axis=0) if np.isnan(size).any() else np.median(size, axis=0)
    return np.asarray(np.nan_to_num(middle) * MAD_TO_SIGMA, np.float64)


def plateaus(signal: Floats, tolerance: float, min_frames: int) -> list[Plateau]:
    """The times when `signal` (T,) keeps within about `tolerance` of a level for `min_frames` or more.

    Minimises the plateaus' squared deviations, plus tolerance² for each moment outside and half of that times the
    shortest plateau for each plateau, by dynamic programming over all partitions.
    """
    width = -(-signal.size // MAX_BINS)
    bins = signal[: signal.size // width * width].reshape(-1, width).mean(axis=1)
    outside = tolerance**2 + 4 * float(noise(bins)) ** 2
    spans = _partition(bins - bins.mean(), outside, max(3, round(min_frames / width)))
    merged: list[Plateau] = []
    for start, end in spans:
        level = float(bins[start:end].mean())
        if merged and abs(level - merged[-1].level) < MERGED_TOLERANCES * tolerance:
            start = merged.pop().start // width
            level = float(np.median(bins[start:end]))
        merged.append(Plateau(start * width, end * width, level))
    return merged


def _partition(values: Floats, outside: float, shortest: int) -> list[tuple[int, int]]:
    """The best plateaus (start, end) in values (n,), in order."""
    n = values.size
    sums, squares = (np.concatenate([[0.0], np.cumsum(each)]) for each in (values, values**2))
    cost, start = np.zeros(n + 1), np.full(n + 1, -1)
    for end in range(1, n + 1):
        cost[end] = cost[end - 1] + outside
        if end >= shortest:
            first = np.arange(end - shortest + 1)
            error = squares[end] - squares[first] - (sums[end] - sums[first]) ** 2 / (end - first)
            totals = cost[first] + error + outside * shortest / 2
            if totals[best := int(totals.argmin())] < cost[end]:
                cost[end], start[end] = totals[best], best
    spans, end = [], n
    while end > 0:
        if start[end] >= 0:
            spans.append((int(start[end]), end))
        end = int(start[end]) if start[end] >= 0 else end - 1
    return spans[::-1]
