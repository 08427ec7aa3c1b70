"""Quality of a fit of a cover: its interval, its error on left-out presses, and what it cannot show."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tactiled.arrays import Floats
from tactiled.calibrate.cover.fit import CoverFit, Method
from tactiled.calibrate.cover.free_kernel import free_kernel
from tactiled.calibrate.cover.joint import ENDS, MISFIT, Joint, fit_jointly
from tactiled.calibrate.cover.likelihood import left_out, pooled, schur
from tactiled.calibrate.cover.notes import MAX_MISFIT, edge_objection, thicker, unknown_notes
from tactiled.calibrate.cover.presses import Press
from tactiled.calibrate.cover.recorded_presses import UNCALIBRATED_SPREAD
from tactiled.calibrate.cover.search import Fitted, Touch, search
from tactiled.calibrate.cover.unknowns import FACTOR, PROFILE, SIZE
from tactiled.cover import layered
from tactiled.restore.noise import NORMAL_95

DOUBLED = float(np.log(2))  # between two estimates of a rubber's modulus, such as from Shore A
IRRELEVANT = 0.01  # of the thickness: a modulus that changes it by less does not matter
MAX_POINTS = 2000  # of the plotted line


def fit_cover(touch: Touch, presses: Sequence[Press], method: Method) -> CoverFit:
    """Fit the thickness to a touch made of `presses`; notes name those of them that were not used."""
    fitted = search(touch)
    joint, family = fit_jointly(touch, fitted), fitted.touch.family
    middle, spread = float(joint.effective.shared[FACTOR]), NORMAL_95 * joint.effective_deviation
    factor, low, high = (float(np.exp(np.clip(middle + each, *ENDS))) for each in (0, -spread, spread))
    ends = float(np.exp(joint.interval[0])), float(np.exp(joint.interval[1]))
    within, depth = (min(low, ends[0]), max(high, ends[1])), family.configured.depth
    misfits = left_out(joint.likelihood, joint.solution)
    reason = _reason(joint.interval, depth, float(np.median(touch.gain_error)) >= UNCALIBRATED_SPREAD)
    fit = CoverFit(
        method=method,
        factor=factor,
        interval=within,
        thickness_mm=factor * depth,
        interval_mm=(within[0] * depth, within[1] * depth),
        presses=len(joint.solution.own),
        residual=pooled(misfits),
        reason=reason,
        effective=(low, high),
        notes=(*_unused(presses, fitted), *(() if reason else (*unknown_notes(joint), _modulus(fitted, joint)))),
        line=_line(joint),
    )
    if reason:
        return fit
    if objection := edge_objection(joint):
        return replace(fit, objection=objection, notes=(objection, *fit.notes))
    return _explained(fit, fitted, misfits)


def _reason(ends: tuple[float, float], depth: float, uncalibrated: bool) -> str:
    """Why presses cannot tell the thickness, whose interval reaches an end of the family; "" where they can."""
    low, high = (f"{np.exp(each) * depth:.3g} mm" for each in ends)
    thin, thick = ends[0] <= ENDS[0] + 1e-6, ends[1] >= ENDS[1] - 1e-6
    if thin and thick:
        advice = "calibrate the gain first" if uncalibrated else "press harder, and with a smaller tip"
        return f"every cover from {low} to {high} explains the presses: {advice}"
    if thin:
        return f"any cover thinner than {high} explains the presses: is the cover configured far too thick?"
    if thick:
        return f"any cover thicker than {low} explains the presses: is the cover configured far too thin?"
    return ""


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
    """The fit with the free kernel where presses that were left out want it, and what speaks against the model."""
    if fit.residual <= MISFIT:
        return fit
    miss = f"presses left out of the fit miss by {fit.residual:.2g} times what noise and gain errors explain"
    # an edge that is not sharp looks like another kernel, and other edges of the same pad do, too
    free = free_kernel(fitted, misfits) if fit.method == "tip" else None
    if free is not None:
        note = f'{miss}, those of a free kernel by {free.residual:.2g}: use kernel.model = "measured"'
        return replace(fit, kernel=free.kernel, objection=note, notes=(note, *fit.notes))
    tool = {"tip": "use another tip", "edge": "use a tip (--tip-mm)"}[fit.method]
    note = f"{miss}: is the gain of the taxels calibrated? If it is, {tool}"
    return replace(fit, objection=note if fit.residual > MAX_MISFIT else "", notes=(note, *fit.notes))


def _modulus(fitted: Fitted, joint: Joint) -> str:
    """What the presses tell of the cover's modulus apart from its thickness."""
    likelihood, touch = fitted.likelihood, fitted.touch
    nodes, count = likelihood.model.response.nodes, len(fitted.solution.shared)

    def spectrum(shared: Floats) -> Floats:
        factor, stiffer = float(np.exp(np.clip(shared[FACTOR], *ENDS))), float(np.exp(shared[count]))
        thick = touch.family.configured.thickened(factor)
        stack = thick.with_cover(lambda layer: replace(layer, young=layer.young * stiffer))
        return np.asarray(layered.gain(stack, nodes.q) * touch.transform(nodes.q, *shared[[SIZE, PROFILE]]))

    model = replace(likelihood.model, spectrum=spectrum, free=(*touch.free, count))
    information = likelihood.information(model, fitted.solution, 1)
    order = [FACTOR, count, *touch.free[1:]]
    reduced = schur(information[np.ix_(order, order)], 2) / joint.misfit**2
    deviation = np.sqrt(np.linalg.pinv(reduced)[1, 1])
    return _note("Young's modulus", float(deviation), -float(reduced[0, 1] / reduced[0, 0]) * DOUBLED)


def _note(name: str, deviation: float, change: float) -> str:
    """What presses tell of a parameter whose logarithm they tell to `deviation`, and what it does to the fit."""
    percent = thicker(change)
    if abs(change) < IRRELEVANT:
        return f"the cover's {name} does not matter: twice as much would make it only {percent}"
    effect = f"with twice as much, the cover would be {percent}"
    if NORMAL_95 * deviation > DOUBLED:
        return f"the cover's {name} cannot be told from its thickness by these presses: {effect}"
    return f"the cover's {name} was taken as configured: {effect}, and these presses would show that"


def _line(fitted: Joint) -> Floats:
    """Measured and fitted response (3, n) by the distance from the tip or edge, over the load's."""
    likelihood, solution = fitted.likelihood, fitted.solution
    x, scale = fitted.touch.on_line(likelihood, solution)
    points = np.stack([x, likelihood.readings.value / scale, solution.model / scale])
    order = np.argsort(x)
    return np.asarray(points[:, order[:: len(order) // MAX_POINTS + 1]])
