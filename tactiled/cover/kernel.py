"""The cover as a blur: its gain G(q), and g(r) as G's inverse Hankel transform; cached on disk by content."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.fft import fht, fhtoffset
from scipy.interpolate import CubicSpline

from tactiled.cover import layered
from tactiled.cover.stack import Stack
from tactiled.errors import PhysicsError

Floats = NDArray[np.float64]
Model = Literal["fem", "layered"]

NOTHING = 1e-9  # a gain that is as good as 0, and a loss of gain that is as good as none


@dataclass(frozen=True, slots=True, eq=False)
class Kernel:
    """A solved cover: the normal stress at the sensing plane is g convolved with the surface pressure."""

    stack: Stack
    model: Model
    q: Floats  # (n,) cycles/mm, 0 first, then even in its logarithm up to where the gain is as good as 0
    gain: Floats  # (n,) G(q)
    r: Floats  # (m,) mm, 0 first
    g: Floats  # (m,) 1/mm^2
    error_estimate: float  # of G, absolute

    def gain_at(self, q: Floats | float) -> Floats:
        """Give G at q in cycles/mm, any shape; 0 past the end of the table."""
        place = np.log(np.clip(q, self.q[1], self.q[-1]))
        value = CubicSpline(np.log(self.q[1:]), self.gain[1:])(place)
        return np.asarray(np.where(np.asarray(q) > self.q[-1], 0.0, value))


def solve(stack: Stack, model: Model = "layered") -> Kernel:
    """Solve a cover; PhysicsError where it cannot be."""
    if model != "layered":
        raise PhysicsError(f"cover model is {model!r}: give 'fem' or 'layered'")
    q = _frequencies(stack)
    gain = layered.gain(stack, q)
    r, g = radial(q, gain)
    return Kernel(stack, model, q, gain, r, g, layered.ROUNDING)


def _frequencies(stack: Stack) -> Floats:
    """Give q (cycles/mm) over all that a stack's gain does, 0 first, 64 a decade."""
    wide = np.logspace(-7, 3, 321) / stack.faces[-1]
    gain = layered.gain(stack, wide)
    first = np.flatnonzero(np.abs(1 - gain) > NOTHING)[0]
    last = np.flatnonzero(np.abs(gain) > NOTHING)[-1]
    ends = wide[max(first - 1, 0)], wide[min(last + 1, len(wide) - 1)]
    return np.concatenate([[0.0], np.geomspace(*ends, int(64 * np.log10(ends[1] / ends[0])) + 2)])


def radial(q: Floats, gain: Floats) -> tuple[Floats, Floats]:
    """Give r (mm) and g (1/mm^2) of a gain (n,) on q (n,): g = 2 pi integral of G J0(2 pi q r) q dq (FFTLog)."""
    spline = CubicSpline(np.log(q[1:]), gain[1:])
    wide = np.geomspace(q[1] * 1e-9, q[-1] * 1e3, 4096)
    step = float(np.log(wide[1] / wide[0]))
    value = np.where(wide > q[-1], 0.0, spline(np.log(np.clip(wide, q[1], q[-1]))))
    offset = fhtoffset(step, mu=0.0)
    g = 2 * np.pi * fht(value * wide, step, mu=0.0, offset=offset)
    k = np.exp(offset) / wide[::-1]
    g = g / k
    r = k / (2 * np.pi)
    keep = (r > 0.02 / q[-1]) & (r < 0.1 / q[1])
    peak = 2 * np.pi * np.trapezoid(value * wide**2, dx=step)
    return np.concatenate([[0.0], r[keep]]), np.concatenate([[peak], g[keep]])
