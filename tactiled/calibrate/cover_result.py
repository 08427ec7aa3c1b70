"""What a fit of a cover is good for: its interval, its test on presses left out, and what it cannot tell."""

import numpy as np
from numpy.typing import NDArray

from tactiled.calibrate.cover_fit import CoverFit, Method
from tactiled.calibrate.cover_search import Fitted
from tactiled.calibrate.likelihood import interval, left_out, pooled
from tactiled.cover.family import FACTORS

Floats = NDArray[np.float64]

FOLDS = 5


def result(fitted: Fitted, method: Method) -> CoverFit:
    """The fit as a whole."""
    likelihood, solution, family = fitted.likelihood, fitted.solution, fitted.touch.family
    dispersion = max(1.0, pooled(likelihood.misfits(solution))) ** 2
    bounds = float(np.log(FACTORS[0])), float(np.log(FACTORS[1]))
    low, high = np.exp(interval(likelihood, solution, dispersion, bounds))
    factor = float(np.clip(np.exp(solution.shared[0]), *FACTORS))
    depth = family.configured.depth
    residual = pooled(left_out(likelihood, solution, FOLDS))
    return CoverFit(
        method, factor, (float(low), float(high)), factor * depth, (float(low) * depth, float(high) * depth),
        len(solution.own), residual,
    )  # fmt: skip
