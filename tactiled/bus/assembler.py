"""Readings to frames: lost messages are counted and marked, never made up; pure."""

from bisect import bisect_right
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactiled.bus.batch import Batch
from tactiled.bus.codec import NO_SEQUENCE, Codec, Readings, Rows, ShearCodec
from tactiled.errors import CodecError
from tactiled.frames import BAD, MISSING, Counts, Loss, Message, RawFrame

UNLEARN_FRAMES = 16  # in a row that are not whole, after which a learned order is forgotten
SEAM_FRAMES = 3  # in a row with their longest pause at the same place, after which that place is their beginning
RESTART_S = 0.25  # of silence, after which a sequence number that looks old is that of a restarted sender
NOWHERE = np.zeros(0, np.int64)
DESCENTS_PER_SEGMENT = 8  # segments to a descent at least where each may end a run: `python -m tests.study bus`


class _Arrivals(NamedTuple):
    """The messages (n) of a batch that are not malformed, in order."""

    readings: Readings
    now: float | NDArray[np.float64]  # s, when all came, or each (n,)
    newest: float | NDArray[np.float64]  # s, the largest of these, so far (n,)
    rows: NDArray[np.int64] | None  # (n,) numbers in the batch; None: their own
    # (n,) the last one before each with which it shares no frame by itself: of another sequence number, or of
    # the same group of ordered segments and not behind it; -1: none
    divided: NDArray[np.int64]
    descents: list[int]  # those of a segment that is not behind the one before
    times_rise: bool  # the messages' times never step back

    def row(self, at: int) -> int:
        """The number of a message in its batch."""
        return at if self.rows is None else int(self.rows[at])


@dataclass(slots=True)
class _Others:
    """Messages of one kind of loss, in order of the places in a batch before which they came."""

    kind: str
    places: NDArray[np.int64]
    counted: int = 0  # so far


def _at(values: float | NDArray[np.float64], at: int) -> float:
    return values if isinstance(values, float) else float(values[at])


class _Open:
    """A frame of which not every segment has come yet."""

    def __init__(self, codec: Codec, payloads: NDArray[Any], time: float) -> None:
        """`payloads` are some of the codec's, `time` (s) is of one of the frame's messages."""
        self.began = self.ended = time
        self.arrived = 0.0  # s, when its newest message came
        self.payloads = np.zeros((codec.segments, *payloads.shape[1:]), payloads.dtype)
        self.present = np.zeros(codec.segments, np.bool_)
        self.missing = codec.segments
        self.bad: list[int] = []
        self.highest = -1
        self.disputed: set[int] = set()  # segments that came twice and not the same
        self.segments: list[NDArray[np.int64]] = []  # in the order of arrival
        self.times: list[NDArray[np.float64]] = []  # s, the same

    def add(self, arrivals: _Arrivals, some: slice, ascending: bool) -> None:
        """Take messages of segments that are not there yet, in `ascending` order or any."""
        readings, last = arrivals.readings, some.stop - 1
        segments, times = readings.segments[some], readings.times[some]
        places: slice | NDArray[np.int64] = segments
        first, end = int(segments[0]), int(segments[-1]) + 1
        if ascending and end - first == len(segments):
            places = slice(first, end)
        self.payloads[places] = readings.payloads[some]
        self.present[places] = True
        self.missing -= len(segments)
        self.arrived = _at(arrivals.now, last)
        self.segments.append(segments)
        self.times.append(times)
        if readings.bad:
            self.bad += [taxel for at in range(some.start, some.stop) for taxel in readings.bad.get(at, ())]
        began, ended = times[0], times[-1]
        if not arrivals.times_rise:
            began, ended = np.minimum.reduce(times), np.maximum.reduce(times)
        self.began, self.ended = min(self.began, float(began)), max(self.ended, float(ended))

    def late(self, segments: NDArray[np.int64], ascending: bool) -> int:
        """How many of some segments come behind a later one."""
        if ascending and segments[0] > self.highest:
            self.highest = int(segments[-1])
            return 0
        highest = np.maximum.accumulate(np.concatenate(([self.highest], segments)))
        self.highest = int(highest[-1])
        return int(np.count_nonzero(highest[1:] > segments))

    def same_payload(self, segment: int, payload: Any) -> bool:
        """Whether a segment has this payload."""
        return bool(np.all(self.payloads[segment] == payload))

    def taken(self) -> Sequence[bytes | None]:
        """The payloads that are not disputed."""
        disputed = list(self.disputed)
        self.present[disputed] = False
        if self.payloads.dtype == object:
            return [each if there else None for each, there in zip(self.payloads, self.present, strict=True)]
        self.payloads[disputed] = 0
        return Rows(self.payloads, self.present)


