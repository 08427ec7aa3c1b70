"""The cover as a blur: its gain G(q), and g(r) as G's inverse Hankel transform; cached on disk by content."""

import os
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Literal
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray
from scipy.fft import fht, fhtoffset
from scipy.interpolate import CubicSpline

from tactiled.cover import layered
from tactiled.cover.stack import Profile, Stack
from tactiled.errors import PhysicsError
from tactiled.files import whole

if TYPE_CHECKING:
    from tactiled.cover import fem

Floats = NDArray[np.float64]
Model = Literal["fem", "layered"]

FORMAT = 1  # of a cached kernel; another number makes older files strangers
TABLE = 512  # frequencies of a tabulated gain
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
    clock: Callable[[], float] = lambda: 0.0,
    budget_s: float = np.inf,
) -> Kernel:
    """Solve a cover to `accuracy` of its gain; PhysicsError where it cannot be in `budget_s` by `clock` (s)."""
    if model == "layered":
        if profile is not None:
            raise PhysicsError("model 'layered' knows flat layers only: use 'fem' for a cover with a profile")
        q = _frequencies(stack)
        gain = layered.gain(stack, q)
        return Kernel(stack, model, q, gain, *radial(q, gain), error_estimate=layered.ROUNDING)
    if model != "fem":
        raise PhysicsError(f"cover model is {model!r}: give 'fem' or 'layered'")
    from tactiled.cover import fem  # scikit-fem, which a cached kernel does not need

    start = clock()
    found = fem.solve(stack, accuracy, profile, late=lambda: clock() - start > budget_s)
    q, gain = _continued(found)
    return Kernel(
        stack, model, q, gain, *radial(q, gain), found.error_estimate, found.mesh, found.unknowns, profile
    )


def cached(
    stack: Stack,
    model: Model = "fem",
    accuracy: float = 1e-3,
    profile: Profile | None = None,
    folder: Path | None = None,
) -> Kernel:
    """Give what `solve` gives, from `folder` (by default the user's cache) where it is already there."""
    key = sha256(repr((FORMAT, stack, model, accuracy, profile)).encode()).hexdigest()
    path = (folder or cache_folder()) / f"{key}.npz"
    # A cache that cannot be read, whatever is wrong with it, is no reason to stop: the cover is solved again.
    with suppress(OSError, ValueError, KeyError, EOFError, BadZipFile), np.load(path) as stored:
        columns, rows, unknowns = (int(number) for number in stored["mesh"])
        q, gain, r, g = (np.asarray(stored[name]) for name in ("q", "gain", "r", "g"))
        return Kernel(
            stack, model, q, gain, r, g, float(stored["error_estimate"]), (columns, rows), unknowns, profile
        )
    kernel = solve(stack, model, accuracy, profile)
    with suppress(OSError):
        _store(kernel, path)
    return kernel


def _store(kernel: Kernel, path: Path) -> None:
    """Write a kernel, of which no reader ever meets half a file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole(path, replace=True) as part, part.open("wb") as file:
        np.savez(
            file,
            **{name: getattr(kernel, name) for name in ("q", "gain", "r", "g", "error_estimate")},
            mesh=np.array([*kernel.mesh, kernel.unknowns]),
        )


def cache_folder() -> Path:
    """Give the folder for solved covers in the user's cache."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "tactiled"


def _continued(found: "fem.Solution") -> tuple[Floats, Floats]:
    """Tabulate the elements' gain evenly in log q, and let it die away past the end as it did before it."""
    from tactiled.cover import fem

    value = fem.interpolant(found.q, found.gain)
    last = float(found.q[np.flatnonzero(np.abs(found.gain) >= fem.FLOOR)[-1]])
    before, at = value(np.array([0.8 * last, last]))
    fall = max(float(np.log(max(before / at, 1.0))) / (0.2 * last), 1 / last)
    q = np.geomspace(1e-3 * found.q[1], last + np.log(fem.FLOOR / NOTHING) / fall, TABLE)
    tail = at * np.exp(-fall * np.maximum(q - last, 0))
    gain = np.where(q > last, tail, value(np.minimum(q, last)))
    return np.concatenate([[0.0], q]), np.concatenate([[1.0], gain])


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
