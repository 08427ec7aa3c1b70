"""A frame that is being put together, and the order in which its segments come."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactiled.bus.arrivals import Arrivals
from tactiled.bus.codec import Codec, Rows
from tactiled.core import messages

UNLEARN_FRAMES = 16  # incomplete frames in a row, after which a learned order is forgotten
SILENT_FRAMES = 8  # frames in a row without a segment, after which it counts as silent, not as lost
SEAM_FRAMES = 3  # frames in a row with the longest pause at one place, after which frames begin there


class OpenFrame:
    """A frame of which not every segment has come yet."""

    def __init__(self, codec: Codec, time: float) -> None:
        """`time` (s) is that of one of the frame's messages."""
        self.began = self.ended = time
        self.arrived = 0.0  # s, when its newest message came
        self.payloads: NDArray[Any] | None = None  # (segments, ...) once the first has come
        self.present = np.zeros(codec.segments, np.bool_)
        self._marks, self._ordered = self.present.view(np.uint8), codec.ordered
        self.missing = codec.segments
        self.bad: list[int] = []
        self.disputed: set[int] = set()  # segments that came twice, with different payloads
        self.segments: list[NDArray[np.int64]] = []  # in the order of arrival, without sequence numbers
        self.times: list[NDArray[np.float64]] = []  # s, the same

    def fill(self, arrivals: Arrivals, at: int, cycle: "Cycle | None") -> tuple[int, float, int]:
        """Take message `at`, of a segment that has not come yet, and those behind it that are of this frame.

        Gives the first message not taken, when the newest one came (s), and how many came behind a later segment.
        """
        readings, came = arrivals.readings, arrivals.now
        rank, length = (None, 0) if cycle is None else (cycle.rank, cycle.length)
        sequences = readings.sequences if cycle is None else None
        each_came = came if isinstance(came, np.ndarray) else None
        end, began, ended, last, newest, late = messages.run(
            readings.segments, sequences, readings.times, each_came,
            at, self._marks, self.missing, self._ordered, rank, length,
        )  # fmt: skip
        segments, payloads = readings.segments[at:end], readings.payloads[at:end]
        if end - at == len(self.present) and not late:  # all of them, in order
            self.payloads = payloads
        else:
            if self.payloads is None:
                self.payloads = np.zeros((len(self.present), *payloads.shape[1:]), payloads.dtype)
            self.payloads[segments] = payloads
        self.missing -= end - at
        self.arrived, newest = (last, newest) if isinstance(came, np.ndarray) else (came, came)
        self.began, self.ended = min(self.began, began), max(self.ended, ended)
        if cycle is not None:
            self.segments.append(segments)
            self.times.append(readings.times[at:end])
        if readings.bad:
            self.bad += [taxel for row in range(at, end) for taxel in readings.bad.get(row, ())]
        return end, newest, late

    def same_payload(self, segment: int, payload: Any) -> bool:
        """Whether a segment has this payload."""
        return self.payloads is not None and bool(np.all(self.payloads[segment] == payload))

    def used_payloads(self) -> Sequence[bytes | None]:
        """The payloads that are not disputed."""
        assert self.payloads is not None
        if self.disputed:
            self.present[list(self.disputed)] = False
        if self.payloads.dtype == object:
            return [each if present else None for each, present in zip(self.payloads, self.present, strict=True)]
        if self.disputed:
            self.payloads[list(self.disputed)] = 0
        return Rows(self.payloads, self.present)


class Cycle:
    """The order in which a skin without sequence numbers sends its segments, learned from whole frames.

    A frame that lacks only silent segments is whole, too. Without the order, the first messages of a frame could
    fill in for messages that the frame before lost. From then on every frame would consist of two halves.
    """

    def __init__(self) -> None:
        self.rank: NDArray[np.int64] | None = None  # of each segment; None: no order is known
        self.length = 0  # segments that were not silent when the order was learned
        self._absent: NDArray[np.int64] | int = 0  # frames in a row that lacked each segment
        self._broken = 0  # frames in a row that were not whole
        self._seam: int | None = None  # the segment before which the longest pause is; None: the first
        self._seams = 0  # frames in a row with this `_seam`

    def wraps(self, before: int, segment: int) -> bool:
        """Whether a segment is so far back in the order behind another that it begins a new frame."""
        return self.rank is not None and bool(2 * (self.rank[before] - self.rank[segment]) >= self.length)

    def learn(self, frame: OpenFrame, pause: float) -> None:
        """Look at a closed frame that came after a `pause` (s)."""
        if not self._is_whole(frame):
            self._broken += 1
            if self._broken >= UNLEARN_FRAMES:
                self.rank = None
            return
        self._broken = 0
        segments, times = frame.segments[0], frame.times[0]
        if len(frame.segments) > 1:
            segments, times = np.concatenate(frame.segments), np.concatenate(frame.times)
        pause = max(pause, 0.0)
        first = 0
        if len(times) > 1:
            pauses = times[1:] - times[:-1]
            if frame.missing:
                pauses -= pause * _silent_between(frame, segments)
            longest = int(pauses.argmax())
            first = longest + 1 if pauses[longest] > 4 * pause else 0
        seam = int(segments[first]) if first else None
        self._seams = self._seams + 1 if seam == self._seam else 1
        self._seam = seam
        if self._seams < SEAM_FRAMES:
            first = 0
        self.length = len(segments)
        self.rank = np.empty(len(frame.present), np.int64)
        self.rank[segments] = (np.arange(self.length) - first) % self.length
        if frame.missing:
            for each in np.flatnonzero(~frame.present).tolist():  # placed right behind its neighbour
                self.rank[each] = self.rank[each - 1] if each else 0

    def _is_whole(self, frame: OpenFrame) -> bool:
        """Whether a frame lacks nothing but silent segments."""
        if not frame.missing:
            self._absent = 0
            return True
        self._absent = np.where(frame.present, 0, self._absent + 1)
        return bool((frame.present | (self._absent >= SILENT_FRAMES)).all())


def _silent_between(frame: OpenFrame, segments: NDArray[np.int64]) -> NDArray[np.int64]:
    """How many segments that a frame lacks are between each of its `segments` (n,) and the next, (n - 1,)."""
    between = np.abs(np.diff(np.cumsum(~frame.present)[segments]))
    around = 2 * np.abs(np.diff(segments)) > len(frame.present)  # from the last to the first
    return np.where(around, frame.missing - between, between)
