"""The likelihood of presses under a cover: what they share, what each has of its own, and the taxels' gain errors.

Reading n of taxel i in press k is (1 + e_i) model + noise. A gain error e_i is one number for all presses, so that
it is integrated out per taxel: the covariance of a taxel's readings is diagonal plus s_i^2 m m', with m the model
of a pilot fit. All else is solved for by Gauss and Newton's method with Levenberg's damping.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_array

from tactiled.arrays import Floats, Ints, Mask
from tactiled.calibrate.cover.touch_response import EdgeResponse, TipResponse
from tactiled.calibrate.cover.unknowns import CURVATURE
from tactiled.restore.noise import NORMAL_95

# shared (S,) -> gain times the load's transform (n,) on the nodes of a quadrature
Spectrum = Callable[[Floats], Floats]

MAX_STEPS = 30
CONVERGED = 1e-3  # of chi-squared: a step that gains no more is the last
START_DAMPING, MAX_DAMPING = 1e-4, 1e8  # over the diagonal of the Hessian
FOLDS = 5  # each of which is left out once
LEFT_OUT_STEPS = 2  # from the fit to all presses
MAX_SECANTS = 12  # to an end of an interval
INFORMATIVE = 0.05  # of its press's peak: only such readings say whether the model is right


@dataclass(frozen=True, slots=True, eq=False)
class Readings:
    """Readings of taxels under presses, those that a fit uses, one behind the other."""

    value: Floats  # (M,) kPa
    error: Floats  # (M,) kPa, standard deviation
    press: Ints  # (M,)
    taxel: Ints  # (M,)
    gain_error: Floats  # (N,) relative standard deviation of every taxel's gain


@dataclass(frozen=True, slots=True, eq=False)
class Prior:
    """Normal priors; a deviation of infinity is none, one of 0 makes a shared parameter known."""

    shared: Floats  # (S,)
    shared_deviation: Floats
    own: Floats  # (K, P)
    own_deviation: Floats

    def of(self, presses: Ints) -> "Prior":
        """That of some presses only."""
        return replace(self, own=self.own[presses], own_deviation=self.own_deviation[presses])


@dataclass(frozen=True, eq=False)
class Model:
    """What readings should be, from parameters that presses share (S,) and have of their own (K, P)."""

    positions: Floats  # (M, 2) mm, of the readings' taxels
    press: Ints  # (M,)
    spectrum: Spectrum
    response: TipResponse | EdgeResponse
    free: tuple[int, ...]  # what is solved for of what is shared; slopes in the rest are 0
    highest: float  # kPa, the highest reading: unit of the bend of the taxels' curves

    def of(self, keep: Mask, press: Ints) -> "Model":
        """The model of some readings, of presses numbered anew."""
        return replace(self, positions=self.positions[keep], press=press)

    def __call__(self, shared: Floats, own: Floats) -> tuple[Floats, Floats, Floats]:
        """The model (M,), its slopes in what is shared (M, S) and in what is the press's own (M, P)."""
        raise NotImplementedError

    def bent(
        self, shared: Floats, model: Floats, by_shared: Floats, by_own: Floats
    ) -> tuple[Floats, Floats, Floats]:
        """The same as read by taxels whose curves bend."""
        bend = model / self.highest
        slope = (1 - 2 * shared[CURVATURE] * bend)[:, None]
        by_shared = by_shared * slope
        by_shared[:, CURVATURE] = -model * bend
        return model * (1 - shared[CURVATURE] * bend), by_shared, by_own * slope


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """The most likely parameters."""

    shared: Floats  # (S,)
    own: Floats  # (K, P)
    chi2: float  # with priors, gain errors integrated out
    model: Floats  # (M,)
    information: Floats  # (S, S) on the shared ones, all else solved for


