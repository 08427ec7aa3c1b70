"""The tangential load on a surface, from tangential readings and the image of the pressure on it.

Where nothing presses nothing drags, and what drags does so about alike over a contact. So the load is the pressure
p of the image times a smooth field of random friction, t = p m, and the image may be wrong by d, smooth and in
proportion to it. Taxels feel both in both kinds of reading, as the cover couples them: the mean of t given the
readings, by Gaussian process regression on t and d together, is one linear system. How large friction is, from
none on, the readings tell, too: the mean at each size is weighted by how likely they are under it, as errors of
the model look like a little friction where there is none.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from tactiled.arrays import Floats

FRICTION = 0.35  # tangential load along an axis over pressure, standard deviation, at most
SIZES = (0.0, 0.1, 0.3, 1.0)  # of friction: parts of its variance that are tried
UNLIKELY = 0.01  # probability of a size, from which on it counts
SHARES, ALIKE_PITCHES = (0.5, 0.35, 0.15), (np.inf, 4.0, 1.0)  # of its variance, and pitches that they go on for
WRONG, FAINT, WRONG_PITCHES = 0.45, 0.05, 0.7  # of the image, of its peak; pitches that this goes on for
MODEL_ERROR = 0.05  # of the largest reading: the cover's model
PRESSED = 0.02  # of the image's peak: fainter pressure drags nothing


class Coupled(NamedTuple):
    """What N taxels feel of M cells of a surface (R, C): pressure, then what is along x, then along y."""

    felt: Floats  # (3 N, 3 M)
    cells: Floats  # (M, 2), pitches
    shape: tuple[int, int]
    own: tuple[slice, ...]  # the array's part of the surface
    wide: bool = True  # enough for what a load adds to the pressure to be told from what pressure does


class Load(NamedTuple):
    """A tangential load on the array's cells, along x and y (2, R, C)."""

    traction: NDArray[np.float32]  # kPa
    deviation: NDArray[np.float32]  # kPa, its standard deviation
    pressure: Floats  # (N,) kPa that it adds to what the taxels read


class Traction:
    """Restores tangential loads of one array."""

    def __init__(self, coupled: Coupled) -> None:
        self.coupled = coupled
        apart = ((coupled.cells[:, None] - coupled.cells) ** 2).sum(axis=-1)
        alike = zip(SHARES, ALIKE_PITCHES, strict=True)
        self._friction = FRICTION**2 * sum(share * np.exp(-apart / (2 * pitches**2)) for share, pitches in alike)
        self._wrong = WRONG**2 * np.exp(-apart / (2 * WRONG_PITCHES**2))

    def __call__(self, image: NDArray[Any], readings: Floats, noise: Floats) -> Load:
        """Restore the load under an image (R, C) of the pressure, in kPa, from readings (3, N), NaN where unknown.

        `noise` (3,) is the standard deviation of a reading of each kind. An image of the array alone is taken to
        have no pressure around it.
        """
        felt, cells, shape, own, _ = self.coupled
        size, p = len(cells), np.zeros(shape)
        p[own if image.shape != shape else ...] = image
        p = np.maximum(p.ravel(), 0)
        traction, spread = np.zeros((2, size)), np.zeros((2, size))
        there, known = p > PRESSED * p.max(), np.isfinite(readings).ravel()
        if there.any() and known.any():
            at = np.flatnonzero(there)
            largest = np.nanmax(np.abs(readings), axis=1, initial=0.0)
            variance = np.repeat(noise**2 + (MODEL_ERROR * largest) ** 2, readings.shape[1])[known]
            left = readings.ravel()[known] - felt[known][:, :size] @ p
            A = felt[known][:, np.concatenate([at, at + size, at + 2 * size])]
            traction[:, at], spread[:, at] = self._estimate(at, p[at], A, left, variance)
        spread = np.hypot(spread, FRICTION * noise[0])
        added = felt[: readings.shape[1], size:] @ traction.ravel()
        traction, spread = (each.reshape(2, *shape)[:, *own] for each in (traction, spread))
        return Load(traction.astype(np.float32), spread.astype(np.float32), added)

    def _estimate(
        self, at: NDArray[np.intp], load: Floats, A: Floats, left: Floats, variance: Floats
    ) -> tuple[Floats, Floats]:
        """Mean and standard deviation (2, m) of the traction of cells `at` (m,) under pressure `load` (m,).

        `left` (n,) is what the pressure does not explain of the readings, `variance` (n,) of their noise, and A
        (n, 3 m) what they feel of those cells.
        """
        square, spoiled = np.ix_(at, at), load + FAINT * load.max()
        friction = self._friction[square] * np.outer(load, load)
        wrong = self._wrong[square] * np.outer(spoiled, spoiled)
        of_pressure, *of_traction = np.split(A, 3, axis=1)
        felt_wrong = wrong @ of_pressure.T  # (m, n) covariance of loads and readings, likewise
        felt_friction = np.concatenate([friction @ each.T for each in of_traction])
        base, more = of_pressure @ felt_wrong + np.diag(variance), np.hstack(of_traction) @ felt_friction
        factors = [np.linalg.cholesky(base + size * more) for size in SIZES]
        white = [solve_triangular(L, left, lower=True, check_finite=False) for L in factors]
        fits = [-each @ each / 2 - np.log(L.diagonal()).sum() for each, L in zip(white, factors, strict=True)]
        odds = np.exp(np.array(fits) - max(fits))
        mean, square_mean = np.zeros((2, len(at))), np.zeros((2, len(at)))
        for size, L, each, share in zip(SIZES, factors, white, odds / odds.sum(), strict=True):
            if share < UNLIKELY or not size:
                continue
            seen = solve_triangular(
                L, np.concatenate([felt_wrong, size * felt_friction]).T, lower=True, check_finite=False
            )
            found = (each @ seen).reshape(3, -1)[1:]
            before = np.concatenate([wrong.diagonal(), *[size * friction.diagonal()] * 2])
            left_over = np.maximum(before - (seen**2).sum(axis=0), 0).reshape(3, -1)
            spread = left_over[1:] + left_over[0] * (found / load) ** 2  # what drags is the pressure
            mean += share * found
            square_mean += share * (spread + found**2)
        return mean, np.sqrt(np.maximum(square_mean - mean**2, 0))
