"""The search for a cover's thickness from any touch: coarse, fine, without presses that do not fit."""

from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Self

import numpy as np

from tactiled.arrays import Floats, Ints, Mask
from tactiled.calibrate.cover.likelihood import Likelihood, Model, Prior, Readings, Solution, Spectrum
from tactiled.calibrate.cover.presses import Press
from tactiled.calibrate.cover.touch_response import ONE, Quadrature, quadrature
from tactiled.calibrate.cover.unknowns import (
    APERTURE,
    APERTURE_SCALES,
    CURVATURE,
    FACTOR,
    POISSON,
    PROFILE,
    SHARED,
    SIZE,
)
from tactiled.cover.family import FACTORS, CoverFamily, lagrange
from tactiled.geometry import Array

COARSE_FACTORS = np.geomspace(*FACTORS, 13)
COARSE_PRESSES = 6  # the strongest, which decide where the fine search starts
COARSE_STEPS = 4
BRACKET = 1.5  # tables hold for covers so many times thinner and thicker than the last estimate
MAX_ROUNDS = 6  # of tables
SETTLED = 0.2  # of the factor's logarithm: an estimate nearer to its tables' middle is the last
MODEL_ERROR = 1e-3  # of a press's peak: finite elements' gain and the tables are no better
MISFIT_RATIO = 3.0  # of a press's misfit over the median's and over 1: something else touched, or it slid
REFERENCES, NEAR_REFERENCES = 3, 2  # rounds, in each of which gain errors are proportional to the last one's model
MAX_APERTURE = np.log(0.5), np.log(2)  # over the configured one
FREED = {
    SIZE: 1.0,
    APERTURE: 0.5,
    POISSON: 0.15,
    CURVATURE: 0.3,
    PROFILE: 2.0,
}  # deviations in place of priors that presses refuse
STEP = 1e-4  # of finite differences in shared parameters


@dataclass(frozen=True, eq=False)
class Touch:
    """Presses of one kind. What they share begins with the logarithm of the factor of thickness."""

    array: Array
    family: CoverFamily
    presses: tuple[Press, ...]
    gain_error: Floats  # (N,) relative standard deviation
    prior: Prior  # its `own` is where the search starts

    def transform(self, q: Floats, size: float, profile: float) -> Floats:
        """Transform of the load (n,), 1 at q = 0, of what is shared at SIZE and PROFILE."""
        raise NotImplementedError

    def model(self, nodes: Quadrature, spectrum: Spectrum, readings: Readings, coarse: bool = False) -> Model:
        """The model of `readings`; a coarse one is fast."""
        raise NotImplementedError

    def near(self, reach: float, depth: float) -> Mask:
        """Readings (K, N) that the model holds for; a response ends at `reach` under a cover of `depth` (mm)."""
        raise NotImplementedError

    def on_line(self, likelihood: Likelihood, solution: Solution) -> tuple[Floats, Floats]:
        """Each reading's distance (M,) in mm from the load, and what the load is there (kPa): the plot's units."""
        raise NotImplementedError

    def freed_deviation(self, parameter: int) -> float:
        """Deviation of what is shared where presses refuse its prior."""
        return FREED[parameter]

    def only(self, presses: Ints) -> Self:
        """The same with some presses."""
        return replace(self, presses=tuple(self.presses[at] for at in presses), prior=self.prior.of(presses))

    @property
    def extra_mm(self) -> float:
        """How far a response reaches beyond that of the cover."""
        return 3 * self.array.pitch

    @property
    def free(self) -> tuple[int, ...]:
        """What is solved for of what is shared."""
        return tuple(np.flatnonzero(self.prior.shared_deviation > 0).tolist())

    @property
    def scales(self) -> tuple[float, ...]:
        """Of the aperture, of the tables."""
        return APERTURE_SCALES if APERTURE in self.free else ONE

    def fixed(self, *parameters: int) -> Self:
        """The same where some of what is shared is as configured."""
        deviation = self.prior.shared_deviation.copy()
        deviation[list(parameters)] = 0
        return replace(self, prior=replace(self.prior, shared_deviation=deviation))

    def spectrum(self, nodes: Quadrature) -> Spectrum:
        """The family's gain times the load's transform, a block for each of `scales`."""
        low, high = np.log(FACTORS)

        @lru_cache(maxsize=8)  # slopes in the load and the aperture need the same one
        def gain(log_factor: float, poisson: float) -> Floats:
            return self.family.gain(nodes.q, np.exp(np.clip(log_factor, low, high)), poisson)

        load = lru_cache(maxsize=8)(partial(self.transform, nodes.q))  # and slopes in the cover the same load

        def once(shared: Floats) -> Floats:
            return np.asarray(gain(shared[FACTOR], shared[POISSON]) * load(shared[SIZE], shared[PROFILE]))

        if self.scales == ONE:
            return once
        places = np.log(self.scales)
        return lambda shared: np.outer(
            lagrange(float(np.clip(shared[APERTURE], *MAX_APERTURE)), places), once(shared)
        ).ravel()

    def readings(self, near: Mask) -> Readings:
        """The known ones of `near` (K, N); MODEL_ERROR is part of their error."""
        means, errors = (np.stack([getattr(each, name) for each in self.presses]) for name in ("mean", "error"))
        press, taxel = np.nonzero(np.isfinite(means) & near)
        errors = np.hypot(errors, MODEL_ERROR * np.nanmax(means, axis=1, keepdims=True))
        return Readings(means[press, taxel], errors[press, taxel], press, taxel, self.gain_error)

    def likelihood(self, factors: tuple[float, float], coarse: bool = False) -> Likelihood:
        """Likelihood with tables for covers of `factors` (low, high), taxels' gains taken for exact."""
        low, high = np.clip(factors, *FACTORS)
        nodes, depth = quadrature(self.family, (low, high), self.extra_mm), self.family.configured.depth
        near = (np.inf, depth) if coarse else (nodes.reach - self.array.pitch, depth * np.sqrt(low * high))
        readings = self.readings(self.near(*near))
        model = self.model(nodes, self.spectrum(nodes), readings, coarse)
        return Likelihood(readings, model, self.prior, np.zeros(len(readings.value)))


