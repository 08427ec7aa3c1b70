"""Frames that a program pushes: floats, carried inside the service, and in its recordings, as CAN FD messages.

A message has a sequence number (32 bits), a segment (16 bits), two zeros and 14 taxels (float32), little-endian.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tactiled.bounds import MAX_READING
from tactiled.bus.batch import MAX_BYTES, Batch, Key
from tactiled.bus.codec import (
    Codec,
    Match,
    Readings,
    Skin,
    Traffic,
    stacked,
    standard_ids,
    understands,
)
from tactiled.bus.codecs.packed import squarest
from tactiled.errors import CodecError
from tactiled.frames import MISSING, Counts, Message
from tactiled.geometry import Array

ID = 0x600
HEADER = 8  # bytes
TAXELS = (MAX_BYTES - HEADER) // 4  # in a message
MAX_TAXELS = TAXELS << 16


@dataclass(frozen=True)
class Pushed(Codec):
    """The layout of an array of `taxels`; where a value is not finite, the frame lacks its taxel."""

    taxels: int

    modulus, full_scale, bad_flag, rounds = 1 << 32, 0xFFFF, MISSING, False

    @cached_property
    def size(self) -> int:
        """Taxels in a frame."""
        return self.taxels

    @cached_property
    def segments(self) -> int:
        """Messages in a whole frame."""
        return -(-self.taxels // TAXELS)

    @cached_property
    def ordered(self) -> int:
        """All segments come in order."""
        return self.segments

    @cached_property
    def ids(self) -> frozenset[Key]:
        """One id, on a bus of the array's own."""
        return standard_ids(ID)

    def span(self, segment: int) -> slice:
        """The taxels that a segment carries."""
        return slice(segment * TAXELS, min((segment + 1) * TAXELS, self.taxels))

    def readings(self, batch: Batch) -> Readings:
        """Sequence number, segment and floats of every message."""
        head = np.ascontiguousarray(batch.data[:, :HEADER])
        sequences, segments = head.view("<u4")[:, 0].astype(np.int64), head.view("<u2")[:, 2].astype(np.int64)
        good = (batch.lengths == MAX_BYTES) & batch.fd & (segments < self.segments) & ~head[:, 6:].any(axis=1)
        payloads = np.ascontiguousarray(batch.data[:, HEADER:])
        unknown = ~_are_readings(payloads.view("<f4"))
        marked = np.flatnonzero(unknown.any(axis=1) & good).tolist()
        bad = {row: self._taxels_of(int(segments[row]), unknown[row]) for row in marked}
        return Readings(batch.times, segments, payloads, good, sequences, bad)

    def _taxels_of(self, segment: int, unknown: NDArray[np.bool_]) -> tuple[int, ...]:
        """Taxels of a segment that are `unknown` (TAXELS,)."""
        taxels = segment * TAXELS + np.flatnonzero(unknown)
        return tuple(taxels[taxels < self.taxels].tolist())

    def unpack(self, payloads: Sequence[bytes | None]) -> NDArray[np.float32]:
        """The values (N,) of one frame; 0 where one is no reading, or a segment None."""
        values = np.ascontiguousarray(stacked(payloads, MAX_BYTES - HEADER)).view("<f4").ravel()[: self.taxels]
        return np.where(_are_readings(values), values, 0).astype(np.float32)

    def encode(self, counts: Counts, sequence: int, time: float) -> list[Message]:
        """The messages of one frame (N,), NaN: unknown."""
        if counts.shape != (self.taxels,):
            raise CodecError(f"counts {counts.shape}: expected {self.taxels}")
        table = np.zeros((self.segments, MAX_BYTES), np.uint8)
        head, values = np.zeros((self.segments, 4), "<u2"), np.zeros(self.segments * TAXELS, "<f4")
        head[:, :2] = sequence % self.modulus & 0xFFFF, sequence % self.modulus >> 16
        head[:, 2] = np.arange(self.segments)
        values[: self.taxels] = counts
        table[:, :HEADER], table[:, HEADER:] = (
            head.view(np.uint8),
            values.view(np.uint8).reshape(self.segments, -1),
        )
        return [Message(time, ID, row.tobytes(), fd=True) for row in table]


@dataclass(frozen=True)
class Settings(Skin):
    """Any array whose frames a program pushes into the service."""

    def codec(self, array: Array) -> Codec:
        """The layout of an array."""
        return Pushed(array.size)

    @classmethod
    def recognise(cls, traffic: Traffic) -> Iterator[Match]:
        """Every segment, as a recording has them."""
        messages = Batch.of(traffic.get((ID, False), ()))
        if not len(messages) or not understands(every := Pushed(MAX_TAXELS), messages):
            return
        readings = every.readings(messages)
        taxels = readings.segments[:, None] * TAXELS + np.arange(TAXELS)
        sent = taxels[readings.payloads.view("<f4") != 0]  # behind the last of them is padding, or rest at 0
        codec = Pushed(int(sent.max(initial=0)) + 1)
        if {*readings.segments.tolist()} == {*range(codec.segments)}:
            shape = squarest(codec.size, codec.size)
            note = f"array: at least {codec.size} taxels"
            yield Match({}, codec, ((ID, False),), shape, "frames that a program pushed", (note,))


def _are_readings(values: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Which are numbers that a sensor may give: neither infinite nor NaN, nor past MAX_READING."""
    return np.abs(values) <= MAX_READING


SKIN = Settings
