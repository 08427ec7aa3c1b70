"""What taxels feel of pressure that is finer than their grid: no image of it can say, and no noise is so small."""

from collections.abc import Callable

import numpy as np

from tactiled.arrays import Floats


class Aliasing:
    """The waves that look alike on the grid: what a taxel feels of each, and what remains of it in a cell's mean.

    Made from a stencil of cells `parts` times finer than the taxels', on a surface of one cell a taxel.
    """

    def __init__(self, stencil: Floats, shape: tuple[int, int], parts: int) -> None:
        sizes = [2 * parts * n for n in shape]
        waves = [np.asarray(np.fft.fftfreq(size, 1 / parts), float) for size in sizes]
        turns = (np.exp(1j * np.pi * (n - 1) * q / parts) for n, q in zip(stencil.shape, waves, strict=True))
        gain = (np.fft.fft2(stencil, sizes) * np.multiply.outer(*turns)).real
        within = (np.arange(parts) - (parts - 1) / 2) / parts
        means = (np.cos(2 * np.pi * np.multiply.outer(q, within)).mean(axis=1) for q in waves)
        smooth = np.multiply.outer(*(_spline(q) * np.sinc(q / parts) for q in waves))
        folded, self._mean, self._q, of_smooth = (
            _folded(values, shape, parts)
            for values in (gain, np.multiply.outer(*means), np.hypot(waves[0][:, None], waves[1]), gain * smooth)
        )
        self._missed = (folded - of_smooth.sum(axis=(0, 2))[:, None] * self._mean) ** 2

    def variance(self, spectrum: Callable[[Floats], Floats]) -> Floats:
        """Give the variance of each taxel mode that pressure smooth between cells leaves, over the cells' own.

        `spectrum` maps frequency (cycles a cell) to the relative variance of pressure.
        """
        S = spectrum(self._q)
        return np.asarray((S * self._missed).sum(axis=(0, 2)) / (S * self._mean**2).sum(axis=(0, 2)))


def _spline(q: Floats) -> Floats:
    """Give the transform of the parabolic spline whose mean is 1 over one cell and 0 over all others."""
    return np.asarray(3 * np.sinc(q) ** 3 / (2 + np.cos(2 * np.pi * q)))


def _folded(values: Floats, shape: tuple[int, int], parts: int) -> Floats:
    """Give (parts, rows, parts, columns): waves that look alike along the first and third axis."""
    rows, columns = shape
    return values.reshape(parts, 2 * rows, parts, 2 * columns)[:, :rows, :, :columns]
