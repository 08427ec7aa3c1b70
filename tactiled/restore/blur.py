"""The blur as an operator from surface cells to taxels: planned once, float32, no allocation when it is applied.

A grid's blur is even in both directions, so that a real Fourier basis diagonalises it: four small matrix products
and one multiplication, which at these sizes beats a fast Fourier transform. The basis is taken at the places of
cells and of taxels, on a period so long that what wraps round is negligible: pressure outside the array is zero.
Any other layout is a matrix.
"""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Doubles = NDArray[np.float64]
Floats = NDArray[np.float32]
WRAPPED = 1e-3  # share of the stencil that may wrap round


class Operator(Protocol):
    """A planned linear map."""

    def __call__(self, values: Floats, out: Floats) -> Floats:
        """Apply the map to `values` into `out`, which is returned."""


class Blur(Protocol):
    """What every blur offers."""

    taxels: tuple[int, ...]  # shape of a frame
    cells: tuple[int, ...]  # shape of a surface
    cell_mm: float  # side of a surface cell
    forward: Operator  # cells -> taxels, H
    adjoint: Operator  # taxels -> cells, H'

    def tikhonov(self, weight: float) -> Operator:
        """Taxels -> cells: the x that minimises |H x - y|^2 + weight |x|^2."""

    def kept(self, weight: float) -> float:
        """Share of the taxels' degrees of freedom that `tikhonov` lets through, 0 to 1."""

    def noise_gain(self, weight: float) -> float:
        """Standard deviation of a cell that `tikhonov` makes of white noise of 1 on the taxels."""


class Diagonal:
    """A map that multiplies by a spectrum in one basis along rows and one along columns."""

    def __init__(self, into: tuple[Floats, Floats], spectrum: Doubles, out: tuple[Floats, Floats]) -> None:
        self._rows, self._columns = into[0], np.ascontiguousarray(into[1].T)
        self._rows_out, self._columns_out = np.ascontiguousarray(out[0].T), out[1]
        self._spectrum = np.ascontiguousarray(spectrum, np.float32)
        self._half = np.empty((len(into[0]), into[1].shape[1]), np.float32)
        self._full = np.empty(spectrum.shape, np.float32)
        self._back = np.empty((out[0].shape[1], len(out[1])), np.float32)

    def __call__(self, values: Floats, out: Floats) -> Floats:
        """Apply the map to `values` into `out`, which is returned."""
        np.dot(self._rows, values, out=self._half)
        np.dot(self._half, self._columns, out=self._full)
        np.multiply(self._full, self._spectrum, out=self._full)
        np.dot(self._rows_out, self._full, out=self._back)
        return np.dot(self._back, self._columns_out, out=out)


class Grid:
    """Taxels on a grid under cells `refine` times finer, from the stencil that `cover.operator.stencil` gives."""

    def __init__(self, stencil: Doubles, shape: tuple[int, int], refine: int, cell_mm: float) -> None:
        self.taxels, self.cell_mm = shape, cell_mm
        self.cells = (refine * shape[0], refine * shape[1])
        periods = [_period(np.abs(stencil).sum(axis=1 - axis), n, refine) for axis, n in enumerate(shape)]
        waves = [_waves(period * refine) for period in periods]
        response = _response(stencil, [period * refine for period in periods])
        power = (response**2).reshape(refine, periods[0], refine, periods[1]).mean(axis=(0, 2))
        self._spectrum = response[np.ix_(*waves)]
        self._power = power[np.ix_(*(wave % period for wave, period in zip(waves, periods, strict=True)))]
        self._taxels = [
            _basis((np.arange(n) - (n - 1) / 2) * refine, p * refine) for n, p in zip(shape, periods, strict=True)
        ]
        self._cells = [
            _basis(np.arange(n) - (n - 1) / 2, p * refine) for n, p in zip(self.cells, periods, strict=True)
        ]
        self.forward: Operator = self._map(self._cells, self._spectrum, self._taxels)
        self.adjoint: Operator = self._map(self._taxels, self._spectrum, self._cells)
        self._refine, self._waves = refine, periods[0] * periods[1] * refine**2

    @staticmethod
    def _map(into: list[Floats], spectrum: Doubles, out: list[Floats]) -> Diagonal:
        return Diagonal((into[0], into[1]), spectrum, (out[0], out[1]))

    def tikhonov(self, weight: float) -> Operator:
        """Taxels -> cells: H' (H H' + weight)^-1, on the period."""
        return self._map(self._taxels, self._spectrum / (self._power + weight), self._cells)

    def kept(self, weight: float) -> float:
        """Share of the taxels' degrees of freedom that `tikhonov` lets through, 0 to 1."""
        return float(np.sum(self._spectrum**2 / (self._power + weight))) / self._waves

    def noise_gain(self, weight: float) -> float:
        """Standard deviation of a cell that `tikhonov` makes of white noise of 1 on the taxels."""
        gains = self._spectrum / (self._power + weight)
        return float(np.sqrt(np.sum(gains**2) / self._waves)) / self._refine


