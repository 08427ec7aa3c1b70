"""What taxels feel of pressure that is finer than their grid: no image of it can say, and no noise is so small."""

from collections.abc import Callable

import numpy as np

from tactiled.restore.modes import Floats

Spectrum = Callable[[Floats], Floats]  # cycles a cell -> relative variance of pressure


class Aliases:
    """The waves that look alike on the grid: what a taxel feels of each, and what is left of it in a cell's mean.

    Made from a stencil of cells `parts` times finer than the taxels', on a surface of one cell a taxel.
    """

    def __init__(self, stencil: Floats, shape: tuple[int, int], parts: int) -> None:
        sizes = [2 * parts * n for n in shape]
        waves = [np.asarray(np.fft.fftfreq(size, 1 / parts), float) for size in sizes]
        turns = (np.exp(1j * np.pi * (n - 1) * q / parts) for n, q in zip(stencil.shape, waves, strict=True))
        felt = (np.fft.fft2(stencil, sizes) * np.multiply.outer(*turns)).real
        within = (np.arange(parts) - (parts - 1) / 2) / parts
        means = (np.cos(2 * np.pi * np.multiply.outer(q, within)).mean(axis=1) for q in waves)
        smooth = np.multiply.outer(*(_spline(q) * np.sinc(q / parts) for q in waves))
        self._felt, self._mean, self._q, told = (
            _folded(values, shape, parts)
            for values in (felt, np.multiply.outer(*means), np.hypot(waves[0][:, None], waves[1]), felt * smooth)
        )
        self._left = (self._felt - told.sum(axis=(0, 2))[:, None] * self._mean) ** 2

    def missed(self, spectrum: Spectrum) -> Floats:
        """Give the variance of each taxel mode that pressure smooth between cells leaves, over the cells' own."""
        S = spectrum(self._q)
        return np.asarray((S * self._left).sum(axis=(0, 2)) / (S * self._mean**2).sum(axis=(0, 2)))


def _spline(q: Floats) -> Floats:
    """Give the transform of the parabolic spline whose mean is 1 over one cell and 0 over all others."""
    return np.asarray(3 * np.sinc(q) ** 3 / (2 + np.cos(2 * np.pi * q)))


def _folded(values: Floats, shape: tuple[int, int], parts: int) -> Floats:
    """Give (parts, rows, parts, columns): waves that look alike along the first and third axis."""
    rows, columns = shape
    return values.reshape(parts, 2 * rows, parts, 2 * columns)[:, :rows, :, :columns]
