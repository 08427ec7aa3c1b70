"""The packed layout: any array of 8 to 16 bit taxels, sequence number and segment index in every message."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tactiled.errors import CodecError, ConfigError
from tactiled.frames import Message, Reading

HEADER = 2  # bytes: sequence number, segment index
CLASSIC, FD = 8, 64  # bytes a message
LENGTHS: tuple[int, ...] = (*range(9), 12, 16, 20, 24, 32, 48, 64)  # that CAN and CAN FD know
MOST = 256  # segments


@dataclass(frozen=True)
class Packed:
    """Taxels in row-major order, `bits` each, whole taxels only in a message."""

    size: int
    bits: int = 12
    fd: bool = False
    array_id: int = 0
    base_id: int = 0x500
    extended: bool = False

    def __post_init__(self) -> None:
        """Refuse what the layout cannot carry."""
        if not 8 <= self.bits <= 16:
            raise ConfigError(f"codec.bits = {self.bits}: the packed layout carries 8 to 16 bits a taxel")
        top = 0x1FFFFFFF if self.extended else 0x7FF
        if not 0 <= self.id <= top:
            raise ConfigError(f"codec id {self.id:#x} (base_id + array_id) is past {top:#x}: lower base_id")
        if self.segments > MOST:
            raise ConfigError(
                f"{self.size} taxels of {self.bits} bits need {self.segments} messages a frame and the packed "
                f"layout has at most {MOST}: use fewer bits{'' if self.fd else ', or CAN FD (fd = true)'}"
            )

    @property
    def id(self) -> int:
        """The one CAN id of the array."""
        return self.base_id + self.array_id

    @property
    def ids(self) -> frozenset[tuple[int, bool]]:
        """The (id, extended) of the messages it listens to."""
        return frozenset({(self.id, self.extended)})

    @property
    def modulus(self) -> int:
        """What the sequence counter wraps at."""
        return 256

    @property
    def ordered(self) -> int:
        """Segments that come in order: the sequence number tells, not the order."""
        return 1

    @property
    def full_scale(self) -> int:
        """Largest count."""
        return (1 << self.bits) - 1

    @property
    def taxels(self) -> int:
        """Taxels in a full segment."""
        return ((FD if self.fd else CLASSIC) - HEADER) * 8 // self.bits

    @property
    def segments(self) -> int:
        """Messages in a whole frame."""
        return -(-self.size // self.taxels)

    def span(self, segment: int) -> slice:
        """The taxels that a segment carries."""
        return slice(segment * self.taxels, min((segment + 1) * self.taxels, self.size))

    def _length(self, taxels: int) -> int:
        """Bytes of the message that carries so many taxels."""
        return next(length for length in LENGTHS if length >= HEADER + -(-taxels * self.bits // 8))

    def decode(self, message: Message) -> Reading:
        """What one message says; CodecError where its kind, index, length or padding is not the layout's."""
        data = message.data
        if message.fd != self.fd:
            raise CodecError(f"{'CAN FD' if message.fd else 'classic'} message where the other kind is configured")
        if len(data) < HEADER or data[1] >= self.segments:
            raise CodecError(f"segment {data[1] if len(data) > 1 else 'index missing'} of {self.segments}")
        span = self.span(data[1])
        count = span.stop - span.start
        if len(data) != self._length(count):
            raise CodecError(f"{len(data)} bytes in segment {data[1]}, expected {self._length(count)}")
        counts, rest = _unpack(data[HEADER:], count, self.bits)
        if rest:
            raise CodecError(f"padding of segment {data[1]} is not 0")
        return Reading(message.time, data[1], span.start, counts, data[0])

    def encode(self, counts: NDArray[np.uint16], sequence: int, time: float) -> list[Message]:
        """The messages of one frame (N,); CodecError where a count needs more bits."""
        counts = np.ascontiguousarray(counts, np.uint16)
        if counts.shape != (self.size,) or int(counts.max()) > self.full_scale:
            raise CodecError(
                f"counts {counts.shape} up to {counts.max()}: expected {self.size} up to {self.full_scale}"
            )
        return [self._message(counts, sequence % 256, segment, time) for segment in range(self.segments)]

    def _message(self, counts: NDArray[np.uint16], sequence: int, segment: int, time: float) -> Message:
        part = counts[self.span(segment)]
        payload = _pack(part, self.bits)
        data = bytes((sequence, segment)) + payload
        return Message(time, self.id, data.ljust(self._length(len(part)), b"\0"), self.extended, self.fd)


def _pack(counts: NDArray[np.uint16], bits: int) -> bytes:
    """Counts as one little-endian integer of `bits` a taxel."""
    if bits == 16:
        return counts.astype("<u2").tobytes()
    if bits == 8:
        return counts.astype(np.uint8).tobytes()
    pairs = np.unpackbits(counts.astype("<u2").view(np.uint8), bitorder="little").reshape(-1, 16)
    return np.packbits(pairs[:, :bits], bitorder="little").tobytes()


def _unpack(payload: bytes, count: int, bits: int) -> tuple[NDArray[np.uint16], bool]:
    """The first `count` taxels of a payload, and whether any bit behind them is set."""
    stream = np.unpackbits(np.frombuffer(payload, np.uint8), bitorder="little")
    used = count * bits
    wide = np.zeros((count, 16), np.uint8)
    wide[:, :bits] = stream[:used].reshape(count, bits)
    return np.packbits(wide, bitorder="little").view("<u2").astype(np.uint16), bool(stream[used:].any())
