"""The gain from a load of known force: an indenter beside a force log, or a weight.

The sum of the taxels' pressures times the area of each is the force, whatever the cover (its gain at frequency 0
is 1), where the load is away from the array's border. That gives the common curve. A taxel's own gain follows
where so many presses lay on it, and not only on its neighbours, that the sum tells it from theirs.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from tactiled.calibrate.curve_fit import CurveFit, Points, fit, hysteresis
from tactiled.calibrate.curves import Curves, unit_curves
from tactiled.calibrate.film import Film
from tactiled.calibrate.gain import FOLDS, GainFit, assembled, check_pressure, log_points, require_press
from tactiled.calibrate.means import Means, Rails, mean_counts, require_response
from tactiled.calibrate.plateaus import CLEAR_SHARE, CLEAR_SIGMAS, plateaus, response
from tactiled.calibrate.reference import Reference, align
from tactiled.errors import ConfigError
from tactiled.geometry import Array, tiling
from tactiled.units import N_PER_KPA_MM2

RIM_SPACINGS = 1.5  # within which a taxel's neighbours are counted: 8 on a grid
ONE_SIDED = 0.25  # length of the mean direction to them: 0 inside, 0.48 at a grid's edge, 0.8 in its corner
MAX_LOST_SHARE = 0.01  # of a load on the rim's and on dead taxels: about so much of it is not measured
RIM_SIGMAS = 2.0  # of the rim's noise: so much is no load
MIN_PRESSED = 5  # points away from the border
NEIGHBOURS = 4  # that a dead taxel is held against
DEAD_SLOPE = 0.05  # of a taxel's counts over its neighbours'
CLEARLY_PRESSED = 0.2  # of the largest reading: where a taxel's neighbours read less, it may be beside the press
FINE_BLOCKS = 3000  # of the recording, for the gains: a thousand taxels need some thousand
RATIOS = np.logspace(-8, 2, 101)  # of residual to gain variance, over the largest mode's, to search the likeliest
NEED = 0.5  # of what a line leaves must be explained by a curve: the taxels' own gains look like one
EXPLAINED = 0.25  # of the left-out mean square, at most, remains where taxels have gains of their own
OWN_GAIN = 0.5  # of the taxels' spread: with a smaller standard error a taxel has its own gain
WEIGHT_TOLERANCE = 0.1  # of the weight's reading, within which a plateau keeps
MIN_WEIGHT_HOLD = 0.05  # of the recording
Floats = NDArray[np.float64]


def fit_weight(film: Film, weight_n: float, array: Array, rails: Rails) -> GainFit:
    """The common gain from one known weight, laid on once or more often."""
    if not (np.isfinite(weight_n) and weight_n > 0):
        raise ConfigError(f"--weight-n {weight_n:g}: give the weight's force in N, above 0")
    signal = response(film, total=True)
    size = require_press(signal)
    holds = plateaus(signal, WEIGHT_TOLERANCE * size, round(MIN_WEIGHT_HOLD * signal.size))
    levels = np.array([each.level for each in holds])
    sign = float(np.sign(levels[np.abs(levels).argmax()])) if levels.size else 1.0
    loaded = sign * levels > size / 2
    if not loaded.any() or loaded[0] or (sign * levels < -size / 4).any():
        raise ConfigError("the recording must start unloaded, and then hold the weight still for a few seconds")
    means = mean_counts(film, [each.core for each in holds], ~loaded, sign, rails)
    count = int(np.count_nonzero(loaded))
    order, force = np.arange(count), np.full(count, weight_n)
    points = Points(means.over[loaded, :, None], force, np.zeros(count, np.int8), order, order)
    return _weighed(points, means, array, loaded)


def _weighed(points: Points, means: Means, array: Array, loaded: NDArray[np.bool_]) -> GainFit:
    """The common gain of a weight; what the taxels' own are is not known."""
    summed, _, dead = _summed(points, means.noise, array)
    _require_total(summed, means.noise[loaded])
    end = np.array([summed.counts.max()])
    fitted = fit(summed, end)
    count = summed.pressure.size
    error = (
        f"{100 * fitted.variance[0] ** 0.5:.2g} % by their scatter" if count > 1 else "unknown: lay it on again"
    )
    unknown = np.full(array.size, np.nan)
    notes = (
        "one gain for all taxels: their spread is not known",
        f"weight laid on {count} time{'s' if count > 1 else ''}; standard error of the common gain {error}",
    )
    return replace(_made(fitted, np.full(array.size, end[0]), means, summed, dead, unknown), notes=notes)


