"""Curves through points of known pressure: the form by cross-validation, the gain's standard error, hysteresis.

A point is a pressure that is the weighted sum of S terms of one curve: of one taxel (S = 1) under a uniform
pressure, or of all taxels under an indenter of known force. So every array here is (M points, N curves, S terms).
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tactiled.arrays import Floats
from tactiled.calibrate.counts.curves import CHORD_TO, FORMS, KNOTS, Form, cubic_slope, unit_curves

FREE = {"linear": 1, "power": 2, "cubic": 3, "spline": KNOTS.size}  # parameters
DIFFERENCE = 1e-4  # of a spline's pressure, to differentiate by a knot's value
STEPS = 8  # of Gauss-Newton: a power law of any exponent from 0.3 to 4 converges to 1e-6 (tests)
EXPONENTS = (0.2, 5.0)  # of a power law
MIN_SLOPE = 0.02  # of a fitted curve, over its mean slope: flatter says nothing of pressure
MAX_CURVES_COMPARED = 128  # that choose the form
HYSTERESIS_BINS = 10  # of pressure
INNER = 0.95  # of the largest pressure: only points below are left out, as no curve holds beyond its range
RIDGE = 1e-9  # of the normal equations
STIFFNESS = 1e-5  # of a spline against bending, likewise: a knot without points follows its neighbours
UNCOMPARED: dict[Form, Floats] = {"linear": np.array([np.nan])}


@dataclass(frozen=True, slots=True, eq=False)
class Points:
    """Counts under known pressures, all above no load."""

    counts: Floats  # (M, N, S) over no load; NaN: left out
    pressure: Floats  # (M,) kPa, of the weighted sum of the S terms
    direction: NDArray[np.int8]  # (M,) 1: while pressure rises, -1: while it falls, 0: neither
    cluster: NDArray[np.int64]  # (M,) points of one plateau, press or time share their errors
    fold: NDArray[np.int64]  # (M,) points that are left out together to compare forms
    weight: Floats = field(default_factory=lambda: np.ones(1))  # (S,) or (1,) of the terms


@dataclass(frozen=True, slots=True, eq=False)
class CurveFit:
    """Curves of one form."""

    form: Form
    parameters: Floats  # (N, P), of relative counts: of a line kPa at the range's end
    variance: Floats  # (N,) of the pressure at the range's end, relative to it squared
    lever: Floats  # (N,) relative change of that pressure with an offset of all relative counts
    residuals: Floats  # (M, N) fitted less known pressure, kPa


def choose_form(
    points: Points, end: Floats, need: float = 0.0, bias: float = 0.0
) -> tuple[Form, dict[Form, float]]:
    """The simplest form that cross-validation supports, and each form's rms error of left-out points.

    These errors are over the largest pressure. A form must explain more than `need` of what a simpler one leaves,
    and more than an error of `bias` that all forms share.
    """
    scores = _scores(points.counts / end[:, None], points)
    form: Form = "linear"
    for other in FORMS[1:]:
        if other in scores:
            better = scores[form] ** 2 - scores[other] ** 2
            threshold = max(
                better.std(ddof=1) / np.sqrt(better.size), need * np.square(scores[form]).mean(), bias**2
            )
            if better.mean() > threshold:
                form = other
    return form, {key: float(np.sqrt(np.mean(each**2))) for key, each in scores.items()}


def fit(points: Points, end: Floats, form: Form) -> CurveFit:
    """Fit curves of one form; `end` (N,) are the counts at the range's loaded end."""
    relative = points.counts / end[:, None]
    parameters, design = _solve(form, relative, points.pressure, points.weight)
    residuals = value(form, parameters, relative, points.weight) - points.pressure[:, None]
    variance, lever = _uncertainty(form, parameters, design, residuals, relative, points)
    return CurveFit(form, parameters, variance, lever, residuals)


def value(form: Form, parameters: Floats, relative: Floats, weight: Floats) -> Floats:
    """Pressure (M, N) of relative counts (M, N, S) as the weighted sum of the terms; NaN stays."""
    terms = unit_curves(form, parameters).pressure(np.moveaxis(relative, 1, -1))
    return np.asarray((terms * weight[:, None]).sum(axis=1))


def hysteresis(fitted: CurveFit, points: Points) -> Floats:
    """Largest difference (N,) between rising and falling pressure at the same counts, % of full scale.

    Of the fitted curve's residuals, in bins of pressure, so that both need not be at exactly the same pressure.
    NaN where no pressure is reached both ways.
    """
    full = points.pressure.max()
    bins = np.minimum((points.pressure / full * HYSTERESIS_BINS).astype(int), HYSTERESIS_BINS - 1)
    largest = np.full(fitted.residuals.shape[1], np.nan)
    for each in np.unique(bins):
        rising, falling = ((bins == each) & (points.direction == sign) for sign in (1, -1))
        if rising.any() and falling.any():
            difference = _mean(fitted.residuals[falling]) - _mean(fitted.residuals[rising])
            largest = np.fmax(largest, np.abs(difference))
    return np.asarray(100 * largest / full)


