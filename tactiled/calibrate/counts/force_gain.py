"""The gain from a load of known force: an indenter beside a force log, or a weight.

The sum of the taxels' pressures times the area of each is the force, whatever the cover (its gain at frequency 0
is 1), less what the cover spreads beyond the array: its `reach` says how much. That gives the common curve. It
does not give a taxel's own gain: under a cover every load lies on several taxels, and their sum hardly tells
neighbours apart.
"""

from dataclasses import replace
from math import hypot

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree
from scipy.special import stdtrit

from tactiled.arrays import Floats, Mask
from tactiled.calibrate.counts.curve_fit import CurveFit, Points, choose_form, fit, hysteresis
from tactiled.calibrate.counts.curves import Form, unit_curves
from tactiled.calibrate.counts.gain import GainFit, assembled, check_pressure, log_points, require_press
from tactiled.calibrate.counts.means import Means, Rails, mean_counts, require_response, unknown_taxels
from tactiled.calibrate.counts.plateaus import plateaus, response
from tactiled.calibrate.counts.reference import Reference, align
from tactiled.errors import ConfigError
from tactiled.frames import FrameSeries
from tactiled.geometry import Array, raster, tiling
from tactiled.restore.blur import Blur
from tactiled.restore.noise import NORMAL_95
from tactiled.units import N_PER_KPA_MM2

MAX_LOST_SHARE = 0.01  # of a load that dead taxels, or the rim under an unknown cover, may miss
MAX_BEYOND = 0.1  # of a load that the cover spreads beyond the array
# Standard error of that share, relative to it: a thickness off by 20 % changes it by 40 to 70 %.
BEYOND_ERROR = 0.5
RIM_SIGMAS = 2.0  # noise standard deviations of the rim: less is no load
MIN_PRESSED = 5  # points away from the border
NEIGHBOURS = 4  # with which a taxel is compared to see whether it is dead
DEAD_SLOPE = 0.05  # of a taxel's counts over its neighbours'
CLEARLY_PRESSED = 0.2  # of the largest reading: where a taxel's neighbours read less, it may be beside the press
NEED = 0.5  # share of a line's error that a curve must explain: taxels' own gains look like a curve
BETWEEN = 0.3, 0.6  # of the largest reading: levels there are neither no load nor the weight
WEIGHT_TOLERANCE = 0.1  # of the weight's reading: how far a plateau may vary
SAME_PLACE = 0.5  # correlation of two loads' readings: they lie on the same taxels
MIN_WEIGHT_HOLD = 0.05  # of the recording


def reach_of(blur: Blur, array: Array) -> Floats:
    """Share (N,) of a load above each taxel that the array senses."""
    areas, cells = tiling(array).areas, raster(array, blur.refine)
    share = blur.adjoint(areas.reshape(blur.frame_shape)) / cells.side**2
    return np.asarray(cells.at_taxels(share, array.size), float)


@unknown_taxels()
def fit_force(
    series: FrameSeries, log: Reference, array: Array, rails: Rails, reach: Floats | None = None
) -> GainFit:
    """The common curve of all taxels from a log of an indenter's force, and how far they spread about it.

    `reach` (N,) as of `reach_of`; None: the cover is not known.
    """
    signal = response(series, tiling(array).areas)
    signal = signal * np.sign(signal.sum())
    require_press(signal)
    alignment = align(series.times, signal, log)
    points, means, *_ = log_points(series, log, alignment, rails)
    summed, usable, dead, beyond = _summed(points, means.noise, array, MIN_PRESSED, reach)
    _require_total(summed, means.noise)
    end = np.array([summed.counts.max()])
    form, scores = choose_form(_alike(summed, end), end, NEED)
    fitted = fit(summed, end, form)
    check_pressure(f"{log.path}: force_n", float(unit_curves(form, fitted.parameters).gain[0]))
    spread = _taxel_spread(fitted, summed)
    offset = fitted.lever[0] * np.median(means.no_load_noise) / end[0] / np.sqrt(array.size)
    common = fitted.variance[0] + offset**2 + (BEYOND_ERROR * beyond) ** 2
    deviation = np.full(array.size, np.sqrt(common + spread**2))
    deviation[dead] = np.nan
    loop = float(hysteresis(fitted, summed)[0])
    made = _made(fitted, scores, float(end[0]), means, summed, dead, deviation, loop)
    notes = (
        f"{np.count_nonzero(usable)} of {usable.size} loads are off the border and dead taxels, and used",
        *_beyond_note(beyond),
        f"one curve for all taxels, spread about {100 * spread:.2g} %: uniform pressure gives each its own",
    )
    return replace(made, spread=spread, notes=notes, alignment=alignment, force_n=points.pressure[usable])


