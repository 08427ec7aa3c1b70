"""What an array under a cover would count: a scene, blurred finer than it is restored, sampled, with noise."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from tactiled.calibrate.counts.calibration import Calibration
from tactiled.cover.kernel import Kernel
from tactiled.cover.operator import cached, matrix, stencil
from tactiled.geometry import Array

FINER = 4  # surface cells along each side of a taxel
Sample = Callable[[NDArray[np.float64]], NDArray[np.float64]]


class Surface:
    """Cells over an array, `finer` times finer than its pitch, and what its taxels sense of pressure on them."""

    def __init__(self, kernel: Kernel, array: Array, finer: int = FINER) -> None:
        low, high = array.positions.min(axis=0), array.positions.max(axis=0)
        self.grain, self.taxels = array.pitch / finer, array.size
        self.size = float((high - low).min() + array.pitch)  # mm
        middle = (low + high) / 2
        counts = np.round((high - low) / array.pitch).astype(int) * finer + finer
        x, y = ((np.arange(n) - (n - 1) / 2) * self.grain for n in counts)
        self.x, self.y = np.meshgrid(x, y)  # (rows, columns) mm from the array's centre
        self.cells = cells = np.column_stack([self.x.ravel(), self.y.ravel()]) + middle  # mm, as of the taxels
        if array.shape is None:
            response = matrix(kernel, array, cells, self.grain)
            self.sense: Sample = lambda pressure: np.asarray(response @ pressure.ravel())
        else:
            self.sense = _convolution(cached(stencil, kernel, array, finer), array.shape, finer)


def _convolution(response: NDArray[np.float64], shape: tuple[int, int], finer: int) -> Sample:
    """Convolve fine cells with a stencil and keep every taxel: (R k, C k) -> (R C,)."""
    padded = [finer * fft.next_fast_len(2 * n, real=True) for n in shape]
    spectrum = fft.rfft2(response[::-1, ::-1].astype(np.float32), padded)
    first = [finer * n - 1 for n in shape]

    def sense(pressure: NDArray[np.float64]) -> NDArray[np.float64]:
        blurred = fft.irfft2(fft.rfft2(pressure.astype(np.float32), padded) * spectrum, padded)
        rows, columns = (slice(at, at + finer * n, finer) for at, n in zip(first, shape, strict=True))
        return np.asarray(blurred[rows, columns].ravel(), np.float64)

    return sense


class Taxels:
    """Pressure (kPa) to counts: noise, gain, rounding, ceiling."""

    def __init__(self, calibration: Calibration, full_scale: int, noise_kpa: float, seed: int) -> None:
        self._calibration, self._full_scale, self._noise = calibration, full_scale, noise_kpa
        self._random = np.random.default_rng(seed)

    def count(self, pressure: NDArray[np.float64]) -> NDArray[np.uint16]:
        """Counts (N,) of taxels under `pressure` (N,) in kPa."""
        noisy = pressure + self._random.normal(0, self._noise, pressure.shape)
        return np.clip(np.round(self._calibration.counts(noisy)), 0, self._full_scale).astype(np.uint16)

    def shear(self, traction: NDArray[np.float64]) -> NDArray[np.float32]:
        """Counts (2, N) from rest of taxels under `traction` (2, N) in kPa, as many to a kPa as of pressure."""
        noisy = traction + self._random.normal(0, self._noise, traction.shape)
        return (noisy / abs(self._calibration.kpa_per_count)).astype(np.float32)
