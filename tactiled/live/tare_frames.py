"""The frames of a tare, collected as they come."""

from threading import Lock

import numpy as np

from tactiled.arrays import Floats32
from tactiled.frames import UNKNOWN, RawFrame

TARE_FRAMES = 16  # that a tare takes at least
TARE_S = 0.5  # of frames that it takes at least: 25 periods of the mains, and 50 frames at 100 Hz
MAX_TARE_FRAMES = 256  # that it takes at most: a skin of more than 512 Hz is tared in less time


class TareFrames:
    """Collects frames on one thread from `start` on until there are enough; any thread may start and stop it."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._frames: list[Floats32] | None = None  # (1 or 3, N) each; None: none under way
        self._first_at = 0.0  # s, when the first frame came
        self.time, self.force = 0.0, False  # of the tare under way, or the last

    @property
    def under_way(self) -> bool:
        """Whether frames are collected."""
        return self._frames is not None

    def start(self, time: float, force: bool) -> None:
        """Start over, at `time` (s, Unix); with `force` it is of a loaded array, too."""
        with self._lock:
            self._frames, self.time, self.force = [], time, force

    def stop(self) -> bool:
        """Stop; returns whether it was under way."""
        with self._lock:
            under_way, self._frames = self._frames is not None, None
        return under_way

    def add(self, frame: RawFrame) -> Floats32 | None:
        """All frames (T, 1, N) of counts, or (T, 3, N) with shear along x and y, once enough; NaN: unknown."""
        with self._lock:
            if self._frames is None or (frame.flags & UNKNOWN).all():
                return None
            self._first_at = self._first_at if self._frames else frame.arrived
            values = np.asarray(frame.counts, np.float32)[None].copy()
            if frame.shear is not None:
                values = np.concatenate([values, frame.shear])
            values[:, frame.flags & UNKNOWN > 0] = np.nan
            self._frames.append(values)
            enough = len(self._frames) >= TARE_FRAMES and frame.arrived - self._first_at >= TARE_S
            if not enough and len(self._frames) < MAX_TARE_FRAMES:
                return None
            frames, self._frames = np.stack(self._frames), None
            return frames
