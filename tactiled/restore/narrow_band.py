"""Textures: a frame's modes whose power stands out of the spectrum picked for it, as a few of one period do.

The spectrum falls smoothly with frequency. Ridges and lattices have their power in a few modes, which it takes for
noise where the cover leaves little of them. Their own power, averaged over neighbours, then takes its place.

Faults have power in modes, too, that the cover takes. Wrong gains and dead taxels raise all modes, noise that all
taxels of a row or column share those that vary along one axis alone. What stands out must stand out of that.
"""

import numpy as np
from scipy.special import chdtri

from tactiled.arrays import Floats, Floats32
from tactiled.restore.modes import Modes
from tactiled.restore.prior import MAX_AMPLIFICATION

# Chosen on scenes of the first family and on those that the network is trained on.
WINDOW = 5  # modes along each axis whose power is averaged, as in `filtered`
FALSE_ALARMS = 1e-3  # of frames of noise alone, in which a mode stands out
QUIET = 0.25  # of the modes, those of least gain


class NarrowBand:
    """What `coefficients.filtered` finds such modes by, and weighs them with."""

    def __init__(self, modes: Modes, gain_variance: Floats) -> None:
        """`gain_variance` of each taxel mode's gain, as the cover's model may be wrong."""
        gain = modes.gain
        rows, columns = (_neighbours(n) for n in gain.shape)
        count = rows.sum(axis=1)[:, None] * columns.sum(axis=1)
        rows, columns = (each / each.sum(axis=1)[:, None] for each in (rows, columns))
        strong = gain > 1 / MAX_AMPLIFICATION
        clear = chdtri(count, FALSE_ALARMS / gain.size) / count - 1
        self._clear = np.where(strong, clear, np.inf)  # power over the noise's that noise hardly ever has
        inverse = np.divide(1, gain, out=np.zeros_like(gain), where=strong)
        quiet = np.zeros(gain.size)
        quiet[np.argsort(gain, axis=None)[: max(1, int(QUIET * gain.size))]] = 1
        quiet = (quiet / quiet.sum()).reshape(gain.shape)
        self.of_modes = np.array([quiet, inverse, 1 + gain_variance * inverse**2], np.float32)
        # Power of what is the same all along an axis, in each of the axis' modes, over that in the first.
        shares = [basis.sum(axis=0) ** 2 for basis in modes.taxel]
        parts = [mean @ (share / share[0]) for mean, share in zip((rows, columns), shares, strict=True)]
        self.shared = np.concatenate(parts).astype(np.float32)

    def limit(self, expected: Floats) -> Floats32:
        """Give the power of each mode, over that of the noise, above which it stands out of a spectrum.

        `expected`: the spectrum's power in the frame, over the noise's.
        """
        return np.asarray(1 + np.maximum(self._clear, expected), np.float32)


def _neighbours(n: int) -> Floats:
    """Which of n modes (n, n) are in one window with each."""
    at = np.arange(n)
    return np.asarray(np.abs(at[:, None] - at) <= WINDOW // 2, float)
