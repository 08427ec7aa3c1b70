"""The cover as a blur: its gain G(q), and g(r) as G's inverse Hankel transform; cached on disk by content."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
from scipy.fft import fht, fhtoffset
from scipy.interpolate import CubicSpline

from tactiled.arrays import Floats
from tactiled.cover import layered
from tactiled.cover.cache import Report, cached_table
from tactiled.cover.stack import Profile, Stack
from tactiled.errors import PhysicsError

if TYPE_CHECKING:
    from tactiled.cover import fem

Model = Literal["fem", "layered", "measured"]

TABLE_SIZE = 512  # frequencies of a tabulated gain
NEGLIGIBLE = 1e-9  # a gain that is as good as 0, and a loss of gain that is as good as none


@dataclass(frozen=True, slots=True, eq=False)
class Kernel:
    """A solved cover: the normal stress at the sensing plane is g convolved with the surface pressure."""

    stack: Stack
    model: Model
    q: Floats  # (n,) cycles/mm, 0 first, then even in its logarithm up to where the gain is as good as 0
    gain: Floats  # (n,) G(q)
    r: Floats  # (m,) mm, 0 first
    g: Floats  # (m,) 1/mm^2
    error_estimate: float  # of G, absolute, wherever G is 1e-3 or more
    mesh: tuple[int, int] = (0, 0)  # elements along r and along z
    unknowns: int = 0
    profile: Profile | None = None

    def gain_at(self, q: Floats | float) -> Floats:
        """Give G at q in cycles/mm, any shape; 0 past the end of the table."""
        place = np.log(np.clip(q, self.q[1], self.q[-1]))
        value = CubicSpline(np.log(self.q[1:]), self.gain[1:])(place)
        return np.asarray(np.where(np.asarray(q) > self.q[-1], 0.0, value))


def solve(
    stack: Stack,
    model: Model = "fem",
    accuracy: float = 1e-3,
    profile: Profile | None = None,
    late: Callable[[], bool] = lambda: False,
) -> Kernel:
    """Solve a cover to `accuracy` of its gain; PhysicsError where it cannot be, or `late` says that time is up."""
    if model == "layered":
        if profile is not None:
            raise PhysicsError("model 'layered' knows flat layers only: use 'fem' for a cover with a profile")
        q = frequencies(stack)
        gain = layered.gain(stack, q)
        return Kernel(stack, model, q, gain, *radial(q, gain), error_estimate=layered.MAX_ROUNDING)
    if model != "fem":
        raise PhysicsError(f"cover model is {model!r}: give 'fem' or 'layered'")
    from tactiled.cover import fem  # scikit-fem, which a cached kernel does not need

    solved = fem.solve(stack, accuracy, profile, late)
    q, gain = _continued(solved)
    return Kernel(
        stack, model, q, gain, *radial(q, gain), solved.error_estimate, solved.mesh, solved.unknowns, profile
    )


def cached(
    stack: Stack,
    model: Model = "fem",
    accuracy: float = 1e-3,
    profile: Profile | None = None,
    folder: Path | None = None,
    report: Report = lambda _: None,
    solving: Callable[[], object] = lambda: None,
) -> Kernel:
    """Give what `solve` gives, from `folder` (by default the user's cache) where it is already there.

    `report` gets a line on a cache that cannot be read or written; `solving` is called where it is not there.
    """
    inputs = version("tactiled"), stack, model, accuracy, profile

    def make() -> Floats:
        solving()
        return _numbers(solve(*inputs[1:]))

    numbers = cached_table(folder, inputs, make, report, "kernel")
    return _kernel(stack, model, profile, numbers.tobytes())


@lru_cache(maxsize=64)  # arrays under one cover share what is made of it
def _kernel(stack: Stack, model: Model, profile: Profile | None, stored: bytes) -> Kernel:
    numbers = np.frombuffer(stored)
    n, m, error, columns, rows, unknowns = numbers[:6]
    q, gain, r, g, _ = np.split(numbers[6:], np.cumsum([int(n), int(n), int(m), int(m)]))
    return Kernel(stack, model, q, gain, r, g, float(error), (int(columns), int(rows)), int(unknowns), profile)


def _numbers(kernel: Kernel) -> Floats:
    """Give all the numbers of a kernel as one column (n, 1)."""
    head = len(kernel.q), len(kernel.r), kernel.error_estimate, *kernel.mesh, kernel.unknowns
    return np.concatenate([head, kernel.q, kernel.gain, kernel.r, kernel.g])[:, None]


def _continued(solved: "fem.Solution") -> tuple[Floats, Floats]:
    """Tabulate the elements' gain evenly in log q, and let it die away past the end as it did before it."""
    from tactiled.cover import fem

    value = fem.interpolant(solved.q, solved.gain)
    last = float(solved.q[np.flatnonzero(np.abs(solved.gain) >= fem.FLOOR)[-1]])
    before, at = value(np.array([0.8 * last, last]))
    fall = max(float(np.log(max(before / at, 1.0))) / (0.2 * last), 1 / last)
    q = np.geomspace(1e-3 * solved.q[1], last + np.log(fem.FLOOR / NEGLIGIBLE) / fall, TABLE_SIZE)
    tail = at * np.exp(-fall * np.maximum(q - last, 0))
    gain = np.where(q > last, tail, value(np.minimum(q, last)))
    return np.concatenate([[0.0], q]), np.concatenate([[1.0], gain])


def frequencies(stack: Stack) -> Floats:
    """Give q (cycles/mm) over all that a stack's gain does, 0 first, 64 a decade."""
    wide = np.logspace(-7, 3, 321) / stack.faces[-1]
    gain = layered.gain(stack, wide)
    first = np.flatnonzero(np.abs(1 - gain) > NEGLIGIBLE)[0]
    last = np.flatnonzero(np.abs(gain) > NEGLIGIBLE)[-1]
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
