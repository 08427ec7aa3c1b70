"""Readings to frames: lost messages are counted and marked, never made up; pure."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from tactiled.bus.arrivals import NOWHERE, Arrivals, decoded, moment
from tactiled.bus.batch import Batch
from tactiled.bus.codec import NO_SEQUENCE, Codec
from tactiled.bus.open_frame import Cycle, OpenFrame
from tactiled.errors import CodecError
from tactiled.frames import MISSING, Counts, Loss, Message, RawFrame

SILENCE_S = 0.05  # of a silent bus, after which `flush` is to close an incomplete frame
BUSY_S = 0.5  # the same without a message of the sensor, while others keep the bus busy
# A lower sequence number means a restarted sender: after a silence of RESTART_S, or after RESTART_FRAMES frames.
RESTART_S, RESTART_FRAMES = 0.25, 3


@dataclass(slots=True)
class _Others:
    """Messages of one kind of loss: the rows of a batch before which they came, ascending."""

    kind: str
    places: NDArray[np.int64]
    counted: int = 0  # so far


class Assembler:
    """Collects one array's readings into frames.

    A frame is published when its last segment is in, or, marked, when a message of a newer frame comes first or
    `flush` finds it too old. Without sequence numbers (`codec.modulus` None) a segment that comes again, or behind
    one that it always comes before, begins a newer frame. A sender that restarts its sequence numbers is
    followed at once after a silence, else after RESTART_FRAMES. If a segment comes twice with different payloads,
    neither is used: one of two senders is wrong. Any error of a codec counts as a malformed message.

    Ages and silences are computed from `now` (s), the arrival, which never steps back. The times of messages are
    only data, as their clock may step back.
    """

    def __init__(self, codec: Codec, bus_counts: Callable[[], Mapping[str, int]] = dict) -> None:
        """`bus_counts` gives what the bus itself counts, by the names of `Loss`."""
        self.codec, self._bus_counts = codec, bus_counts
        self._counts = {each.name: 0 for each in fields(Loss)}  # its keys never change: other threads read it
        self._loss: Loss | None = None  # of the last frame; None after a new count
        self._open: OpenFrame | None = None
        self._closed = np.zeros(codec.segments, np.bool_)  # segments that the frame closed last had
        self._wire = NO_SEQUENCE  # sequence number, as on the bus, of the newest frame begun
        self._sequence = -1  # the same, not wrapped
        self._newest = float("-inf")  # s, when the newest message came
        self._old = 0  # messages in a row of older frames
        self._cycle = Cycle() if codec.modulus is None else None
        self._others: list[_Others] = []  # of the batch that is taken
        self._ended = float("inf")  # s, when the frame closed last had its last message

    def count(self, kind: str, by: int = 1) -> None:
        """Add to one kind of loss."""
        self._counts[kind] += by
        self._loss = None

    @property
    def loss(self) -> Loss:
        """What went wrong so far; any thread."""
        return Loss(**self._counts)

    @property
    def needed(self) -> int:
        """How many more messages complete the open frame, or the next one."""
        return self.codec.segments if self._open is None else self._open.missing

    def push(
        self,
        batch: Batch | Message,
        now: float | NDArray[np.float64] | None = None,
        foreign: NDArray[np.int64] = NOWHERE,
    ) -> list[tuple[int, RawFrame]]:
        """Take messages that arrived at `now` (s; None: their own times); returns closed frames, oldest first.

        Each frame has the row of the message that closed it. `foreign` are the rows of the batch before which the
        bus had a message that belongs to no sensor.
        """
        batch = Batch.of((batch,)) if isinstance(batch, Message) else batch
        arrivals, malformed = decoded(self.codec, batch, now)
        if malformed.size or foreign.size:
            self._others = [_Others("malformed", malformed), _Others("foreign", foreign)]
        frames: list[tuple[int, RawFrame]] = []
        at, count = 0, 0 if arrivals is None else len(arrivals.readings.segments)
        while arrivals is not None and at < count:
            at = self._take(arrivals, at, frames)
        if self._others:
            self._count_others(len(batch))
            self._others = []
        return frames

    def flush(self, before: float) -> tuple[RawFrame, ...]:
        """Close, marked, a frame whose newest message came before time `before` (s)."""
        closed = self._close() if self._open is not None and self._open.arrived < before else None
        return () if closed is None else (closed,)

    def _take(self, arrivals: Arrivals, at: int, frames: list[tuple[int, RawFrame]]) -> int:
        """Take message `at` and the following ones of the same frame; returns the first message not taken."""
        readings, frame = arrivals.readings, self._open
        segment, now = int(readings.segments[at]), moment(arrivals.now, at)
        sequence = NO_SEQUENCE if readings.sequences is None else int(readings.sequences[at])
        step = self._step(segment, sequence, now)
        self._newest = max(self._newest, now)
        if step <= 0 and (step < 0 or frame is None):
            self.count("repeated" if step == 0 and self._closed[segment] else "late")
            self._old = self._old + 1 if step < 0 else 0
            return at + 1
        self._old = 0
        if step or frame is None:
            if frame is not None:
                self._close_at(arrivals.row(at), frames)
            if step > 1:
                self.count("lost", (step - 1) * self.codec.segments)
            self._wire, self._sequence = sequence, self._sequence + step
            frame = self._open = OpenFrame(self.codec, float(readings.times[at]))
        if frame.present[segment]:
            self.count("repeated")
            if not frame.same_payload(segment, readings.payloads[at]):
                frame.disputed.add(segment)
                frame.ended = max(frame.ended, float(readings.times[at]))
            return at + 1
        end, newest, late = frame.fill(arrivals, at, self._cycle)
        if late and self._cycle is None:
            self.count("late", late)
        self._newest = max(self._newest, newest)
        if not frame.missing:
            self._close_at(arrivals.row(end - 1), frames)
        return end

    def _close_at(self, row: int, frames: list[tuple[int, RawFrame]]) -> None:
        """Close the open frame at a message of the batch."""
        if self._others:
            self._count_others(row)
        if closed := self._close():
            frames.append((row, closed))

    def _step(self, segment: int, sequence: int, now: float) -> int:
        """By how many frames a message is ahead of the newest frame; 0: part of it; negative: of an older one."""
        modulus, frame = self.codec.modulus, self._open
        if modulus is None:
            return int(frame is None or self._begins(frame, segment))
        if sequence == NO_SEQUENCE or self._wire == NO_SEQUENCE:
            return 1
        ahead = (sequence - self._wire) % modulus
        step = ahead if ahead <= modulus // 2 else ahead - modulus
        old = step < 0 or (step == 0 and frame is None)
        restarted = now - self._newest > RESTART_S or self._old >= RESTART_FRAMES * self.codec.segments
        return 1 if old and restarted else step

    def _begins(self, frame: OpenFrame, segment: int) -> bool:
        """Whether a segment without a sequence number begins a new frame."""
        end = (segment // self.codec.ordered + 1) * self.codec.ordered
        if np.logical_or.reduce(frame.present[segment:end]) or self._cycle is None:
            return True
        return self._cycle.wraps(int(frame.segments[-1][-1]), segment)

    def _count_others(self, row: int) -> None:
        """Count the malformed and foreign messages up to a row of the batch."""
        for each in self._others:
            count = int(np.searchsorted(each.places, row, "right"))
            if count > each.counted:
                self.count(each.kind, count - each.counted)
            each.counted = count

    def _close(self) -> RawFrame | None:
        """The frame that is open, unless its codec fails."""
        frame, self._open = self._open, None
        if frame is None:
            return None
        self._closed = frame.present
        if self._cycle is not None:
            self._cycle.learn(frame, frame.began - self._ended)
        self._ended = frame.ended
        if frame.missing:
            self.count("lost", frame.missing)
        payloads = frame.used_payloads()
        try:
            counts, shear = unpacked(self.codec, payloads)
            references = self.codec.references(payloads)
        except Exception:  # of another package's codec: none of ours raises here
            self.count("malformed", self.codec.segments - frame.missing)
            return None
        flags = self._flags(frame)
        if frame.missing or frame.disputed:
            self.count("incomplete")
        loss, skew = self._newest_loss(), frame.ended - frame.began
        fields = self._sequence, frame.began, skew, counts, flags, loss, shear, frame.arrived, references
        return RawFrame(*fields)

    def _newest_loss(self) -> Loss:
        """Losses so far, with those of the bus; a new object only after a new count."""
        bus = self._bus_counts()
        if not bus.items() <= self._counts.items():
            self._counts.update(bus)
            self._loss = None
        loss = self._loss = self._loss or Loss(**self._counts)
        return loss

    def _flags(self, frame: OpenFrame) -> NDArray[np.uint8]:
        flags = np.zeros(self.codec.size, np.uint8)
        if frame.missing or frame.disputed:
            for segment in np.flatnonzero(~frame.present).tolist():
                flags[self.codec.span(segment)] = MISSING
        if frame.bad:
            flags[frame.bad] |= self.codec.bad_flag
        return flags


def unpacked(codec: Codec, payloads: Sequence[bytes | None]) -> tuple[Counts, NDArray[np.float32] | None]:
    """The counts (N,) of one frame and the shear (2, N) of a 3-axis skin; CodecError for a wrong type or shape."""
    counts: Counts = codec.unpack(payloads)
    if counts.shape != (codec.size,) or counts.dtype.char not in "Hf":
        raise CodecError(f"unpack gave {counts.dtype} {counts.shape}, not uint16 or float32 {(codec.size,)}")
    if (sheared := codec.shear(payloads)) is None:
        return counts, None
    shear = np.asarray(sheared, np.float32)
    if shear.shape != (2, codec.size):
        raise CodecError(f"shear gave {shear.shape}, not {(2, codec.size)}")
    return counts, shear


def assemble(codec: Codec, messages: Batch | Iterable[Message]) -> tuple[list[RawFrame], Loss]:
    """The frames in some messages, and what was lost."""
    assembler = Assembler(codec)
    batch = messages if isinstance(messages, Batch) else Batch.of(messages)
    return [frame for _, frame in assembler.push(batch)], assembler.loss
