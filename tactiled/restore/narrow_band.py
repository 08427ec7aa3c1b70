"""Textures: a frame's modes whose power stands out of the spectrum picked for it, as a few of one period do.

The spectrum falls smoothly with frequency. Ridges and lattices have their power in a few modes, which it takes for
noise where the cover leaves little of them. Their own power, averaged over neighbours, then takes its place.

Wrong gains and dead taxels raise all modes. So what stands out must do so of the modes, too, that the cover takes.
"""

import numpy as np
from scipy.special import chdtri

from tactiled.restore.modes import Floats, Image, Modes, Transform
from tactiled.restore.prior import MAX_AMPLIFICATION

# Chosen on scenes of the first family and on those that the network is trained on.
WINDOW = 5  # modes along each axis whose power is averaged
FALSE_ALARMS = 1e-3  # of frames of noise alone, in which a mode stands out
QUIET = 0.25  # of the modes, those of least gain


class NarrowBand:
    """Finds such modes, and gives the filter's `weight` with them; allocates nothing a frame."""

    def __init__(self, modes: Modes, noise: float, gain_variance: Floats) -> None:
        """`noise` in kPa; `gain_variance` of each taxel mode's gain, as the cover's model may be wrong."""
        gain = modes.gain
        rows, columns = (_neighbours(n) for n in gain.shape)
        count = rows.sum(axis=1)[:, None] * columns.sum(axis=1)
        self._average = Transform((rows / rows.sum(axis=1)[:, None], columns / columns.sum(axis=1)[:, None]))
        strong = gain > 1 / MAX_AMPLIFICATION
        clear = chdtri(count, FALSE_ALARMS / gain.size) / count - 1
        self._clear = np.where(strong, clear, np.inf)  # power over the noise's that noise hardly ever has
        self._inverse = np.divide(1, gain, out=np.zeros_like(gain), where=strong).astype(np.float32)
        self._firm = (1 + gain_variance * self._inverse**2).astype(np.float32)
        quiet = np.zeros(gain.size, np.float32)
        quiet[np.argsort(gain, axis=None)[: max(1, int(QUIET * gain.size))]] = 1
        self._quiet = quiet / quiet.sum() / np.float32(noise**2)  # mean over them, over the noise's variance
        self._variance = noise**2
        self._power, self._divisor = self._average.empty(), self._average.empty()
        self.weight = self._average.empty()
        self._mask = np.zeros(gain.shape, bool)
        self._factor, self._one = np.zeros((), np.float32), np.ones((), np.float32)
        self._zeros = np.zeros_like(self._power)

    def limit(self, expected: Floats) -> Image:
        """Give the power of each mode, over that of the noise, above which it stands out of a spectrum.

        `expected`: the spectrum's power in the frame, over the noise's.
        """
        return np.asarray(1 + np.maximum(self._clear, expected), np.float32)

    def __call__(self, squares: Image, limit: Image, weight: Image) -> bool:
        """Take in a frame's squared coefficients and a filter; gives whether any mode stands out."""
        power, divisor, factor = self._average(squares, self._power), self._divisor, self._factor
        quiet = max(1.0, float(self._quiet.dot(squares.reshape(-1))))
        factor[()] = 1 / (quiet * self._variance)
        np.multiply(power, factor, out=power)
        np.greater(power, limit, out=self._mask)
        if not self._mask.any():
            return False
        factor[()] = quiet
        np.multiply(power, factor, out=power)
        np.subtract(power, self._one, out=power)
        np.maximum(power, self._zeros, out=power)
        np.multiply(power, self._firm, out=divisor)
        np.add(divisor, self._one, out=divisor)
        np.multiply(power, self._inverse, out=power)
        np.divide(power, divisor, out=power)
        np.copyto(self.weight, weight)
        np.copyto(self.weight, power, where=self._mask)
        return True


def _neighbours(n: int) -> Floats:
    """Which of n modes (n, n) are in one window with each."""
    at = np.arange(n)
    return np.asarray(np.abs(at[:, None] - at) <= WINDOW // 2, float)
