"""Point loads fitted to a frame y by damped Gauss-Newton: min |y - sum f_i r(x_i)|^2 over places x, forces f."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from tactiled.restore.modes import Floats, Image
from tactiled.restore.point_response import PointResponse

# All chosen on the scenes of `python -m tests.study judge --family first`.
MAX_POINTS = 8
EARLY_STEPS = 3  # after which a step that takes off less than
MIN_PROGRESS = 0.2  # of the residual's square, while that is
HOPELESS = 4.0  # times what noise leaves, is the last
INITIAL_DAMPING = 0.03  # of a point's response, per square pitch
DAMPING_FACTOR = 0.3  # times the damping after a step that helped
MIN_GAIN = 2.0  # of the noise's variance: a step that takes less off the residual's square is the last
SETTLED = 0.01  # pitches: a step that moves no point further is the last
MAX_STEP = 0.5  # pitches that one step may move a point
FORCE_SIGMAS = 4.0  # standard deviations that a point's force must stand out by
RIDGE = 1e-6  # on every square, so that what no frame can tell apart is only very uncertain


class Fit(NamedTuple):
    """Loads and the normal equations about them."""

    places: Floats  # (n, 2), pitches
    force: Floats
    residual: float  # of the frame, squared
    normal: Floats  # of n times force, row, column and width
    right: Floats


class _Step(NamedTuple):
    """Loads on the way to a fit, and the products of their frames and slopes."""

    places: Floats  # (n, 2), pitches
    force: Floats
    residual: float  # of the frame, squared
    gram: Floats  # (3 n, 3 n) of unit frames, and their slopes down and across
    right: Floats  # (3 n,) of these and the residual

    def move(self, damping: float) -> Floats:
        """Give the move (n, 2) of the loads; the damping also holds those whose response is flat about them."""
        n = len(self.force)
        scale = np.concatenate([np.ones(n), self.force, self.force])
        damped = scale[:, None] * scale * self.gram
        stiff = np.tile(damped.diagonal()[:n], 3)
        stiff[:n] *= RIDGE
        stiff[n:] *= damping * scale[n:] ** 2
        damped.flat[:: 3 * n + 1] += stiff
        return np.asarray(np.linalg.solve(damped, scale * self.right)[n:].reshape(2, n).T, float)


class Fitter:
    """Fits loads to frames (R, C) of a `noise` (kPa); `jacobian` and `residual` are those of the last fit."""

    def __init__(self, response: PointResponse, noise: float, cut: Callable[[], bool]) -> None:
        """Fits end without a result where `cut` says so; `places` are those that were tried last."""
        self._response, self._noise, self._cut = response, noise, cut
        self.places = np.empty((0, 2))
        rows, columns = self.shape = response.shape
        self.jacobian = np.empty((4 * MAX_POINTS, rows * columns), np.float32)
        self.residual = np.empty(rows * columns, np.float32)

    def __call__(self, y: Image, places: Floats, model: float, steps: int) -> tuple[int, Fit | None]:
        """Give the steps made from `places` (n, 2), at most `steps`, and the fit that they led to.

        `model` is what the response itself may miss of the frame's square (kPa^2).
        """
        variance = self._noise**2
        damping, best = INITIAL_DAMPING, None
        done = 0
        while done < steps:
            self.places = places
            if self._cut():
                return done, None
            done += 1
            n = len(places)
            A = self._responses(places)
            J = A.reshape(3 * n, -1)
            gram = np.asarray(J @ J.T, float)
            along = np.asarray(J @ y, float)
            force = np.asarray(np.linalg.solve(ridged(gram[:n, :n]), along[:n]), float)
            clear = force > FORCE_SIGMAS * self._noise / np.sqrt(gram.diagonal()[:n])
            if not clear.all():
                best, places = None, places[clear]
                if not len(places):
                    break
                continue
            residual = self._subtract(y, force)
            if best is None or residual <= best.residual:
                gain = best.residual - residual if best else np.inf
                best = _Step(places, force, residual, gram, along - gram[:, :n] @ force)
                damping *= DAMPING_FACTOR
                if gain < MIN_GAIN * (variance + model / y.size):
                    break
                slow = done >= EARLY_STEPS and gain < MIN_PROGRESS * residual
                if slow and residual > HOPELESS * (variance * y.size + model):
                    break
            else:
                damping /= DAMPING_FACTOR**2
            step = best.move(damping)
            if np.abs(step).max() < SETTLED:
                break
            places = self.within(best.places + np.clip(step, -MAX_STEP, MAX_STEP))
        return done, self._finished(y, best) if best else None

    def _finished(self, y: Image, best: "_Step") -> Fit:
        """Give the fit of the best step, with what widths would do."""
        n = len(best.force)
        if best.places is not self.places:  # a step after it was tried and was worse
            self._responses(best.places)
            self._subtract(y, best.force)
        self._response.jacobian(best.places, self.jacobian[3 * n : 4 * n].reshape(1, n, -1), first=3)
        J, scale = self.jacobian[: 4 * n], np.concatenate([np.ones_like(best.force), *[best.force] * 3])
        normal, right = scale[:, None] * scale * (J @ J.T), scale * (J @ self.residual)
        return Fit(best.places, best.force, best.residual, ridged(normal), right)

    def within(self, places: Floats) -> Floats:
        """Give places no further out than half a pitch from the taxels."""
        rows, columns = self.shape
        return np.clip(places, -0.5, (rows - 0.5, columns - 0.5))

    def _responses(self, places: Floats) -> Image:
        n = len(places)
        A = self.jacobian[: 3 * n].reshape(3, n, -1)
        self._response.jacobian(places, A)
        return A

    def _subtract(self, y: Image, force: Floats) -> float:
        """Put in place what remains of a frame, the loads' last responses taken off; gives its square."""
        responses = self.jacobian[: len(force)].reshape(-1, y.size)
        np.subtract(y, force.astype(np.float32) @ responses, out=self.residual)
        return float(self.residual.dot(self.residual))


def ridged(normal: Floats) -> Floats:
    """Normal equations that can be solved, whatever the frame tells apart."""
    firm = normal.copy()
    firm.flat[:: len(normal) + 1] *= 1 + RIDGE
    return firm
