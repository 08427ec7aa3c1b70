"""Gain and curve of each taxel from a recording under uniform pressure: in known steps, or beside a log."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import hypot

import numpy as np

from tactiled.arrays import Floats, Ints, Mask
from tactiled.calibrate.counts.curve_fit import Points, choose_form, fit, hysteresis
from tactiled.calibrate.counts.curves import KNOTS, Curves, Form
from tactiled.calibrate.counts.gain_error import (
    CREEP_SHARE,
    MIN_NOTED,
    creep_per_decade,
    curvature_error,
    left_out_error,
    pattern_note,
)
from tactiled.calibrate.counts.hysteresis import Loop
from tactiled.calibrate.counts.hysteresis_fit import Trace, choose_loop
from tactiled.calibrate.counts.means import (
    DEAD_BELOW,
    Means,
    Rails,
    mean_counts,
    require_response,
    require_unsaturated,
    unknown_taxels,
)
from tactiled.calibrate.counts.plateaus import Plateau, noise, plateaus, response
from tactiled.calibrate.counts.reference import Alignment, Reference, align, resampled
from tactiled.errors import ConfigError
from tactiled.frames import FrameSeries
from tactiled.geometry import Array
from tactiled.units import number_text

STEP_TOLERANCE = 0.07  # of the smallest step: a plateau's readings keep within
MIN_HOLD = 0.15  # of the mean time of a step: a shorter hold is none
MIN_RANGE_SIGMAS = 15.0  # of smoothed readings: of pure noise 500 reach 7
SMOOTHED_FRAMES = 20
BLOCKS = 600  # into which a recording beside a log is cut
UNLOADED = 0.01  # of the log's largest value, and less
STARTS_LOADED = 0.05  # of the log's largest value
MAX_RAMP = 0.1  # of the log's largest value: a block in which it changes by more is left out
MIN_POINTS = 10
FOLDS = 10  # pieces of time, left out in turn
MIN_CORRELATION, MIN_FOLLOWING = 0.7, 3  # of a taxel's counts with the pressure, over so many points (p = u⁴: .87)
UNLIKE_GAIN = 5.0  # times the gain before, or one over it: grams for newtons make 102, kilograms 0.102
PRESSURES_KPA = (0.01, 1e4)  # of a skin's largest: beyond, the log has another unit


@dataclass(frozen=True, slots=True, eq=False)
class GainFit:
    """Curves of an array, and where they come from."""

    curves: Curves
    no_load: Floats  # (N,) counts where the recording starts
    dead: tuple[int, ...]  # taxels without a response
    spread: float  # of the taxels' gains, standard deviation over mean; NaN: unknown
    scores: dict[Form, float]  # rms error of left-out points by form, over the largest pressure; NaN: not compared
    points: Points  # (M, N, 1), of a force (M, 1, N)
    residuals: Floats  # (M, N), of a force (M, 1): fitted less known pressure, kPa; NaN: left out
    alignment: Alignment | None = None
    notes: tuple[str, ...] = ()
    force_n: Floats | None = None  # (M,) known loads, of a force: `points.pressure` is over a taxel's area
    common_error: float = np.nan  # half of the common gain's 95 % interval, relative, of a weight; NaN: unknown


@unknown_taxels()
def fit_steps(
    series: FrameSeries, steps_kpa: Sequence[float], rails: Rails, array: Array | None = None
) -> GainFit:
    """Curves from pressures that the whole array bore one after another, the first of them 0.

    With the array's geometry, a pattern of the gains across it is noted.
    """
    steps = _checked(steps_kpa)
    signal = response(series)
    require_unsaturated(series, signal, rails)
    holds = find_steps(signal, steps)
    sign = float(np.sign(np.polyfit(steps, [each.level for each in holds], 1)[0]))
    _require_order(steps, [sign * each.level for each in holds])
    means = mean_counts(series, [each.core for each in holds], steps == 0, sign, rails)
    loaded = steps > 0
    points = Points(
        counts=means.over[loaded, :, None],
        pressure=steps[loaded],
        direction=np.sign(np.diff(steps, prepend=0.0)).astype(np.int8)[loaded],
        cluster=np.arange(np.count_nonzero(loaded)),
        fold=np.unique(steps[loaded], return_inverse=True)[1],
    )
    trace = Trace(series, [each.core for each in holds], means.no_load)
    return _uniform(points, means, loaded, array, trace, creep_per_decade(series, holds))


@unknown_taxels()
def fit_pressure(series: FrameSeries, log: Reference, rails: Rails, array: Array | None = None) -> GainFit:
    """Curves from a log of the pressure that the whole array bore; `array` as of `fit_steps`."""
    check_pressure(f"{log.path}: pressure_kpa", float(log.values.max()))
    signal = response(series)
    signal = signal * np.sign(signal.sum())
    require_press(signal)
    alignment = align(series.times, signal, log)
    points, means, used, pieces = log_points(series, log, alignment, rails)
    trace = Trace(series, pieces, means.no_load)
    return replace(_uniform(points, means, used, array, trace), alignment=alignment)


def _uniform(
    points: Points,
    means: Means,
    used: Mask,
    array: Array | None,
    trace: Trace,
    creep: float = 0,
) -> GainFit:
    """Curves of taxels that all bore the same pressure; those without a response are dead, with the mean curve."""
    require_response("the median taxel", means.over[used], means.noise[used])
    end = np.nanmax(points.counts[..., 0], axis=0, initial=0.0)
    dead = ~(end >= DEAD_BELOW * np.median(end[end > 0])) | ~_follows(points)
    live, common = np.flatnonzero(~dead), CREEP_SHARE * creep
    alive = replace(points, counts=points.counts[:, live])
    form, scores = choose_form(alive, end[live], bias=common)
    plain = fit(alive, end[live], form)
    plays, drift = trace.of(live).plays(means.sign * end[live])[:, used], means.drift[used][:, live]
    loop, bent = _without_loop(alive, end[live], drift, plays, form, common)
    form, scores = choose_form(bent, end[live], bias=common) if loop else (form, scores)
    fitted = fit(bent, end[live], form)
    offset = fitted.lever * means.no_load_noise[live] / end[live]
    placed = partial(_placed, live, end.size)
    curvature = hypot(curvature_error(bent, fitted.residuals), common)  # NaN: unknown
    curves = assembled(
        form,
        placed(fitted.parameters, fitted.parameters.mean(axis=0)),
        means.sign * placed(end[live], end[live].mean()),
        deviation=placed(np.sqrt(fitted.variance + offset**2 + common**2)),
        hysteresis=placed(hysteresis(plain, alive)),
        individual=~dead,
    )
    curves = replace(
        curves,
        loop=loop,
        error_kpa=placed(left_out_error(alive, bent, end[live], form)),
        curvature=None if np.isnan(curvature) else curvature,
    )
    gains = curves.gain[live]
    pattern = pattern_note(alive, gains, array, live) if array else ""
    return GainFit(
        curves=curves,
        no_load=means.no_load,
        dead=tuple(np.flatnonzero(dead).tolist()),
        spread=float(gains.std() / abs(gains.mean())),
        scores=scores,
        points=points,
        residuals=placed(fitted.residuals.T).T,
        notes=_notes(loop, creep, pattern),
    )


def _without_loop(
    points: Points, end: Floats, drift: Floats, plays: Floats, form: Form, bias: float
) -> tuple[Loop | None, Points]:
    """The loop, if a model of it pays, and the points without it: what remains after a load is no `drift` then."""
    still = replace(points, counts=points.counts + drift[..., None])
    return choose_loop(still, points, end, plays, form, bias) or (None, points)


def _placed(taxels: Ints, size: int, values: Floats, other: Floats | float = np.nan) -> Floats:
    """`values` (L, ...) in the places of some `taxels` (L,) of (size, ...), `other` elsewhere."""
    full = np.empty((size, *values.shape[1:]))
    full[:], full[taxels] = other, values
    return full


def _notes(loop: Loop | None, creep: float, pattern: str) -> tuple[str, ...]:
    """What was found besides curves."""
    notes = []
    if loop is not None:
        notes.append(f"a hysteresis of {loop.percent:.2g} % of full scale is taken off by a model")
    if creep > MIN_NOTED:
        notes.append(f"creep of {100 * creep:.2g} % in a tenfold time is in the standard error")
    return (*notes, pattern) if pattern else tuple(notes)


def _follows(points: Points) -> Mask:
    """Whether the counts of each taxel (N,) rise with the pressure."""
    counts, pressure = points.counts[..., 0], points.pressure[:, None]
    finite = np.isfinite(counts)
    off, other = (
        np.where(finite, each - np.nanmean(np.where(finite, each, np.nan), axis=0), 0.0)
        for each in (counts, np.broadcast_to(pressure, counts.shape))
    )
    size = np.sqrt(np.square(off).sum(axis=0) * np.square(other).sum(axis=0))
    too_short = finite.sum(axis=0) < MIN_FOLLOWING
    return np.asarray(too_short | ((off * other).sum(axis=0) > MIN_CORRELATION * size))


def assembled(
    form: Form,
    parameters: Floats,
    end: Floats,
    deviation: Floats,
    hysteresis: Floats,
    individual: Mask,
) -> Curves:
    """Curves from parameters (N, P) over relative counts and the signed counts (N,) at the range's end."""
    return Curves(
        form=form,
        parameters=parameters / end[:, None] if form == "linear" else parameters,
        reach_counts=np.column_stack([np.minimum(end, 0), np.maximum(end, 0)]),
        deviation=deviation,
        hysteresis=hysteresis,
        individual=individual,
        knots=KNOTS if form == "spline" else np.empty(0),
    )


