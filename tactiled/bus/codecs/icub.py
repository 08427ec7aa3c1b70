"""iCub MTB skin: triangles of twelve pads of 8 bits, two messages a triangle; the value falls as pressure rises.

Source of the layout: robotology's icub-firmware-shared (canProtocolLib), icub-firmware (embot/prot/can) and
icub-main (canBusSkin, skinLib). Of types, thermal pads and set-up: icub-firmware
(embot/app/embot_app_application_theSkin.cpp) and robots-configuration (hardware/skin/*-skinSpec.xml).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from tactiled.bounds import Bounds
from tactiled.bus.batch import Batch, Key
from tactiled.bus.codec import (
    Match,
    OrderedSkin,
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
THERMAL, HAND_THERMAL = (6, 10), (11,)  # pads that follow temperature, not pressure: of arms and trunk; of hands
PALM_AND_FINGERTIPS, ERGOCUB_HAND = 1, 3  # skin types
ERGOCUB_FINGERTIPS = 5  # triangles of an ergoCub hand that are fingertips; those of the palm come after them
UNITS_PER_MM = 40  # of the table below
PAD_POSITIONS = (
    (257.2, 0.0), (385.83, -222.83), (128.62, -222.83), (0.0, 0.0), (-128.62, -222.83), (-385.83, -222.83),
    (-256.3, -147.64), (-257.2, 0.0), (-128.62, 222.83), (0.0, 445.54), (0.0, 296.55), (128.62, 222.83),
)  # fmt: skip
SET_UP_S = 0.5  # between a board's set-up and its start
TRIANGLE_PITCH_MM = 25.0  # between the centres of triangles drawn side by side


@dataclass(frozen=True)
class Icub(OrderedSkin):
    """iCub MTB board with triangles of 10 or 12 taxels."""

    board: Annotated[int, Bounds(0, 15)]
    """Number of the board."""
    triangles: Annotated[tuple[Annotated[int, Bounds(0, 15)], ...], Field(min_length=1, max_length=16)]
    """Numbers of the triangles, in the order of their taxels."""
    thermal_pads: bool = True
    """Pads that measure temperature are left out; false: they are taxels, as on a fingertip of an iCub."""
    skin_type: Literal[0, 1, 2, 3, 8] = 0
    """`skinType` in the robot's files: 1 palm and fingertips, 3 hand of an ergoCub."""
    start: bool = False
    """Set up and start the board when the service starts."""
    period_ms: Annotated[int, Bounds(1, 255, "ms")] = 30
    """Time between two frames of a board that the service starts."""
    shift: Annotated[int, Bounds(0, 15)] = 2
    """Bits that the board drops from a reading: one more halves the gain and doubles the range."""
    cdc_offset: Annotated[int, Bounds(0, 0xFFFF, hexadecimal=True)] = 0x2200
    """Offset of the board's capacitance converter."""
    no_load: Annotated[int, Bounds(1, 254, "counts")] = 240
    """Counts of an unloaded taxel; the board gets them at its start."""

    full_scale, ordered = 255, 2  # a head, then its tail
    kpa_per_count = -1.0

    def __post_init__(self) -> None:
        """Refuse a triangle named twice."""
        require_distinct("triangles", self.triangles)

    @cached_property
    def is_taxel(self) -> NDArray[np.bool_]:
        """Which pads (triangles, PADS) are taxels; the others are thermal."""
        taxels = np.ones((len(self.triangles), PADS), np.bool_)
        for place, triangle in enumerate(self.triangles if self.thermal_pads else ()):
            fingertip = self.skin_type == ERGOCUB_HAND and triangle < ERGOCUB_FINGERTIPS
            hand = self.skin_type == PALM_AND_FINGERTIPS or fingertip
            taxels[place, list(HAND_THERMAL if hand else THERMAL)] = False
        return taxels

    @cached_property
    def _numbers(self) -> NDArray[np.int64]:
        """The number (triangles, PADS) of each pad among the taxels; of a thermal one, of the taxel after it."""
        return (np.cumsum(self.is_taxel) - self.is_taxel.ravel()).reshape(-1, PADS)

    @cached_property
    def positions(self) -> NDArray[np.float64]:
        """Where the taxels are (N, 2), mm: each triangle flat, side by side along x."""
        offsets = np.arange(len(self.triangles))[:, None, None] * (TRIANGLE_PITCH_MM, 0.0)
        return np.asarray((np.array(PAD_POSITIONS) / UNITS_PER_MM + offsets)[self.is_taxel])

    @cached_property
    def size(self) -> int:
        """Taxels in a frame."""
        return int(self.is_taxel.sum())

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
        offset = self.cdc_offset.to_bytes(2, "little")
        set_up = [bytes((0x4D, self.skin_type, self.period_ms, self.no_load))]
        set_up += [bytes((0x50, *ends, self.shift, 1, *offset)) for ends in _runs(self.triangles)]
        start = [*((0.0, each) for each in set_up), (SET_UP_S, b"\x07\x00")]
        return Polling(
            start=tuple((after, Message(0.0, POLL | self.board, data)) for after, data in start),
            stop=(Message(0.0, POLL | self.board, b"\x07\x01"),),
        )

    def span(self, segment: int) -> slice:
        """The taxels that a segment carries."""
        place, tail = divmod(segment, 2)
        numbers, end = self._numbers[place], int(self._numbers[place, 0] + self.is_taxel[place].sum())
        return slice(int(numbers[HEAD_PADS]), end) if tail else slice(int(numbers[0]), int(numbers[HEAD_PADS]))

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
        return _triangles(payloads)[:, :PADS][self.is_taxel].astype(np.uint16)

    def references(self, payloads: Sequence[bytes | None]) -> NDArray[np.float32] | None:
        """Counts (M,) of the thermal pads of each triangle, in order; NaN where missing or bad."""
        if not self.thermal_pads:
            return None
        triangles, heads_and_tails = _triangles(payloads), missing(payloads).reshape(-1, 2)
        codes = triangles[:, PADS:].astype(int) @ (1 << 8, 1)
        bad = codes[:, None] & [_bits(pad) for pad in range(PADS)] != 0
        bad |= np.repeat(heads_and_tails, (HEAD_PADS, PADS - HEAD_PADS), axis=1)
        return np.where(bad, np.nan, triangles[:, :PADS])[~self.is_taxel].astype(np.float32)

    def _bad(self, place: int, data: bytes) -> tuple[int, ...]:
        """Taxels that a tail's diagnostics call out of range; all of them where the triangle does not answer."""
        code, taxels = data[6] << 8 | data[7], np.flatnonzero(self.is_taxel[place]).tolist()
        return tuple(int(self._numbers[place, pad]) for pad in taxels if code & _bits(pad))

    def encode(self, counts: Counts, sequence: int, time: float) -> list[Message]:
        """The messages of one frame (N,); thermal pads have no load; the sequence number has no place in them."""
        del sequence
        pads = np.full((len(self.triangles), PADS), self.no_load, np.uint8)
        pads[self.is_taxel] = self.checked(counts)
        messages = []
        for triangle, data in zip(self.triangles, map(bytes, pads), strict=True):
            id_ = PERIODIC | self.board << 4 | triangle
            messages.append(Message(time, id_, bytes((HEAD, *data[:HEAD_PADS]))))
            messages.append(Message(time, id_, bytes((TAIL, *data[HEAD_PADS:], 0, 0))))
        return messages

    @classmethod
    def recognise(cls, traffic: Traffic) -> Iterator[Match]:
        """Heads and tails by triangle."""
        notes = (
            "thermal_pads: false where pads 6 and 10 are taxels too, as on a fingertip",
            "skin_type: as in the robot's files, where it is not 0",
        )
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
                    yield Match(settings, codec, keys, None, description, notes)


def _runs(triangles: Sequence[int]) -> list[tuple[int, int]]:
    """First and last of each run of neighbouring triangles."""
    firsts = sorted(each for each in triangles if each - 1 not in triangles)
    lasts = sorted(each for each in triangles if each + 1 not in triangles)
    return list(zip(firsts, lasts, strict=True))


def _bits(pad: int) -> int:
    """Those of a tail's diagnostics that call a pad out of range, or say that its triangle does not answer."""
    return 0xF | 1 << (4 + pad)


def _triangles(payloads: Sequence[bytes | None]) -> NDArray[np.uint8]:
    """All pads of a frame's triangles, each followed by its diagnostics (triangles, PADS + 2); 0 for None."""
    return stacked(payloads, HEAD_PADS).reshape(-1, 2 * HEAD_PADS)


SKIN = Icub