@unknown_taxels()
def fit_weight(
    series: FrameSeries, weight_n: float, array: Array, rails: Rails, reach: Floats | None = None
) -> GainFit:
    """The common gain from one known weight, laid on once or more often; `reach` (N,) as of `reach_of`."""
    if not (np.isfinite(weight_n) and weight_n > 0):
        raise ConfigError(f"weight_n = {weight_n:g}: give the force of the weight in N, above 0")
    signal = response(series, tiling(array).areas)
    size = require_press(signal)
    holds = plateaus(signal, WEIGHT_TOLERANCE * size, round(MIN_WEIGHT_HOLD * signal.size))
    levels = np.array([each.level for each in holds])
    sign = float(np.sign(levels[np.abs(levels).argmax()])) if levels.size else 1.0
    share = sign * levels / size
    loaded = share > BETWEEN[1]
    mixed = (share < -BETWEEN[0]) | (share > BETWEEN[0]) & ~loaded
    if not loaded.any() or loaded[0] or sign == -rails.sign or mixed.any():
        raise ConfigError("the recording must start unloaded, and show no load, or the weight held still")
    means = mean_counts(series, [each.core for each in holds], ~loaded, sign, rails)
    count = int(np.count_nonzero(loaded))
    order, force = np.arange(count), np.full(count, weight_n)
    points = Points(
        means.over[loaded, :, None], force, np.zeros(count, np.int8), _places(means.over[loaded]), order
    )
    return _weighed(points, means, array, means.noise[loaded], reach)


def _places(over: Floats) -> NDArray[np.int64]:
    """Numbers (M,) of the places of loads with readings `over` (M, N): loads on the same taxels share errors."""
    patterns = np.nan_to_num(over) / np.linalg.norm(np.nan_to_num(over), axis=1, keepdims=True)
    return np.asarray(connected_components(patterns @ patterns.T > SAME_PLACE)[1], np.int64)


def _weighed(points: Points, means: Means, array: Array, noise: Floats, reach: Floats | None) -> GainFit:
    """The common gain of a weight; what the taxels' own are is not known. `noise` (M, N) of each load."""
    summed, usable, dead, beyond = _summed(points, noise, array, 1, reach)
    _require_total(summed, noise)
    end = np.array([summed.counts.max()])
    fitted = fit(summed, end, "linear")
    check_pressure("weight", float(fitted.parameters[0, 0]))
    count, places = summed.pressure.size, np.unique(summed.cluster).size
    half, error = np.nan, "unknown: lay it on again at another place"
    if places > 1:
        scatter = float(stdtrit(places - 1, 0.975) * fit(_by_place(summed), end, "linear").variance[0] ** 0.5)
        half = hypot(scatter, NORMAL_95 * BEYOND_ERROR * beyond)
        error = f"±{100 * half:.2g} % by their scatter"
    unknown = np.full(array.size, np.nan)
    incomplete = np.isnan(points.counts[:, ~dead, 0].sum(axis=1))
    notes = (
        *(
            f"load {n + 1} of {usable.size} is not used: "
            + ("a taxel is saturated" if incomplete[n] else "it reaches the border of the array or a dead taxel")
            for n in np.flatnonzero(~usable)
        ),
        *_beyond_note(beyond),
        "one gain for all taxels: their spread is not known, so each one's own error is unknown",
        f"weight laid on {count} time{'s' if count > 1 else ''}, at {places} place{'s' if places > 1 else ''}; "
        f"95 % interval of the common gain {error}",
    )
    made = _made(fitted, {}, float(end[0]), means, summed, dead, unknown, np.nan)
    return replace(made, notes=notes, force_n=points.pressure[usable], common_error=half)


def _by_place(points: Points) -> Points:
    """The mean load at each place."""
    places = np.unique(points.cluster)
    counts, pressure = (
        np.stack([each[points.cluster == place].mean(axis=0) for place in places])
        for each in (points.counts, points.pressure)
    )
    return Points(counts, pressure, np.zeros(places.size, np.int8), places, places, points.weight)


def _beyond_note(beyond: float) -> tuple[str, ...]:
    """What the cover spreads beyond the array of the loads used, in the mean, if it matters."""
    if not beyond > MAX_LOST_SHARE:
        return ()
    return (f"{100 * beyond:.2g} % of a load is beyond the array by the cover's model, and taken into account",)


def _alike(points: Points, end: Floats) -> Points:
    """The same points with the pressures of each press scaled to fit one line: only its bend is left of it.

    The gains of the taxels under a press make it read more or less than another one, which looks like a curve.
    """
    pressure = points.pressure.copy()
    line = pressure + fit(points, end, "linear").residuals[:, 0]
    for each in np.unique(points.cluster):
        press = points.cluster == each
        pressure[press] *= (line[press] @ pressure[press]) / (pressure[press] @ pressure[press])
    return replace(points, pressure=pressure)


