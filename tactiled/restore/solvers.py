"""Iterations that take callables and know neither rubber nor transforms."""

from collections.abc import Callable

import numpy as np

from tactiled.arrays import Floats32

Map = Callable[[Floats32], Floats32]


def conjugate_gradients(A: Map, b: Floats32, max_iterations: int, tolerance: float = 1e-3) -> Floats32:
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
    y: Floats32,
    x: Floats32,
    weight: Floats32,
    max_iterations: int,
    residual: float = 0.0,
) -> int:
    """Minimise sum(H x - y log H x) over x >= 0 (in place): x <- x H'(y / H x) / H'1; `weight` is 1 / H'1.

    Gives the iterations made: stops once the mean square of y - H x is down to `residual`, before it fits the
    noise.
    """
    ratio, floor = np.empty_like(y), np.float32(1e-6 * max(float(y.max()), 1e-30))
    for done in range(max_iterations):
        Hx = np.maximum(forward(x), floor)
        np.subtract(y, Hx, out=ratio)
        if residual and float(np.vdot(ratio, ratio)) <= residual * y.size:
            return done
        np.divide(y, Hx, out=ratio)
        correction = adjoint(ratio)
        np.multiply(correction, weight, out=correction)
        np.maximum(correction, 0, out=correction)
        np.multiply(x, correction, out=x)
    return max_iterations
