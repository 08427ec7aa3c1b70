"""The tangential load on a surface, from tangential readings and the image of the pressure on it.

Where nothing presses nothing drags, and what drags does so about alike over a contact. So the load is the pressure
p of the image times a smooth field of random friction, t = p m, and the image may be wrong by d, smooth and in
proportion to it. Taxels feel both in both kinds of reading, as the cover couples them: the mean of t given the
readings, by Gaussian process regression on t and d together, is one linear system. How large friction is, from
none on, the readings tell, too: the mean at each size is weighted by how likely they are under it, as errors of
the model look like a little friction where there is none.
"""

from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from tactiled.arrays import Floats, Floats32, Ints
from tactiled.restore.noise import IMPLAUSIBLE_KPA

FRICTION = 0.35  # tangential load along an axis over pressure, standard deviation, at most
SIZES = (0.0, 0.1, 0.3, 1.0)  # of friction: parts of its variance that are tried
UNLIKELY = 0.01  # probability of a size, from which on it counts
SHARES, ALIKE_PITCHES = (0.5, 0.35, 0.15), (np.inf, 4.0, 1.0)  # of its variance, and pitches that they go on for
WRONG, FAINT, WRONG_PITCHES = 0.45, 0.05, 0.7  # of the image, of its peak; pitches that this goes on for
MODEL_ERROR = 0.05  # of the largest reading: the cover's model
PRESSED = 0.02  # of the image's peak: fainter pressure drags nothing
HEARD = 0.02  # of the most that loads as large as the pressure leave on a reading: with less it tells nothing
ADDED_SIGMAS = 0.25  # of a reading's noise: what a load adds to the pressure, and is less, changes no image


class Coupled(NamedTuple):
    """What N taxels feel of M cells of a surface (R, C): pressure, then what is along x, then along y."""

    felt: Floats  # (3 N, 3 M)
    cells: Floats  # (M, 2), pitches
    shape: tuple[int, int]
    own: tuple[slice, ...]  # the array's part of the surface
    wide: bool = True  # enough for what a load adds to the pressure to be told from what pressure does


class Traction:
    """Restores tangential loads of one array."""

    def __init__(self, coupled: Coupled) -> None:
        self.coupled, self._felt = coupled, np.asarray(coupled.felt, np.float32)
        apart = ((coupled.cells[:, None] - coupled.cells) ** 2).sum(axis=-1)
        alike = zip(SHARES, ALIKE_PITCHES, strict=True)
        friction = sum(share * np.exp(-apart / (2 * pitches**2)) for share, pitches in alike)
        self._friction = np.asarray(FRICTION**2 * friction, np.float32)
        self._wrong = np.asarray(WRONG**2 * np.exp(-apart / (2 * WRONG_PITCHES**2)), np.float32)

    def __call__(self, image: NDArray[Any], readings: Floats, noise: Floats) -> "Load":
        """Restore the load under an image (R, C) of the pressure, in kPa, from readings (3, N), NaN where unknown.

        `noise` (3,) is the standard deviation of a reading of each kind. An image of the array alone is taken to
        have no pressure around it.
        """
        felt, (_, cells, shape, own, _) = self._felt, self.coupled
        readings = np.where(np.abs(readings) < IMPLAUSIBLE_KPA, readings, np.nan)
        taxels, size, p = readings.shape[1], len(cells), np.zeros(shape, np.float32)
        p[own if image.shape != shape else ...] = image
        p = np.maximum(p.ravel(), 0)
        at = np.flatnonzero(p > PRESSED * p.max())
        A = felt[:, np.concatenate([at, at + size, at + 2 * size])]
        strength = np.abs(A) @ np.tile(p[at], 3)
        known = np.isfinite(readings).ravel() & (strength > HEARD * strength.max())
        if not known.any():
            return Load(self.coupled, noise[0], np.zeros(taxels))
        largest = np.nanmax(np.abs(readings), axis=1, initial=0.0)
        variance = np.repeat(noise**2 + (MODEL_ERROR * largest) ** 2, taxels)[known]
        left = np.asarray(readings.ravel()[known] - felt[known][:, :size] @ p, np.float32)
        try:
            estimate = _Estimate(
                p[at], A[known], left, variance, self._friction[at][:, at], self._wrong[at][:, at]
            )
        except np.linalg.LinAlgError:  # values so small that their squares vanish
            return Load(self.coupled, noise[0], np.zeros(taxels))
        added = (A[:taxels, len(at) :] @ estimate.mean.ravel()).astype(float)
        return Load(self.coupled, noise[0], added, at, estimate)


class _Size(NamedTuple):
    """What follows where friction is of one of SIZES."""

    share: float  # how likely it is
    size: np.float32
    factor: Floats32  # (n, n) lower, of the readings' covariance
    mean: Floats32  # (2, m) kPa