class Likelihood:
    """Readings, a model and priors, with the gain errors' covariance at the model `reference` (M,)."""

    def __init__(self, readings: Readings, model: Model, prior: Prior, reference: Floats) -> None:
        self.readings, self.model, self.prior, self.reference = readings, model, prior, reference
        count, scaled = len(reference), reference / readings.error
        taxels = len(readings.gain_error)
        self._per_taxel = csr_array((scaled, (readings.taxel, np.arange(count))), shape=(taxels, count))
        squares = np.bincount(readings.taxel, scaled**2, minlength=taxels)
        variance = readings.gain_error**2
        self._shrink = np.sqrt(variance / (1 + variance * squares))

    def of(self, presses: Ints) -> "Likelihood":
        """The same of some presses only, numbered anew."""
        readings = self.readings
        keep = np.isin(readings.press, presses)
        press = np.searchsorted(presses, readings.press[keep])
        value, error, taxel = readings.value[keep], readings.error[keep], readings.taxel[keep]
        fewer = Readings(value, error, press, taxel, readings.gain_error)
        return Likelihood(fewer, self.model.of(keep, press), self.prior.of(presses), self.reference[keep])

    def solve(
        self, shared: Floats, own: Floats, fixed: tuple[int, ...] = (), max_steps: int = MAX_STEPS
    ) -> Solution:
        """Minimise chi-squared from a start; shared parameters that are `fixed` or known stay."""
        free = np.concatenate([self.prior.shared_deviation > 0, np.ones(own.size, bool)])
        free[list(fixed)] = False
        damping, at = START_DAMPING, np.concatenate([shared, own.ravel()])
        chi2, gradient, hessian, model = self._expand(at, len(shared))
        for _ in range(max_steps):
            damped = (hessian + damping * np.diag(np.diag(hessian)))[np.ix_(free, free)]
            trial = at.copy()
            trial[free] += np.linalg.lstsq(damped, gradient[free], rcond=1e-14)[0]
            expansion = self._expand(trial, len(shared))
            gained = chi2 - expansion[0]
            if gained >= 0:
                at, damping = trial, damping / 10
                chi2, gradient, hessian, model = expansion
            else:
                damping = max(10 * damping, 1e-2)
            if abs(gained) < CONVERGED or damping > MAX_DAMPING:
                break
        own = at[len(shared) :].reshape(own.shape)
        return Solution(at[: len(shared)], own, chi2, model, schur(hessian, len(shared)))

    def information(self, model: Model, solution: Solution, extra: int) -> Floats:
        """Information (S + extra, ...) on what is shared where `model` has more shared parameters, at 0."""
        prior = self.prior
        wider = replace(
            prior,
            shared=np.append(prior.shared, np.zeros(extra)),
            shared_deviation=np.append(prior.shared_deviation, np.full(extra, np.inf)),
        )
        at = np.concatenate([solution.shared, np.zeros(extra), solution.own.ravel()])
        *_, hessian, _ = Likelihood(self.readings, model, wider, self.reference)._expand(at, len(wider.shared))
        return schur(hessian, len(wider.shared))

    def residuals(self, solution: Solution) -> tuple[Floats, Ints]:
        """Informative residuals over their deviation (each with its taxel's gain error), and their presses."""
        readings, model = self.readings, solution.model
        peak = np.zeros(len(solution.own))
        np.maximum.at(peak, readings.press, np.abs(model))
        informative = np.abs(model) > INFORMATIVE * peak[readings.press]
        deviation = np.hypot(readings.error, readings.gain_error[readings.taxel] * model)
        return ((readings.value - model) / deviation)[informative], readings.press[informative]

    def misfits(self, solution: Solution) -> Floats:
        """Root mean square (K,) of each press's informative residuals, its own parameters counted off."""
        residuals, press = self.residuals(solution)
        count, own = len(solution.own), solution.own.shape[1]
        freedom = np.maximum(np.bincount(press, minlength=count) - own, 1)
        return np.asarray(np.sqrt(np.bincount(press, residuals**2, minlength=count) / freedom))

    def _expand(self, at: Floats, count: int) -> tuple[float, Floats, Floats, Floats]:
        """Give chi-squared, minus half its gradient, half its Hessian (Gauss-Newton), and the model (M,)."""
        prior, readings = self.prior, self.readings
        model, by_shared, by_own = self.model(at[:count], at[count:].reshape(prior.own.shape))
        width = count + by_own.shape[1]  # of a row's slopes: all others are 0
        columns = np.empty((len(model), width), np.intp)
        columns[:, :count] = np.arange(count)
        columns[:, count:] = count + readings.press[:, None] * by_own.shape[1] + np.arange(by_own.shape[1])
        values = np.hstack([by_shared, by_own]) / readings.error[:, None]
        rows = np.arange(0, values.size + 1, width)
        slopes = csr_array((values.ravel(), columns.ravel(), rows), shape=(len(model), len(at)))
        residual = (readings.value - model) / readings.error
        by_taxel = self._shrink[:, None] * (self._per_taxel @ slopes).toarray()
        of_taxel = self._shrink * (self._per_taxel @ residual)
        deviation = np.concatenate([prior.shared_deviation, prior.own_deviation.ravel()])
        weight = np.where(deviation > 0, np.maximum(deviation, 1e-12) ** -2.0, 0.0)
        offset = at - np.concatenate([prior.shared, prior.own.ravel()])
        chi2 = residual @ residual - of_taxel @ of_taxel + weight @ offset**2
        gradient = slopes.T @ residual - by_taxel.T @ of_taxel - weight * offset
        hessian = (slopes.T @ slopes).toarray() - by_taxel.T @ by_taxel + np.diag(weight)
        return float(chi2), gradient, hessian, model