def moderated(variances: Floats, freedom: float) -> Floats:
    """Each variance (N,) drawn to the mean of all as far as their spread is chance: `freedom` degrees each.

    Smyth 2004 (limma), with the prior's degrees of freedom from the variances' mean and spread.
    """
    mean = float(variances.mean())
    spread = float(variances.var()) / mean**2 if mean > 0 else 0.0
    if spread * freedom <= 2:
        return np.full_like(variances, mean)
    prior = (2 * freedom - 4 + 4 * spread * freedom) / (spread * freedom - 2)
    return np.asarray((prior * mean + freedom * variances) / (prior + freedom))


def _mean(values: Floats) -> Floats:
    """Mean over the first axis without NaN; NaN where all are."""
    finite = np.isfinite(values)
    with np.errstate(invalid="ignore"):
        return np.asarray(np.where(finite, values, 0).sum(axis=0) / finite.sum(axis=0))


def _scores(relative: Floats, points: Points) -> dict[Form, Floats]:
    """Errors (folds,) of left-out points over the largest pressure, for each form that the folds can hold."""
    some = np.unique(np.linspace(0, relative.shape[1] - 1, MAX_CURVES_COMPARED).astype(int))
    relative, inner = relative[:, some], points.pressure < INNER * points.pressure.max()
    folds = np.unique(points.fold[inner])
    forms: list[Form] = [each for each in FORMS if len(folds) >= max(FREE[each], 2)] or ["linear"]
    if relative.shape[2] > 1 and "spline" in forms:
        forms.remove("spline")  # terms near 0, of which a sum has the most, say nothing of its knots
    if len(forms) == 1:
        return UNCOMPARED
    scores: dict[Form, Floats] = {}
    for form in forms:
        errors = []
        for each in folds:
            out = inner & (points.fold == each)
            parameters, _ = _solve(form, relative[~out], points.pressure[~out], points.weight)
            missed = value(form, parameters, relative[out], points.weight) - points.pressure[out, None]
            errors.append(np.sqrt(np.nanmean(missed**2)) / points.pressure.max())
        scores[form] = np.array(errors)
    return scores


def _power(relative: Floats, exponent: Floats) -> Floats:
    """|u|^b with u's sign, as the chord up to CHORD_TO."""
    size = np.abs(relative)
    chord = CHORD_TO ** (exponent - 1) * size
    return np.sign(relative) * np.where(size < CHORD_TO, chord, np.maximum(size, CHORD_TO) ** exponent)


def _basis(form: Form, relative: Floats, weight: Floats) -> Floats:
    """What a curve's parameters multiply (M, N, P), summed over the terms; of a spline, piecewise linear."""
    if form == "spline":
        knots = np.concatenate([[0.0], KNOTS])
        hats = [np.interp(relative, knots, row) for row in np.eye(knots.size)[1:]]
        return np.stack([(each * weight).sum(axis=-1) for each in hats], axis=-1)
    powers = range(1, FREE[form] + 1)
    return np.stack([(relative**each * weight).sum(axis=-1) for each in powers], axis=-1)


def _solve(form: Form, relative: Floats, pressure: Floats, weight: Floats) -> tuple[Floats, Floats]:
    """Parameters (N, P) by least squares, held monotone, and the design (M, N, P) at the solution."""
    if form == "power":
        return _solve_power(relative, pressure, weight)
    design = _basis(form, relative, weight)
    target = np.broadcast_to(pressure[:, None], design.shape[:2])
    parameters = least_squares(design, target)
    if form == "spline":
        return _solve_spline(_rising(parameters), relative, target, weight)
    if form == "cubic":
        line = np.zeros_like(parameters)
        line[:, :1] = least_squares(design[..., :1], target)
        parameters = _monotone_cubic(parameters, line)
    return parameters, design


def _solve_spline(parameters: Floats, relative: Floats, target: Floats, weight: Floats) -> tuple[Floats, Floats]:
    """Fit PCHIP's values at the knots by Gauss-Newton from those of piecewise linear curves."""
    for step in range(STEPS + 1):
        fitted, step_kpa = value("spline", parameters, relative, weight), DIFFERENCE * parameters[:, -1]
        steps = step_kpa[:, None] * np.eye(KNOTS.size)[:, None]
        moved = [value("spline", parameters + each, relative, weight) for each in steps]
        design = (np.stack(moved, axis=-1) - fitted[..., None]) / step_kpa[:, None]
        if step < STEPS:
            parameters = _rising(parameters + least_squares(design, target - fitted))
    return parameters, design