class _Estimate:
    """The traction of m cells under `load` (m,), the pressure on them.

    `left` (n,) is what the pressure does not explain of the readings, `variance` (n,) of their noise, and
    A (n, 3 m) what they feel of those cells. `friction` and `wrong` (m, m) are covariances, over the load.
    """

    def __init__(
        self, load: Floats32, A: Floats32, left: Floats32, variance: Floats, friction: Floats32, wrong: Floats32
    ) -> None:
        self._load, self._spoiled = load, load + np.float32(FAINT) * load.max()
        of_pressure, *of_traction = np.split(A, 3, axis=1)
        of_pressure, *of_traction = of_pressure * self._spoiled, *(each * load for each in of_traction)
        # Covariances (n, m) of readings and cells, these over their loads.
        self._felt_wrong, self._felt_friction = of_pressure @ wrong, [each @ friction for each in of_traction]
        self._before = wrong[0, 0], friction[0, 0]
        base = self._felt_wrong @ of_pressure.T
        more = sum(seen @ each.T for seen, each in zip(self._felt_friction, of_traction, strict=True))
        rounding = len(left) * np.finfo(np.float32).eps * float((base + more).diagonal().max())
        base[np.diag_indices(len(left))] += (variance + rounding).astype(np.float32)
        self._likely: list[_Size] = []
        fits = [self._fit(base + np.float32(size) * more, left) for size in SIZES]
        odds = np.exp([each[0] - max(fit for fit, *_ in fits) for each in fits])
        self.mean = np.zeros((2, len(load)), np.float32)  # kPa
        for share, size, (_, factor, weight) in zip(odds / odds.sum(), SIZES, fits, strict=True):
            if share >= UNLIKELY and size:
                found = np.float32(size) * load * np.stack([weight @ each for each in self._felt_friction])
                self.mean += np.float32(share) * found
                self._likely.append(_Size(share, np.float32(size), factor, found))

    @staticmethod
    def _fit(K: Floats32, left: Floats32) -> tuple[float, Floats32, Floats32]:
        """Logarithm of how likely `left` (n,) of covariance K (n, n) is; Cholesky's lower factor; K^-1 left."""
        factor, failed = lapack.spotrf(K, lower=1)
        if failed:
            raise np.linalg.LinAlgError("the readings' covariance is not positive definite")
        weight, _ = lapack.spotrs(factor, left, lower=1)
        return -float(left @ weight) / 2 - float(np.log(factor.diagonal()).sum()), factor, weight

    def deviation(self) -> Floats32:
        """Standard deviation (2, m), kPa."""
        variance = -(self.mean**2)
        (wrong, friction), load, spoiled = self._before, self._load, self._spoiled
        for share, size, factor, found in self._likely:
            covariance = np.hstack([self._felt_wrong, *(size * each for each in self._felt_friction)])
            seen, _ = lapack.strtrs(factor, covariance, lower=1)
            told = np.einsum("ij,ij->j", seen, seen).reshape(3, -1)
            of_pressure = np.maximum(wrong - told[0], 0) * spoiled**2
            own = np.maximum(size * friction - told[1:], 0) * load**2
            variance += share * (own + of_pressure * (found / load) ** 2 + found**2)  # what drags is the pressure
        return np.sqrt(np.maximum(variance, 0))


class Load:
    """A tangential load on an array's cells, along x and y; its deviation is computed where it is asked for."""

    def __init__(
        self,
        coupled: Coupled,
        noise: float,
        pressure: Floats,
        at: Ints | None = None,
        estimate: _Estimate | None = None,
    ) -> None:
        """An `estimate` of cells `at` (m,) of the surface, None: there is no load; `noise` of a pressure (kPa)."""
        self._coupled, self._noise, self._at, self._estimate = coupled, noise, at, estimate
        self.pressure = pressure  # (N,) kPa that it adds to what the taxels read

    @property
    def matters(self) -> bool:
        """Whether it adds more to a reading than noise hides."""
        return bool(np.abs(self.pressure).max() > ADDED_SIGMAS * self._noise)

    @cached_property
    def traction(self) -> Floats32:
        """The load (2, R, C), kPa."""
        return self._on_array(self._estimate.mean if self._estimate else None)

    @cached_property
    def deviation(self) -> Floats32:
        """Its standard deviation (2, R, C), kPa."""
        spread = self._on_array(self._estimate.deviation() if self._estimate else None)
        return np.asarray(np.hypot(spread, FRICTION * self._noise), np.float32)

    def _on_array(self, values: Floats32 | None) -> Floats32:
        """Values (2, m) of the cells that were estimated, on the array's own (2, R, C); 0 of others."""
        whole = np.zeros((2, *self._coupled.shape), np.float32)
        if values is not None:
            whole.reshape(2, -1)[:, self._at] = values
        return whole[:, *self._coupled.own]
