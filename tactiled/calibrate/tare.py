"""Whether an array is loaded: what a tare must not take for its zero."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tactiled.restore.noise import MAD_TO_SIGMA, detection_threshold

CLEARLY = 2.0  # times what noise reaches: a median above it is no drift of an array that was tared
AT_ZERO = 2.0  # noise standard deviations within which a taxel reads zero
SKIRT = 0.05  # of the highest reading: so little is a contact's skirt, and reads zero as well
UNPRESSED = 0.1  # of the taxels: if so many read zero, zero is right

Floats = NDArray[np.float64]


def load_seen(frames: Sequence[NDArray[np.float32]], noise_kpa: float) -> str:
    """What in the newest frames (kPa, NaN: unknown) is a load rather than an offset; "" where nothing is.

    An offset stands still and is all over the array, scattered as far below the array's median as above it. So a
    load is what stands above the median by more than the noise, and the scatter below the median, can reach, or
    what moves between frames by more than noise. The median of an array that is half pressed is no offset: where
    it is clearly above the noise, but a tenth of the taxels read zero and none less, zero takes its place.
    A steady load that leaves fewer free, or lies on half of an array whose zero is wrong, passes for an offset.
    """
    values = np.array([each.ravel() for each in frames], float)
    values = values[:, np.isfinite(values).any(axis=0)] if values.size else values
    if not values.size:
        return ""
    level = np.nanmean(values, axis=0)
    above = level - _unloaded(level, noise_kpa)
    scatter = MAD_TO_SIGMA * float(np.median(-above[above < 0])) if (above < 0).any() else 0.0
    taxels = np.count_nonzero(above > detection_threshold(max(noise_kpa, scatter), level.size))
    if taxels:
        return f"contact of {above.max():.3g} kPa on {taxels} taxel{'s' if taxels > 1 else ''}"
    moved = float(np.nanmax(np.abs(values - level)))
    return f"readings that move by {moved:.3g} kPa" if moved > detection_threshold(noise_kpa, values.size) else ""


def _unloaded(level: Floats, noise_kpa: float) -> float:
    """Reading (kPa) of a taxel without a load."""
    median, reach = float(np.median(level)), detection_threshold(noise_kpa, level.size)
    at_zero = np.count_nonzero(np.abs(level) < max(AT_ZERO * noise_kpa, SKIRT * level.max()))
    pressed = median > CLEARLY * reach and level.min() > -reach and at_zero >= UNPRESSED * level.size
    return 0.0 if pressed else median