def _made(
    fitted: CurveFit,
    scores: dict[Form, float],
    end: float,
    means: Means,
    points: Points,
    dead: Mask,
    deviation: Floats,
    loop: float,
) -> GainFit:
    """One curve for all taxels."""
    size = dead.size
    curves = assembled(
        fitted.form,
        np.tile(fitted.parameters, (size, 1)),
        np.full(size, means.sign * end),
        deviation=deviation,
        hysteresis=np.full(size, loop),
        individual=np.zeros(size, bool),
    )
    listed = tuple(np.flatnonzero(dead).tolist())
    return GainFit(curves, means.no_load, listed, np.nan, scores, points, fitted.residuals)


def _summed(
    points: Points, noise: Floats, array: Array, need: int, reach: Floats | None
) -> tuple[Points, Mask, Mask, float]:
    """Points (M', 1, N) of the force over the median taxel's area, those of the M that are used, and dead taxels.

    Last the mean share of the force beyond the array, which the points do not have. ConfigError where fewer than
    `need` loads lie away from the border.
    """
    cells, counts = tiling(array), points.counts[..., 0]
    if (border := cells.rim).all():
        raise ConfigError(
            "a force gives no gain: every taxel is at the border of the array, where part of a load is not "
            "measured: use known pressures on the whole array"
        )
    dead, around = _dead(counts, array)
    counts = np.where(dead, 0, counts)
    complete = np.isfinite(counts).all(axis=1)
    if reach is None:
        beyond, lossy = np.zeros(len(counts)), border | dead
        lost = counts[:, border].sum(axis=1) + around[:, dead].sum(axis=1)
    else:
        beyond, lossy = 1 - _sensed(counts, reach), dead
        lost = around[:, dead].sum(axis=1)
    chance = RIM_SIGMAS * np.sqrt(np.square(np.median(noise, axis=0)[lossy]).sum())
    usable = complete & (lost <= np.maximum(MAX_LOST_SHARE * counts.sum(axis=1), chance)) & (beyond <= MAX_BEYOND)
    firm = points.pressure > points.pressure.max() / 2
    if np.count_nonzero(usable & firm) < min(need, int(np.count_nonzero(firm))):
        raise ConfigError(
            f"{np.count_nonzero(firm & ~usable)} of {np.count_nonzero(firm)} loads reach the border of the array "
            "or a dead taxel, where part of a load is not measured: press in the middle"
        )
    area = float(np.median(cells.areas))
    groups = np.unique(points.cluster[usable], return_inverse=True)[1]
    pressure = points.pressure[usable] * (1 - beyond[usable]) / (area * N_PER_KPA_MM2)
    weight = cells.areas / area
    summed = Points(counts[usable][:, None], pressure, points.direction[usable], groups, groups, weight)
    return summed, usable, dead, float(beyond[usable].mean())


def _sensed(counts: Floats, reach: Floats) -> Floats:
    """Share (M,) of each load that the array senses: the reach where its readings (M, N) are strongest."""
    square = np.square(np.nan_to_num(counts))
    return np.asarray(square @ reach / square.sum(axis=1))


def _dead(counts: Floats, array: Array) -> tuple[Mask, Floats]:
    """Dead taxels (N,), which do not count while their neighbours do; each one's neighbours' mean (M, N)."""
    tree = cKDTree(array.positions)
    near = np.asarray(tree.query(array.positions, k=range(2, min(NEIGHBOURS + 1, array.size) + 1))[1])
    finite = np.nan_to_num(counts)
    around = finite[:, near].mean(axis=2)
    pressed = around > 0.5 * around.max(axis=0)
    slope = (finite * around * pressed).sum(axis=0) / np.maximum((around**2 * pressed).sum(axis=0), 1e-300)
    dead = (slope < DEAD_SLOPE) & (around.max(axis=0) > CLEARLY_PRESSED * finite.max())
    return dead | (np.isnan(counts).mean(axis=0) > 0.5), around


def _require_total(summed: Points, noise: Floats) -> None:
    """ConfigError where the sum of all taxels does not stand out of its noise; `noise` (M, N) of each."""
    sigma = np.sqrt(np.square(noise).sum(axis=1)).max()
    require_response("the array", summed.counts.sum(axis=2), np.full((len(summed.pressure), 1), sigma))


def _taxel_spread(fitted: CurveFit, points: Points) -> float:
    """Standard deviation of the taxels' gains over the common one, from the scatter of the loads.

    A load on n taxels of spread s scatters by s / sqrt(n), where n = (sum of counts)² / sum of their squares,
    each count times its taxel's area.
    """
    firm = points.pressure > points.pressure.max() / 2
    counts = points.counts[firm, 0] * points.weight
    taxels = np.square(counts.sum(axis=1)) / np.square(counts).sum(axis=1)
    scatter = fitted.residuals[firm, 0] / points.pressure[firm]
    return float(np.sqrt(np.mean(np.square(scatter) * taxels)))
