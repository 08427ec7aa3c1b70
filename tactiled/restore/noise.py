"""How noisy is a taxel? Measured from frames, whatever is pressed on them meanwhile."""

import numpy as np
from numpy.typing import NDArray

NORMAL = 1.4826  # a normal deviate's standard deviation over its median absolute deviation
FALL_BACK = 1e-4  # of the largest pressure: the noise assumed where the frames show none


def estimate(frames: NDArray[np.floating]) -> float:
    """Standard deviation (kPa) of a taxel from frames (T, ...), NaN ignored; over 0 unless all frames are 0.

    From second differences in time, which a steady or evenly moving load leaves alone; from one or two frames,
    from second differences between neighbours, which the cover keeps small. The median discards the rest.
    """
    values = np.asarray(frames, float)
    if len(values) >= 3:
        second = values[2:] - 2 * values[1:-1] + values[:-2]
    else:
        second = np.concatenate([_across(values, axis) for axis in range(1, values.ndim)] or [np.zeros(0)])
    second = np.abs(second[np.isfinite(second)])
    found = NORMAL * float(np.median(second)) / np.sqrt(6) if second.size else 0.0
    known = np.abs(values[np.isfinite(values)])
    return max(found, FALL_BACK * float(known.max(initial=0.0)))


def _across(values: NDArray[np.float64], axis: int) -> NDArray[np.float64]:
    if values.shape[axis] < 3:
        return np.zeros(0)
    return np.diff(values, 2, axis=axis).ravel()
