"""What a fit of a cover is good for: its interval, its test on presses left out, and what it cannot tell."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tactiled.calibrate.cover_fit import CoverFit, Method
from tactiled.calibrate.cover_search import Fitted, Touch, search
from tactiled.calibrate.free_kernel import free_kernel
from tactiled.calibrate.likelihood import interval, left_out, pooled, schur
from tactiled.calibrate.presses import Press
from tactiled.calibrate.recorded_presses import UNCALIBRATED_SPREAD
from tactiled.cover import layered
from tactiled.cover.family import FACTORS, CoverFamily
from tactiled.cover.stack import Layer, Stack
from tactiled.restore.noise import NORMAL_95

Floats = NDArray[np.float64]

MISFIT = 1.2  # times noise and gain errors: presses left out that miss by more show a wrong model
DOUBLED = float(np.log(2))  # between two estimates of a rubber's modulus or compressibility, such as from Shore A
IRRELEVANT = 0.01  # of the thickness: a modulus that changes it by less does not matter
ENDS = float(np.log(FACTORS[0])), float(np.log(FACTORS[1]))
MAX_POINTS = 2000  # of the plotted line


def fit_cover(touch: Touch, presses: Sequence[Press], method: Method) -> CoverFit:
    """Fit the thickness to a touch made of `presses`; notes name those of them that were not used."""
    fitted = search(touch)
    likelihood, solution, family = fitted.likelihood, fitted.solution, fitted.touch.family
    dispersion = max(1.0, pooled(likelihood.misfits(solution))) ** 2
    ends = interval(likelihood, solution, dispersion, ENDS)
    low, high = (float(each) for each in np.exp(ends))
    factor, depth = float(np.exp(np.clip(solution.shared[0], *ENDS))), family.configured.depth
    uncalibrated = float(np.median(touch.gain_error)) >= UNCALIBRATED_SPREAD
    misfits, reason = left_out(likelihood, solution), _reason(ends, depth, uncalibrated)
    others = [] if reason else _other_parameters(fitted, dispersion)
    fit = CoverFit(
        method=method,
        factor=factor,
        interval=(min(low, factor), max(high, factor)),
        thickness_mm=factor * depth,
        interval_mm=(min(low, factor) * depth, max(high, factor) * depth),
        presses=len(solution.own),
        residual=pooled(misfits),
        reason=reason,
        notes=(*_unused(presses, fitted), *others),
        line=_line(fitted),
    )
    fit = fit if reason else _explained(fit, fitted, misfits)
    note = fitted.touch.size_note(solution, float(np.sqrt(dispersion)))
    return replace(fit, notes=(note, *fit.notes)) if note else fit


def _reason(ends: tuple[float, float], depth: float, uncalibrated: bool) -> str:
    """Why presses cannot tell the thickness, whose interval reaches an end of the family; "" where they can."""
    low, high = (f"{np.exp(each) * depth:.3g} mm" for each in ends)
    thin, thick = ends[0] <= ENDS[0] + 1e-6, ends[1] >= ENDS[1] - 1e-6
    if thin and thick:
        advice = "calibrate the gain first" if uncalibrated else "press harder, and with a smaller tip"
        return f"every cover from {low} to {high} explains the presses: {advice}"
    if thin:
        return f"any cover thinner than {high} explains the presses: is the cover configured far too thick?"
    return (
        f"any cover thicker than {low} explains the presses: is the cover configured far too thin?"
        if thick
        else ""
    )


def _unused(presses: Sequence[Press], fitted: Fitted) -> list[str]:
    """A line on each press that was not used."""
    misfitting = {each.start for each in fitted.misfitting}
    reasons = {each.start: each.reason for each in presses if each.reason}
    reasons |= dict.fromkeys(
        misfitting, "fits far worse than the others: did something else touch, or did it slide?"
    )
    return [
        f"press {number} of {len(presses)} is not used: {reasons[each.start]}"
        for number, each in enumerate(presses, 1)
        if each.start in reasons
    ]


def _explained(fit: CoverFit, fitted: Fitted, misfits: Floats) -> CoverFit:
    """The fit with the free kernel where presses that were left out want it, and what is to be noted of both."""
    if fit.residual <= MISFIT:
        return fit
    miss = f"presses left out of the fit miss by {fit.residual:.2g} times what noise and gain errors explain"
    free = free_kernel(fitted, misfits)
    if free is None:
        note = f"{miss}, and a free kernel is not significantly better: is the gain of the taxels calibrated?"
        return replace(fit, notes=(note, *fit.notes))
    note = f'{miss}, those of a free kernel by {free.residual:.2g}: use kernel.model = "measured"'
    return replace(fit, kernel=free.kernel, notes=(note, *fit.notes))


def _other_parameters(fitted: Fitted, dispersion: float) -> list[str]:
    """What the presses tell of the cover's modulus and compressibility apart from its thickness."""
    likelihood, touch = fitted.likelihood, fitted.touch
    nodes, count = likelihood.model.response.nodes, len(fitted.solution.shared)

    def spectrum(shared: Floats) -> Floats:
        stack = _changed(touch.family, float(np.exp(np.clip(shared[0], *ENDS))), *shared[count:])
        return np.asarray(layered.gain(stack, nodes.q) * touch.transform(nodes.q, shared))

    model = replace(likelihood.model, spectrum=spectrum)
    information = likelihood.information(model, fitted.solution, 2)
    free = [0, *(at for at in range(1, count) if likelihood.prior.shared_deviation[at] > 0)]
    order = [0, count, count + 1, *free[1:]]
    reduced = schur(information[np.ix_(order, order)], 3) / dispersion
    deviations = np.sqrt(np.diag(np.linalg.pinv(reduced)))
    return [
        _note(name, float(deviations[at]), -float(reduced[0, at] / reduced[0, 0]) * DOUBLED)
        for at, name in ((1, "Young's modulus"), (2, "compressibility (1 - 2 Poisson's ratio)"))
    ]


def _changed(family: CoverFamily, factor: float, modulus: float, compressibility: float) -> Stack:
    """The stack with another modulus and compressibility over the sensing plane, by their logarithms."""
    stack = family.configured.thickened(factor)
    layers = [
        Layer(each.thickness, each.young * np.exp(modulus), 0.5 - (0.5 - each.poisson) * np.exp(compressibility))
        for each in stack.layers[: stack.sensing]
    ]
    return replace(stack, layers=(*layers, *stack.layers[stack.sensing :]))


def _note(name: str, deviation: float, change: float) -> str:
    """What presses tell of a parameter whose logarithm they tell to `deviation`, and what it does to the fit."""
    percent = f"{abs(100 * np.expm1(change)):.2g} % {'thicker' if change > 0 else 'thinner'}"
    if abs(change) < IRRELEVANT:
        return f"the cover's {name} does not matter: twice as much would make it only {percent}"
    effect = f"with twice as much, the cover would be {percent}"
    if NORMAL_95 * deviation > DOUBLED:
        return f"the cover's {name} cannot be told from its thickness by these presses: {effect}"
    return f"the cover's {name} was taken as configured: {effect}, and these presses would show that"


def _line(fitted: Fitted) -> Floats:
    """Measured and fitted response (3, n) by the distance from the tip or edge, over the load's."""
    likelihood, solution = fitted.likelihood, fitted.solution
    x, scale = fitted.touch.on_line(likelihood, solution)
    points = np.stack([x, likelihood.readings.value / scale, solution.model / scale])
    order = np.argsort(x)
    return np.asarray(points[:, order[:: len(order) // MAX_POINTS + 1]])
