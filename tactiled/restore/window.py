"""A small contact on a large grid: only a window around it is solved, all the rest being noise."""

from math import prod, sqrt

import numpy as np

from tactiled.restore.auto import ITERATED, REVIEW_FRAMES, SUM_SIGMAS, Auto
from tactiled.restore.blur import Blur, GridBlur
from tactiled.restore.deviation import deviation
from tactiled.restore.modes import Floats, Image
from tactiled.restore.noise import detection_threshold
from tactiled.restore.scene import Restored, Scene

SIDE = 32  # taxels: windows of 16 on grids of 32 saved nothing (docs/decisions.md)
MIN_WINDOWS = 2  # that a grid has taxels for: on a smaller one, looking costs what solving less saves
MARGIN = 4  # taxels within the window's edge that must be noise too
MOVE_TAXELS = 2  # taxels within that margin that a contact is given to move in
CONTACT = 0.8  # of what noise hardly reaches: a taxel above belongs to the contact

Slices = tuple[slice, slice]


def fits(blur: Blur) -> bool:
    """Whether a blur's array is a grid large enough for windows to pay."""
    shape = blur.frame_shape
    return len(shape) == 2 and min(shape) >= SIDE and prod(shape) >= MIN_WINDOWS * SIDE**2


class Windowed:
    """Restores by `auto` until a small contact needs iterations, then in a window while all around it is noise.

    All around is noise where peak, trough, sum and power are. A window that its contact leaves is put around it
    again; one that did not last `REVIEW_FRAMES`, or could not be put, gives way to the full grid for as many.
    """

    def __init__(self, scene: Scene) -> None:
        blur = scene.blur
        assert isinstance(blur, GridBlur)
        self._scene, self._full = scene, Auto(scene)
        self._part_scene = Scene(blur.cut((SIDE, SIDE)), scene.noise)
        self._part = Auto(self._part_scene)
        self._refine = blur.surface_shape[0] // blur.frame_shape[0]
        self._crop, self._around = np.empty((SIDE, SIDE), np.float32), np.empty(blur.frame_shape, np.float32)
        self._flat, self._ones = self._around.reshape(-1), np.ones(self._around.size, np.float32)
        self._image = np.zeros(blur.surface_shape, np.float32)
        self._peak = detection_threshold(scene.noise, scene.flat.size)
        self._open = self.used = False  # whether there is a window, and whether the last image came from it
        self._taxels = self._inside = self._cells = (slice(0), slice(0))
        self._age = self._wait = 0
        self.is_idle = self._full.is_idle

    def prepare(self) -> None:
        """Make now what any frame may need."""
        self._full.prepare()
        self._part.prepare()

    def reset(self) -> None:
        """Forget the frames so far."""
        self._open, self._wait = False, 0
        self._full.reset()

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
        self.used = False
        if self._open:
            if self._quiet(y) or (self._age > REVIEW_FRAMES and self._put(y)):
                done = self._windowed(y)
                if done.method != "idle":
                    return done
            self._close()
        done = self._full(y)
        if self._wait:
            self._wait -= 1
        elif done.method in ITERATED and not self._put(y):
            self._close()
        return done

    def _close(self) -> None:
        if self._open:
            self._full.follow(self._part)
        self._open, self.used, self._wait = False, False, REVIEW_FRAMES

    def _windowed(self, y: Image) -> Restored:
        self._crop[...] = y[self._taxels]
        self._part_scene.high, self._part_scene.low = self._scene.high, self._scene.low
        self._part.keep_method()  # linear was refused on the full grid, where more noise shows
        done = self._part(self._crop)
        self._image[self._cells] = done.image
        self._age += 1
        self.used = True
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
        pressed = y > CONTACT * self._peak
        rows, columns = (
            _place(np.flatnonzero(pressed.any(axis)), n) for axis, n in zip((1, 0), y.shape, strict=True)
        )
        if rows is None or columns is None:
            return False
        self._taxels, self._inside = (rows[0], columns[0]), (rows[1], columns[1])
        if not self._quiet(y):
            return False
        k = self._refine
        self._cells = slice(k * rows[0].start, k * rows[0].stop), slice(k * columns[0].start, k * columns[0].stop)
        self._image[...] = 0
        self._part.follow(self._part if self._open else self._full)
        self._open, self._age = True, 0
        return True


def _place(pressed: "np.ndarray[tuple[int, ...], np.dtype[np.intp]]", n: int) -> Slices | None:
    """Window and its inside along an axis of n taxels, around those pressed; None where they do not fit in."""
    if not len(pressed):
        return None
    first, last = int(pressed[0]), int(pressed[-1])
    start = min(max((first + last + 1 - SIDE) // 2, 0), n - SIDE)
    inside = slice(start + MARGIN if start else 0, start + SIDE - MARGIN if start + SIDE < n else n)
    ahead = first - inside.start if start else MOVE_TAXELS
    behind = inside.stop - 1 - last if start + SIDE < n else MOVE_TAXELS
    return (slice(start, start + SIDE), inside) if min(ahead, behind) >= MOVE_TAXELS else None
