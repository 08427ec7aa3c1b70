"""Iterations that take callables and know neither rubber nor transforms."""

from collections.abc import Callable

import numpy as np

from tactiled.restore.modes import Image

Map = Callable[[Image], Image]


def conjugate_gradients(A: Map, b: Image, rounds: int, accuracy: float = 1e-3) -> Image:
    """Solve A x = b for symmetric positive A; stops at `accuracy` of |b| or after `rounds`."""
    x, r = np.zeros_like(b), b.copy()
    p, rr = r.copy(), float(r @ r)
    enough = accuracy**2 * rr
    for _ in range(rounds):
        if rr <= enough:
            break
        Ap = A(p)
        step = rr / float(p @ Ap)
        x += step * p
        r -= step * Ap
        rr, before = float(r @ r), rr
        p = r + (rr / before) * p
    return x


def richardson_lucy(
    forward: Map,
    adjoint: Map,
    y: Image,
    x: Image,
    weight: Image,
    iterations: int,
    enough: float = 0.0,
    accelerate: bool = False,
) -> int:
    """Multiply x (in place) by H'(y / H x) / H'1 up to `iterations` times; `weight` is 1 / H'1; gives how many.

    Stops once the mean square of y - H x is down to `enough`, before it fits the noise. Accelerated by Biggs
    and Andrews: extrapolates along the last step by the correlation of the last two.
    """
    ratio, floor = np.empty_like(y), np.float32(1e-6 * max(float(y.max()), 1e-30))
    pace = _Pace(x) if accelerate else None
    for done in range(iterations):
        if pace is not None:
            pace.leap(x)
        Hx = np.maximum(forward(x), floor)
        np.subtract(y, Hx, out=ratio)
        if enough and float(np.vdot(ratio, ratio)) <= enough * y.size:
            return done
        np.divide(y, Hx, out=ratio)
        correction = adjoint(ratio)
        np.multiply(correction, weight, out=correction)
        np.maximum(correction, 0, out=correction)
        np.multiply(x, correction, out=x)
        if pace is not None:
            pace.land(x)
    return iterations


class _Pace:
    """How far to extrapolate along the last step."""

    def __init__(self, x: Image) -> None:
        self._start, self._last = x.copy(), x.copy()
        self._step, self._before = np.zeros_like(x), np.zeros_like(x)
        self._factor = 0.0

    def leap(self, x: Image) -> None:
        """Move x (in place) on along its last step, never below 0."""
        np.subtract(x, self._last, out=self._start)
        self._last[...] = x
        np.multiply(self._start, np.float32(self._factor), out=self._start)
        np.add(x, self._start, out=x)
        np.maximum(x, 0, out=x)
        self._start[...] = x

    def land(self, x: Image) -> None:
        """Learn the factor from the step just made."""
        np.subtract(x, self._start, out=self._step)
        norm = float(np.vdot(self._before, self._before))
        self._factor = min(max(float(np.vdot(self._step, self._before)) / norm, 0.0), 1.0) if norm else 0.0
        self._step, self._before = self._before, self._step