def _checked(steps_kpa: Sequence[float]) -> Floats:
    """The pressures as an array; ConfigError names what is wrong with them."""
    steps = np.array(steps_kpa, np.float64)
    listing = ",".join(f"{each:g}" for each in steps)
    if not (np.isfinite(steps) & (steps >= 0)).all() or steps.size < 2 or steps[0] != 0:
        raise ConfigError(f"pressures {listing} kPa: give two or more, the first of them 0")
    if not np.diff(steps).all():
        raise ConfigError(f"pressures {listing} kPa: one follows itself: give it once")
    if not PRESSURES_KPA[0] <= steps.max() <= PRESSURES_KPA[1]:
        raise ConfigError(
            f"pressures {listing}: give kPa, the largest {PRESSURES_KPA[0]:g} to {PRESSURES_KPA[1]:g}"
        )
    return steps


def _require_order(steps: Floats, levels: list[float]) -> None:
    """ConfigError where readings fall from a step to a higher one, or rise to a lower one."""
    for n, (step, change) in enumerate(zip(np.diff(steps), np.diff(levels), strict=True)):
        if step * change < 0:
            what = f"from {steps[n]:g} to {steps[n + 1]:g} kPa the readings {'rise' if change > 0 else 'fall'}"
            raise ConfigError(f"{what}: give the pressures in the order of the recording")


