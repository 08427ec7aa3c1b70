"""Textures: a frame's modes whose power stands out of the spectrum picked for it, as a few of one period do.

The spectrum falls smoothly with frequency. Ridges and lattices have their power in a few modes, which it takes for
noise where the cover leaves little of them. Their own power, averaged over neighbours, then takes its place.

Faults have power in modes, too, that the cover takes. Wrong gains and dead taxels raise all modes, noise that all
taxels of a row or column share those that vary along one axis alone. What stands out must stand out of that.
"""

import numpy as np
from scipy.special import chdtri

from tactiled.restore.modes import Floats, Image, Modes, Transform
from tactiled.restore.prior import MAX_AMPLIFICATION

# Chosen on scenes of the first family and on those that the network is trained on.
WINDOW = 5  # modes along each axis whose power is averaged
FALSE_ALARMS = 1e-3  # of frames of noise alone, in which a mode stands out
QUIET = 0.25  # of the modes, those of least gain
MEDIAN = 0.455  # of a normal variable's square
MOST = 1e18  # of a power over the noise's: more overflows, and changes nothing


class NarrowBand:
    """Finds such modes, and gives the filter's `weight` with them; allocates nothing a frame."""

    def __init__(self, modes: Modes, noise: float, gain_variance: Floats) -> None:
        """`noise` in kPa; `gain_variance` of each taxel mode's gain, as the cover's model may be wrong."""
        gain = modes.gain
        rows, columns = (_neighbours(n) for n in gain.shape)
        count = rows.sum(axis=1)[:, None] * columns.sum(axis=1)
        rows, columns = (each / each.sum(axis=1)[:, None] for each in (rows, columns))
        self._average = Transform((rows, columns))
        strong = gain > 1 / MAX_AMPLIFICATION
        clear = chdtri(count, FALSE_ALARMS / gain.size) / count - 1
        self._clear = np.where(strong, clear, np.inf)  # power over the noise's that noise hardly ever has
        self._inverse = np.divide(1, gain, out=np.zeros_like(gain), where=strong).astype(np.float32)
        self._firm = (1 + gain_variance * self._inverse**2).astype(np.float32)
        quiet = np.zeros(gain.size, np.float32)
        quiet[np.argsort(gain, axis=None)[: max(1, int(QUIET * gain.size))]] = 1
        self._variance = noise**2
        self._quiet = quiet / quiet.sum() / np.float32(self._variance)  # mean over them, over the noise's variance
        # Power of what is the same all along an axis, in each of the axis' modes, over that in the first.
        shares = [basis.sum(axis=0) ** 2 for basis in modes.taxel]
        down, across = (mean @ (share / share[0]) for mean, share in zip((rows, columns), shares, strict=True))
        self._down = down.astype(np.float32)
        self._by_row = np.ones((len(down), 3), np.float32)  # what columns share, what rows share, and the noise
        self._by_column = np.stack([np.ones_like(across), across, np.ones_like(across)]).astype(np.float32)
        self._sorted = [np.empty(n - n // 2, np.float32) for n in gain.shape]
        self._power, self._level = self._average.empty(), self._average.empty()
        self.weight = self._average.empty()
        self._mask = np.zeros(gain.shape, bool)
        self._factor, self._one = np.zeros((), np.float32), np.ones((), np.float32)
        self._most = np.full((), MOST, np.float32)
        self._zeros = np.zeros_like(self._power)

    def limit(self, expected: Floats) -> Image:
        """Give the power of each mode, over that of the noise, above which it stands out of a spectrum.

        `expected`: the spectrum's power in the frame, over the noise's.
        """
        return np.asarray(1 + np.maximum(self._clear, expected), np.float32)

    def __call__(self, squares: Image, limit: Image, weight: Image) -> bool:
        """Take in a frame's squared coefficients and a filter; gives whether any mode stands out."""
        power, level, factor = self._average(squares, self._power), self._level, self._factor
        quiet = max(1.0, float(self._quiet.dot(squares.reshape(-1))))
        factor[()] = 1 / (quiet * self._variance)
        np.multiply(power, factor, out=power)
        np.greater(power, limit, out=self._mask)
        if not self._mask.any():
            return False
        factor[()] = quiet
        np.multiply(power, factor, out=power)
        np.minimum(power, self._most, out=power)
        np.maximum(self._shared(squares), factor, out=level)
        np.multiply(level, limit, out=level)
        np.greater(power, level, out=self._mask)
        np.subtract(power, self._one, out=power)
        np.maximum(power, self._zeros, out=power)
        np.multiply(power, self._firm, out=level)
        np.add(level, self._one, out=level)
        np.multiply(power, self._inverse, out=power)
        np.divide(power, level, out=power)
        np.copyto(self.weight, weight)
        np.copyto(self.weight, power, where=self._mask)
        return bool(self._mask.any())

    def _shared(self, squares: Image) -> Image:
        """Power of the noise in every mode, over that of the taxels' own, with what rows and columns share."""
        row, column = (n // 2 for n in squares.shape)
        of_columns = self._excess(squares[0, column:], self._sorted[1])
        np.multiply(self._down, of_columns, out=self._by_row[:, 0])
        self._by_row[:, 1] = self._excess(squares[row:, 0], self._sorted[0])
        self._by_row.dot(self._by_column, self._level)
        return self._level

    def _excess(self, squares: Image, ordered: Image) -> float:
        """How far the median of some squares is above that of the noise, over the noise's variance; 0 if not."""
        np.copyto(ordered, squares)
        ordered.sort()
        return min(MOST, max(0.0, ordered.item(len(ordered) // 2) / (MEDIAN * self._variance) - 1))


def _neighbours(n: int) -> Floats:
    """Which of n modes (n, n) are in one window with each."""
    at = np.arange(n)
    return np.asarray(np.abs(at[:, None] - at) <= WINDOW // 2, float)
