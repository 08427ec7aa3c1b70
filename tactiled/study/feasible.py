"""Whether some press explains a frame down to its noise: then nothing in the frame tells that it is wrong."""

from collections.abc import Sequence

import numpy as np
from scipy.optimize import minimize

from tactiled.restore.blur import Blur
from tactiled.study.skin import Floats, Frames

MOST = 300  # iterations
TAXEL = 5.0  # noise standard deviations that one taxel may be left out by
PART = 4.0  # of a part's own, that the mean over one of the parts may be
PARTS = 4  # of a frame along each axis


def lawful(blur: Blur, frame: Frames, noise: float) -> bool:
    """Whether pressure that nowhere pulls, however odd, leaves of a frame (kPa) no more than `noise` (kPa)."""
    rest = _left(blur, np.asarray(frame, float)) / noise
    wide = [np.sum(part) / np.sqrt(part.size) for part in _parts(rest)]
    return bool(np.mean(rest**2) <= 1 and np.abs(rest).max() <= TAXEL and np.abs(wide).max() <= PART)


def _left(blur: Blur, frame: Floats) -> Floats:
    """What the best fit of pressure that nowhere pulls leaves of a frame, kPa."""

    def misfit(cells: Floats) -> tuple[float, Floats]:
        rest = blur.forward(cells.reshape(blur.surface_shape)) - frame
        return float(np.sum(rest**2)) / 2, blur.adjoint(rest).ravel()

    start = np.full(int(np.prod(blur.surface_shape)), max(float(frame.mean()), 0.0))
    bounds = [(0.0, None)] * start.size
    done = minimize(misfit, start, jac=True, bounds=bounds, method="L-BFGS-B", options={"maxiter": MOST})
    explained: Floats = blur.forward(done.x.reshape(blur.surface_shape))
    return frame - explained


def _parts(rest: Floats) -> Sequence[Floats]:
    """The frame's parts, PARTS along both axes, or as many of a layout."""
    if rest.ndim == 1:
        return np.array_split(rest, min(PARTS**2, rest.size))
    bands = np.array_split(rest, min(PARTS, len(rest)))
    return [part for band in bands for part in np.array_split(band, min(PARTS, band.shape[1]), axis=1)]