class Layout:
    """Taxels anywhere, from the matrix (N, M) that `cover.operator.matrix` gives."""

    def __init__(self, matrix: Doubles, cell_mm: float) -> None:
        self.cell_mm = cell_mm
        self.taxels, self.cells = (len(matrix),), (matrix.shape[1],)
        self._left, self._values, self._right = np.linalg.svd(matrix, full_matrices=False)
        self.forward: Operator = _product(matrix)
        self.adjoint: Operator = _product(matrix.T)

    def tikhonov(self, weight: float) -> Operator:
        """Taxels -> cells: H' (H H' + weight)^-1, by singular values."""
        return _product(self._right.T * (self._values / (self._values**2 + weight)) @ self._left.T)

    def kept(self, weight: float) -> float:
        """Share of the taxels' degrees of freedom that `tikhonov` lets through, 0 to 1."""
        return float(np.sum(self._values**2 / (self._values**2 + weight))) / self.taxels[0]

    def noise_gain(self, weight: float) -> float:
        """Standard deviation of a cell that `tikhonov` makes of white noise of 1 on the taxels."""
        gains = self._values / (self._values**2 + weight)
        return float(np.sqrt(np.sum(gains**2) / self.cells[0]))


def _product(matrix: Doubles) -> Operator:
    held = np.ascontiguousarray(matrix, np.float32)
    return lambda values, out: np.dot(held, values, out=out)


def _period(profile: Doubles, taxels: int, refine: int) -> int:
    """Odd period, in pitches, on which a stencil's share past half of it is at most WRAPPED."""
    middle = (len(profile) - 1) / 2
    away = np.abs(np.arange(len(profile)) - middle) / refine
    longest = 2 * taxels - 1
    for period in range(taxels | 1, longest, 2):
        if profile[away > period - taxels].sum() <= WRAPPED * profile.sum():
            return period
    return longest


def _waves(period: int) -> NDArray[np.intp]:
    """Wave numbers of a real basis on a period: the constant, cosines, sines (the one at period/2 is always 0)."""
    count = np.arange(1, (period - 1) // 2 + 1)
    return np.concatenate([[0], count, count])


def _basis(places: NDArray[np.floating], period: int) -> Floats:
    """Orthonormal real Fourier basis (waves, places) on a period, at places in cells."""
    phase = 2 * np.pi / period * np.outer(np.arange(1, (period - 1) // 2 + 1), places)
    constant = np.full((1, len(places)), 0.5**0.5)
    waves = np.concatenate([constant, np.cos(phase), np.sin(phase)])
    return np.asarray((2 / period) ** 0.5 * waves, np.float32)


def _response(stencil: Doubles, periods: list[int]) -> Doubles:
    """Gain of every pair of waves 0 ... period - 1 of an even stencil."""
    offsets = (np.arange(n) - (n - 1) / 2 for n in stencil.shape)
    rows, columns = (
        np.cos(2 * np.pi / period * np.outer(np.arange(period), at))
        for period, at in zip(periods, offsets, strict=True)
    )
    return np.asarray(rows @ stencil @ columns.T)