def fit_force(film: Film, log: Reference, array: Array, rails: Rails) -> GainFit:
    """The common curve, and the gains of taxels that were pressed often enough, from a log of force."""
    fitted, gains = _force(film, log, array, rails, np.ones(array.size))
    if (gains != 1).any():  # without them the clocks are aligned better
        fitted, _ = _force(film, log, array, rails, gains)
    return fitted


def _force(film: Film, log: Reference, array: Array, rails: Rails, gains: Floats) -> tuple[GainFit, Floats]:
    """The fit, and its gains (N,) over the common one; those given only help to align the clocks."""
    signal = response(Film(film.times, film.counts * gains.astype(np.float32)), total=True)
    signal = signal * np.sign(signal.sum())
    require_press(signal)
    alignment = align(film.times, signal, log)
    points, means, _ = log_points(film, log, alignment, rails)
    summed, usable, dead = _summed(points, means.noise, array)
    _require_total(summed, means.noise)
    end = np.array([summed.counts.max()])
    fitted = fit(summed, end, need=1)
    curve = unit_curves(fitted.form, fitted.parameters)
    check_pressure(log, float(curve.gain[0]))
    fine, finer, _ = log_points(film, log, alignment, rails, FINE_BLOCKS)
    own = _own_gains(*_changes(_summed(fine, finer.noise, array)[0], end, curve, finer, array))
    individual = (own.deviation < OWN_GAIN * own.spread) & ~dead
    gains = 1 + np.where(individual, own.gains, 0)
    summed = replace(summed, counts=summed.counts * gains)
    fitted = fit(summed, end, NEED)
    offset = fitted.lever[0] * np.median(means.no_load_noise) / end[0] / np.sqrt(array.size)
    deviation = np.sqrt(fitted.variance[0] + offset**2 + own.deviation**2)
    deviation[dead] = np.nan
    made = _made(fitted, end / gains, means, summed, dead, deviation)
    loop = np.full(array.size, hysteresis(fitted, summed)[0])
    curves = replace(made.curves, hysteresis=loop, individual=individual)
    notes = (f"{np.count_nonzero(usable)} of {usable.size} loads are off the border and dead taxels, and used",)
    return replace(made, curves=curves, spread=own.spread, notes=notes, alignment=alignment), gains


def _made(
    fitted: CurveFit, end: Floats, means: Means, points: Points, dead: NDArray[np.bool_], deviation: Floats
) -> GainFit:
    """A fit of one curve for all taxels, each with its own end (N,) of the range."""
    size = end.size
    curves = assembled(
        fitted.form,
        np.tile(fitted.parameters, (size, 1)),
        means.sign * end,
        deviation=deviation,
        hysteresis=np.full(size, np.nan),
        individual=np.zeros(size, bool),
    )
    listed = tuple(np.flatnonzero(dead).tolist())
    return GainFit(curves, means.no_load, listed, np.nan, fitted.scores, points, fitted.residuals)


def _summed(points: Points, noise: Floats, array: Array) -> tuple[Points, NDArray[np.bool_], NDArray[np.bool_]]:
    """Points (M', 1, N) of the mean pressure on a taxel's area, those of the M that are used, and the dead taxels.

    ConfigError where hardly a load lies away from the border.
    """
    counts = points.counts[..., 0]
    dead, around = _dead(counts, array)
    counts = np.where(dead, 0, counts)
    complete = np.isfinite(counts).all(axis=1)
    lost = counts[:, border := rim(array)].sum(axis=1) + around[:, dead].sum(axis=1)
    chance = RIM_SIGMAS * np.sqrt(np.square(np.median(noise, axis=0)[border | dead]).sum())
    usable = complete & (lost <= np.maximum(MAX_LOST_SHARE * counts.sum(axis=1), chance))
    if np.count_nonzero(usable) < min(MIN_PRESSED, len(usable)):
        raise ConfigError(
            f"{np.count_nonzero(complete & ~usable)} of {len(usable)} loads reach the border of the array "
            "or a dead taxel, where part of a load is not measured: press in the middle"
        )
    area = float(np.median(tiling(array).areas))
    groups = np.unique(points.cluster[usable], return_inverse=True)[1]
    pressure = points.pressure[usable] / (area * N_PER_KPA_MM2)
    return Points(counts[usable][:, None], pressure, points.direction[usable], groups, groups), usable, dead


