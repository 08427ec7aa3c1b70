"""A small contact on a large grid: only a window around it is solved, all the rest being noise."""

from math import prod, sqrt

import numpy as np

from tactiled.restore.auto import SUM_SIGMAS, Auto
from tactiled.restore.blur import Blur, GridBlur
from tactiled.restore.deviation import deviation
from tactiled.restore.modes import Floats, Image
from tactiled.restore.noise import detection_threshold
from tactiled.restore.scene import Restored, Scene

SIDE = 32  # taxels: windows of 16 on grids of 32 saved nothing (docs/decisions.md)
MIN_WINDOWS = 2  # that a grid has taxels for: on a smaller one, looking costs what solving less saves
MARGIN = 4  # taxels within the window's edge that must be noise too
CONTACT = 0.8  # of what noise hardly reaches: a taxel above belongs to the contact

Slices = tuple[slice, slice]


def fits(blur: Blur) -> bool:
    """Whether a blur's array is a grid large enough for windows to pay."""
    shape = blur.frame_shape
    return len(shape) == 2 and min(shape) >= SIDE and prod(shape) >= MIN_WINDOWS * SIDE**2


class Windowed:
    """Restores by `auto`: a small contact in a window around it, where all around that is noise.

    All around is noise where peak, trough, sum and power are.
    """

    def __init__(self, scene: Scene) -> None:
        blur = scene.array
        assert isinstance(blur, GridBlur)
        self._scene, self._full = scene, Auto(scene)
        self._part_scene = Scene(blur.cut((SIDE, SIDE)), scene.noise)
        self._part = Auto(self._part_scene)
        self._refine = blur.refine
        self._crop, self._around = np.empty((SIDE, SIDE), np.float32), np.empty(blur.frame_shape, np.float32)
        self._own = blur.wide.own if blur.wide else tuple(slice(0, n) for n in blur.frame_shape)
        self._goes_on = blur.wide is not None
        self._flat, self._ones = self._around.reshape(-1), np.ones(self._around.size, np.float32)
        self._image = np.zeros(scene.blur.surface_shape, np.float32)
        self._pressed = np.empty(blur.frame_shape, bool)
        self._peak = detection_threshold(scene.noise, scene.size)
        self.used = False  # whether the last image came from a window
        self._taxels = self._inside = self._cells = (slice(0), slice(0))
        self.is_idle = self._full.is_idle

    def prepare(self) -> None:
        """Make now what any frame may need."""
        self._full.prepare()
        self._part.prepare()

    def deviation(self) -> Floats:
        """Standard deviation (kPa) of every cell of the image last restored."""
        if not self.used:
            return self._full.deviation()
        self._scene.look_at_nothing()
        spread = deviation(self._scene)
        spread[self._cells] = self._part.deviation()
        return spread

    def __call__(self, y: Image) -> Restored:
        """Restore a frame without gaps."""
        self.used = not self.is_idle(y) and self._put(y)
        return self._windowed(y) if self.used else self._full(y)

    def _windowed(self, y: Image) -> Restored:
        scene, part = self._scene, self._part_scene
        self._crop[...] = y[self._taxels]
        part.high, part.low, part.expired, part.cut_short = scene.high, scene.low, scene.expired, False
        done = self._part(self._crop)
        scene.cut_short = part.cut_short
        self._image[...] = 0
        self._image[self._cells] = done.image
        return done._replace(image=self._image)

    def _quiet(self, y: Image) -> bool:
        """Whether all around the window's inside is noise."""
        flat = self._flat
        self._around[...] = y
        self._around[self._inside] = 0
        if flat[flat.argmax()] > self._peak or flat[flat.argmin()] < -self._peak:
            return False
        noise, outside = self._scene.noise, flat.size - prod(each.stop - each.start for each in self._inside)
        if float(flat.dot(flat)) > noise**2 * (outside + SUM_SIGMAS * sqrt(2 * outside)):
            return False
        return abs(float(flat.dot(self._ones))) < SUM_SIGMAS * noise * sqrt(outside)

    def _put(self, y: Image) -> bool:
        """Put the window around the contact; False where that has no room in it, or more is pressed elsewhere."""
        pressed = np.greater(y, CONTACT * self._peak, out=self._pressed)
        rows, columns = (
            _place(np.flatnonzero(pressed.any(axis)), n, self._goes_on)
            for axis, n in zip((1, 0), y.shape, strict=True)
        )
        if rows is None or columns is None:
            return False
        self._taxels, self._inside = (rows[0], columns[0]), (rows[1], columns[1])
        if not self._quiet(y):
            return False
        k = self._refine
        down, across = (
            slice(own.start + k * part.start, own.start + k * part.stop)
            for own, part in zip(self._own, self._taxels, strict=True)
        )
        self._cells = down, across
        return True


def _place(pressed: "np.ndarray[tuple[int, ...], np.dtype[np.intp]]", n: int, goes_on: bool) -> Slices | None:
    """Window and its inside along an axis of n taxels, around those pressed; None where they do not fit in.

    Where the surface `goes_on` beyond the border, no window does, so the contact must be clear of it.
    """
    if not len(pressed):
        return None
    first, last = int(pressed[0]), int(pressed[-1])
    start = min(max((first + last + 1 - SIDE) // 2, 0), n - SIDE)
    inside = slice(
        start + MARGIN if goes_on or start else 0, start + SIDE - MARGIN if goes_on or start + SIDE < n else n
    )
    return (slice(start, start + SIDE), inside) if inside.start <= first and last < inside.stop else None
