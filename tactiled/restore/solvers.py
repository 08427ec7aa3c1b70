"""Iterations that take callables and know neither rubber nor transforms."""

from collections.abc import Callable

import numpy as np

from tactiled.restore.modes import Image

Map = Callable[[Image], Image]


def conjugate_gradients(A: Map, b: Image, max_iterations: int, tolerance: float = 1e-3) -> Image:
    """Minimise x'Ax / 2 - b'x for symmetric positive A, until |b - A x| is down to `tolerance` of |b|."""
    x, r = np.zeros_like(b), b.copy()
    p, rr = r.copy(), float(r @ r)
    enough = tolerance**2 * rr
    for _ in range(max_iterations):
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
    max_iterations: int,
    residual: float = 0.0,
    accelerate: bool = False,
) -> int:
    """Minimise sum(H x - y log H x) over x >= 0 (in place): x <- x H'(y / H x) / H'1; `weight` is 1 / H'1.

    Gives the iterations made: stops once the mean square of y - H x is down to `residual`, before it fits the
    noise. Accelerated after Biggs and Andrews: along the last step, by the correlation of the last two.
    """
    ratio, floor = np.empty_like(y), np.float32(1e-6 * max(float(y.max()), 1e-30))
    momentum = _Momentum(x) if accelerate else None
    for done in range(max_iterations):
        if momentum is not None:
            momentum.extrapolate(x)
        Hx = np.maximum(forward(x), floor)
        np.subtract(y, Hx, out=ratio)
        if residual and float(np.vdot(ratio, ratio)) <= residual * y.size:
            return done
        np.divide(y, Hx, out=ratio)
        correction = adjoint(ratio)
        np.multiply(correction, weight, out=correction)
        np.maximum(correction, 0, out=correction)
        np.multiply(x, correction, out=x)
        if momentum is not None:
            momentum.update(x)
    return max_iterations


class _Momentum:
    """How far to extrapolate along the last step."""

    def __init__(self, x: Image) -> None:
        self._start, self._last = x.copy(), x.copy()
        self._step, self._before = np.zeros_like(x), np.zeros_like(x)
        self._factor = 0.0

    def extrapolate(self, x: Image) -> None:
        """Move x (in place) on along its last step, never below 0."""
        np.subtract(x, self._last, out=self._start)
        self._last[...] = x
        np.multiply(self._start, np.float32(self._factor), out=self._start)
        np.add(x, self._start, out=x)
        np.maximum(x, 0, out=x)
        self._start[...] = x

    def update(self, x: Image) -> None:
        """Learn the factor from the step just made."""
        np.subtract(x, self._start, out=self._step)
        norm = float(np.vdot(self._before, self._before))
        self._factor = min(max(float(np.vdot(self._step, self._before)) / norm, 0.0), 1.0) if norm else 0.0
        self._step, self._before = self._before, self._step
