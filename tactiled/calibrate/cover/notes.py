"""Notes on what a person does not know exactly: what the presses show of it, and what to measure first."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from tactiled.calibrate.cover.edge import EdgeTouch
from tactiled.calibrate.cover.joint import MISFIT, Joint
from tactiled.calibrate.cover.tip import TipTouch
from tactiled.calibrate.cover.unknowns import APERTURE, CURVATURE, FACTOR, POISSON, PROFILE, SIZE

MAX_MISFIT = 3.0  # times noise and gain errors: above it nothing that was given explains the presses
CLEAR = 2.5  # standard deviations from what was given, from which a note says so
# Of the thickness: a fade exp(-x / b) weakens a wave w by sqrt(1 + (wb)^2), a Gaussian blur by exp((wb)^2 / 2). At
# w = 2 / thickness, of which covers pass half, they differ by 0.6 % where b is a fifth of the thickness.
MAX_BLUR = 0.2
NOTED = 0.25  # of the thickness's variance: what adds as much is named, too
MADE_UP = "the thickness makes up for it, so keep the setting"


class _Words(NamedTuple):
    """One parameter: what it is, and what presses say of it where they differ clearly."""

    name: str
    differs: Callable[[Joint], str]


def unknown_notes(joint: Joint) -> tuple[str, ...]:
    """A line on what would narrow the interval most, and one on all that differs clearly from what was given."""
    words = {at: _words(joint, at) for at in joint.touch.free if at != FACTOR}
    if not words:
        return ()
    shares = sorted(((joint.share(at), at) for at in words), reverse=True)
    parts = [
        f"{words[at].name} ({100 * (1 - max(1 - share, 0) ** 0.5):.0f} % narrower)"
        for number, (share, at) in enumerate(shares)
        if not number or share > NOTED
    ]
    counts = f"to narrow the interval, measure exactly: {', '.join(parts)}"
    if joint.misfit > MAX_MISFIT:
        return (counts,)
    is_size_unknown = isinstance(joint.touch, TipTouch) and joint.touch.tip.diameter_mm is None
    told_of = {at for at in words if at != SIZE or not is_size_unknown}
    return *(words[at].differs(joint) for at in sorted(told_of) if joint.differs(at) > CLEAR), counts


def edge_objection(joint: Joint) -> str:
    """Why an edge is none that a thickness can be told by; "" where it is one, or a ridge."""
    is_edge = isinstance(joint.touch, EdgeTouch) and np.isinf(joint.touch.width)
    if not is_edge or not (joint.freed or joint.misfit > MISFIT or _is_shape_decisive(joint)):
        return ""
    return (
        "the edge is not sharp, or its pressure is not even: lay a ridge of known width (--edge-mm), or use a tip"
    )


def _is_shape_decisive(joint: Joint) -> bool:
    """Whether an edge is clearly blurred, so widely under its cover that an unknown shape of the blur matters."""
    depth = joint.touch.family.configured.depth * np.exp(joint.solution.shared[FACTOR])
    blur = abs(joint.solution.shared[PROFILE]) ** 0.5
    return bool(blur > MAX_BLUR * depth and joint.differs(PROFILE) > CLEAR)


def thicker(change: float) -> str:
    """A change of the thickness's logarithm in words."""
    return f"{abs(100 * np.expm1(change)):.2g} % {'thicker' if change > 0 else 'thinner'}"


def _words(joint: Joint, parameter: int) -> _Words:
    touch = joint.touch
    if parameter == APERTURE:
        return _Words("the aperture", _aperture)
    if parameter == POISSON:
        return _Words("Poisson's ratio", _poisson)
    if parameter == CURVATURE:
        return _Words("the bend of the taxels' curves", _curvature)
    if parameter == SIZE:
        return _Words(f"the {'tip' if isinstance(touch, TipTouch) else 'ridge'}'s size", _size)
    if isinstance(touch, EdgeTouch) and np.isinf(touch.width):
        return _Words("the edge's blur", _blur)
    return _Words("how the load spreads", _profile)


def _aperture(joint: Joint) -> str:
    width = joint.touch.array.width
    fitted = width * np.exp(joint.solution.shared[APERTURE])
    return f"the presses look like those on an aperture of {fitted:.2g} mm, not {width:.2g} mm: {MADE_UP}"


def _poisson(joint: Joint) -> str:
    configured = joint.touch.family.configured.layers[0].poisson
    fitted = min(configured + joint.solution.shared[POISSON], 0.5)
    return f"the presses look like those under a Poisson's ratio of {fitted:.2g}, not {configured:.3g}: {MADE_UP}"


def _curvature(joint: Joint) -> str:
    bend = 100 * joint.solution.shared[CURVATURE]
    side = "less" if bend > 0 else "more"
    return (
        f"the taxels read {abs(bend):.2g} % {side} at the highest reading than their curves say:"
        " calibrate the gain over the pressures of the presses"
    )


def _size(joint: Joint) -> str:
    fitted, measured = np.exp(joint.sized.shared[SIZE]), np.exp(joint.touch.prior.shared[SIZE])
    depth = np.exp(joint.sized.shared[FACTOR]) * joint.touch.family.configured.depth
    if isinstance(joint.touch, TipTouch):
        name, fitted, measured, option = "tip", 2 * fitted, 2 * measured, "--tip-mm"
    else:
        name, option = "ridge", "--edge-mm"
    return (
        f"the presses look like those of a {name} of {fitted:.2g} mm, not {measured:.3g} mm, under a cover of"
        f" {depth:.3g} mm: measure it again ({option})"
    )


def _blur(joint: Joint) -> str:
    square = float(joint.solution.shared[PROFILE])
    if square < 0:
        return "the pad presses hardest along its edge, as a hard plate does: a soft pad tells more"
    blur = f"{np.sqrt(square):.2g} mm"
    return f"the edge is blurred by {blur}, as a soft or worn one is: a ridge of known width tells more"


def _profile(joint: Joint) -> str:
    name = "tip" if isinstance(joint.touch, TipTouch) else "ridge"
    exponent = joint.solution.shared[PROFILE] - joint.touch.prior.shared[PROFILE]
    if exponent < 0:
        return f"the {name} presses hardest at its rim, as hard flat ones do: that is part of the fit"
    return f"the {name} presses hardest in its middle, as round or worn ones do: that is part of the fit"
