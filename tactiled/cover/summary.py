"""What a cover does to an array, in words a designer uses."""

from dataclasses import dataclass

import numpy as np

from tactiled.arrays import Floats
from tactiled.cover.kernel import Kernel
from tactiled.cover.operator import aperture_mean
from tactiled.errors import PhysicsError
from tactiled.geometry import Array

VISIBLE_SIGMAS = 3.0  # noise standard deviations: a dip this deep survives


@dataclass(frozen=True, slots=True)
class CoverSummary:
    """A cover over an array: frequencies in cycles/mm, lengths in mm."""

    half_gain: float  # frequency where the gain has fallen to 0.5
    tenth_gain: float  # and to 0.1
    nyquist: float  # 1 / (2 pitch), the finest wave that the taxels can tell
    nyquist_gain: float  # of the cover there
    noise_gain: float  # how much undoing cover and aperture amplifies the noise there; inf where nothing is left
    smallest_gap: float  # mm between two indenters, and their width, that survives the noise; inf for none
    limit: str  # what sets the smallest gap: "cover" or "pitch"


def summarise(kernel: Kernel, array: Array, noise: float = 0.01) -> CoverSummary:
    """Say what survives of the surface pressure if a taxel's noise is `noise` times the indenters' pressure.

    Two indenters and the gap between them, all w wide, are a wave of frequency 1 / (2 w). Its dip is visible if
    cover and aperture pass VISIBLE_SIGMAS times the noise of it, and if taxels stand no further apart than w.
    """
    if not 0 < noise < np.inf:
        raise PhysicsError(f"noise is {noise} of the indenters' pressure: give a number above 0, such as 0.01")
    q = np.geomspace(kernel.q[1], kernel.q[-1], 4000)
    gain = kernel.gain_at(q)
    nyquist = 1 / (2 * array.pitch)
    nyquist_gain = float(kernel.gain_at(nyquist))
    passed = float(abs(nyquist_gain * aperture_mean(array, np.array(nyquist))))
    finest = _falls(q, np.abs(gain * aperture_mean(array, q)), VISIBLE_SIGMAS * noise)
    gap = 1 / (2 * finest) if finest else np.inf
    return CoverSummary(
        half_gain=_falls(q, gain, 0.5),
        tenth_gain=_falls(q, gain, 0.1),
        nyquist=nyquist,
        nyquist_gain=nyquist_gain,
        noise_gain=1 / passed if passed > np.finfo(float).tiny else np.inf,
        smallest_gap=max(gap, array.pitch),
        limit="cover" if gap > array.pitch else "pitch",
    )


def _falls(q: Floats, gain: Floats, level: float) -> float:
    """Give the first frequency where the gain falls under a level; 0 where it never was above it."""
    below = np.flatnonzero(gain < level)
    if not len(below):
        return float(q[-1])
    under = int(below[0])
    if under == 0:
        return 0.0
    low, high = gain[under - 1], gain[under]
    return float(q[under - 1] + (low - level) / (low - high) * (q[under] - q[under - 1]))