def require_press(signal: Floats) -> float:
    """Range of a signal (T,) without outliers; ConfigError where it is no more than noise."""
    width = min(SMOOTHED_FRAMES, max(signal.size // SMOOTHED_FRAMES, 1))
    smooth = signal[: signal.size // width * width].reshape(-1, width).mean(axis=1)
    size = float(np.diff(np.percentile(smooth, [0.5, 99.5]))[0])
    if not size > MIN_RANGE_SIGMAS * float(noise(signal)) / width**0.5:
        raise ConfigError("no press above the noise in the recording: press more, or check the sensor")
    return size


def find_steps(signal: Floats, steps: Floats) -> list[Plateau]:
    """A plateau of `signal` (T,) for each step; ConfigError where their numbers differ."""
    smallest = np.abs(np.diff(steps)).min() / np.ptp(steps)
    tolerance = STEP_TOLERANCE * float(smallest) * require_press(signal)
    holds = plateaus(signal, tolerance, round(MIN_HOLD * signal.size / steps.size))
    if len(holds) != steps.size:
        levels = ", ".join(f"{each.level:.0f}" for each in holds)
        raise ConfigError(
            f"{steps.size} pressures are given, and the recording holds {len(holds)}, at {levels} counts "
            "(median taxel): give every pressure in its order, and hold each for the same time"
        )
    return holds


def check_pressure(source: str, largest_kpa: float) -> None:
    """ConfigError where the largest pressure that `source` names is none that a skin bears."""
    low, high = PRESSURES_KPA
    if not low <= largest_kpa <= high:
        raise ConfigError(
            f"{source}: {number_text(largest_kpa)} kPa at most, outside {low:g} to {high:g}: check the unit"
        )


def unlike_gain(curves: Curves, before: float | None) -> tuple[str, ...]:
    """A note where the median gain is far from the one `before` (kPa per count), as a slip of units makes it."""
    ratio = 1.0 if before is None else abs(float(np.median(curves.gain)) / before)
    if 1 / UNLIKE_GAIN <= ratio <= UNLIKE_GAIN:
        return ()
    return (
        f"the gain is {ratio:.3g} times the one before: check the unit of the load (N or kPa; 1 kg weighs 9.81 N)",
    )


def log_points(
    series: FrameSeries, log: Reference, alignment: Alignment, rails: Rails
) -> tuple[Points, Means, Mask, list[slice]]:
    """Points of a recording cut into blocks of even time, the means of all blocks, those that are points, all."""
    values = resampled(log, series.times + alignment.offset_s)
    full, width = float(np.nanmax(values)), max(1, -(-values.size // BLOCKS))
    starts = np.arange(0, values.size - width + 1, width)
    within = values[: starts.size * width].reshape(-1, width)
    level, ramp = within.mean(axis=1), np.ptp(within, axis=1)
    inside = np.isfinite(level)
    level, ramp, starts = level[inside], ramp[inside], starts[inside]
    quiet = max(UNLOADED * full, 4 * float(noise(log.values)))
    if level[0] > max(STARTS_LOADED * full, quiet):
        reading = f"{number_text(level[0])} {log.unit}"
        raise ConfigError(f"{log.path}: {reading} where the recording starts: start unloaded")
    unloaded = np.abs(level) <= quiet
    unloaded[0] = True
    unloaded[1:] &= unloaded[:-1]  # the first block after a press may still recover
    used = (level > quiet) & (ramp <= MAX_RAMP * full)
    if np.count_nonzero(used) < MIN_POINTS:
        used = level > quiet
    signal = response(series, 1.0 if log.quantity == "force_n" else None)
    sign = float(np.sign((signal * np.nan_to_num(values)).sum()))
    pieces = [slice(each, each + width) for each in starts]
    means = mean_counts(series, pieces, unloaded, sign, rails)
    direction = np.where(np.abs(change := np.gradient(level)) > UNLOADED * full / 2, np.sign(change), 0)
    number = np.cumsum(np.diff(level > quiet, prepend=False) & (level > quiet))[used]
    even = np.arange(number.size) * FOLDS // number.size
    groups = np.unique(number, return_inverse=True)[1] if np.unique(number).size >= FOLDS // 2 else even
    points = Points(means.over[used, :, None], level[used], direction.astype(np.int8)[used], groups, groups)
    return points, means, used, pieces
