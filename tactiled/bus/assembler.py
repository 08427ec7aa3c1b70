"""Readings to frames: lost messages are counted and marked, never made up; pure."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import fields
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from tactiled.bus.codec import Codec, ShearCodec
from tactiled.errors import CodecError
from tactiled.frames import BAD, MISSING, Counts, Loss, Message, RawFrame, Reading

UNLEARN_FRAMES = 16  # in a row that are not whole, after which a learned order is forgotten
SEAM_FRAMES = 3  # in a row with their longest pause at the same place, after which that place is their beginning
RESTART_S = 0.25  # of silence, after which a sequence number that looks old is that of a restarted sender


class _Open:
    """A frame of which not every segment has come yet."""

    def __init__(self, codec: Codec, reading: Reading) -> None:
        self.began = self.ended = reading.time
        self.arrived = 0.0  # s, when its newest message came
        self.payloads: list[bytes | None] = [None] * codec.segments
        self.missing = codec.segments
        self.bad: list[int] = []
        self.highest = -1
        self.disputed: set[int] = set()  # segments that came twice and not the same
        self.arrivals: list[tuple[int, float]] = []  # segments and their times (s) in the order of arrival

    def add(self, reading: Reading, now: float) -> None:
        time, segment, payload, _, bad = reading
        self.arrived = now
        self.payloads[segment] = payload
        self.missing -= 1
        self.arrivals.append((segment, time))
        if bad:
            self.bad += bad
        if segment > self.highest:
            self.highest = segment
        if time > self.ended:
            self.ended = time
        elif time < self.began:
            self.began = time


class _Cycle:
    """The order in which a skin without sequence numbers sends its segments, learned from whole frames.

    Without it the first messages of a frame could take the place of the same ones lost from the frame before, and
    every frame from there on would be put together from two.
    """

    def __init__(self) -> None:
        self._rank: dict[int, int] = {}
        self._broken = 0  # frames in a row that were not whole
        self._seam: int | None = None  # a segment within frames behind a long pause
        self._seams = 0  # frames in a row with that seam

    def wraps(self, last: int, segment: int) -> bool:
        """Whether a segment that comes behind `last` is so far back in the order that it begins a new frame."""
        return bool(self._rank) and 2 * (self._rank[last] - self._rank[segment]) >= len(self._rank)

    def learn(self, frame: _Open, pause: float) -> None:
        """Look at a closed frame that came after a `pause` (s)."""
        if frame.missing:
            self._broken += 1
            if self._broken >= UNLEARN_FRAMES:
                self._rank = {}
            return
        self._broken = 0
        pauses = [after[1] - before[1] for before, after in pairwise(frame.arrivals)]
        longest = max(pauses, default=0.0)
        first = pauses.index(longest) + 1 if longest > 4 * max(pause, 0.0) else 0
        seam = frame.arrivals[first][0] if first else None
        self._seams = self._seams + 1 if seam == self._seam else 1
        self._seam = seam
        if self._seams < SEAM_FRAMES:
            first = 0
        order = frame.arrivals[first:] + frame.arrivals[:first]
        self._rank = {segment: rank for rank, (segment, _) in enumerate(order)}


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
        self._closed: list[bytes | None] = [None] * codec.segments  # what the frame closed last had
        self._wire: int | None = None  # sequence number, as on the bus, of the newest frame begun
        self._sequence = -1  # the same, not wrapped
        self._newest = float("-inf")  # s, when the newest message came
        self._cycle = _Cycle() if codec.modulus is None else None
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

    def push(self, reading: Reading, now: float | None = None) -> tuple[RawFrame, ...]:
        """Take one reading, come at `now` (s; None: its own time); returns the frames it closes, oldest first."""
        now = reading.time if now is None else now
        if not 0 <= reading.segment < self.codec.segments:
            raise CodecError(f"segment {reading.segment} of {self.codec.segments}")
        frame = self._open
        if reading.bad and not 0 <= min(reading.bad) <= max(reading.bad) < self.codec.size:
            raise CodecError(f"bad taxels {reading.bad} of {self.codec.size}")
        same = frame is not None and self._cycle is None and self._wire == reading.sequence is not None
        step = 0 if same else self._step(reading, now)
        if now > self._newest:
            self._newest = now
        if step <= 0 and (step < 0 or frame is None):
            again = step == 0 and self._closed[reading.segment] is not None
            self.count("repeated" if again else "late")
            return ()
        closed: tuple[RawFrame, ...] = ()
        if step or frame is None:
            closed = self._close()
            self.count("lost", (step - 1) * self.codec.segments)
            self._wire, self._sequence = reading.sequence, self._sequence + step
            frame = self._open = _Open(self.codec, reading)
        if (payload := frame.payloads[reading.segment]) is not None:
            self.count("repeated")
            if payload != reading.payload:
                frame.disputed.add(reading.segment)
                frame.ended = max(frame.ended, reading.time)
            return closed
        if reading.segment < frame.highest and self.codec.modulus is not None:
            self.count("late")
        frame.add(reading, now)
        return closed if frame.missing else (*closed, *self._close())

    def flush(self, before: float) -> tuple[RawFrame, ...]:
        """Close, marked, a frame whose newest message came before time `before` (s)."""
        return self._close() if self._open is not None and self._open.arrived < before else ()

    def _step(self, reading: Reading, now: float) -> int:
        """How many frames a reading is ahead of the newest one begun; 0: of it; negative: of an older one."""
        modulus = self.codec.modulus
        if modulus is None:
            return int(self._open is None or self._begins(self._open, reading.segment))
        if reading.sequence is None or self._wire is None:
            return 1
        ahead = (reading.sequence - self._wire) % modulus
        step = ahead if ahead <= modulus // 2 else ahead - modulus
        old = step < 0 or (step == 0 and self._open is None)
        return 1 if old and now - self._newest > RESTART_S else step

    def _begins(self, frame: _Open, segment: int) -> bool:
        """Whether a segment without a sequence number cannot be of the open frame."""
        end = (segment // self.codec.ordered + 1) * self.codec.ordered
        again = any(each is not None for each in frame.payloads[segment:end])
        return again or (self._cycle is not None and self._cycle.wraps(frame.arrivals[-1][0], segment))

    def _close(self) -> tuple[RawFrame, ...]:
        frame, self._open = self._open, None
        if frame is None:
            return ()
        self._closed = frame.payloads
        if self._cycle is not None:
            self._cycle.learn(frame, frame.began - self._ended)
        self._ended = frame.ended
        self.count("lost", frame.missing)
        for segment in frame.disputed:
            frame.payloads[segment] = None
        skew = frame.ended - frame.began
        try:
            counts, shear = unpacked(self.codec, frame.payloads)
            references = self.codec.references(frame.payloads)
        except Exception:  # of another package's codec: none of ours raises here
            self.count("malformed", self.codec.segments - frame.missing)
            return ()
        flags = self._flags(frame)
        self.count("incomplete", int(None in frame.payloads))
        loss = self._newest_loss()
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
        if None in frame.payloads:
            for segment, payload in enumerate(frame.payloads):
                if payload is None:
                    flags[self.codec.span(segment)] = MISSING
        if frame.bad:
            flags[frame.bad] |= BAD
        return flags


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


def assemble(codec: Codec, messages: Iterable[Message]) -> tuple[list[RawFrame], Loss]:
    """The frames in some messages, and what was lost; malformed messages are passed over."""
    assembler = Assembler(codec)
    frames: list[RawFrame] = []
    for message in messages:
        try:
            frames += assembler.push(codec.decode(message))
        except CodecError:
            continue
    return frames, assembler.loss