def schur(hessian: Floats, count: int) -> Floats:
    """Information (count, count) on the first parameters after all others are solved for."""
    cross = hessian[:count, count:]
    rest = np.linalg.lstsq(hessian[count:, count:], cross.T, rcond=1e-14)[0]
    return np.asarray(hessian[:count, :count] - cross @ rest)


def interval(
    likelihood: Likelihood, best: Solution, dispersion: float, bounds: tuple[float, float]
) -> tuple[float, float]:
    """95 % interval of the first shared parameter by its profile likelihood, within `bounds`.

    `dispersion` is the mean square of residuals over what noise and gain errors explain.
    """
    free = np.flatnonzero(likelihood.prior.shared_deviation > 0)
    information = float(schur(best.information[np.ix_(free, free)], 1)[0, 0])
    deviation = np.sqrt(dispersion / max(information, 1e-12))

    def rise(at: float) -> float:
        """Standard deviations that the profile likelihood has fallen by."""
        shared = np.concatenate([[at], best.shared[1:]])
        chi2 = likelihood.solve(shared, best.own, fixed=(0,)).chi2
        return float(np.sqrt(max(chi2 - best.chi2, 1e-12) / dispersion))

    def end(bound: float) -> float:
        limit, side = abs(bound - best.shared[0]), np.sign(bound - best.shared[0])
        ends, rises = [0.0], [0.0]
        for _ in range(MAX_SECANTS):
            slope = (rises[-1] - rises[-2]) / (ends[-1] - ends[-2]) if len(ends) > 1 else 1 / deviation
            step = np.clip((NORMAL_95 - rises[-1]) / max(slope, 1e-9), -ends[-1] / 2, ends[-1] + 3 * deviation)
            ends.append(float(min(ends[-1] + step, limit)))
            rises.append(rise(best.shared[0] + side * ends[-1]) if ends[-1] != ends[-2] else rises[-1])
            if abs(rises[-1] - NORMAL_95) < 0.02 or (ends[-1] == limit and rises[-1] < NORMAL_95):
                break
        return float(best.shared[0] + side * ends[-1])

    return end(bounds[0]), end(bounds[1])


def left_out(likelihood: Likelihood, best: Solution) -> Floats:
    """Misfit (K,) of each press under what is fitted to the others; its own parameters are its own."""
    presses = np.arange(len(best.own))
    result = np.zeros(len(presses))
    for fold in range(min(FOLDS, len(presses))):
        out = presses[fold::FOLDS]
        others = np.setdiff1d(presses, out)
        fitted = likelihood.of(others).solve(best.shared, best.own[others], max_steps=LEFT_OUT_STEPS)
        test = likelihood.of(out)
        test.model = replace(test.model, free=())
        everything = tuple(range(len(best.shared)))
        its_own = test.solve(fitted.shared, best.own[out], fixed=everything, max_steps=LEFT_OUT_STEPS)
        result[out] = test.misfits(its_own)
    return result


def pooled(misfits: Floats) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(misfits))))
