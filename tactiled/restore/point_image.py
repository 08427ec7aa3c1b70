"""Point loads as an image of cells, and its standard deviation."""

from math import pi, sqrt
from typing import NamedTuple

import numpy as np
from scipy.special import ndtr

from tactiled.arrays import Floats

MIN_PLACE_ERROR = 0.05  # pitches: no place is known better than that
FAR = 1e9  # cells, for infinity, at which a density times its distance would be NaN
MODEL_ERROR = 0.01  # of the frame's norm: what a model of a cover may miss it by


class PointLoads(NamedTuple):
    """Loads that a frame supports, in pitches and kPa square pitches."""

    places: Floats  # (n, 2)
    force: Floats
    spread: Floats  # (n, 2): deviation of where a load's force is, and of the load itself
    variance: Floats  # (n, 3) of force and place
    width: float  # variance of the square of what all loads' spread has in common
    noise: float  # share of these variances that is the noise's

    def margin(self, shape: tuple[int, ...]) -> float:
        """Give the least distance (pitches) of a load to the outermost of R x C taxels; negative beyond them."""
        return float(np.minimum(self.places, np.array(shape) - 1 - self.places).min())


class PointImage:
    """Draws loads on a surface of `refine` cells a pitch; `image` is valid until the next."""

    def __init__(self, shape: tuple[int, ...], refine: int, noise: float) -> None:
        self._refine, self._noise = refine, noise
        self.image = np.empty(shape, np.float32)
        rows, columns = shape
        self._edges = np.concatenate([np.arange(rows + 1.0), np.arange(columns + 1.0)])
        self._edges[[0, rows, rows + 1, -1]] = -FAR, FAR, -FAR, FAR  # what lies outside is in the last cells
        self._axis = np.repeat([0, 1], [rows + 1, columns + 1])
        self._rows, self._columns = slice(rows), slice(rows + 1, None)  # steps between edges of the same axis
        self._loads: PointLoads
        self._shares: Floats  # (3, n, edges - 1): of each load in either axis' cells, their slopes and curvatures

    def __call__(self, loads: PointLoads) -> None:
        """Spread each point's force over the cells that it may be on, in proportion to how likely it is there."""
        sigma = loads.spread[:, self._axis] * self._refine
        z = (self._edges - (loads.places[:, self._axis] + 0.5) * self._refine) / sigma
        density = np.exp(-0.5 * z * z) / (-sqrt(2 * pi) * sigma)
        self._loads, self._shares = loads, np.diff(np.stack([ndtr(z), density, density * z / sigma]))
        share = self._shares[0]
        force = loads.force[:, None] * self._refine**2
        np.matmul((force * share[:, self._rows]).T, share[:, self._columns], out=self.image, casting="same_kind")

    @property
    def noise_gain(self) -> float:
        """Noise of the image over the frame's: it moves forces, places and width, and they the image.

        A width that is narrow for its error has slopes that go on for less than that error: what it moves is no
        more than what shares p of a load may be out by, p (1 - p), as in `deviation`.
        """
        loads, k, squares = self._loads, self._refine, self._shares[:2] ** 2
        down, across = squares[..., self._rows].sum(axis=-1), squares[..., self._columns].sum(axis=-1)
        force, row, column = loads.variance.T
        moves = (k * loads.force) ** 2
        moved = force * down[0] * across[0] + moves * (row * down[1] * across[0] + column * down[0] * across[1])
        half = 0.5 * k**2 * loads.force[:, None]  # a spread's square diffuses what it spreads
        rows, columns = self._shares[..., self._rows], self._shares[..., self._columns]
        wider = (half * rows[2]).T @ columns[0] + (half * rows[0]).T @ columns[2]
        widened = loads.noise * loads.width * float(np.vdot(wider, wider))
        powers = [(rows[0] ** n).sum(axis=-1) * (columns[0] ** n).sum(axis=-1) for n in (2, 3, 4)]
        widened = min(widened, float(loads.force**2 @ (powers[0] - 2 * powers[1] + powers[2])))
        return k**2 * sqrt((loads.noise * float(moved.sum()) + widened) / self.image.size) / self._noise

    def deviation(self) -> Floats:
        """Standard deviation (kPa) of every cell of the image last drawn, by the fit.

        Of force and place, the latter known to MIN_PLACE_ERROR at best, of the model, and of a load's shape: a
        share p of it that a cell is given may be out by p (1 - p).
        """
        loads, squares = self._loads, self._shares[:2] ** 2
        rows, row_slopes = squares[..., self._rows]
        columns, column_slopes = squares[..., self._columns]
        force = loads.force[:, None] ** 2
        places = force * self._refine**2 * np.maximum(loads.variance[:, 1:], MIN_PLACE_ERROR**2)
        share = rows.T @ ((loads.variance[:, :1] + (1 + MODEL_ERROR**2) * force) * columns)
        shape = (rows**2).T @ (force * columns**2) - 2 * (rows**1.5).T @ (force * columns**1.5)
        place = row_slopes.T @ (places[:, :1] * columns) + rows.T @ (places[:, 1:] * column_slopes)
        return np.asarray(self._refine**2 * np.sqrt(np.maximum(share + shape + place, 0)))
