"""Readings to frames: what is lost is counted and marked, never mended."""

from collections.abc import Iterable
from dataclasses import fields
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from tactiled.bus.codecs import Codec, Shearing
from tactiled.errors import CodecError
from tactiled.frames import BAD, MISSING, Loss, Message, RawFrame, Reading

UNLEARN = 16  # frames in a row that are not whole, after which a learned order is forgotten
SEAM = 3  # frames in a row with their longest pause at the same place, after which that place is their beginning
RESTART_S = 0.25  # of silence, after which a sequence number that looks old is a sender's that began anew


class _Open:
    """A frame of which not every segment has come yet."""

    def __init__(self, codec: Codec, reading: Reading) -> None:
        self.began = self.ended = reading.time
        self.arrived = 0.0  # s, when its newest message came
        self.payloads: list[bytes | None] = [None] * codec.segments
        self.left = codec.segments
        self.bad: list[int] = []
        self.highest = -1
        self.disputed: set[int] = set()  # segments that came twice and not the same
        self.came: list[tuple[int, float]] = []  # segments and their times (s) in the order of their coming

    def add(self, reading: Reading, now: float) -> None:
        self.arrived = now
        self.payloads[reading.segment] = reading.payload
        self.left -= 1
        self.came.append((reading.segment, reading.time))
        if reading.bad:
            self.bad += reading.bad
        self.highest = max(self.highest, reading.segment)
        self.began, self.ended = min(self.began, reading.time), max(self.ended, reading.time)

    def settle(self) -> None:
        """Leave out what came twice and not the same: of which of two senders it is, nobody knows."""
        for segment in self.disputed:
            self.payloads[segment] = None


class _Cycle:
    """The order in which a skin without sequence numbers sends its segments, learned from whole frames.

    Without it the first messages of a frame could take the place of the same ones lost from the frame before, and
    every frame from there on would be put together from two.
    """

    def __init__(self) -> None:
        self._rank: dict[int, int] = {}
        self._broken = 0  # frames in a row that were not whole
        self._seam: tuple[int | None, int] = (
            None,
            0,
        )  # a segment within frames behind a long pause; frames in a row

    def wraps(self, last: int, segment: int) -> bool:
        """Whether a segment that comes behind `last` is so far back in the order that it begins a new frame."""
        return bool(self._rank) and 2 * (self._rank[last] - self._rank[segment]) >= len(self._rank)

    def learn(self, frame: _Open, pause: float) -> None:
        """Look at a closed frame that came after a `pause` (s)."""
        if frame.left:
            self._broken += 1
            if self._broken >= UNLEARN:
                self._rank = {}
            return
        self._broken = 0
        gaps = [after[1] - before[1] for before, after in pairwise(frame.came)]
        longest = max(gaps, default=0.0)
        first = gaps.index(longest) + 1 if longest > 4 * max(pause, 0.0) else 0
        seam = frame.came[first][0] if first else None
        self._seam = seam, self._seam[1] + 1 if seam == self._seam[0] else 1
        if self._seam[1] < SEAM:
            first = 0
        self._rank = {segment: rank for rank, (segment, _) in enumerate(frame.came[first:] + frame.came[:first])}


