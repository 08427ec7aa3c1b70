"""A frame that is being put together, and the order in which its segments come."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactiled.bus.arrivals import Arrivals, moment
from tactiled.bus.codec import Codec, Rows

UNLEARN_FRAMES = 16  # incomplete frames in a row, after which a learned order is forgotten
SILENT_FRAMES = 8  # frames in a row without a segment, after which it counts as silent, not as lost
SEAM_FRAMES = 3  # frames in a row with the longest pause at one place, after which frames begin there


class OpenFrame:
    """A frame of which not every segment has come yet."""

    def __init__(self, codec: Codec, payloads: NDArray[Any], time: float) -> None:
        """`payloads` give the type and width; `time` (s) is that of one of the frame's messages."""
        self.began = self.ended = time
        self.arrived = 0.0  # s, when its newest message came
        self.payloads = np.zeros((codec.segments, *payloads.shape[1:]), payloads.dtype)
        self.present = np.zeros(codec.segments, np.bool_)
        self.missing = codec.segments
        self.bad: list[int] = []
        self.highest = -1
        self.disputed: set[int] = set()  # segments that came twice, with different payloads
        self.segments: list[NDArray[np.int64]] = []  # in the order of arrival
        self.times: list[NDArray[np.float64]] = []  # s, the same

    def add(self, arrivals: Arrivals, some: slice, ascending: bool) -> None:
        """Take messages of segments that have not come yet; `ascending`: in ascending order."""
        readings, last = arrivals.readings, some.stop - 1
        segments, times = readings.segments[some], readings.times[some]
        places: slice | NDArray[np.int64] = segments
        first, end = int(segments[0]), int(segments[-1]) + 1
        if ascending and end - first == len(segments):
            places = slice(first, end)
        self.payloads[places] = readings.payloads[some]
        self.present[places] = True
        self.missing -= len(segments)
        self.arrived = moment(arrivals.now, last)
        self.segments.append(segments)
        self.times.append(times)
        if readings.bad:
            self.bad += [taxel for at in range(some.start, some.stop) for taxel in readings.bad.get(at, ())]
        began, ended = times[0], times[-1]
        if not arrivals.times_rise:
            began, ended = np.minimum.reduce(times), np.maximum.reduce(times)
        self.began, self.ended = min(self.began, float(began)), max(self.ended, float(ended))

    def late(self, segments: NDArray[np.int64], ascending: bool) -> int:
        """How many of these segments come after a segment that follows them in the frame."""
        if ascending and segments[0] > self.highest:
            self.highest = int(segments[-1])
            return 0
        highest = np.maximum.accumulate(np.concatenate(([self.highest], segments)))
        self.highest = int(highest[-1])
        return int(np.count_nonzero(highest[1:] > segments))

    def blocked(self, ordered: int) -> NDArray[np.bool_]:
        """Which segments it no longer accepts: it has them, or a later one of their group of `ordered`."""
        if ordered == 1:
            return self.present
        groups = np.zeros((-(-len(self.present) // ordered), ordered), np.bool_)
        groups.ravel()[: len(self.present)] = self.present
        return np.logical_or.accumulate(groups[:, ::-1], axis=1)[:, ::-1].ravel()[: len(self.present)]

    def same_payload(self, segment: int, payload: Any) -> bool:
        """Whether a segment has this payload."""
        return bool(np.all(self.payloads[segment] == payload))

    def used_payloads(self) -> Sequence[bytes | None]:
        """The payloads that are not disputed."""
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
        self._rank: NDArray[np.int64] | None = None
        self._length = 0  # segments that were not silent when the order was learned
        self._absent: NDArray[np.int64] | int = 0  # frames in a row that lacked each segment
        self._broken = 0  # frames in a row that were not whole
        self._seam: int | None = None  # the segment before which the longest pause is; None: the first
        self._seams = 0  # frames in a row with this `_seam`

    def wraps(self, before: Any, segments: Any) -> Any:
        """Whether segments (n,), or one, are so far back in the order behind these that they begin a new frame.

        None: no order is known.
        """
        return None if self._rank is None else 2 * (self._rank[before] - self._rank[segments]) >= self._length

    def learn(self, frame: OpenFrame, pause: float) -> None:
        """Look at a closed frame that came after a `pause` (s)."""
        if not self._is_whole(frame):
            self._broken += 1
            if self._broken >= UNLEARN_FRAMES:
                self._rank = None
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
        self._length = len(segments)
        self._rank = np.empty(len(frame.present), np.int64)
        self._rank[segments] = (np.arange(self._length) - first) % self._length
        if frame.missing:
            for each in np.flatnonzero(~frame.present).tolist():  # placed right behind its neighbour
                self._rank[each] = self._rank[each - 1] if each else 0

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
