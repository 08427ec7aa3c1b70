"""Point loads fitted to a frame y by damped Gauss-Newton: min |y - sum f_i r(x_i)|^2 over places x, forces f."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from tactiled.restore.modes import Floats, Image
from tactiled.restore.point_response import PointResponse

# All chosen on the scenes of `python -m tests.study judge --family first`.
MAX_POINTS = 8
MAX_STEPS = 12  # for one number of points
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
    normal: Floats  # of n times force, row and column, then n times width down, across and both
    right: Floats

    def isotropic(self) -> tuple[Floats, Floats]:
        """Give normal and right of n times force, row, column and a width that is the same down and across."""
        n = len(self.force)
        alike = np.eye(6 * n)[:, : 4 * n]
        alike[4 * n : 5 * n, 3 * n :] = np.eye(n)
        return ridged(alike.T @ self.normal @ alike), self.right @ alike

    def step(self, damping: float) -> Floats:
        """Give the move (n, 2) of the points; the damping also holds those whose response is flat about them."""
        n = len(self.force)
        damped = self.normal[: 3 * n, : 3 * n].copy()
        stiff = np.tile(damped.diagonal()[:n], 3)
        stiff[:n] *= RIDGE
        stiff[n:] *= damping * np.tile(self.force**2, 2)
        damped.flat[:: 3 * n + 1] += stiff
        return np.asarray(np.linalg.solve(damped, self.right[: 3 * n])[n:].reshape(2, n).T, float)

    def widths(self) -> tuple[Floats, Floats]:
        """Give each load's own widths (3, n), down, across and both, and their covariance for a noise of 1."""
        n = len(self.force)
        inverse = np.linalg.inv(ridged(self.normal))[3 * n :]
        covariance = np.asarray(inverse[:, 3 * n :], float)
        return np.asarray(inverse @ self.right).reshape(3, n), covariance.reshape(3, n, 3, n)


class Fitter:
    """Fits loads to frames (R, C) of a `noise` (kPa); `jacobian` and `residual` are those of the last fit."""

    def __init__(self, response: PointResponse, noise: float, cut: Callable[[], bool]) -> None:
        """Fits end without a result where `cut` says so; `places` are those that were tried last."""
        self._response, self._noise, self._cut = response, noise, cut
        self.places = np.empty((0, 2))
        rows, columns = self.shape = response.shape
        self.jacobian = np.empty((6 * MAX_POINTS, rows * columns), np.float32)
        self.residual = np.empty(rows * columns, np.float32)

    def __call__(self, y: Image, places: Floats, model: float) -> tuple[int, Fit | None]:
        """Give the steps made from `places` (n, 2) and the fit that they led to.

        `model` is what the response itself may miss of the frame's square (kPa^2).
        """
        variance = self._noise**2
        damping, fit = INITIAL_DAMPING, None
        done = 0
        while done < MAX_STEPS:
            self.places = places
            if self._cut():
                return done, None
            done += 1
            A = self._responses(places)
            gram = np.asarray(A[0] @ A[0].T, float)
            force = np.asarray(np.linalg.solve(ridged(gram), np.asarray(A[0] @ y, float)), float)
            clear = force > FORCE_SIGMAS * self._noise / np.sqrt(gram.diagonal())
            if not clear.all():
                fit, places = None, places[clear]
                if not len(places):
                    break
                continue
            residual = self._subtract(y, force)
            if fit is None or residual <= fit.residual:
                J, scale = A.reshape(6 * len(force), -1), np.concatenate([np.ones_like(force), *[force] * 5])
                normal, right = scale[:, None] * scale * (J @ J.T), scale * (J @ self.residual)
                gain = fit.residual - residual if fit else np.inf
                fit = Fit(places, force, residual, normal, right)
                damping *= DAMPING_FACTOR
                if gain < MIN_GAIN * (variance + model / y.size):
                    break
                slow = done >= EARLY_STEPS and gain < MIN_PROGRESS * residual
                if slow and residual > HOPELESS * (variance * y.size + model):
                    return done, fit
            else:
                damping /= DAMPING_FACTOR**2
            step = fit.step(damping)
            if np.abs(step).max() < SETTLED:
                break
            places = self.within(fit.places + np.clip(step, -MAX_STEP, MAX_STEP))
        if fit is not None and residual > fit.residual:
            self._responses(fit.places)
            self._subtract(y, fit.force)
        return done, fit

    def within(self, places: Floats) -> Floats:
        """Give places no further out than half a pitch from the taxels."""
        rows, columns = self.shape
        return np.clip(places, -0.5, (rows - 0.5, columns - 0.5))

    def _responses(self, places: Floats) -> Image:
        n = len(places)
        A = self.jacobian[: 6 * n].reshape(6, n, -1)
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