class Assembler:
    """Collects one array's readings into frames.

    A frame is published when its last segment is in, or, marked, when a message of a newer frame comes first or
    `flush` finds it too old. Without sequence numbers (`codec.modulus` None) a segment that comes again, or behind
    one that it always comes before, begins a newer frame. A sender that begins its sequence numbers anew after a
    silence is followed at once.

    Ages and silences are of `now` (s), which is when a message came and never steps back; the times of messages,
    whose clock may, are data.
    """

    def __init__(self, codec: Codec) -> None:
        self.codec = codec
        self._counts = {each.name: 0 for each in fields(Loss)}  # never grows: other threads read it
        self._open: _Open | None = None
        self._closed: list[bytes | None] = [None] * codec.segments  # what the frame closed last had
        self._wire: int | None = None  # sequence number, as on the bus, of the newest frame begun
        self._sequence = -1  # the same, not wrapped
        self._newest = float("-inf")  # s, when the newest message came
        self._cycle = _Cycle() if codec.modulus is None else None
        self._ended = float("inf")  # s, when the frame closed last had its last message

    def count(self, kind: str, by: int = 1) -> None:
        """Add to one kind of loss."""
        self._counts[kind] += by

    @property
    def loss(self) -> Loss:
        """What went wrong so far."""
        return Loss(**self._counts)

    def push(self, reading: Reading, now: float | None = None) -> tuple[RawFrame, ...]:
        """Take one reading, come at `now` (s; None: its own time); returns the frames it closes, oldest first."""
        now = reading.time if now is None else now
        step = self._step(reading, now)
        self._newest = max(self._newest, now)
        if step <= 0 and (step < 0 or self._open is None):
            again = step == 0 and self._closed[reading.segment] is not None
            self.count("repeated" if again else "late")
            return ()
        closed = self._begin(reading, step) if step else ()
        frame = self._open
        if frame is None:  # a step begins a frame, and without one there was a frame
            return closed
        if (held := frame.payloads[reading.segment]) is not None:
            self.count("repeated")
            if held != reading.payload:
                frame.disputed.add(reading.segment)
                frame.ended = max(frame.ended, reading.time)
            return closed
        if reading.segment < frame.highest and self.codec.modulus is not None:
            self.count("late")
        frame.add(reading, now)
        return closed if frame.left else (*closed, *self._close())

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
        return again or (self._cycle is not None and self._cycle.wraps(frame.came[-1][0], segment))

    def _begin(self, reading: Reading, step: int) -> tuple[RawFrame, ...]:
        """Close the open frame, count the frames between as lost, open the reading's own."""
        closed = self._close() if self._open is not None else ()
        self.count("lost", (step - 1) * self.codec.segments)
        self._wire, self._sequence = reading.sequence, self._sequence + step
        self._open = _Open(self.codec, reading)
        return closed

    def _close(self) -> tuple[RawFrame, ...]:
        frame, self._open = self._open, None
        if frame is None:
            return ()
        self._closed = frame.payloads
        if self._cycle is not None:
            self._cycle.learn(frame, frame.began - self._ended)
        self._ended = frame.ended
        self.count("lost", frame.left)
        frame.settle()
        skew = frame.ended - frame.began
        try:
            counts = self.codec.unpack(frame.payloads)
            shear = self.codec.shear(frame.payloads) if isinstance(self.codec, Shearing) else None
        except CodecError:  # another package's codec: none of ours raises here
            self.count("malformed", self.codec.segments - frame.left)
            return ()
        flags = self._flags(frame)
        self.count("incomplete", int(None in frame.payloads))
        return (RawFrame(self._sequence, frame.began, skew, counts, flags, self.loss, shear, frame.arrived),)

    def _flags(self, frame: _Open) -> NDArray[np.uint8]:
        flags = np.zeros(self.codec.size, np.uint8)
        if None in frame.payloads:
            for segment, payload in enumerate(frame.payloads):
                if payload is None:
                    flags[self.codec.span(segment)] = MISSING
        flags[frame.bad] |= BAD
        return flags


def assemble(codec: Codec, messages: Iterable[Message]) -> tuple[list[RawFrame], Loss]:
    """The frames in some messages, and what was lost; messages that mean nothing are passed over."""
    assembler = Assembler(codec)
    frames: list[RawFrame] = []
    for message in messages:
        try:
            frames += assembler.push(codec.decode(message))
        except CodecError:
            continue
    return frames, assembler.loss


def whole(frames: Iterable[RawFrame]) -> list[RawFrame]:
    """Those of some frames of which no taxel is missing or bad."""
    return [each for each in frames if not each.flags.any()]
