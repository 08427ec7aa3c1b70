"""The packed layout: any array of 8 to 16 bit taxels, sequence number and segment index in every message."""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field
from functools import cached_property
from itertools import pairwise
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactiled.bounds import Bounds
from tactiled.bus.assembler import assemble
from tactiled.bus.batch import Batch, Key
from tactiled.bus.codec import Codec, Match, Readings, Skin, Traffic, stacked, understands
from tactiled.bus.grid_shape import alike_shapes
from tactiled.core import messages
from tactiled.errors import ConfigError
from tactiled.frames import Counts, Message
from tactiled.geometry import Array

HEADER = 2  # bytes: sequence number, segment index
CLASSIC, FD = 8, 64  # bytes a message
LENGTHS: tuple[int, ...] = (*range(9), 12, 16, 20, 24, 32, 48, 64)  # that CAN and CAN FD know
MAX_SEGMENTS = 256
DEFAULT_BITS = 12
SHAPE_FRAMES = 1000  # from which rows and columns are guessed


@dataclass(frozen=True)
class Packed(Codec):
    """Taxels in row-major order, `bits` each, no taxel split between messages."""

    size: int = field()
    bits: int = DEFAULT_BITS
    fd: bool = False
    array_id: int = 0
    base_id: int = 0x500
    extended: bool = False

    modulus = 256

    def __post_init__(self) -> None:
        """Refuse what the layout cannot carry."""
        top = 0x1FFFFFFF if self.extended else 0x7FF
        if self.id > top:
            raise ConfigError(f"codec id {self.id:#x} (base_id + array_id) is past {top:#x}: lower base_id")
        if self.segments > MAX_SEGMENTS:
            raise ConfigError(
                f"{self.size} taxels of {self.bits} bits need {self.segments} messages a frame and the packed "
                f"layout has at most {MAX_SEGMENTS}: use fewer bits{'' if self.fd else ', or CAN FD (fd = true)'}"
            )

    @property
    def id(self) -> int:
        """The array's one CAN id."""
        return self.base_id + self.array_id

    @cached_property
    def ids(self) -> frozenset[Key]:
        """That id."""
        return frozenset({(self.id, self.extended)})

    @cached_property
    def full_scale(self) -> int:
        """Largest count."""
        return (1 << self.bits) - 1

    @cached_property
    def taxels(self) -> int:
        """Taxels in a full segment."""
        return ((FD if self.fd else CLASSIC) - HEADER) * 8 // self.bits

    @cached_property
    def segments(self) -> int:
        """Messages in a whole frame."""
        return -(-self.size // self.taxels)

    def span(self, segment: int) -> slice:
        """The taxels that a segment carries."""
        return slice(segment * self.taxels, min((segment + 1) * self.taxels, self.size))

    @cached_property
    def _forms(self) -> tuple[tuple[int, int, int], ...]:
        """For each segment the message's length and, byte and bit, where its padding begins."""
        sizes = [min(self.taxels, self.size - first) for first in range(0, self.size, self.taxels)]
        ends = [divmod(n * self.bits, 8) for n in sizes]
        lengths = [next(each for each in LENGTHS if each >= HEADER + byte + (bit > 0)) for byte, bit in ends]
        return tuple((length, HEADER + byte, bit) for length, (byte, bit) in zip(lengths, ends, strict=True))

    @cached_property
    def _lengths(self) -> NDArray[np.uint8]:
        """The length (256,) of a message by the segment that it names; 0 where the frame has none such."""
        lengths = np.zeros(MAX_SEGMENTS, np.uint8)
        lengths[: self.segments] = [length for length, _, _ in self._forms]
        return lengths

    @cached_property
    def _padding(self) -> tuple[int, NDArray[np.uint8]]:
        """The first column of the data that any segment pads, and the bits (256, columns) that must be 0."""
        bits = np.zeros((MAX_SEGMENTS, HEADER + self._width), np.uint8)
        for segment, (length, byte, bit) in enumerate(self._forms):
            bits[segment, byte:length] = 0xFF
            bits[segment, byte : byte + 1] &= 0xFF << bit & 0xFF
        padded = np.flatnonzero(bits.any(axis=0))
        first = int(padded[0]) if padded.size else HEADER + self._width
        return first, np.ascontiguousarray(bits[:, first:])

    @cached_property
    def _width(self) -> int:
        """Bytes of a full segment's payload."""
        return self._forms[0][0] - HEADER

    def readings(self, batch: Batch) -> Readings:
        """A batch; malformed is a message whose kind, index, length or padding is not the layout's."""
        sequences, segments = np.empty(len(batch), np.int64), np.empty(len(batch), np.int64)
        good = np.empty(len(batch), np.bool_)
        kinds, (first, bits) = batch.fd.view(np.uint8), self._padding
        expected = self.fd, self._lengths, bits, first
        messages.well_formed(batch.data, batch.lengths, kinds, *expected, sequences, segments, good.view(np.uint8))
        return Readings(batch.times, segments, batch.data[:, HEADER : HEADER + self._width], good, sequences)

    def unpack(self, payloads: Sequence[bytes | None]) -> NDArray[np.uint16]:
        """The counts (N,) of one frame; 0 where a segment is None."""
        counts = np.empty(self.size, np.uint16)
        messages.unpack(stacked(payloads, self._width), self.bits, self.taxels, counts)
        return counts

    def encode(self, counts: Counts, sequence: int, time: float) -> list[Message]:
        """The messages of one frame (N,); CodecError where a count needs more bits."""
        padded = np.zeros(self.segments * self.taxels, "<u2")
        padded[: self.size] = self.checked(counts)
        bits = np.unpackbits(padded.view(np.uint8).reshape(-1, 2), axis=1, bitorder="little")[:, : self.bits]
        payload = np.packbits(bits.reshape(self.segments, -1), axis=1, bitorder="little")
        header = np.column_stack([np.full(self.segments, sequence % 256), np.arange(self.segments)])
        table = np.hstack([header.astype(np.uint8), payload])
        return [
            Message(time, self.id, row.tobytes()[: form[0]], self.extended, self.fd)
            for row, form in zip(table, self._forms, strict=True)
        ]


@dataclass(frozen=True)
class Settings(Skin):
    """Any array, in this project's own open layout."""

    array_id: Annotated[int, Bounds(0, 15)] = 0
    """Number of the array: its messages have the CAN id `base_id` + `array_id`."""
    base_id: Annotated[int, Bounds(0, 0x1FFFFFF0, hexadecimal=True)] = 0x500
    """First CAN id of the layout."""
    extended: bool = False
    """Ids have 29 bits; false: 11 bits."""
    bits: Annotated[int, Bounds(8, 16)] = DEFAULT_BITS
    """Bits of one taxel."""
    fd: bool = False
    """CAN FD messages of up to 64 bytes; false: classic messages of up to 8 bytes."""

    def codec(self, array: Array) -> Packed:
        """The layout of an array; ConfigError where the array is larger than it can carry."""
        return Packed(array.size, **asdict(self))

    @classmethod
    def recognise(cls, traffic: Traffic) -> Iterator[Match]:
        """Sequence numbers and segments that count up."""
        for key, came in traffic.items():
            fits = packed_fits(key, came) if _counts_up(came) else []
            if fits:
                yield _match(key, came, fits)


SKIN = Settings


class Fit(NamedTuple):
    """A width of the taxels that lengths and padding allow."""

    bits: int
    min_size: int  # taxels
    max_size: int
    roughness: float  # mean step from taxel to taxel over full scale: small where the width is right

    @property
    def sizes(self) -> str:
        """How many taxels there may be."""
        return f"{self.min_size}" if self.min_size == self.max_size else f"{self.min_size} to {self.max_size}"


def _counts_up(messages: Sequence[Message]) -> bool:
    """Whether nearly every message may follow the one before it; some may be lost between them."""
    if len(messages) < 4 or any(len(each.data) < HEADER or each.fd != messages[0].fd for each in messages):
        return False
    heads = [(each.data[0], each.data[1]) for each in messages]
    last = max(segment for _, segment in heads)
    if {segment for _, segment in heads} != set(range(last + 1)):
        return False
    follows = sum(
        after == ((sequence, segment + 1) if segment < last else ((sequence + 1) % 256, 0))
        for (sequence, segment), after in pairwise(heads)
    )
    return follows >= 0.8 * (len(messages) - 1)


def packed_fits(key: Key, messages: Sequence[Message]) -> list[Fit]:
    """Every width, with its numbers of taxels, whose lengths and padding are those of an id's messages."""

    def codec(size: int, bits: int) -> Packed:
        return Packed(size, bits, messages[0].fd, 0, *key)

    segments = max(each.data[1] for each in messages) + 1
    full = Batch.of({each.data: each for each in messages if each.data[1] < segments - 1}.values())
    last = Batch.of({each.data: each for each in messages if each.data[1] == segments - 1}.values())
    fits = []
    for bits in range(8, 17):
        taxels = codec(1, bits).taxels
        sizes = range((segments - 1) * taxels + 1, segments * taxels + 1)
        if len(full) and not understands(codec(sizes[-1], bits), full):
            continue
        good = [size for size in sizes if understands(codec(size, bits), last)]
        if good:
            fits.append(Fit(bits, good[0], good[-1], _roughness(codec(good[0], bits), messages)))
    return fits


def _counts(codec: Packed, messages: Sequence[Message], frames: int) -> NDArray[np.float64]:
    """Counts (T, N) of the first whole frames."""
    first = assemble(codec, messages[: frames * codec.segments])[0]
    return np.array([each.counts for each in first if not each.flags.any()], np.float64).reshape(-1, codec.size)


def _roughness(codec: Packed, messages: Sequence[Message]) -> float:
    """Mean step from taxel to taxel of the first frames, over full scale."""
    counts = _counts(codec, messages, 100)
    return float(np.abs(np.diff(counts)).mean() / codec.full_scale) if len(counts) and codec.size > 1 else 0.0


def likeliest(fits: Sequence[Fit]) -> Fit:
    """The width with the least roughness, of nearly equal ones the smallest; DEFAULT_BITS if all have none."""
    if all(each.roughness == 0 for each in fits):
        return next((each for each in fits if each.bits == DEFAULT_BITS), fits[0])
    bound = 1.25 * min(each.roughness for each in fits) + 1e-3
    return next(each for each in fits if each.roughness <= bound)


def squarest(min_size: int, max_size: int) -> tuple[int, int]:
    """The squarest rows x columns with so many taxels; of equally square ones the largest."""
    sizes = range(min_size, max_size + 1)
    sides = [(rows, size // rows) for size in sizes for rows in range(1, size + 1) if not size % rows]
    return min((each for each in sides if each[0] <= each[1]), key=lambda each: (each[1] / each[0], -each[0]))


def _match(key: Key, messages: Sequence[Message], fits: Sequence[Fit]) -> Match:
    """The array of the likeliest fit; the others are notes."""
    best, fd = likeliest(fits), messages[0].fd
    id_, extended = key
    usual = not extended and 0x500 <= id_ <= 0x50F
    base_id, array_id = (0x500, id_ - 0x500) if usual else (id_, 0)
    settings: dict[str, Any] = {
        "base_id": base_id, "array_id": array_id, "extended": extended, "bits": best.bits, "fd": fd,
    }  # fmt: skip
    kind = "CAN FD" if fd else "classic"
    description = f"packed layout, {kind}, array {array_id} at {base_id:#x}, {best.bits} bits a taxel"
    counts = _counts(Packed(best.max_size, **settings), messages, SHAPE_FRAMES)
    ever = np.flatnonzero(counts.any(axis=0))  # behind the last of these is padding, or taxels that rest at 0
    max_size = max(best.min_size, int(ever[-1]) + 1) if ever.size else best.max_size
    shapes = alike_shapes(counts, range(best.min_size, max_size + 1))
    rows, columns = shape = shapes[0] if shapes else squarest(best.min_size, max_size)
    unclear = "" if rows == columns else "; slide a finger over it to tell"
    why = ", in which neighbours change alike" if shapes else unclear
    notes = [f"array: {best.sizes} taxels fit; best guess: {rows} x {columns}{why}"]
    if others := ", ".join(f"{each.bits} ({each.sizes})" for each in fits if each is not best):
        notes.append(f"bits: {best.bits} give the smoothest image; also possible: {others} taxels")
    codec = Packed(rows * columns, **settings)
    return Match(settings, codec, (key,), shape, description, tuple(notes), pitch_mm=1.0)
