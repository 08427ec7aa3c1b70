"""Point loads as an image of cells, and its standard deviation."""

from math import pi, sqrt
from typing import NamedTuple

import numpy as np
from scipy.special import erf

from tactiled.restore.modes import Floats

MIN_PLACE_ERROR = 0.05  # pitches: no place is known better than that
MODEL_ERROR = 0.01  # of the frame's norm: what a model of a cover may miss it by

_Shares = tuple[Floats, Floats, Floats]  # (n, cells) of each point along an axis, their slopes and curvatures


class PointLoads(NamedTuple):
    """Loads that a frame supports, in pitches and kPa square pitches."""

    places: Floats  # (n, 2)
    force: Floats
    spread: Floats  # (n, 2): deviation of where a load's force is, and of the load itself
    variance: Floats  # (n, 3) of force and place
    width: float  # variance of the square of what all loads' spread has in common
    noise: float  # share of these variances that is the noise's


class PointImage:
    """Draws loads on a surface of `refine` cells a pitch; `image` is valid until the next."""

    def __init__(self, shape: tuple[int, ...], refine: int, noise: float) -> None:
        self._refine, self._noise = refine, noise
        self.image = np.empty(shape, np.float32)
        self.noise_gain = 0.0
        self._loads: PointLoads
        self._down: _Shares
        self._across: _Shares

    def __call__(self, loads: PointLoads) -> None:
        """Spread each point's force over the cells that it may be on, in proportion to how likely it is there."""
        middles, spread = (loads.places + 0.5) * self._refine, loads.spread * self._refine
        self._loads = loads
        self._down, self._across = (
            _share(n, middles[:, axis], spread[:, axis]) for axis, n in enumerate(self.image.shape)
        )
        self.image[...] = (loads.force[:, None] * self._refine**2 * self._down[0]).T @ self._across[0]
        self.noise_gain = self._gain()

    def _gain(self) -> float:
        """Give the image's noise over the frame's: it moves forces, places and width, and they the image."""
        loads, moves = self._loads, (self._refine * self._loads.force) ** 2
        rows, slopes_down, _ = ((each**2).sum(axis=1) for each in self._down)
        columns, slopes_across, _ = ((each**2).sum(axis=1) for each in self._across)
        moved = np.stack([rows * columns, moves * slopes_down * columns, moves * rows * slopes_across])
        half = 0.5 * self._refine**2 * loads.force[:, None]  # a spread's square diffuses what it spreads
        wider = (half * self._down[2]).T @ self._across[0] + self._down[0].T @ (half * self._across[2])
        variance = float((loads.variance.T * moved).sum()) + loads.width * float((wider**2).sum())
        return self._refine**2 * sqrt(loads.noise * variance / self.image.size) / self._noise

    def deviation(self) -> Floats:
        """Standard deviation (kPa) of every cell of the image last drawn, by the fit.

        Of force and place, the latter known to MIN_PLACE_ERROR at best, of the model, and of a load's shape: a
        share p of it that a cell is given may be out by p (1 - p).
        """
        loads, (rows, slopes_down, _), (columns, slopes_across, _) = self._loads, self._down, self._across
        force, squares = loads.force[:, None] ** 2, rows**2
        down, across = (force * self._refine**2 * np.maximum(loads.variance[:, 1:], MIN_PLACE_ERROR**2)).T[
            ..., None
        ]
        share = squares.T @ ((loads.variance[:, :1] + (1 + MODEL_ERROR**2) * force) * columns**2)
        shape = (rows**4).T @ (force * columns**4) - 2 * (rows**3).T @ (force * columns**3)
        place = (slopes_down**2).T @ (down * columns**2) + squares.T @ (across * slopes_across**2)
        return np.asarray(self._refine**2 * np.sqrt(np.maximum(share + shape + place, 0)))


def _share(n: int, middle: Floats, sigma: Floats) -> _Shares:
    """How likely values of those means and deviations lie in each of n cells, all in one; and how that changes."""
    distance = (np.arange(n + 1.0) - middle[:, None]) / (sqrt(2) * sigma[:, None])
    below = 0.5 * (1 + erf(distance))
    slope = np.exp(-(distance**2)) / (sqrt(2 * pi) * sigma[:, None])
    below[:, 0], below[:, -1] = 0, 1
    slope[:, 0] = slope[:, -1] = 0
    return np.diff(below), -np.diff(slope), -np.diff(slope * distance * sqrt(2) / sigma[:, None])
