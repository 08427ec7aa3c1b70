"""A radial kernel of any shape, where no thickness of the configured stack explains the presses.

The gain is the stack's times exp(s(q)): never negative, 1 at q = 0, s a smooth random function with s(0) = 0.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline

from tactiled.arrays import Floats
from tactiled.calibrate.cover.likelihood import Likelihood, left_out, pooled
from tactiled.calibrate.cover.search import Fitted

GAIN_END = 0.01  # of the stack: beyond END_RATIO times its frequency, s stays what it is
END_RATIO = 1.5
SMOOTHNESS = 0.25  # correlation length of s, over the frequency where the stack's gain ends
DEVIATION = 1.0  # prior one of s: a factor of e either way
MODES = 8  # of s: the ninth has 1e-4 of its variance
MIN_EXPLAINED = 0.5  # of the squared misfit over 1, which is what noise and gain errors explain
MIN_T = 2.0  # mean of the presses' improvements over its standard error
KERNEL_SIZE = 256


@dataclass(frozen=True, slots=True, eq=False)
class FreeKernel:
    """A free gain that explains presses left out significantly better than the stack."""

    kernel: Floats  # (2, n): q (cycles/mm, 0 first) and gain
    residual: float  # misfit of presses left out


def free_kernel(fitted: Fitted, misfits: Floats) -> FreeKernel | None:
    """Fit a free gain; None unless it is better than the stack, whose left-out presses miss by `misfits` (K,).

    The test: presses are left out by fifths, each under what the others give; a press's squared misfits under both
    are a pair. The free gain is taken if it explains MIN_EXPLAINED of what is above 1 in their mean, and the mean
    of the pairs' differences is MIN_T standard errors above 0.
    """
    touch, solution, nodes = fitted.touch, fitted.solution, fitted.likelihood.model.response.nodes
    stack = touch.spectrum(nodes)
    factor, count = float(np.exp(solution.shared[0])), len(solution.shared)
    wide = np.geomspace(nodes.q[0], nodes.q[-1], KERNEL_SIZE)
    end = float(wide[np.flatnonzero(touch.family.gain(wide, factor) >= GAIN_END)[-1]])
    basis, old = _basis(end), fitted.likelihood
    shape = basis(np.minimum(nodes.q, END_RATIO * end))

    def spectrum(shared: Floats) -> Floats:
        return np.asarray(stack(shared) * np.exp(shape @ shared[count:]))

    prior = replace(
        old.prior,
        shared=np.append(old.prior.shared, np.zeros(MODES)),
        shared_deviation=np.concatenate([[0.0], old.prior.shared_deviation[1:], np.ones(MODES)]),
    )
    free_now = tuple(np.flatnonzero(prior.shared_deviation > 0).tolist())
    model = replace(old.model, spectrum=spectrum, free=free_now)
    likelihood = Likelihood(old.readings, model, prior, old.reference)
    best = likelihood.solve(np.append(solution.shared, np.zeros(MODES)), solution.own)
    free = left_out(likelihood, best)
    gains = misfits**2 - free**2
    significant = gains.mean() > MIN_T * gains.std(ddof=1) / np.sqrt(len(gains))
    explained = gains.mean() / max(float(np.mean(misfits**2)) - 1, 1e-9)
    if not significant or explained < MIN_EXPLAINED:
        return None
    q = np.append(0.0, wide)
    gain = touch.family.gain(q, factor) * np.exp(basis(np.minimum(q, END_RATIO * end)) @ best.shared[count:])
    gain[0] = 1.0
    return FreeKernel(np.stack([q, gain]), pooled(free))


def _basis(end: float) -> CubicSpline:
    """Modes of s(q), of unit prior deviation each, up to END_RATIO times `end` (cycles/mm)."""
    q = np.linspace(0, END_RATIO * end, 65)
    covariance = np.exp(-(((q[:, None] - q) / (SMOOTHNESS * end)) ** 2) / 2)
    covariance -= np.outer(covariance[:, 0], covariance[0])  # given that s(0) = 0
    values, vectors = np.linalg.eigh(covariance)
    return CubicSpline(q, DEVIATION * vectors[:, : -MODES - 1 : -1] * np.sqrt(values[: -MODES - 1 : -1]))
