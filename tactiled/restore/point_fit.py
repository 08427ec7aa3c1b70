"""Point loads fitted to a frame y by Gauss-Newton steps: min |y - sum f_i r(x_i)|^2 over places x, forces f."""

from typing import NamedTuple

import numpy as np

from tactiled.arrays import Floats, Floats32
from tactiled.core import points
from tactiled.restore.point_response import PointResponse

# All chosen on the scenes of `python -m tests.bench judge --family first`.
MAX_POINTS = 7
MAX_STEPS = 3  # places that are tried: those read off an image, and two moves on; the last step is a linear one
SETTLED = 0.05  # pitches: a smaller step is left to the linear one
MAX_STEP = 0.5  # pitches that one step may move a load
FORCE_SIGMAS = 4.0  # standard deviations that a load's force must stand out by
RIDGE = 1e-6  # on every square, so that what no frame can tell apart is only very uncertain
OWN_WIDTH, OWN_SHARE = 0.03, 0.4  # square pitches, and of the common width: what a load's own may differ by


class Fit(NamedTuple):
    """Loads (n,) at their last places, and what a linear last step from there changes."""

    steps: int
    places: Floats  # (n, 2), pitches
    force: Floats  # kPa square pitches
    change: Floats  # of the forces
    shift: Floats  # (n, 2) of the places
    width: Floats  # square pitches: each load's own, a variance along any axis
    variance: Floats  # (n, 3) of force and place for a noise of 1
    own: Floats  # square pitches: widths held near no other
    own_variance: Floats  # of these, for a noise of 1
    common_width: float  # square pitches
    common_variance: float  # of that, for a noise of 1
    left: Floats32  # (N,) of the frame, valid until the next fit


class Fitter:
    """Fits loads to frames (R, C) of a `noise` (kPa)."""

    def __init__(self, response: PointResponse, noise: float) -> None:
        self._response, self.shape = response, response.shape
        self._variance = noise**2
        limits = FORCE_SIGMAS * noise, SETTLED, MAX_STEP, RIDGE, OWN_WIDTH, OWN_SHARE
        self._limits = np.array(limits)
        rows, columns = response.shape
        self._jacobian = np.empty((4 * MAX_POINTS, rows * columns), np.float32)
        self._left = np.empty(rows * columns, np.float32)

    def __call__(self, y: Floats32, places: Floats) -> Fit | None:
        """Give the fit that `places` (n, 2) lead to.

        Loads of too little force are left out; None where one is of so little at the last places.
        """
        at, found = np.empty((MAX_POINTS, 2)), np.empty((10, MAX_POINTS))
        at[: len(places)] = places
        tables = self._response.down, self._response.across
        steps, n, width, variance = points.fit(
            *tables, y, at, len(places), self._variance, MAX_STEPS, self._limits, self._jacobian, self._left, found
        )
        if not n:
            return None
        force, change, _, _, own_width, own, own_variance = found[:7, :n]
        others = found[2:4, :n].T, np.maximum(own_width, 0), found[7:, :n].T, own, own_variance
        return Fit(steps, at[:n], force, change, *others, width, variance, self._left)

    def within(self, places: Floats) -> Floats:
        """Give places no further out than half a pitch from the taxels."""
        rows, columns = self.shape
        return places.clip(-0.5, (rows - 0.5, columns - 0.5))