class _Cycle:
    """The order in which a skin without sequence numbers sends its segments, learned from whole frames.

    Without it the first messages of a frame could take the place of the same ones lost from the frame before, and
    every frame from there on would be put together from two.
    """

    def __init__(self) -> None:
        self._rank: NDArray[np.int64] | None = None
        self._broken = 0  # frames in a row that were not whole
        self._seam: int | None = None  # a segment within frames behind a long pause
        self._seams = 0  # frames in a row with that seam

    def wraps(self, segments: NDArray[np.int64]) -> NDArray[np.bool_] | None:
        """Which of some segments, from the second on, is so far back in the order that it begins a new frame.

        None: no order is known.
        """
        if self._rank is None:
            return None
        ranks = self._rank[segments]
        return 2 * (ranks[:-1] - ranks[1:]) >= len(self._rank)

    def learn(self, frame: _Open, pause: float) -> None:
        """Look at a closed frame that came after a `pause` (s)."""
        if frame.missing:
            self._broken += 1
            if self._broken >= UNLEARN_FRAMES:
                self._rank = None
            return
        self._broken = 0
        segments, times = frame.segments[0], frame.times[0]
        if len(frame.segments) > 1:
            segments, times = np.concatenate(frame.segments), np.concatenate(frame.times)
        first = 0
        if len(times) > 1:
            pauses = times[1:] - times[:-1]
            longest = int(pauses.argmax())
            first = longest + 1 if pauses[longest] > 4 * max(pause, 0.0) else 0
        seam = int(segments[first]) if first else None
        self._seams = self._seams + 1 if seam == self._seam else 1
        self._seam = seam
        if self._seams < SEAM_FRAMES:
            first = 0
        self._rank = np.empty(len(segments), np.int64)
        self._rank[segments] = (np.arange(len(segments)) - first) % len(segments)


