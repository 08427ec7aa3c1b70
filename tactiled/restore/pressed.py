"""Where does something press? The box of a surface that is restored, where all around it is noise."""

import numpy as np

from tactiled.arrays import Floats32
from tactiled.core import surface
from tactiled.restore.blur import Blur
from tactiled.restore.noise import detection_threshold

MARGIN = 2  # pitches around the taxels that feel more than noise
QUIET_SIGMAS = 4.0  # standard deviations of noise hold the sum of what is felt around, and of its squares,
HIDDEN = 0.05  # and pressure that this would hide has no larger norm than so much of the frame's

# Cells of a surface: rows from, to, columns from, to, and whether it ends before the array's border on every side.
Box = tuple[int, int, int, int, bool]


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
        # Of the cell that each taxel feels most.
        self._down, self._across = np.divmod(cells.ravel().astype(np.int32), np.int32(columns))
        first, last = self._down.min(), self._down.max()
        self._ends = int(first), int(last), int(self._across.min()), int(self._across.max())
        self._threshold = detection_threshold(noise, cells.size)
        self._margin, self._noise = MARGIN * array.refine, noise
        self._shape = rows, columns
        self.whole: Box = 0, rows, 0, columns, False

    def __call__(self, y: Floats32) -> Box:
        """Give the box for a frame without gaps: the whole surface, if nothing less is sure."""
        return surface.box(
            y.reshape(-1),
            self._down,
            self._across,
            self._ends,
            self._shape,
            self._threshold,
            self._margin,
            self._noise,
            QUIET_SIGMAS,
            HIDDEN,
        )
