"""Pressure under a grid from its frames: weighted non-negative least squares on cells finer than the taxels."""

import numpy as np
from scipy import fft

from tactiled.arrays import Floats, Floats32
from tactiled.cover.family import CoverFamily
from tactiled.cover.operator import aperture_mean
from tactiled.geometry import Array

Images = Floats32

REFINE = 2  # cells along a taxel's side: with one, a sharp edge between two cells looks like a thinner cover's
MARGIN = 2  # taxels that the surface reaches past the array
REACH = 3.0  # thicknesses, past which a cover's response is as good as 0
MIN_REACH = 6  # taxels
ROUNDING = 1.05  # curvatures are taken this little too high, so that steps stay stable
MIN_CURVATURE = 1e-3  # of a frame's largest: cells that no taxel feels stay where they are


class Convolution:
    """H from cells of pressure to taxels, by Fourier transforms; both take a leading axis of frames."""

    def __init__(self, family: CoverFamily, factor: float, array: Array) -> None:
        """For a cover `factor` times as thick as configured; `array` is a grid."""
        assert array.shape is not None, "only grids are convolutions"
        side, k = array.pitch / REFINE, REFINE
        pad = MARGIN + max(MIN_REACH, int(REACH * factor * family.configured.depth / array.pitch))
        self.cells = tuple((n + 2 * MARGIN) * k for n in array.shape)
        self._padded = tuple(fft.next_fast_len((n + pad) * k, real=True) for n in array.shape)
        u, v = fft.fftfreq(self._padded[0], side)[:, None], fft.rfftfreq(self._padded[1], side)
        response = np.zeros((u.size, v.size), complex)
        for alias in np.ndindex(3, 3):
            U, V = (q + (n - 1) / side for q, n in zip((u, v), alias, strict=True))
            footprint = np.sinc(U * side) * np.sinc(V * side) * aperture_mean(array, U, V)
            offset = np.exp(1j * np.pi * (U + V) * (k - 1) * side)  # from a taxel's first cell to its middle
            response += family.gain(np.hypot(U, V), factor) * footprint * offset
        self._response, self._adjoint = response.astype(np.complex64), response.conj().astype(np.complex64)
        self._taxels = tuple(slice(MARGIN * k, (MARGIN + n) * k, k) for n in array.shape)

    def forward(self, x: Images) -> Images:
        """H x: (T, cells) -> (T, taxels)."""
        blurred = fft.irfft2(fft.rfft2(x, self._padded) * self._response, self._padded)
        return np.asarray(blurred[:, *self._taxels])

    def adjoint(self, y: Images) -> Images:
        """H' y: (T, taxels) -> (T, cells)."""
        spread = np.zeros((len(y), *self._padded), np.float32)
        spread[:, *self._taxels] = y
        rows, columns = self.cells
        return np.asarray(fft.irfft2(fft.rfft2(spread) * self._adjoint, self._padded)[:, :rows, :columns])


class Precision:
    """Inverse covariance of frames' errors: each taxel's own, and what a row, a column or a whole frame shares."""

    def __init__(self, weight: Images, shared: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> None:
        """For `weight` (T, *taxels), 1 over own variances, and variances `shared` by rows, columns, all taxels."""
        self.weight = weight
        rows, columns = weight.shape[1:]
        scale = np.sqrt(np.repeat(shared, (rows, columns, 1))).astype(np.float32)
        self._inverse: Images | None = None
        if scale.any():  # Woodbury's identity, for the indicators of rows, columns and all
            gram = np.zeros((len(weight), len(scale), len(scale)), np.float32)
            for n, taxels in enumerate(_indicators(rows, columns)):
                gram[:, n] = self._sums(weight * taxels)
            inner = np.eye(len(scale), dtype=np.float32) + scale[:, None] * gram * scale
            self._inverse = np.asarray(scale[:, None] * np.linalg.inv(inner) * scale)

    def __call__(self, residual: Images) -> Images:
        """Residuals (T, *taxels) times the inverse covariance."""
        weighted = self.weight * residual
        if self._inverse is None:
            return weighted
        part = np.einsum("tij,tj->ti", self._inverse, self._sums(weighted))
        rows, columns = self.weight.shape[1:]
        common = part[:, :rows, None] + part[:, None, rows : rows + columns] + part[:, -1:, None]
        return np.asarray(weighted - self.weight * common)

    def square(self, residual: Images) -> Floats:
        """Chi-squared (T,) of residuals."""
        return np.asarray((residual * self(residual)).sum(axis=(1, 2), dtype=float))

    @staticmethod
    def _sums(values: Images) -> Images:
        """Sums (T, R + C + 1) over each row, each column and everything."""
        rows, columns = values.sum(axis=2), values.sum(axis=1)
        return np.concatenate([rows, columns, rows.sum(axis=1, keepdims=True)], axis=1)


def _indicators(rows: int, columns: int) -> Images:
    """Taxels (R + C + 1, R, C) of each row, each column, and all."""
    result = np.zeros((rows + columns + 1, rows, columns), np.float32)
    result[np.arange(rows), np.arange(rows)] = 1
    result[rows + np.arange(columns), :, np.arange(columns)] = 1
    result[-1] = 1
    return result


def deblurred(blur: Convolution, y: Images, precision: Precision, start: Images, iterations: int) -> Images:
    """Pressure x >= 0 (T, cells) that lowers chi-squared of H x - y, from a start.

    Nesterov's accelerated projected gradients, started again where they point uphill (O'Donoghue, Candes 2015).
    Each cell's step is that of a separable surrogate, H' W H 1 (De Pierro 1995): under a peak, whose weights are
    low, it is hundreds of times longer than one step for all cells.
    """
    x, ahead, t = start, start, 1.0
    curvature = blur.adjoint(precision.weight * blur.forward(np.ones((1, *blur.cells), np.float32)))
    curvature = ROUNDING * np.maximum(curvature, MIN_CURVATURE * curvature.max(axis=(1, 2), keepdims=True))
    for _ in range(iterations):
        gradient = blur.adjoint(precision(blur.forward(ahead) - y))
        after = np.maximum(ahead - gradient / curvature, np.float32(0))
        if np.vdot(curvature * (ahead - after), after - x) > 0:
            t = 1.0
        later = (1 + np.sqrt(1 + 4 * t**2)) / 2
        x, ahead, t = after, after + np.float32((t - 1) / later) * (after - x), later
    return x