def _solve_power(relative: Floats, pressure: Floats, weight: Floats) -> tuple[Floats, Floats]:
    """Fit a power law by Gauss-Newton from a line."""
    target = np.broadcast_to(pressure[:, None], relative.shape[:2])
    a = least_squares(_basis("linear", relative, weight), target)[:, 0]
    b = np.ones_like(a)
    for step in range(STEPS + 1):
        powers = _power(relative, b[:, None]) * weight
        logs = np.log(np.maximum(np.abs(relative), CHORD_TO))
        design = np.stack([powers.sum(axis=-1), a * (powers * logs).sum(axis=-1)], axis=-1)
        if step < STEPS:
            change = least_squares(design, target - a * design[..., 0])
            a = np.maximum(a + change[:, 0], a / 2)
            b = np.clip(b + np.clip(change[:, 1], -0.5, 0.5), *EXPONENTS)
    return np.column_stack([a, b]), design


def least_squares(design: Floats, target: Floats) -> Floats:
    """Parameters (N, P) from design (M, N, P) and target (M, N); points that are NaN are left out."""
    finite = np.isfinite(design).all(axis=-1) & np.isfinite(target)
    used = np.where(finite[..., None], design, 0.0)
    normal = _normal(used)
    right = np.einsum("mnp,mn->np", used, np.where(finite, target, 0.0))
    return np.asarray(np.linalg.solve(normal, right[..., None])[..., 0])


def _normal(design: Floats) -> Floats:
    """Normal equations' matrices (N, P, P)."""
    normal = np.einsum("mnp,mnq->npq", design, design)
    scale = np.trace(normal, axis1=1, axis2=2)[:, None, None] + np.finfo(float).tiny
    ridge = RIDGE * np.eye(design.shape[-1])
    if design.shape[-1] == KNOTS.size:
        bends = np.diff(np.eye(KNOTS.size + 1), 2, axis=0)[:, 1:]
        ridge = ridge + STIFFNESS * bends.T @ bends
    return np.asarray(normal + scale * ridge)


def _rising(parameters: Floats) -> Floats:
    """A spline's values (N, K), each raised to stand above the one before."""
    steps = np.diff(parameters, prepend=0.0, axis=1)
    threshold = MIN_SLOPE * np.abs(parameters).max(axis=1, keepdims=True) * np.diff(KNOTS, prepend=0.0)
    return np.asarray(np.cumsum(np.maximum(steps, threshold), axis=1))


def _monotone_cubic(cubic: Floats, line: Floats) -> Floats:
    """Each cubic (N, 3), or as far from its line towards it as its slope allows."""
    low, high = np.zeros(len(cubic)), np.ones(len(cubic))
    enough = MIN_SLOPE * np.abs(line[:, 0])
    share = np.where(cubic_slope(cubic) >= enough, 1.0, 0.5)
    for _ in range(20):
        mixed = line + share[:, None] * (cubic - line)
        monotone = cubic_slope(mixed) >= enough
        low, high = np.where(monotone, share, low), np.where(monotone, high, share)
        share = np.where(low == 1, 1.0, (low + high) / 2)
    return line + low[:, None] * (cubic - line)


def _uncertainty(
    form: Form, parameters: Floats, design: Floats, residuals: Floats, relative: Floats, points: Points
) -> tuple[Floats, Floats]:
    """Variance (N,) of the pressure at the range's end over its square, robust to errors that a cluster shares.

    MacKinnon and White's HC2, summed by cluster, then moderated over the curves; and what `CurveFit.lever` is.
    """
    finite = np.isfinite(design).all(axis=-1) & np.isfinite(residuals)
    used = np.where(finite[..., None], design, 0.0)
    projected = np.einsum("mnp,npq->mnq", used, np.linalg.inv(_normal(used)))
    leverage = np.clip(np.einsum("mnp,mnp->mn", projected, used), 0, 0.95)
    end = {"power": [1.0, 0.0], "spline": [0.0, 0.0, 0.0, 1.0]}.get(form, [1.0] * FREE[form])
    curves = unit_curves(form, parameters)
    pull = (projected @ np.array(end)) / curves.gain
    influence = pull * np.where(finite, residuals, 0.0) / np.sqrt(1 - leverage)
    labels, index = np.unique(points.cluster, return_inverse=True)
    sums, share = np.zeros((2, labels.size, len(parameters)))
    np.add.at(sums, index, influence)
    np.add.at(share, index, pull**2)
    freedom = float(np.median(share.sum(axis=0) ** 2 / (share**2).sum(axis=0)))
    slopes = curves.slope(np.moveaxis(np.nan_to_num(relative), 1, -1)) * points.weight[:, None]
    return moderated((sums**2).sum(axis=0), max(freedom, 1.0)), (pull * slopes.sum(axis=1)).sum(axis=0)
