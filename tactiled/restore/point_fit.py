"""Point loads fitted to a frame y by Gauss-Newton steps: min |y - sum f_i r(x_i)|^2 over places x, forces f."""

from typing import NamedTuple

import numpy as np

from tactiled.core import points
from tactiled.restore.modes import Floats, Image
from tactiled.restore.point_response import PointResponse

# All chosen on the scenes of `python -m tests.bench judge --family first`.
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

    def __init__(self, response: PointResponse, noise: float) -> None:
        self._response, self._noise = response, noise
        rows, columns = self.shape = response.shape
        self.jacobian = np.empty((4 * MAX_POINTS, rows * columns), np.float32)
        self.residual = np.empty(rows * columns, np.float32)

    def __call__(self, y: Image, places: Floats) -> tuple[int, Fit | None]:
        """Give the steps made from `places` (n, 2), and the fit that they led to.

        Loads of too little force are left out; one that is of so little at the last places ends the fit without a
        result.
        """
        for done in range(1, MAX_STEPS + 1):
            n, places = len(places), self._response.tabulated(places)
            J, found = self.jacobian[: 3 * n], np.empty((4, n))
            self._response.jacobian(places, J.reshape(3, n, -1))
            points.step(np.asarray(J @ J.T, float), np.asarray(J @ y, float), RIDGE, found)
            force, shown, moves = found[0], found[1], found[2:].T
            clear = force * shown > FORCE_SIGMAS * self._noise
            if not clear.any():
                break
            if not clear.all():
                places = places[clear]
            elif done == MAX_STEPS or np.abs(moves).max() < SETTLED:
                return done, self._finished(y, places, force)
            else:
                places = self.within(places + moves.clip(-MAX_STEP, MAX_STEP))
        return done, None

    def _finished(self, y: Image, places: Floats, force: Floats) -> Fit:
        """Give the fit at the last places, with what widths would do."""
        n = len(force)
        self._response.jacobian(places, self.jacobian[3 * n : 4 * n].reshape(1, n, -1), first=3)
        np.subtract(y, force.astype(np.float32) @ self.jacobian[:n], out=self.residual)
        residual = float(self.residual.dot(self.residual))
        J, scale = self.jacobian[: 4 * n], np.concatenate([np.ones(n), force, force, force])
        normal, right = scale[:, None] * scale * (J @ J.T), scale * (J @ self.residual)
        return Fit(places, force, scale, residual, ridged(normal), right)

    def within(self, places: Floats) -> Floats:
        """Give places no further out than half a pitch from the taxels."""
        rows, columns = self.shape
        return places.clip(-0.5, (rows - 0.5, columns - 0.5))


def ridged(normal: Floats) -> Floats:
    """Normal equations that can be solved, whatever the frame tells apart."""
    firm = normal.copy()
    firm.flat[:: len(normal) + 1] *= 1 + RIDGE
    return firm
