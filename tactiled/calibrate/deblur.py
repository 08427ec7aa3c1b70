"""Pressure under a grid from its frames: weighted non-negative least squares on cells finer than the taxels."""

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from tactiled.cover.family import CoverFamily
from tactiled.cover.operator import aperture_mean
from tactiled.geometry import Array

Images = NDArray[np.float32]

REFINE = 2  # cells along a taxel's side: with one, a sharp edge between two cells looks like a thinner cover's
MARGIN = 2  # taxels that the surface reaches past the array
REACH = 3.0  # thicknesses, past which a cover's response is as good as 0
MIN_REACH = 6  # taxels
ROUNDING = 1.05  # the largest eigenvalue is estimated this little too high, so that steps stay stable


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
        self.largest = ROUNDING * float(np.abs(response).max() / k) ** 2  # eigenvalue of H'H

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


def deblurred(blur: Convolution, y: Images, weight: Images, start: Images, iterations: int) -> Images:
    """Pressure x >= 0 (T, cells) that lowers sum weight (H x - y)^2, from a start; weights are 1 at most.

    Nesterov's accelerated projected gradients, started again where they point uphill (O'Donoghue, Candes 2015).
    """
    x, ahead, t = start, start, 1.0
    step, zero = np.float32(1 / blur.largest), np.float32(0)
    for _ in range(iterations):
        gradient = blur.adjoint(weight * (blur.forward(ahead) - y))
        after = np.maximum(ahead - step * gradient, zero)
        if np.vdot(ahead - after, after - x) > 0:
            t = 1.0
        later = (1 + np.sqrt(1 + 4 * t**2)) / 2
        x, ahead, t = after, after + np.float32((t - 1) / later) * (after - x), later
    return x
