"""The last images of one sensor, in memory that is taken once and never grows."""

from math import ceil, floor, prod
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactiled.frames import Image

RATE_HZ = 200  # frames a second that room is made for; of a faster sensor it is a shorter time
BESIDE = 8 + 8 + 8 + 8  # bytes of a frame's sequence number, time, arrival and method


class Kept(NamedTuple):
    """Consecutive images, oldest first."""

    sequence: NDArray[np.int64]  # (T,); lost frames leave gaps
    time: NDArray[np.float64]  # (T,) s, of the frame's first message
    method: tuple[str, ...]  # T, what restored each
    values: NDArray[np.float32]  # (T, *image) kPa; of shear (T, 2, *raw image) counts
    flags: NDArray[np.uint8]  # (T, *raw image)
    older: bool  # whether there are more of them before these
    since: float  # s, where the window that they are of begins, by arrival; whole microseconds
    cut: bool  # whether images of the window's beginning may be kept no longer


class History:
    """A ring of images: one thread adds, any thread reads, and none waits for another."""

    def __init__(
        self,
        seconds: float,
        most_bytes: int,
        raw: tuple[int, ...],
        restored: tuple[int, ...],
        shear: bool = False,  # whether the images have it
    ) -> None:
        shapes = {"raw": raw, "restored": restored} | ({"shear": (2, *raw)} if shear else {})
        each = 4 * sum(map(prod, shapes.values())) + prod(raw) + BESIDE
        slots = min(ceil(seconds * RATE_HZ), most_bytes // each)
        self.capacity = max(slots - 1, 0)  # frames; the slot that is being written is none of them
        slots = self.capacity and slots
        self._images = {kind: np.zeros((slots, *shape), np.float32) for kind, shape in shapes.items()}
        self._flags = np.zeros((slots, *raw), np.uint8)
        self._sequence = np.zeros(slots, np.int64)
        self._time, self._arrived = np.zeros(slots), np.zeros(slots)
        self._method = [""] * slots
        self._count = 0

    def add(self, image: Image) -> None:
        """Copy one image in over the oldest; allocates nothing."""
        if not self.capacity:
            return
        slot = self._count % (self.capacity + 1)
        for kind, kept in self._images.items():
            kept[slot] = getattr(image, kind)
        self._flags[slot] = image.flags
        self._sequence[slot] = image.sequence
        self._time[slot], self._arrived[slot] = image.time, image.arrived
        self._method[slot] = image.method
        self._count += 1

    def __call__(
        self, kind: str, last: float, before: int | None, most: int, most_values: int, since: float | None = None
    ) -> Kept:
        """The newest `most` images of the `last` s that are older than number `before`.

        Fewer, but one at least, where they hold more than `most_values` numbers. Time counts back from the newest
        that there is now, or the window begins at `since` (s, of an answer before) whatever has come meanwhile.
        It is that of their arrival: the bus's own clock may step.
        """
        count, images = self._count, self._images[kind]
        kept = np.arange(max(0, count - self.capacity), count)
        slots = kept % (self.capacity + 1)
        sequence, arrived = self._sequence[slots], self._arrived[slots]
        if since is None:
            since = floor((arrived[-1] - last) * 1e6) / 1e6 if count else 0.0
        wanted = np.flatnonzero(arrived >= since)
        if before is not None:
            wanted = wanted[sequence[wanted] < before]
        page = wanted[-min(most, max(1, most_values // prod(images.shape[1:]))) :]
        values, flags, time = images[slots[page]], self._flags[slots[page]], self._time[slots[page]]
        method = [self._method[slot] for slot in slots[page]]
        # What was written over while it was copied is no longer there.
        gone = int(np.count_nonzero(kept[page] < self._count - self.capacity))
        return Kept(
            sequence[page][gone:],
            time[gone:],
            tuple(method[gone:]),
            values[gone:],
            flags[gone:],
            len(wanted) > len(page) and not gone,
            since,
            gone > 0 or (count > self.capacity and bool(arrived[0] > since)),
        )