def rim(array: Array) -> NDArray[np.bool_]:
    """Taxels (N,) at the border: their neighbours lie on one side."""
    tree = cKDTree(array.positions)
    one_sided = np.ones(array.size, bool)
    near_each: Any = tree.query_ball_point(array.positions, RIM_SPACINGS * array.pitch)
    for n, near in enumerate(near_each):
        steps = array.positions[[each for each in near if each != n]] - array.positions[n]
        if len(steps):
            mean = (steps / np.linalg.norm(steps, axis=1, keepdims=True)).mean(axis=0)
            one_sided[n] = np.linalg.norm(mean) > ONE_SIDED
    return one_sided


def _dead(counts: Floats, array: Array) -> tuple[NDArray[np.bool_], Floats]:
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
    require_response(summed.counts.sum(axis=2), np.full((len(summed.pressure), 1), sigma))


def _changes(
    points: Points, end: Floats, curve: Curves, means: Means, array: Array
) -> tuple[Floats, float, Floats, NDArray[np.int64]]:
    """How the pressure of points (M,) changes with each gain (M, N), that change's noise, what is missing, folds.

    The noise is a taxel's, squared and summed over the points. Only taxels that are clearly pressed, and their
    neighbours, are counted: the noise of the others would add up. What that leaves out of a load is taken as the
    same share of each.
    """
    counts = points.counts[:, 0]
    clear = counts > max(CLEAR_SIGMAS * float(np.median(means.noise)), CLEAR_SHARE * end[0])
    near = cKDTree(array.positions).query(array.positions, k=range(1, min(9, array.size) + 1))[1]
    relative = np.where(clear[:, near].any(axis=2), counts, 0) / end
    pressure = curve.pressure(relative[..., None]).sum(axis=(1, 2))
    share = float(pressure @ points.pressure / (pressure @ pressure))
    slope = share * curve.slope(relative[..., None])[..., 0]
    sigma = float(np.median(means.noise)) / end[0]
    chance = float((np.square(sigma * slope) * (relative != 0)).sum() / np.count_nonzero(relative.any(axis=0)))
    change = relative * slope
    pieces = np.arange(len(pressure)) * FOLDS // len(pressure)
    return change, chance, points.pressure - share * pressure, pieces


@dataclass(frozen=True, slots=True)
class _OwnGains:
    gains: Floats  # (N,) over the common one, less 1
    deviation: Floats  # (N,) standard errors
    spread: float  # standard deviation of all taxels' gains


def _own_gains(change: Floats, chance: float, missing: Floats, fold: NDArray[np.int64]) -> _OwnGains:
    """Each taxel's gain from what is `missing` (M,) and its `change` (M, N) with the gains.

    Least squares over those patterns of gains whose change stands out of the `chance` of noise, under a normal
    prior whose variance is the likeliest (empirical Bayes); no gain differs where that does not halve the
    errors of left-out pieces of time.
    """
    size, count = change.shape[1], missing.size
    values, modes = np.linalg.eigh(change.T @ change)
    modes = modes[:, values > 2 * chance]
    values, change = values[values > 2 * chance] - chance, change @ modes
    turned = change.T @ missing
    ratios = RATIOS * values.max()
    explained = np.square(turned) / (values + ratios[:, None])
    variance = (missing @ missing - explained.sum(axis=1)) / count
    determinant = np.log1p(values / ratios[:, None]).sum(axis=1)
    best = int((count * np.log(variance) + determinant).argmin())
    ratio, spread = float(ratios[best]), float(np.sqrt(variance[best] / ratios[best]))
    better = []
    for each in np.unique(fold):
        out, part = missing[fold == each], change[fold == each]
        normal = np.diag(values + ratio) - part.T @ part
        gains = np.linalg.solve(normal, turned - part.T @ out)
        better.append((np.square(out).mean(), np.square(out - part @ gains).mean()))
    common, own = np.mean(better, axis=0)
    if not own < EXPLAINED * common:
        return _OwnGains(np.zeros(size), np.full(size, spread), spread)
    share = np.square(modes) @ (values / (values + ratio))
    inflated = max(1.0, float(np.sqrt(own / variance[best])))  # errors that last are no white noise
    deviation = np.minimum(inflated * spread * np.sqrt(np.maximum(1 - share, 0)), spread)
    return _OwnGains(modes @ (turned / (values + ratio)), deviation, spread)