class Assembler:
    """Collects one array's readings into frames.

    A frame is published when its last segment is in, or, marked, when a message of a newer frame comes first or
    `flush` finds it too old. Without sequence numbers (`codec.modulus` None) a segment that comes again, or behind
    one that it always comes before, begins a newer frame. A sender that restarts its sequence numbers after a
    silence is followed at once. Of a segment that came twice and not the same neither is used: nobody knows which
    of two senders is right. A codec's fault, of whatever kind, is a malformed message.

    Ages and silences are of `now` (s), which is when a message came and never steps back; the times of messages,
    whose clock may, are data.
    """

    def __init__(self, codec: Codec, bus_counts: Callable[[], Mapping[str, int]] = dict) -> None:
        """`bus_counts` gives what the bus itself counts, by the names of `Loss`."""
        self.codec, self._bus_counts = codec, bus_counts
        self._counts = {each.name: 0 for each in fields(Loss)}  # never grows: other threads read it
        self._loss: Loss | None = None  # of the frame before, while nothing has been counted since
        self._open: _Open | None = None
        self._closed = np.zeros(codec.segments, np.bool_)  # segments that the frame closed last had
        self._wire = NO_SEQUENCE  # sequence number, as on the bus, of the newest frame begun
        self._sequence = -1  # the same, not wrapped
        self._newest = float("-inf")  # s, when the newest message came
        self._cycle = _Cycle() if codec.modulus is None else None
        self._others: list[_Others] = []  # of the batch that is taken
        self._ended = float("inf")  # s, when the frame closed last had its last message

    def count(self, kind: str, by: int = 1) -> None:
        """Add to one kind of loss."""
        if by:
            self._counts[kind] += by
            self._loss = None

    @property
    def loss(self) -> Loss:
        """What went wrong so far; any thread."""
        return Loss(**self._counts)

    @property
    def needed(self) -> int:
        """How many messages more can make a frame whole at the earliest."""
        return self.codec.segments if self._open is None else self._open.missing

    def push(
        self,
        batch: Batch | Message,
        now: float | NDArray[np.float64] | None = None,
        foreign: NDArray[np.int64] = NOWHERE,
    ) -> list[tuple[int, RawFrame]]:
        """Take messages, come at `now` (s; None: their own times); returns the frames they close, oldest first.

        Each frame comes after the number of the message that closes it. `foreign` are the places in the batch
        before which the bus had a message that belongs to no sensor.
        """
        batch = Batch.of((batch,)) if isinstance(batch, Message) else batch
        arrivals, malformed = self._decoded(batch, now)
        self._others = [
            _Others(kind, places)
            for kind, places in (("malformed", malformed), ("foreign", foreign))
            if places.size
        ]
        frames: list[tuple[int, RawFrame]] = []
        at, count = 0, 0 if arrivals is None else len(arrivals.divided)
        while arrivals is not None and at < count:
            at = self._take(arrivals, at, frames)
        self._count_others(len(batch))
        return frames

    def flush(self, before: float) -> tuple[RawFrame, ...]:
        """Close, marked, a frame whose newest message came before time `before` (s)."""
        return self._close() if self._open is not None and self._open.arrived < before else ()

    def _decoded(
        self, batch: Batch, now: float | NDArray[np.float64] | None
    ) -> tuple[_Arrivals | None, NDArray[np.int64]]:
        """The messages that are not malformed, None without any, and the numbers of those that are."""
        try:
            readings = self.codec.readings(batch)
        except Exception:  # of another package's codec: none of ours raises here
            return None, np.arange(len(batch))
        rows, malformed = None, NOWHERE
        if not np.logical_and.reduce(readings.good):
            rows, malformed = np.flatnonzero(readings.good), np.flatnonzero(~readings.good)
            if not rows.size:
                return None, malformed
            readings = _some(readings, rows)
        came = readings.times if now is None else now
        newest = came
        if isinstance(came, np.ndarray):
            came = came if now is None or rows is None else came[rows]
            newest = np.maximum.accumulate(came)
        divided, descents = _divided(readings, self.codec)
        times_rise = bool(np.logical_and.reduce(readings.times[1:] >= readings.times[:-1]))
        return _Arrivals(readings, came, newest, rows, divided, descents, times_rise), malformed

    def _take(self, arrivals: _Arrivals, at: int, frames: list[tuple[int, RawFrame]]) -> int:
        """Take message `at`, and with it all behind it that go into the same frame; returns the next."""
        readings, frame = arrivals.readings, self._open
        segment, now = int(readings.segments[at]), _at(arrivals.now, at)
        sequence = NO_SEQUENCE if readings.sequences is None else int(readings.sequences[at])
        step = self._step(segment, sequence, now)
        self._newest = max(self._newest, now)
        if step <= 0 and (step < 0 or frame is None):
            self.count("repeated" if step == 0 and self._closed[segment] else "late")
            return at + 1
        if step or frame is None:
            frames += self._closed_by(arrivals.row(at))
            self.count("lost", (step - 1) * self.codec.segments)
            self._wire, self._sequence = sequence, self._sequence + step
            frame = self._open = _Open(self.codec, readings.payloads, float(readings.times[at]))
        if frame.present[segment]:
            self.count("repeated")
            if not frame.same_payload(segment, readings.payloads[at]):
                frame.disputed.add(segment)
                frame.ended = max(frame.ended, float(readings.times[at]))
            return at + 1
        some = slice(at, self._end(arrivals, at, frame))
        last = some.stop - 1
        ascending = bisect_right(arrivals.descents, at) == bisect_right(arrivals.descents, last)
        if self._cycle is None:
            self.count("late", frame.late(readings.segments[some], ascending))
        frame.add(arrivals, some, ascending)
        self._newest = max(self._newest, _at(arrivals.newest, last))
        if not frame.missing:
            frames += self._closed_by(arrivals.row(last))
        return some.stop

    def _closed_by(self, row: int) -> list[tuple[int, RawFrame]]:
        """Close the open frame at a message of the batch."""
        if self._others:
            self._count_others(row)
        return [(row, each) for each in self._close()]

    def _end(self, arrivals: _Arrivals, at: int, frame: _Open) -> int:
        """The end of the messages from `at` on that go into a frame one after the other, each to an empty place."""
        end = min(at + frame.missing, len(arrivals.divided))
        if end == at + 1:
            return end
        segments = arrivals.readings.segments[at:end]
        stops = arrivals.divided[at + 1 : end] >= at
        if frame.missing < self.codec.segments:
            stops |= _blocked(frame.present, self.codec.ordered)[segments[1:]]
        if self._cycle is not None and (wraps := self._cycle.wraps(segments)) is not None:
            stops |= wraps
        first = int(stops.argmax())
        return at + 1 + first if stops[first] else end

    def _step(self, segment: int, sequence: int, now: float) -> int:
        """How many frames a message is ahead of the newest one begun; 0: of it; negative: of an older one."""
        modulus, frame = self.codec.modulus, self._open
        if modulus is None:
            return int(frame is None or self._begins(frame, segment))
        if sequence == NO_SEQUENCE or self._wire == NO_SEQUENCE:
            return 1
        ahead = (sequence - self._wire) % modulus
        step = ahead if ahead <= modulus // 2 else ahead - modulus
        old = step < 0 or (step == 0 and frame is None)
        return 1 if old and now - self._newest > RESTART_S else step

    def _begins(self, frame: _Open, segment: int) -> bool:
        """Whether a segment without a sequence number cannot be of the open frame."""
        end = (segment // self.codec.ordered + 1) * self.codec.ordered
        if frame.present[segment:end].any() or self._cycle is None:
            return True
        wraps = self._cycle.wraps(np.array((frame.segments[-1][-1], segment)))
        return wraps is not None and bool(wraps[0])

    def _count_others(self, row: int) -> None:
        """Count what came before a message of the batch and is in no frame."""
        for each in self._others:
            count = int(np.searchsorted(each.places, row, "right"))
            self.count(each.kind, count - each.counted)
            each.counted = count

    def _close(self) -> tuple[RawFrame, ...]:
        frame, self._open = self._open, None
        if frame is None:
            return ()
        self._closed = frame.present
        if self._cycle is not None:
            self._cycle.learn(frame, frame.began - self._ended)
        self._ended = frame.ended
        self.count("lost", frame.missing)
        payloads = frame.taken()
        try:
            counts, shear = unpacked(self.codec, payloads)
            references = self.codec.references(payloads)
        except Exception:  # of another package's codec: none of ours raises here
            self.count("malformed", self.codec.segments - frame.missing)
            return ()
        flags = self._flags(frame)
        self.count("incomplete", int(frame.missing > 0 or bool(frame.disputed)))
        loss, skew = self._newest_loss(), frame.ended - frame.began
        fields = self._sequence, frame.began, skew, counts, flags, loss, shear, frame.arrived, references
        return (RawFrame(*fields),)

    def _newest_loss(self) -> Loss:
        """What went wrong so far, on the bus too; made anew only after something did."""
        bus = self._bus_counts()
        if not bus.items() <= self._counts.items():
            self._counts.update(bus)
            self._loss = None
        loss = self._loss = self._loss or Loss(**self._counts)
        return loss

    def _flags(self, frame: _Open) -> NDArray[np.uint8]:
        flags = np.zeros(self.codec.size, np.uint8)
        if frame.missing or frame.disputed:
            for segment in np.flatnonzero(~frame.present).tolist():
                flags[self.codec.span(segment)] = MISSING
        if frame.bad:
            flags[frame.bad] |= BAD
        return flags


def _some(readings: Readings, rows: NDArray[np.int64]) -> Readings:
    """Some rows of readings."""
    bad = {at: readings.bad[row] for at, row in enumerate(rows.tolist()) if row in readings.bad}
    sequences = None if readings.sequences is None else readings.sequences[rows]
    columns = (each[rows] for each in readings[:4])
    return Readings(*columns, sequences, bad)


def _divided(readings: Readings, codec: Codec) -> tuple[NDArray[np.int64], list[int]]:
    """`_Arrivals.divided` and `descents`."""
    segments, sequences = readings.segments, readings.sequences
    divided = np.full(len(segments), -1)
    down = np.flatnonzero(segments[1:] <= segments[:-1])
    if len(down) * DESCENTS_PER_SEGMENT <= len(segments):
        divided[down + 1] = down  # ends a run earlier than it must, and costs less to find
    else:
        groups = (segments // codec.ordered).astype(np.uint16)
        order = np.argsort(groups, kind="stable")
        before, after = order[:-1], order[1:]
        same = (groups[before] == groups[after]) & (segments[before] >= segments[after])
        divided[after[same]] = before[same]
    if codec.modulus is not None and sequences is not None:
        changes = np.flatnonzero((sequences[1:] != sequences[:-1]) | (sequences[1:] == NO_SEQUENCE))
        divided[changes + 1] = changes
    return divided, (down + 1).tolist()


def _blocked(present: NDArray[np.bool_], ordered: int) -> NDArray[np.bool_]:
    """Which segments (S,) no longer go into a frame: it has them, or one behind them in their ordered group."""
    if ordered == 1:
        return present
    groups = np.zeros((-(-len(present) // ordered), ordered), np.bool_)
    groups.ravel()[: len(present)] = present
    return np.logical_or.accumulate(groups[:, ::-1], axis=1)[:, ::-1].ravel()[: len(present)]


def unpacked(codec: Codec, payloads: Sequence[bytes | None]) -> tuple[Counts, NDArray[np.float32] | None]:
    """The counts (N,) of one frame, and the shear (2, N) of a 3-axis skin; CodecError where they are of no use."""
    counts: Counts = codec.unpack(payloads)
    if counts.shape != (codec.size,) or counts.dtype not in (np.uint16, np.float32):
        raise CodecError(f"unpack gave {counts.dtype} {counts.shape}, not uint16 or float32 {(codec.size,)}")
    if not isinstance(codec, ShearCodec):
        return counts, None
    shear = np.asarray(codec.shear(payloads), np.float32)
    if shear.shape != (2, codec.size):
        raise CodecError(f"shear gave {shear.shape}, not {(2, codec.size)}")
    return counts, shear


def assemble(codec: Codec, messages: Batch | Iterable[Message]) -> tuple[list[RawFrame], Loss]:
    """The frames in some messages, and what was lost."""
    assembler = Assembler(codec)
    batch = messages if isinstance(messages, Batch) else Batch.of(messages)
    return [frame for _, frame in assembler.push(batch)], assembler.loss
