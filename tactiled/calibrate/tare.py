"""Whether an array is loaded, so that a tare would take the load for its zero."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tactiled.restore.noise import MAD_TO_SIGMA, detection_threshold
from tactiled.units import PRESSURE, Unit

MAX_DRIFT_FACTOR = 2.0  # times what noise reaches: a median above it is no drift of an array that was tared
ZERO_SIGMAS = 2.0  # noise standard deviations within which a taxel reads zero
SKIRT_FRACTION = 0.05  # of the highest reading: so little is a contact's skirt, and reads zero as well
UNPRESSED_FRACTION = 0.1  # of the taxels: if so many read zero, zero is right

Floats = NDArray[np.float64]


def load_description(frames: Sequence[NDArray[np.float32]], noise: float, unit: Unit = PRESSURE) -> str:
    """The load in the newest frames (in `unit`, NaN: unknown), in words; "" where there is only an offset.

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
    above = level - _unloaded(level, noise)
    scatter = MAD_TO_SIGMA * float(np.median(-above[above < 0])) if (above < 0).any() else 0.0
    taxels = np.count_nonzero(above > detection_threshold(max(noise, scatter), level.size))
    if taxels:
        return f"contact of {above.max():.3g} {unit} on {taxels} taxel{'s' if taxels > 1 else ''}"
    moved = float(np.nanmax(np.abs(values - level)))
    return f"readings that move by {moved:.3g} {unit}" if moved > detection_threshold(noise, values.size) else ""


def _unloaded(level: Floats, noise: float) -> float:
    """Reading of a taxel without a load."""
    median, reach = float(np.median(level)), detection_threshold(noise, level.size)
    at_zero = np.count_nonzero(np.abs(level) < max(ZERO_SIGMAS * noise, SKIRT_FRACTION * level.max()))
    pressed = (
        median > MAX_DRIFT_FACTOR * reach and level.min() > -reach and at_zero >= UNPRESSED_FRACTION * level.size
    )
    return 0.0 if pressed else median
