"""A small contact on a large grid: only a window around it is solved, all the rest being noise."""

from math import prod, sqrt

import numpy as np

from tactiled.restore.auto import ITERATED, REVIEW, SURE, Auto
from tactiled.restore.blur import Blur, GridBlur
from tactiled.restore.modes import Floats, Image
from tactiled.restore.noise import outstanding
from tactiled.restore.points import Point
from tactiled.restore.scene import Restored, Scene
from tactiled.restore.wiener import deviation

SIDE = 32  # taxels
LEAST = 2  # times the window's taxels: on a grid of fewer, looking costs what solving less saves
MARGIN = 4  # taxels within the window's edge that must be noise too
ROOM = 2  # taxels within that margin that a contact is given to move in
CLEAR = 0.8  # of what noise hardly reaches: a taxel above belongs to the contact

Slices = tuple[slice, slice]


def fits(blur: Blur) -> bool:
    """Whether a blur's array is a grid large enough for windows to pay."""
    shape = blur.frame_shape
    return len(shape) == 2 and min(shape) >= SIDE and shape[0] * shape[1] >= LEAST * SIDE**2


class Windowed:
    """Restores by `whole` until a small contact needs iterations, then in a window while all around it is noise.

    All around is noise where peak, trough, sum and power are. A window that its contact leaves is put anew; one
    that did not last `REVIEW` frames, or could not be put, gives way to the whole for as many.
    """

    def __init__(self, whole: Auto, scene: Scene) -> None:
        blur = scene.blur
        assert isinstance(blur, GridBlur)
        self._whole, self._scene = whole, scene
        self._part_scene = Scene(blur.cut((SIDE, SIDE)), scene.noise)
        self._part = Auto(self._part_scene)
        self._refine = blur.surface_shape[0] // blur.frame_shape[0]
        self._crop, self._around = np.empty((SIDE, SIDE), np.float32), np.empty(blur.frame_shape, np.float32)
        self._flat, self._ones = self._around.reshape(-1), np.ones(self._around.size, np.float32)
        self._image = np.zeros(blur.surface_shape, np.float32)
        self._peak = outstanding(scene.noise, scene.flat.size)
        self._open = self.shown = False  # whether there is a window, and whether the last image came from it
        self._taxels = self._inside = self._cells = (slice(0), slice(0))
        self._age = self._wait = 0

    def prepare(self) -> None:
        """Make now what any frame may need."""
        self._whole.prepare()
        self._part.prepare()

    def reset(self) -> None:
        """Forget the frames so far."""
        self._open, self._wait = False, 0
        self._whole.reset()

    @property
    def found(self) -> tuple[Point, ...]:
        """Loads (mm from the array's first taxel, N) that make up the image last restored."""
        if not self.shown:
            return self._whole.points.found
        pitch = self._scene.blur.cell_mm * self._refine
        down, across = (pitch * each.start for each in self._taxels)
        found = self._part.points.found
        return tuple(each._replace(x_mm=each.x_mm + across, y_mm=each.y_mm + down) for each in found)

    def deviation(self) -> Floats:
        """Standard deviation (kPa) of every cell of the image last restored."""
        if not self.shown:
            return self._whole.deviation()
        self._scene.empty()
        spread = deviation(self._scene)
        spread[self._cells] = self._part.deviation()
        return spread

    def __call__(self, y: Image) -> Restored:
        """Restore a frame without gaps."""
        self.shown = False
        if self._open:
            if self._quiet(y) or (self._age > REVIEW and self._put(y)):
                done = self._windowed(y)
                if done.method != "idle":
                    return done
            self._leave()
        done = self._whole(y)
        if self._wait:
            self._wait -= 1
        elif done.method in ITERATED and not self._put(y):
            self._leave()
        return done

    def _leave(self) -> None:
        if self._open:
            self._whole.follow(self._part)
        self._open, self.shown, self._wait = False, False, REVIEW

    def _windowed(self, y: Image) -> Restored:
        self._crop[...] = y[self._taxels]
        self._part_scene.high, self._part_scene.low = self._scene.high, self._scene.low
        self._part.stay()  # linear was refused on the whole, where more noise shows
        done = self._part(self._crop)
        self._image[self._cells] = done.image
        self._age += 1
        self.shown = True
        return done._replace(image=self._image)

    def _quiet(self, y: Image) -> bool:
        """Whether all around the window's inside is noise."""
        flat = self._flat
        self._around[...] = y
        self._around[self._inside] = 0
        if flat[flat.argmax()] > self._peak or flat[flat.argmin()] < -self._peak:
            return False
        noise, left = self._scene.noise, flat.size - prod(each.stop - each.start for each in self._inside)
        if float(flat.dot(flat)) > noise**2 * (left + SURE * sqrt(2 * left)):
            return False
        return abs(float(flat.dot(self._ones))) < SURE * noise * sqrt(left)

    def _put(self, y: Image) -> bool:
        """Put the window around the contact; False where that has no room in it, or more is pressed elsewhere."""
        pressed = y > CLEAR * self._peak
        places = [_place(np.flatnonzero(pressed.any(axis)), n) for axis, n in zip((1, 0), y.shape, strict=True)]
        if None in places:
            return False
        rows, columns = (place for place in places if place is not None)
        self._taxels, self._inside = (rows[0], columns[0]), (rows[1], columns[1])
        if not self._quiet(y):
            return False
        k = self._refine
        self._cells = slice(k * rows[0].start, k * rows[0].stop), slice(k * columns[0].start, k * columns[0].stop)
        self._image[...] = 0
        self._part.follow(self._part if self._open else self._whole)
        self._open, self._age = True, 0
        return True


def _place(pressed: "np.ndarray[tuple[int, ...], np.dtype[np.intp]]", n: int) -> Slices | None:
    """Window and its inside along an axis of n taxels, around those pressed; None where they do not fit in."""
    if not len(pressed):
        return None
    first, last = int(pressed[0]), int(pressed[-1])
    start = min(max((first + last + 1 - SIDE) // 2, 0), n - SIDE)
    inside = slice(start + MARGIN if start else 0, start + SIDE - MARGIN if start + SIDE < n else n)
    ahead = first - inside.start if start else ROOM
    behind = inside.stop - 1 - last if start + SIDE < n else ROOM
    return (slice(start, start + SIDE), inside) if min(ahead, behind) >= ROOM else None
