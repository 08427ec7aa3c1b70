"""A cover fitted with all that a person does not know exactly, each with the deviation that it has."""

from dataclasses import dataclass, replace

import numpy as np

from tactiled.arrays import Floats
from tactiled.calibrate.cover.likelihood import Likelihood, Solution, interval, pooled
from tactiled.calibrate.cover.search import Fitted, Touch, fine
from tactiled.calibrate.cover.unknowns import APERTURE, FACTOR, PROFILE, SENSOR, SHARED, SIZE
from tactiled.cover.family import FACTORS
from tactiled.restore.noise import NORMAL_95

ENDS = float(np.log(FACTORS[0])), float(np.log(FACTORS[1]))
LINEAR = 0.1  # deviation of the factor's logarithm, up to which its likelihood is as good as normal
MISFIT = 1.2  # times noise and gain errors: above it something that was given is wrong
PULL = 2.0  # standard deviations that presses pull a parameter by, from which its prior is given up
UNEXPLAINED = 1.5  # times noise and gain errors, with priors given up: they were not what is wrong
MAX_FREED = 3
GAINED = 14.0  # of chi-squared: 99.7 % of what three free parameters gain by chance


@dataclass(frozen=True, slots=True, eq=False)
class Joint:
    """A cover and all that was not known exactly, as fitted."""

    touch: Touch
    likelihood: Likelihood
    solution: Solution
    freed: tuple[int, ...]  # whose priors the presses refuse
    misfit: float  # over what noise and gain errors explain, 1 at least
    interval: tuple[float, float]  # of the factor's logarithm, 95 %
    sized: Solution  # with everything but the size as given
    # The simplest that explains the presses with the sensor as configured: restoration is right with its factor.
    effective: Solution
    effective_deviation: float  # of its factor's logarithm

    def share(self, parameter: int) -> float:
        """Share of the variance of the factor's logarithm that would go if a parameter were known."""
        touches = self.touch, self.touch.fixed(parameter)
        all_free, one_less = (np.linalg.pinv(_information(each, self.solution))[0, 0] for each in touches)
        return float(1 - one_less / all_free)

    def differs(self, parameter: int) -> float:
        """Standard deviations between a parameter as given and as the presses have it."""
        covariance, at = np.linalg.pinv(_information(self.touch, self.solution)), self.touch.free.index(parameter)
        own = self.misfit * covariance[at, at] ** 0.5
        return float(abs(self.solution.shared[parameter] - self.touch.prior.shared[parameter]) / own)


def fit_jointly(touch: Touch, fitted: Fitted) -> Joint:
    """Continue a search of the sensor as configured; `touch` has the priors of everything."""
    touch = replace(fitted.touch, prior=replace(fitted.touch.prior, shared_deviation=touch.prior.shared_deviation))
    start, freed = fitted.solution, list[int]()
    simpler = [start]
    while True:
        fitted = fine(touch, start.shared, start.own)
        likelihood, solution = fitted.likelihood, fitted.solution
        misfit = max(1.0, pooled(likelihood.misfits(solution)))
        if not freed:
            as_configured = touch, likelihood, solution, misfit
        refused = _refused(touch, solution, misfit, freed)
        if refused is None or len(freed) == MAX_FREED:
            break
        freed.append(refused)
        wider = touch.prior.shared_deviation.copy()
        wider[refused] = max(touch.freed_deviation(refused), wider[refused])
        touch = replace(touch, prior=replace(touch.prior, shared_deviation=wider))
        if refused == SIZE:  # first without a profile, whose bounds are no place to start from
            start = fine(touch.fixed(*range(APERTURE, SHARED)), start.shared, start.own).solution
            simpler.append(start)
    if freed and misfit > UNEXPLAINED:  # no tool explains it either
        (touch, likelihood, solution, misfit), freed = as_configured, []
        del simpler[1:]
    deviation = misfit * float(np.linalg.pinv(_information(touch, solution))[0, 0]) ** 0.5
    half = NORMAL_95 * deviation
    ends = float(solution.shared[FACTOR]) - half, float(solution.shared[FACTOR]) + half
    if deviation > LINEAR:
        ends = interval(likelihood, solution, misfit**2, ENDS)
    configured = solution.shared.copy()
    configured[list(SENSOR)] = touch.prior.shared[list(SENSOR)]
    effective = likelihood.solve(configured, solution.own, fixed=SENSOR)
    own = touch.fixed(*SENSOR)
    deviation = misfit * float(np.linalg.pinv(_information(own, solution))[0, 0]) ** 0.5
    simplest = next((each for each in simpler if each.chi2 - effective.chi2 < GAINED * misfit**2), effective)
    return Joint(touch, likelihood, solution, tuple(freed), misfit, ends, simpler[-1], simplest, deviation)


def _refused(touch: Touch, solution: Solution, misfit: float, freed: list[int]) -> int | None:
    """The parameter whose prior the presses speak against most; None where they agree with all."""
    others = [at for at in touch.free if at != FACTOR and at not in freed]
    offsets = np.abs(solution.shared - touch.prior.shared)
    pulls = {at: float(offsets[at] / touch.prior.shared_deviation[at]) for at in others}
    worst = max(others, key=lambda at: pulls[at], default=None)
    # A size is measured far more exactly than a profile is known: if both explain the presses, the size is wrong.
    if SIZE in others and ((worst == PROFILE and pulls[PROFILE] > PULL * misfit) or misfit > MISFIT):
        return SIZE
    return worst if worst is not None and pulls[worst] > PULL * misfit else None


def _information(touch: Touch, solution: Solution) -> Floats:
    """Information on what is free of what is shared, the factor's logarithm first."""
    return solution.information[np.ix_(touch.free, touch.free)]
