"""The last images of one sensor, in memory that is allocated once and never grows."""

from math import ceil, floor, prod
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from tactiled.arrays import Flags, Floats, Floats32
from tactiled.frames import SensorImage
from tactiled.units import COUNTS, PRESSURE, Unit

MAX_RATE_HZ = 200  # of frames that there is memory for; of a faster sensor it is a shorter time
Scalar = TypeVar("Scalar", bound=np.generic)
BYTES_BESIDE = 8 + 8 + 8 + 8 + 1  # of a frame's sequence number, time, arrival, method and unit


class Page(NamedTuple):
    """Consecutive images, oldest first."""

    sequence: NDArray[np.int64]  # (T,); lost frames leave gaps
    time: Floats  # (T,) s, of the frame's first message
    method: tuple[str, ...]  # T, that restored each
    values: Floats32  # (T, *image) in `unit`; of shear (T, 2, *raw image) counts
    flags: Flags  # (T, *raw image)
    older: bool  # whether the window has images before these
    since: float  # s, where the window begins, by arrival; whole microseconds
    cut: bool  # whether images at the window's beginning may have been overwritten, or are in another unit
    unit: Unit | None  # of the newest image's pressure, and of all these; None where there is none


class History:
    """A ring of images: one thread adds, any thread reads, and none waits for another."""

    def __init__(
        self,
        seconds: float,
        max_bytes: int,
        raw: tuple[int, ...],
        restored: tuple[int, ...],
        shear: bool = False,  # whether the images have it
    ) -> None:
        shapes = {"raw": raw, "restored": restored} | ({"shear": (2, *raw)} if shear else {})
        self._frame_bytes = 4 * sum(map(prod, shapes.values())) + prod(raw) + BYTES_BESIDE
        slots = min(ceil(seconds * MAX_RATE_HZ), max_bytes // self._frame_bytes)
        self.capacity = max(slots - 1, 0)  # frames; one slot more is being written
        slots = self.capacity and slots
        self._images = {kind: _written((slots, *shape), np.float32) for kind, shape in shapes.items()}
        self._flags = _written((slots, *raw), np.uint8)
        self._sequence = _written((slots,), np.int64)
        self._time, self._arrived = _written((2, slots), np.float64)
        self._method = [""] * slots
        self._in_counts = _written((slots,), np.bool_)
        self._count = 0

    @property
    def bytes(self) -> int:
        """Memory that it has."""
        return len(self._method) * self._frame_bytes

    def keep(self, image: SensorImage) -> None:
        """Copy one image in over the oldest; allocates nothing."""
        if not self.capacity:
            return
        slot = self._count % (self.capacity + 1)
        for kind, images in self._images.items():
            images[slot] = getattr(image, kind)
        self._flags[slot] = image.flags
        self._sequence[slot] = image.sequence
        self._time[slot], self._arrived[slot] = image.time, image.arrived
        self._method[slot], self._in_counts[slot] = image.method, image.unit == COUNTS
        self._count += 1

    def page(
        self,
        kind: str,
        seconds: float,
        before: int | None,
        max_frames: int,
        max_values: int,
        since: float | None = None,
    ) -> Page:
        """The newest `max_frames` images of the last `seconds` that are older than number `before`.

        Fewer, but at least one, where they hold more than `max_values` numbers. The window ends at the newest
        image, or begins at `since` (s, of a page before) whatever has come meanwhile. It is by arrival: the clock
        of the bus may step. Images in another unit than the newest are left out.
        """
        count, images = self._count, self._images[kind]
        numbers = np.arange(max(0, count - self.capacity), count)
        slots = numbers % (self.capacity + 1)
        sequence, arrived = self._sequence[slots], self._arrived[slots]
        if since is None:
            since = floor((arrived[-1] - seconds) * 1e6) / 1e6 if count else 0.0
        in_counts = self._in_counts[slots]
        comparable = (in_counts == in_counts[-1:]) | (kind == "shear")
        window = np.flatnonzero((arrived >= since) & comparable)
        if before is not None:
            window = window[sequence[window] < before]
        page = window[-min(max_frames, max(1, max_values // prod(images.shape[1:]))) :]
        values, flags, time = images[slots[page]], self._flags[slots[page]], self._time[slots[page]]
        method = [self._method[slot] for slot in slots[page]]
        # Images that were overwritten while they were copied are mixed: drop them.
        overwritten = int(np.count_nonzero(numbers[page] < self._count - self.capacity))
        return Page(
            sequence[page][overwritten:],
            time[overwritten:],
            tuple(method[overwritten:]),
            values[overwritten:],
            flags[overwritten:],
            older=len(window) > len(page) and not overwritten,
            since=since,
            cut=overwritten > 0
            or (count > self.capacity and bool(arrived[0] > since))
            or bool((arrived >= since)[~comparable].any()),
            unit=(COUNTS if in_counts[-1] else PRESSURE) if len(in_counts) else None,
        )


def _written(shape: tuple[int, ...], form: type[Scalar]) -> NDArray[Scalar]:
    """Memory that the system gives now, not at its first use: that would hold up a frame for up to 5 ms."""
    memory = np.empty(shape, form)
    memory.fill(0)
    return memory