def differences(value: Spectrum, shared: Floats, free: tuple[int, ...]) -> Floats:
    """Give (n, 1 + S): a spectrum and its slopes in what is shared, 0 where that is not `free`."""
    middle = value(shared)
    result = np.zeros((len(middle), 1 + len(shared)))
    result[:, 0] = middle
    for at in set(free) - {CURVATURE}:
        step = STEP * np.eye(len(shared))[at]
        result[:, 1 + at] = (value(shared + step) - value(shared - step)) / (2 * STEP)
    return result


@dataclass(frozen=True, slots=True, eq=False)
class Fitted:
    """The end of a search."""

    touch: Touch  # without presses that do not fit
    likelihood: Likelihood  # gain errors integrated out
    solution: Solution
    misfitting: tuple[Press, ...]


def search(touch: Touch) -> Fitted:
    """Find the most likely factor of a sensor as configured, without presses that fit far worse than others."""
    touch = touch.fixed(*range(APERTURE, SHARED))
    fitted = fine(touch, _coarse(touch).shared)
    misfits = fitted.likelihood.misfits(fitted.solution)
    fits = misfits <= MISFIT_RATIO * max(1.0, float(np.median(misfits)))
    if fits.all():
        return fitted
    aside = tuple(each for each, fit in zip(touch.presses, fits, strict=True) if not fit)
    return replace(fine(touch.only(np.flatnonzero(fits)), fitted.solution.shared), misfitting=aside)


def _coarse(touch: Touch) -> Solution:
    """The best of COARSE_FACTORS for the strongest presses, the factor held there."""
    peaks = np.array([np.nanmax(each.mean / each.error) for each in touch.presses])
    strongest = touch.only(np.sort(np.argsort(-peaks)[:COARSE_PRESSES]))
    solutions = []
    for factor in COARSE_FACTORS:
        start = np.concatenate([[np.log(factor)], touch.prior.shared[1:]])
        likelihood = _with_gain_noise(strongest.likelihood((factor, factor), coarse=True))
        solutions.append(likelihood.solve(start, strongest.prior.own, fixed=(0,), max_steps=COARSE_STEPS))
    return min(solutions, key=lambda each: each.chi2)


def fine(touch: Touch, shared: Floats, own: Floats | None = None) -> Fitted:
    """Solve for everything, with tables around the last estimate until it stays; with `own` it is near the end."""
    rounds = REFERENCES if own is None else NEAR_REFERENCES
    for _ in range(MAX_ROUNDS):
        middle = shared[0]
        exact = touch.likelihood((np.exp(middle) / BRACKET, np.exp(middle) * BRACKET))
        if own is None:
            pilot = _with_gain_noise(exact).solve(shared, touch.prior.own)
            shared, own, model = pilot.shared, pilot.own, pilot.model
        else:
            model = exact.model(shared, own)[0]
        for _ in range(rounds):
            likelihood = Likelihood(exact.readings, exact.model, exact.prior, model)
            solution = likelihood.solve(shared, own)
            shared, own, model = solution.shared, solution.own, solution.model
        shared = np.append(np.clip(shared[:1], *np.log(FACTORS)), shared[1:])
        if abs(shared[0] - middle) < SETTLED:
            break
    return Fitted(touch, likelihood, solution, ())


def _with_gain_noise(likelihood: Likelihood) -> Likelihood:
    """The same with each gain error as independent noise of its reading."""
    readings = likelihood.readings
    error = np.hypot(readings.error, readings.gain_error[readings.taxel] * readings.value)
    return Likelihood(replace(readings, error=error), likelihood.model, likelihood.prior, likelihood.reference)
