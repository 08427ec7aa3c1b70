"""The packed layout: any array of 8 to 16 bit taxels, sequence number and segment index in every message."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tactiled.errors import CodecError, ConfigError
from tactiled.frames import Counts, Message, Reading

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

    def _length(self, taxels: int) -> int:
        """Bytes of the message that carries so many taxels."""
        return next(length for length in LENGTHS if length >= HEADER + -(-taxels * self.bits // 8))

    @cached_property
    def _forms(self) -> tuple[tuple[int, int, int], ...]:
        """For each segment the message's length and, byte and bit, where its padding begins."""
        spans = [self.span(segment) for segment in range(self.segments)]
        sizes = [span.stop - span.start for span in spans]
        return tuple((self._length(n), HEADER + n * self.bits // 8, n * self.bits % 8) for n in sizes)

    @cached_property
    def _places(self) -> tuple[NDArray[np.intp], NDArray[np.uint32]]:
        """For each taxel the byte, in the joined payloads, and the bit where it begins."""
        segment, place = np.divmod(np.arange(self.size), self.taxels)
        byte, bit = np.divmod(place * self.bits, 8)
        return segment * (self._forms[0][0] - HEADER) + byte, bit.astype(np.uint32)

    def decode(self, message: Message) -> Reading:
        """What one message says; CodecError where its kind, index, length or padding is not the layout's."""
        data = message.data
        if message.fd != self.fd:
            raise CodecError(f"{'CAN FD' if message.fd else 'classic'} message where the other kind is configured")
        if len(data) < HEADER or data[1] >= self.segments:
            raise CodecError(f"segment {data[1] if len(data) > 1 else 'index missing'} of {self.segments}")
        length, byte, bit = self._forms[data[1]]
        if len(data) != length:
            raise CodecError(f"{len(data)} bytes in segment {data[1]}, expected {length}")
        if int.from_bytes(data[byte:], "little") >> bit:
            raise CodecError(f"padding of segment {data[1]} is not 0")
        return Reading(message.time, data[1], data[HEADER:], data[0])

    def unpack(self, payloads: Sequence[bytes | None]) -> NDArray[np.uint16]:
        """The counts (N,) of one frame; 0 where a segment is None."""
        pairs = zip(payloads, self._forms, strict=True)
        whole = (bytes(form[0] - HEADER) if each is None else each for each, form in pairs)
        stream = np.frombuffer(b"".join((*whole, bytes(2))), np.uint8).astype(np.uint32)
        windows = stream[:-2] | stream[1:-1] << 8 | stream[2:] << 16  # 24 bits from every byte on hold any taxel
        byte, bit = self._places
        return (windows[byte] >> bit & self.full_scale).astype(np.uint16)

    def encode(self, counts: Counts, sequence: int, time: float) -> list[Message]:
        """The messages of one frame (N,); CodecError where a count needs more bits."""
        counts = np.asarray(counts, "<u2")
        if counts.shape != (self.size,) or int(counts.max()) > self.full_scale:
            raise CodecError(
                f"counts {counts.shape} up to {counts.max()}: expected {self.size} up to {self.full_scale}"
            )
        padded = np.zeros(self.segments * self.taxels, "<u2")
        padded[: self.size] = counts
        bits = np.unpackbits(padded.view(np.uint8).reshape(-1, 2), axis=1, bitorder="little")[:, : self.bits]
        payload = np.packbits(bits.reshape(self.segments, -1), axis=1, bitorder="little")
        width = HEADER + payload.shape[1]  # of a full segment: no segment is longer
        table = np.empty((self.segments, width), np.uint8)
        table[:, 0], table[:, 1] = sequence % 256, np.arange(self.segments)
        table[:, HEADER:] = payload
        data = table.tobytes()
        return [
            Message(time, self.id, data[at * width : at * width + form[0]], self.extended, self.fd)
            for at, form in enumerate(self._forms)
        ]
