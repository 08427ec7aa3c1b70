"""Errors of a gain beyond its standard error: another recording, creep, curvature, a poor bag."""

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtrc

from tactiled.arrays import Floats, Ints
from tactiled.calibrate.counts.curve_fit import FREE, Points, fit, value
from tactiled.calibrate.counts.curves import Form
from tactiled.calibrate.counts.plateaus import Plateau, response
from tactiled.frames import FrameSeries
from tactiled.geometry import Array, tiling

MIN_REVERSAL = 0.05  # of the largest pressure: less is no branch of its own
MIN_BRANCHES = 3  # with three, the two that are left have a rise and a fall
MIDDLE = 0.25, 0.75  # of the largest pressure, between which a curve is farthest from its ends
CREEP_SHARE = 3**-0.5  # of a decade's creep: loads last a tenth to ten times as long as those of the calibration
FIRST_S = 0.1  # after a step, from which its creep counts
PATTERN_CHANCE = 1e-4  # probability that gains without a pattern seem to have one
MIN_NOTED = 0.005  # relative: a smaller pattern or creep does no harm


def branches(pressure: Floats) -> NDArray[np.int64]:
    """Number (M,) of the rise or fall that each pressure belongs to, in the order of time."""
    reversal = MIN_REVERSAL * float(np.ptp(pressure))
    turns, high, low, way = [0], 0, 0, 0
    for n, each in enumerate(pressure):
        high, low = n if each > pressure[high] else high, n if each < pressure[low] else low
        if way >= 0 and each < pressure[high] - reversal:
            turns, way, low = [*turns, high + 1] if way else turns, -1, n
        elif way <= 0 and each > pressure[low] + reversal:
            turns, way, high = [*turns, low + 1] if way else turns, 1, n
    return np.asarray(np.searchsorted(turns, np.arange(pressure.size), side="right"), np.int64)


def left_out_error(measured: Points, bent: Points, end: Floats, form: Form) -> Floats:
    """Rms error (N,) in kPa of a rise or fall that was left out of the fit, within the others' counts.

    NaN if there is only one, whose error would not contain the hysteresis. `bent` are points less a model of
    hysteresis. If only one rise or fall is left, no such model can be fitted: then `measured` points are taken.
    """
    number = branches(measured.pressure)
    points = bent if number.max() >= MIN_BRANCHES else measured
    square, count = np.zeros(end.size), np.zeros(end.size)
    for each in np.unique(number):
        out = number == each
        others = Points(
            points.counts[~out], points.pressure[~out], points.direction[~out], points.cluster[~out],
            points.fold[~out], points.weight,
        )  # fmt: skip
        if np.unique(others.pressure).size < FREE[form]:
            continue
        parameters = fit(others, end, form).parameters
        relative = points.counts[out] / end[:, None]
        missed = value(form, parameters, relative, points.weight) - points.pressure[out, None]
        inside = (points.counts[out] <= np.nanmax(others.counts, axis=0)).all(axis=2) & np.isfinite(missed)
        square += np.square(np.where(inside, missed, 0)).sum(axis=0)
        count += inside.sum(axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(np.sqrt(square / count))


def curvature_error(points: Points, residuals: Floats) -> float:
    """Relative standard error of the gain in the middle of the range to that at its end, common to all taxels.

    NaN where no pressure lies in the middle: a line and a curve look the same.
    """
    share = points.pressure / points.pressure.max()
    middle = (share > MIDDLE[0]) & (share < MIDDLE[1])
    if not middle.any():
        return np.nan
    common = np.nanmean(residuals[middle], axis=1) / points.pressure[middle]
    groups = np.unique(points.cluster[middle], return_inverse=True)[1]
    means = np.bincount(groups, common) / np.bincount(groups)
    return float(np.sqrt(means.mean() ** 2 + means.var() / max(means.size - 1, 1)))


def creep_per_decade(series: FrameSeries, holds: list[Plateau]) -> float:
    """Growth of a reading that is held, relative to its step, for each tenfold time; 0 where noise explains it.

    Each plateau has its own level, and all one drift; what is left follows the logarithm of the time since each
    step before.
    """
    signal, times = response(series), series.times
    steps = np.diff([each.level for each in holds])
    starts = np.array([times[each.start] for each in holds[1:]])
    cores = [np.arange(len(times))[each.core] for each in holds]
    at = np.concatenate(cores)
    since = times[at, None] - starts
    growth = (np.where(since > 0, np.log10(np.maximum(since, FIRST_S) / FIRST_S), 0) * steps).sum(axis=1)
    columns = np.column_stack([growth, times[at] - times[0], signal[at]])
    bounds = np.cumsum([0, *map(len, cores)])
    for start, stop in pairwise(bounds):
        columns[start:stop] -= columns[start:stop].mean(axis=0)
    design, target = columns[:, :2], columns[:, 2]
    normal = np.linalg.pinv(design.T @ design)
    factors = normal @ design.T @ target
    pull = np.add.reduceat(design * (target - design @ factors)[:, None], bounds[:-1], axis=0)
    variance = float((normal @ (pull.T @ pull) @ normal)[0, 0])  # robust to errors that a plateau shares
    return float(np.sqrt(max(factors[0] ** 2 - 4 * variance, 0.0)))


def pattern_note(points: Points, gain: Floats, array: Array, taxels: Ints) -> str:
    """A note where gains, or the shapes of the curves, follow a pattern across the array; "" where none does.

    Taxels (L,) differ by chance; a bag that does not press everywhere alike differs by place.
    """
    counts, low = points.counts[..., 0], points.pressure < points.pressure.max() / 2
    shape = np.nanmean(counts[low], axis=0) / np.nanmean(counts[~low], axis=0) if low.any() else np.ones(gain.size)
    place = array.positions[taxels] - array.positions[taxels].mean(axis=0)
    x, y = (place / max(float(np.abs(place).max()), 1e-9)).T
    rim = tiling(array).rim[taxels].astype(float)
    design = np.column_stack([np.ones(x.size), x, y, x * y, x**2, y**2, rim])
    for values in (np.log(np.abs(gain)), np.log(np.maximum(shape, 1e-3))):
        size = _pattern(design, values)
        if size > MIN_NOTED:
            return (
                f"gains follow a pattern of {100 * size:.2g} % across the array: check that the bag presses "
                "everywhere alike, at the border, too"
            )
    return ""


def _pattern(design: Floats, values: Floats) -> float:
    """Standard deviation of what a smooth pattern explains of values (L,); 0 where chance does."""
    basis, _ = np.linalg.qr(design)
    rank, count = np.linalg.matrix_rank(design), values.size
    if count <= 2 * rank:
        return 0.0
    off = values - values.mean()
    explained = float(np.square(basis.T @ off).sum())
    unexplained = max(float(np.square(off).sum()) - explained, 1e-300)
    ratio = (explained / (rank - 1)) / (unexplained / (count - rank))
    if fdtrc(rank - 1, count - rank, ratio) > PATTERN_CHANCE:
        return 0.0
    return float(np.sqrt(max(explained - (rank - 1) * unexplained / (count - rank), 0.0) / count))
