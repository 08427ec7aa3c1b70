"""Point loads fitted to a frame y by Gauss-Newton steps: min |y - sum f_i r(x_i)|^2 over places x, forces f."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from tactiled.restore.modes import Floats, Image
from tactiled.restore.point_response import PointResponse

# All chosen on the scenes of `python -m tests.study judge --family first`.
MAX_POINTS = 7
MAX_STEPS = 3  # places that are tried: those read off an image, and two moves on; the last step is a linear one
SETTLED = 0.05  # pitches: a smaller step is left to the linear one
MAX_STEP = 0.5  # pitches that one step may move a load
FORCE_SIGMAS = 4.0  # standard deviations that a load's force must stand out by
RIDGE = 1e-6  # on every square, so that what no frame can tell apart is only very uncertain


class Fit(NamedTuple):
    """Loads and the normal equations about them."""

    places: Floats  # (n, 2), pitches
    force: Floats
    scale: Floats  # (4 n,) of the unknowns: n times force, row, column and width
    residual: float  # of the frame, squared
    normal: Floats  # of the unknowns
    right: Floats


class Fitter:
    """Fits loads to frames (R, C) of a `noise` (kPa); `jacobian` and `residual` are those of the last fit."""

    def __init__(self, response: PointResponse, noise: float, cut: Callable[[], bool]) -> None:
        """Fits end without a result where `cut` says so; `places` are then those to go on from."""
        self._response, self._noise, self._cut = response, noise, cut
        self.places = np.empty((0, 2))
        rows, columns = self.shape = response.shape
        self.jacobian = np.empty((4 * MAX_POINTS, rows * columns), np.float32)
        self.residual = np.empty(rows * columns, np.float32)

    def __call__(self, y: Image, places: Floats) -> tuple[int, Fit | None]:
        """Give the steps made from `places` (n, 2), and the fit that they led to.

        Loads of too little force are left out; one that is of so little at the last places ends the fit without a
        result.
        """
        done, self.places = 0, places
        while not self._cut():
            done += 1
            n = len(self.places)
            J = self.jacobian[: 3 * n]
            self.places = self._response.tabulated(self.places)
            self._response.jacobian(self.places, J.reshape(3, n, -1))
            if self._cut():
                break
            gram, along = np.asarray(J @ J.T, float), np.asarray(J @ y, float)
            force = np.asarray(np.linalg.solve(ridged(gram[:n, :n]), along[:n]), float)
            clear = force > FORCE_SIGMAS * self._noise / np.sqrt(gram.diagonal()[:n])
            if not clear.all():
                self.places = self.places[clear]
                if done == MAX_STEPS or not len(self.places):
                    break
                continue
            if done == MAX_STEPS:
                return done, self._finished(y, force)
            if self._cut():
                break
            change = np.linalg.solve(ridged(gram), along - gram[:, :n] @ force)
            step = (change[n:].reshape(2, n) / force).T
            if np.abs(step).max() < SETTLED:
                return done, self._finished(y, force)
            self.places = self.within(self.places + step.clip(-MAX_STEP, MAX_STEP))
        return done, None

    def _finished(self, y: Image, force: Floats) -> Fit | None:
        """Give the fit at the last places, with what widths would do, unless it is cut."""
        if self._cut():
            return None
        n = len(force)
        self._response.jacobian(self.places, self.jacobian[3 * n : 4 * n].reshape(1, n, -1), first=3)
        np.subtract(y, force.astype(np.float32) @ self.jacobian[:n], out=self.residual)
        residual = float(self.residual.dot(self.residual))
        J, scale = self.jacobian[: 4 * n], np.concatenate([np.ones(n), force, force, force])
        normal, right = scale[:, None] * scale * (J @ J.T), scale * (J @ self.residual)
        return Fit(self.places, force, scale, residual, ridged(normal), right)

    def within(self, places: Floats) -> Floats:
        """Give places no further out than half a pitch from the taxels."""
        rows, columns = self.shape
        return places.clip(-0.5, (rows - 0.5, columns - 0.5))


def ridged(normal: Floats) -> Floats:
    """Normal equations that can be solved, whatever the frame tells apart."""
    firm = normal.copy()
    firm.flat[:: len(normal) + 1] *= 1 + RIDGE
    return firm
