"""iCub MTB skin: triangles of twelve pads of 8 bits, two messages a triangle; the value falls as pressure rises.

Source of the layout: robotology's icub-firmware-shared (canProtocolLib), icub-firmware (embot/prot/can) and
icub-main (canBusSkin, skinLib).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from tactiled.bounds import Bounds
from tactiled.bus.batch import Batch
from tactiled.bus.codec import (
    BatchCodec,
    ClassicSkin,
    Key,
    Match,
    Readings,
    Traffic,
    missing,
    require_distinct,
    stacked,
    standard_ids,
    understands,
)
from tactiled.bus.polling import Polling
from tactiled.frames import Counts, Message

PERIODIC, OLD, POLL = 0x400, 0x300, 0x200  # message classes: skin data, skin data of older boards, set-up
HEAD, TAIL = 0x40, 0xC0  # first byte: pads 0-6, pads 7-11 and diagnostics
PADS, HEAD_PADS = 12, 7
THERMAL = (6, 10)  # pads that follow temperature, not pressure
NO_LOAD = 240  # counts of an unloaded pad, the host's default
UNITS_PER_MM = 40  # of the table below
PAD_POSITIONS = (
    (257.2, 0.0), (385.83, -222.83), (128.62, -222.83), (0.0, 0.0), (-128.62, -222.83), (-385.83, -222.83),
    (-256.3, -147.64), (-257.2, 0.0), (-128.62, 222.83), (0.0, 445.54), (0.0, 296.55), (128.62, 222.83),
)  # fmt: skip
SET_UP_S = 0.5  # between a board's set-up and its start
TRIANGLE_PITCH_MM = 25.0  # between the centres of triangles drawn side by side


@dataclass(frozen=True)
class Icub(BatchCodec, ClassicSkin):
    """iCub MTB board with triangles of 10 or 12 taxels."""

    board: Annotated[int, Bounds(0, 15)]
    """Number of the board."""
    triangles: Annotated[tuple[Annotated[int, Bounds(0, 15)], ...], Field(min_length=1, max_length=16)]
    """Numbers of the triangles, in the order of their taxels."""
    thermal_pads: bool = True
    """Pads 6 and 10 measure temperature and are left out; false: they are taxels, as on a fingertip."""
    start: bool = False
    """Set up and start the board when the service starts."""
    period_ms: Annotated[int, Bounds(1, 255, "ms")] = 30
    """Time between two frames of a board that the service starts."""

    full_scale, ordered = 255, 2  # a head, then its tail
    kpa_per_count, no_load = -1.0, float(NO_LOAD)

    def __post_init__(self) -> None:
        """Refuse a triangle named twice."""
        require_distinct("triangles", self.triangles)

    @cached_property
    def pads(self) -> tuple[int, ...]:
        """The pads of a triangle that are taxels."""
        return tuple(pad for pad in range(PADS) if not (self.thermal_pads and pad in THERMAL))

    @cached_property
    def positions(self) -> NDArray[np.float64]:
        """Where the taxels are (N, 2), mm: each triangle flat, side by side along x."""
        triangle = np.array([PAD_POSITIONS[pad] for pad in self.pads]) / UNITS_PER_MM
        offsets = np.arange(len(self.triangles))[:, None, None] * (TRIANGLE_PITCH_MM, 0.0)
        return (triangle + offsets).reshape(-1, 2)

    @cached_property
    def size(self) -> int:
        """Taxels in a frame."""
        return len(self.pads) * len(self.triangles)

    @cached_property
    def segments(self) -> int:
        """A head and a tail for each triangle."""
        return 2 * len(self.triangles)

    @cached_property
    def ids(self) -> frozenset[Key]:
        """An id a triangle, of both generations of boards."""
        return standard_ids(
            *(kind | self.board << 4 | each for kind in (PERIODIC, OLD) for each in self.triangles)
        )

    @cached_property
    def polling(self) -> Polling:
        """Set up, half a second later start, at the end stop: what the robot's own software sends to a board."""
        if not self.start:
            return Polling()
        set_up = bytes((0x4D, 0, self.period_ms, NO_LOAD))
        triangles = bytes((0x50, 0, 15, 0, 1, 0x00, 0x22))  # all; the capacitance converter's set-up is 0x2200
        start = ((0.0, set_up), (0.0, triangles), (SET_UP_S, b"\x07\x00"))
        return Polling(
            start=tuple((after, Message(0.0, POLL | self.board, data)) for after, data in start),
            stop=(Message(0.0, POLL | self.board, b"\x07\x01"),),
        )

    def span(self, segment: int) -> slice:
        """The taxels that a segment carries."""
        place, tail = divmod(segment, 2)
        start, head = place * len(self.pads), sum(pad < HEAD_PADS for pad in self.pads)
        return slice(start + head, start + len(self.pads)) if tail else slice(start, start + head)

    @cached_property
    def _places(self) -> NDArray[np.int64]:
        """The place (16,) of every triangle among those of the array; -1 of one that is not configured."""
        places = np.full(16, -1)
        places[list(self.triangles)] = np.arange(len(self.triangles))
        return places

    def readings(self, batch: Batch) -> Readings:
        """Heads, and tails with or without diagnostics, of the configured triangles."""
        data, lengths, first = batch.data, batch.lengths, batch.data[:, 0]
        places, tail = self._places[batch.ids & 0xF], first == TAIL
        good = ((lengths == 8) & (tail | (first == HEAD))) | ((lengths == 6) & tail)
        good &= (places >= 0) & ~batch.fd
        marked = np.flatnonzero(tail & good & data[:, 6:8].any(axis=1)).tolist()
        bad = {row: self._bad(int(places[row]), data[row].tobytes()) for row in marked}
        return Readings(batch.times, 2 * places + tail, data[:, 1:8], good, bad=bad)

    def unpack(self, payloads: Sequence[bytes | None]) -> NDArray[np.uint16]:
        """The counts (N,) of one frame; 0 where a segment is None."""
        return _triangles(payloads)[:, self.pads].astype(np.uint16).ravel()

    def references(self, payloads: Sequence[bytes | None]) -> NDArray[np.float32] | None:
        """Counts (2 triangles,) of the thermal pads of each triangle, in order; NaN where missing or bad."""
        if not self.thermal_pads:
            return None
        triangles = _triangles(payloads)
        thermal = triangles[:, THERMAL].astype(np.float32).ravel()
        thermal[missing(payloads)] = np.nan  # pad 6 is in the head, pad 10 in the tail
        diagnostics = triangles[:, PADS:]
        if diagnostics.any():
            codes = diagnostics.astype(int) @ (1 << 8, 1)
            thermal[(codes[:, None] & [_bits(pad) for pad in THERMAL] != 0).ravel()] = np.nan
        return thermal

    def _bad(self, place: int, data: bytes) -> tuple[int, ...]:
        """Taxels that a tail's diagnostics call out of range; all of them where the triangle does not answer."""
        code, first = data[6] << 8 | data[7], place * len(self.pads)
        return tuple(first + at for at, pad in enumerate(self.pads) if code & _bits(pad))

    def encode(self, counts: Counts, sequence: int, time: float) -> list[Message]:
        """The messages of one frame (N,); thermal pads have no load; the sequence number has no place in them."""
        del sequence
        pads = np.full((len(self.triangles), PADS), NO_LOAD, np.uint8)
        pads[:, self.pads] = self.checked(counts).reshape(len(self.triangles), -1)
        messages = []
        for triangle, data in zip(self.triangles, map(bytes, pads), strict=True):
            id_ = PERIODIC | self.board << 4 | triangle
            messages.append(Message(time, id_, bytes((HEAD, *data[:HEAD_PADS]))))
            messages.append(Message(time, id_, bytes((TAIL, *data[HEAD_PADS:], 0, 0))))
        return messages

    @classmethod
    def recognise(cls, traffic: Traffic) -> Iterator[Match]:
        """Heads and tails by triangle."""
        note = "thermal_pads: false where pads 6 and 10 are taxels too, as on a fingertip"
        for kind, age in ((PERIODIC, "class 0x400"), (OLD, "class 0x300, an older board")):
            for board in range(16):
                keys = tuple(
                    key
                    for key in traffic.standard(kind | board << 4 | triangle for triangle in range(16))
                    if {each.data[0] for each in traffic[key] if each.data} == {HEAD, TAIL}
                )
                triangles = tuple(id_ & 0xF for id_, _ in keys)
                codec = cls(board, triangles)
                if keys and understands(codec, traffic.messages(keys)):
                    listed = ", ".join(map(str, triangles))
                    description = f"iCub MTB, {age}, board {board}, triangles {listed}"
                    settings = {"board": board, "triangles": list(triangles)}
                    yield Match(settings, codec, keys, None, description, (note,))


def _bits(pad: int) -> int:
    """Those of a tail's diagnostics that call a pad out of range, or say that its triangle does not answer."""
    return 0xF | 1 << (4 + pad)


def _triangles(payloads: Sequence[bytes | None]) -> NDArray[np.uint8]:
    """All pads of a frame's triangles, each followed by its diagnostics (triangles, PADS + 2); 0 for None."""
    return stacked(payloads, HEAD_PADS).reshape(-1, 2 * HEAD_PADS)


SKIN = Icub
