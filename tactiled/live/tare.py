"""A tare: its states, which any thread may read, and its frames, collected as they come."""

from threading import Lock
from typing import Literal

import numpy as np

from tactiled.arrays import Floats32
from tactiled.frames import UNKNOWN, RawFrame

TARE_FRAMES = 16  # that a tare takes at least
TARE_S = 0.5  # of frames that it takes at least: 25 periods of the mains, and 50 frames at 100 Hz
MAX_TARE_FRAMES = 256  # that it takes at most: a skin of more than 512 Hz is tared in less time

TareState = Literal["none", "requested", "collecting", "judged", "done", "refused", "lapsed", "undone"]
Event = Literal["request", "frame", "enough", "zero", "load", "break", "undo"]
UNDER_WAY: tuple[TareState, ...] = ("requested", "collecting")
NEXT: dict[tuple[TareState, Event], TareState] = {  # what is not here changes nothing; a request starts over
    ("requested", "frame"): "collecting",
    ("collecting", "enough"): "judged",
    ("judged", "zero"): "done",
    ("judged", "load"): "refused",
    ("requested", "break"): "lapsed",
    ("collecting", "break"): "lapsed",
    ("requested", "undo"): "undone",
    ("collecting", "undo"): "undone",
    ("done", "undo"): "undone",
}


class Tare:
    """Collects frames on one thread after a request until there are enough; any thread may request or stop it."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._frames: list[Floats32] = []  # (1 or 3, N) each
        self._first_at = 0.0  # s, when the first frame came
        self.state: TareState = "none"  # of the tare under way, or the last
        self.time, self.force = 0.0, False  # the same
        self.done = self.refused = self.lapsed = 0  # times that a tare ended so
        self.load = ""  # in words: what the last refused tare met

    @property
    def under_way(self) -> bool:
        """Whether frames are collected."""
        return self.state in UNDER_WAY

    def request(self, time: float, force: bool) -> None:
        """Start over, at `time` (s, Unix); with `force` it is of a loaded array, too."""
        with self._lock:
            self.state, self._frames, self.time, self.force = "requested", [], time, force

    def stop(self, event: Literal["break", "undo"]) -> bool:
        """Stop, as frames no longer come or a person undoes it; returns whether it was under way."""
        with self._lock:
            under_way = self.under_way
            self._go(event)
            self.lapsed += under_way and event == "break"
        return under_way

    def finish(self, load: str) -> None:
        """Take note of what became of its frames: a zero, or no zero as there was a load, in words."""
        with self._lock:
            self._go("load" if load else "zero")
            if load:
                self.refused, self.load = self.refused + 1, load
            else:
                self.done += 1

    def _go(self, event: Event) -> None:
        self.state = NEXT.get((self.state, event), self.state)

    def collect(self, frame: RawFrame) -> Floats32 | None:
        """All frames (T, 1, N) of counts, or (T, 3, N) with shear along x and y, once enough; NaN: unknown."""
        with self._lock:
            if not self.under_way or (frame.flags & UNKNOWN).all():
                return None
            self._first_at = self._first_at if self._frames else frame.arrived
            self._go("frame")
            values = np.asarray(frame.counts, np.float32)[None].copy()
            if frame.shear is not None:
                values = np.concatenate([values, frame.shear])
            values[:, frame.flags & UNKNOWN > 0] = np.nan
            self._frames.append(values)
            enough = len(self._frames) >= TARE_FRAMES and frame.arrived - self._first_at >= TARE_S
            if not enough and len(self._frames) < MAX_TARE_FRAMES:
                return None
            frames, self._frames = np.stack(self._frames), []
            self._go("enough")
            return frames
