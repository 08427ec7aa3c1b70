"""The hysteresis of an array from its calibration, where cross-validation shows that a model of it pays."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from tactiled.arrays import Floats, Ints, Mask
from tactiled.calibrate.counts.curve_fit import FREE, Points, fit, least_squares, value
from tactiled.calibrate.counts.curves import Form
from tactiled.calibrate.counts.hysteresis import Loop, Plays
from tactiled.frames import FrameSeries

HALF_WIDTHS = (0.0, 0.025, 0.05, 0.1, 0.2)  # of plays, relative counts
FOLDS = 10  # pieces of time, left out in turn
MIN_GAIN = 0.1  # of the rms error of what was left out, that a model must take away
SIGNIFICANT_ERRORS = 2.0  # standard errors over the folds, likewise
MAX_WEIGHT = 0.9
MAX_CURVES_COMPARED = 64


@dataclass(frozen=True, slots=True, eq=False)
class Trace:
    """The way of the readings through a recording, and its pieces that are points of a fit."""

    series: FrameSeries
    pieces: Sequence[slice]  # (M,)
    no_load: Floats  # (N,)

    def of(self, taxels: Ints) -> "Trace":
        """The same of some taxels."""
        series = FrameSeries(self.series.times, self.series.counts[:, taxels])
        return Trace(series, self.pieces, self.no_load[taxels])

    def plays(self, end: Floats) -> Floats:
        """Means (J, M, N) of the plays of HALF_WIDTHS over the pieces, over the signed `end` (N,)."""
        follower = Plays(np.array(HALF_WIDTHS), end)
        over = self.series.counts - self.no_load.astype(np.float32)
        piece_of = np.full(len(over), -1)
        for n, piece in enumerate(self.pieces):
            piece_of[piece] = n
        sums = np.zeros((len(self.pieces), *follower.state.shape))
        for n, frame in zip(piece_of, over, strict=True):
            state = follower.follow(frame)
            if n >= 0:
                sums[n] += state
        counts = np.bincount(piece_of[piece_of >= 0], minlength=len(self.pieces))
        return np.asarray(np.moveaxis(sums / counts[:, None, None], 1, 0) / np.abs(end))


def choose_loop(
    points: Points, plain: Points, end: Floats, plays: Floats, form: Form, bias: float = 0.0
) -> tuple[Loop, Points] | None:
    """The loop that explains points best, and the points without it; None where none pays.

    It must beat the `plain` points, whose drift was taken off: drift opens a loop, too. `plays` (J, M, N) as of
    `Trace.plays`, `end` (N,) upwards. A loop that is no wider than the `bias` of creep is taken for creep.
    """
    if not ((points.direction > 0).any() and (points.direction < 0).any()):
        return None
    some = np.unique(np.linspace(0, end.size - 1, MAX_CURVES_COMPARED).astype(int))
    sample, other = (replace(each, counts=each.counts[:, some]) for each in (points, plain))
    pairs = list(combinations(range(len(HALF_WIDTHS)), 2))
    fits = [_weight(sample, end[some], plays[near][:, some] - plays[far][:, some]) for near, far in pairs]
    (near, far), (weight, _) = min(zip(pairs, fits, strict=True), key=lambda each: each[1][1])
    opened = plays[near] - plays[far]
    amplitude = weight * (HALF_WIDTHS[far] - HALF_WIDTHS[near])
    possible = 0 < weight < MAX_WEIGHT and amplitude > bias
    if not possible or not _pays(sample, other, end[some], opened[:, some], form):
        return None
    bent = replace(points, counts=points.counts + (weight * opened * end)[..., None])
    return Loop(HALF_WIDTHS[near], HALF_WIDTHS[far], weight), bent


def _weight(points: Points, end: Floats, opened: Floats) -> tuple[float, float]:
    """The weight of `opened` (M, N), a difference of plays, and the rms error in kPa, both of the median taxel.

    Of cubics with a term for the loop, in which everything is linear.
    """
    relative = points.counts[..., 0] / end
    design = np.stack([relative, relative**2, relative**3, opened], axis=-1)
    target = np.broadcast_to(points.pressure[:, None], relative.shape)
    parameters = least_squares(design, target)
    error = np.einsum("mnp,np->mn", design, parameters) - target
    slope = np.maximum(parameters[:, :3].sum(axis=1), 1e-300)  # the mean one from 0 to the range's end
    weight, size = np.median(parameters[:, 3] / slope), np.median(np.nanmean(error**2, axis=0)) ** 0.5
    return float(weight), float(size)


def _pays(points: Points, plain: Points, end: Floats, opened: Floats, form: Form) -> bool:
    """Whether the loop predicts left-out pieces of the recording clearly better than plain curves do."""
    pieces = np.arange(points.pressure.size) * FOLDS // points.pressure.size
    errors = []
    for each in np.unique(pieces):
        out = pieces == each
        if np.unique(points.pressure[~out]).size <= FREE[form]:
            return False
        weight, _ = _weight(_part(points, ~out), end, opened[~out])
        bent = replace(points, counts=points.counts + (weight * opened * end)[..., None])
        errors.append([_left_out(case, out, end, form) for case in (plain, bent)])
    without, better = np.array(errors).T
    gained = without - better
    clear = gained.mean() > SIGNIFICANT_ERRORS * gained.std(ddof=1) / gained.size**0.5
    return bool(clear and better.mean() < (1 - MIN_GAIN) ** 2 * without.mean())


def _left_out(points: Points, out: Mask, end: Floats, form: Form) -> float:
    """Mean square error, of the median taxel, of the points that are `out` (M,) by curves of the others."""
    parameters = fit(_part(points, ~out), end, form).parameters
    missed = value(form, parameters, points.counts[out] / end[:, None], points.weight) - points.pressure[out, None]
    return float(np.nanmedian(np.nanmean(missed**2, axis=0)))


def _part(points: Points, used: Mask) -> Points:
    keys = ("counts", "pressure", "direction", "cluster", "fold")
    return replace(points, **{key: getattr(points, key)[used] for key in keys})
