"""Where does something press? The box of a surface that is restored, where all around it is noise."""

from math import sqrt
from typing import NamedTuple

import numpy as np

from tactiled.core import surface
from tactiled.restore.blur import Blur
from tactiled.restore.modes import Image
from tactiled.restore.noise import detection_threshold

MARGIN = 2  # pitches around the taxels that feel more than noise
QUIET_SIGMAS = 4.0  # standard deviations of noise hold the sum of what is felt around, and of its squares,
HIDDEN = 0.05  # and pressure that this would hide has no larger norm than so much of the frame's


class Box(NamedTuple):
    """Cells of a surface: rows and columns from, to."""

    top: int
    bottom: int
    left: int
    right: int
    clear: bool  # whether it ends before the array's border on every side


class Pressed:
    """Finds the box on an array's surface that what presses is in."""

    def __init__(self, array: Blur, noise: float) -> None:
        """`noise` (kPa) is a taxel's standard deviation."""
        wide = array.wide
        rows, columns = wide.blur.surface_shape if wide else array.surface_shape
        cells = np.arange(rows * columns).reshape(rows, columns)
        if wide is None:
            cells = cells[:: array.refine, :: array.refine]
        else:
            cells = cells[wide.own] if wide.felt is None else wide.felt.argmax(axis=1)
        most = cells.ravel().astype(np.int32)  # the cell that each taxel feels most
        self._at = np.divmod(most, np.int32(columns))  # its row and column
        self._ends = [(int(each.min()), int(each.max())) for each in self._at]
        self._margin = MARGIN * array.refine
        self._noise, self._threshold = noise, detection_threshold(noise, cells.size)
        self.whole = Box(0, rows, 0, columns, clear=False)

    def __call__(self, y: Image) -> Box:
        """Give the box for a frame without gaps: the whole surface, if nothing less is sure."""
        (low, high), (first, last) = self._ends
        top, bottom, left, right, n, total, squares, power = surface.box(
            y.reshape(-1), *self._at, self._threshold, self._margin
        )
        hidden = self._noise**2 * QUIET_SIGMAS * sqrt(2 * n)  # square of the norm of what nothing tells from noise
        quiet = squares < self._noise**2 * n + hidden and total**2 < (QUIET_SIGMAS * self._noise) ** 2 * n
        if bottom < top or not quiet or hidden > HIDDEN**2 * power:
            return self.whole
        return Box(
            top if top > low else 0,
            bottom + 1 if bottom < high else self.whole.bottom,
            left if left > first else 0,
            right + 1 if right < last else self.whole.right,
            clear=low < top and bottom < high and first < left and right < last,
        )
