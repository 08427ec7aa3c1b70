"""What a codec and a skin are; pure functions of bytes, without I/O, clock or thread."""

import json
import operator
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, cast, overload

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict

from tactiled.bus.batch import Batch, Key
from tactiled.bus.polling import Polling
from tactiled.errors import CodecError, ConfigError
from tactiled.frames import BAD, Counts, Message, Reading
from tactiled.geometry import Array

NO_SEQUENCE = -1


class Readings(NamedTuple):
    """The readings of a batch of n messages: one array for each field of `Reading`."""

    times: NDArray[np.float64]  # (n,) s
    segments: NDArray[np.int64]  # (n,)
    payloads: NDArray[Any]  # (n, width) bytes, 0 past a payload's own; or (n,) objects of `bytes`
    good: NDArray[np.bool_]  # (n,) False: malformed, the other arrays mean nothing
    sequences: NDArray[np.int64] | None = None  # (n,) NO_SEQUENCE: none; None: no message has one
    bad: Mapping[int, tuple[int, ...]] = {}  # taxels that the sensor calls out of range, by row


class Rows(Sequence[bytes | None]):
    """The payloads of a frame as an array; also the sequence that `Codec.unpack` takes."""

    def __init__(self, data: NDArray[np.uint8], present: NDArray[np.bool_]) -> None:
        """`data` (segments, width), 0 where not `present` (segments,)."""
        self.data, self.present = data, present

    def __len__(self) -> int:
        """Number of segments."""
        return len(self.data)

    @overload
    def __getitem__(self, at: int) -> bytes | None: ...
    @overload
    def __getitem__(self, at: slice) -> list[bytes | None]: ...
    def __getitem__(self, at: int | slice) -> bytes | list[bytes | None] | None:
        """A segment's payload; None where it did not come."""
        if isinstance(at, slice):
            return [self[each] for each in range(len(self))[at]]
        return self.data[at].tobytes() if self.present[at] else None


def stacked(payloads: Sequence[bytes | None], length: int) -> NDArray[np.uint8]:
    """The payloads of a frame (segments, length); 0 where one is None, and past a shorter one."""
    if isinstance(payloads, Rows):
        return payloads.data
    joined = b"".join((each or b"").ljust(length, b"\0") for each in payloads)
    return np.frombuffer(joined, np.uint8).reshape(-1, length)


def missing(payloads: Sequence[bytes | None]) -> NDArray[np.bool_]:
    """Which payloads (segments,) of a frame did not come."""
    if isinstance(payloads, Rows):
        return ~payloads.present
    return np.array([each is None for each in payloads])


class Codec(ABC):
    """Messages of one array to counts and back."""

    modulus: int | None = None  # number at which the sequence counter wraps; None where the skin sends none
    bad_flag = BAD  # of the taxels that its readings call bad; MISSING where a frame just lacks them
    rounds = True  # its readings are rounded to whole counts
    source: bytes = b""  # the file beside the settings that it was made from

    @cached_property
    def size(self) -> int:
        """Taxels in a frame."""
        raise NotImplementedError("size")

    @cached_property
    def segments(self) -> int:
        """Messages in a whole frame."""
        raise NotImplementedError("segments")

    @cached_property
    def full_scale(self) -> int:
        """Largest count."""
        raise NotImplementedError("full_scale")

    @cached_property
    def ends(self) -> tuple[float, float]:
        """Lowest and highest possible count; infinite if unknown."""
        return (0, self.full_scale) if whole_counts(self) else (-np.inf, np.inf)

    @cached_property
    def ids(self) -> frozenset[Key]:
        """The (id, whether it has 29 bits) of the messages that it reads."""
        raise NotImplementedError("ids")

    @cached_property
    def ordered(self) -> int:
        """Number of neighbouring segments that always come in order; separates frames without sequence numbers."""
        return 1

    @cached_property
    def polling(self) -> Polling:
        """Messages to a skin that must be started or asked."""
        return Polling()

    @abstractmethod
    def span(self, segment: int) -> slice | list[int]:
        """The taxels that a segment carries, as an index into a frame."""

    @abstractmethod
    def readings(self, batch: Batch) -> Readings:
        """What the messages of a batch, all on `ids`, carry."""

    @abstractmethod
    def unpack(self, payloads: Sequence[bytes | None]) -> Counts:
        """The counts (N,) of one frame from the payloads of its segments; 0 where a segment is None."""

    def references(self, payloads: Sequence[bytes | None]) -> NDArray[np.float32] | None:
        """Counts (M,) of pads that follow temperature and not pressure, NaN where missing; None: it has none."""
        del payloads
        return None

    def shear(self, payloads: Sequence[bytes | None]) -> NDArray[np.float32] | None:
        """Shear (2, N) of one frame along x and y, as of ShearCodec; None: the skin feels none."""
        del payloads
        return None

    @abstractmethod
    def encode(self, counts: Counts, sequence: int, time: float) -> list[Message]:
        """The messages of one frame (N,), the inverse of `readings` and `unpack`."""

    def checked(self, counts: Counts) -> NDArray[np.uint16]:
        """The counts (N,) of one frame; CodecError where the skin cannot send them."""
        checked = np.asarray(counts, np.uint16)
        if checked.shape != (self.size,) or int(checked.max()) > self.full_scale:
            raise CodecError(
                f"counts {checked.shape} up to {checked.max()}: expected {self.size} up to {self.full_scale}"
            )
        return checked


class MessageCodec(Codec):
    """A codec whose author reads one message at a time: `decode` in place of `readings`."""

    @abstractmethod
    def decode(self, message: Message) -> Reading:
        """One message on one of `ids`; any exception means that it is malformed."""

    def readings(self, batch: Batch) -> Readings:
        """What `decode` gives of each message."""
        count = len(batch)
        times, segments, good = batch.times.copy(), np.zeros(count, np.int64), np.zeros(count, np.bool_)
        sequences, payloads = np.full(count, NO_SEQUENCE), np.full(count, None, object)
        bad: dict[int, tuple[int, ...]] = {}
        for at, message in enumerate(batch):
            try:
                reading = self.decode(message)
                segment, taxels = operator.index(reading.segment), tuple(reading.bad)
                if not (0 <= segment < self.segments and all(0 <= each < self.size for each in taxels)):
                    continue
                times[at], segments[at], payloads[at] = reading.time, segment, bytes(reading.payload)
                if self.modulus is not None and reading.sequence is not None:
                    sequences[at] = reading.sequence % self.modulus
            except Exception:  # a CodecError of our codecs; another package's may raise anything
                continue
            good[at] = True
            if taxels:
                bad[at] = taxels
        return Readings(times, segments, payloads, good, sequences, bad)


class ShearCodec(Codec):
    """The codec of a 3-axis skin."""

    @abstractmethod
    def shear(self, payloads: Sequence[bytes | None]) -> NDArray[np.float32]:
        """Shear (2, N) of one frame along x and y, counts from the skin's nominal rest; NaN where missing."""

    @abstractmethod
    def encode_sheared(
        self, counts: Counts, shear: NDArray[np.float32], sequence: int, time: float
    ) -> list[Message]:
        """The messages of one frame (N,) and its shear (2, N): the inverse of `readings`, `unpack` and `shear`."""


@dataclass(frozen=True, slots=True)
class Match:
    """One array that a recogniser found."""

    settings: dict[str, Any]  # of its codec, as a configuration has them
    codec: Codec
    keys: tuple[Key, ...]  # its messages' ids, in order
    shape: tuple[int, int] | None  # rows, columns; None where the skin knows its taxels' positions
    description: str  # one phrase
    notes: tuple[str, ...] = ()  # what the bus does not tell
    pitch_mm: float = 4.0  # a guess


def setting_text(key: str, value: object) -> str:
    """Give a codec's setting as a configuration has it: JSON is TOML here, and ids are hexadecimal."""
    return f"{value:#x}" if key == "base_id" else json.dumps(value)


class Traffic(dict[Key, list[Message]]):
    """Messages by id."""

    def __init__(self, messages: Iterable[Message]) -> None:
        super().__init__()
        for each in messages:
            self.setdefault((each.id, each.extended), []).append(each)

    def standard(self, ids: Iterable[int]) -> tuple[Key, ...]:
        """Those of some 11-bit ids on which messages came."""
        return tuple((each, False) for each in ids if (each, False) in self)

    def messages(self, keys: Iterable[Key]) -> list[Message]:
        """All messages on some ids."""
        return [each for key in keys for each in self[key]]

    def even(self, keys: Iterable[Key]) -> bool:
        """Whether these ids came equally often, apart from losses and cut ends."""
        counts = [len(self[key]) for key in keys]
        return max(counts) - min(counts) <= 2 + 0.1 * max(counts)


class Skin:
    """A frozen dataclass whose fields are a skin's settings: SKIN of a file of `codecs/`, or an entry point."""

    __pydantic_config__ = ConfigDict(extra="forbid", use_attribute_docstrings=True)
    kpa_per_count: float | None = None  # kPa, used if the configuration has none; the same for no_load
    no_load: float | None = None  # counts

    @cached_property
    def positions(self) -> NDArray[np.float64] | None:
        """Where the taxels are (N, 2), mm, if the skin knows it."""
        return None

    def codec(self, array: Array) -> Codec:
        """The codec for an array; ConfigError where it cannot carry it."""
        raise NotImplementedError("codec")

    @classmethod
    def recognise(cls, traffic: Traffic) -> Iterator[Match]:
        """Every array of this kind in what came on a bus; by default none."""
        del traffic
        return iter(())


class OrderedSkin(Skin, Codec):
    """A skin that is its own codec: no sequence numbers, `taxels` in a message, all messages in order."""

    taxels: int  # in a message; the last may have fewer

    def codec(self, array: Array) -> Codec:
        """The skin itself: its size does not depend on the array."""
        del array
        return self

    @cached_property
    def segments(self) -> int:
        """Messages in a whole frame."""
        return -(-self.size // self.taxels)

    @cached_property
    def ordered(self) -> int:
        """All segments come in order."""
        return self.segments

    def span(self, segment: int) -> slice | list[int]:
        """The taxels that a segment carries, as an index into a frame."""
        return slice(segment * self.taxels, min((segment + 1) * self.taxels, self.size))

    def stacked(self, payloads: Sequence[bytes | None], length: int) -> NDArray[np.uint8]:
        """The payloads of a frame (segments, length); 0 where one is None."""
        return stacked(payloads, length)


class ClassicSkin(MessageCodec, OrderedSkin):
    """The same, by `decode`."""


def read_one(codec: Codec, message: Message) -> Reading:
    """One message on one of a codec's ids; CodecError where it is malformed."""
    if isinstance(codec, MessageCodec):
        return codec.decode(message)
    readings = codec.readings(Batch.of((message,)))
    if not readings.good[0]:
        kind = "CAN FD " if message.fd else ""
        raise CodecError(f"{kind}message {message.id:#x} of {len(message.data)} bytes is not of this layout")
    sequence = None if readings.sequences is None else int(readings.sequences[0])
    payload = cast(bytes, readings.payloads[0].tobytes())
    return Reading(message.time, int(readings.segments[0]), payload, sequence, readings.bad.get(0, ()))


def understands(codec: Codec, messages: Batch | Iterable[Message]) -> bool:
    """Whether a codec decodes every one of some messages."""
    batch = messages if isinstance(messages, Batch) else Batch.of(messages)
    return bool(codec.readings(batch).good.all())


def whole_counts(codec: Codec) -> bool:
    """Whether counts are whole and never below zero."""
    return codec.unpack([None] * codec.segments).dtype == np.uint16


def standard_ids(*ids: int) -> frozenset[Key]:
    """Ids of 11 bits."""
    return frozenset((each, False) for each in ids)


def require_distinct(key: str, numbers: Sequence[int]) -> None:
    """ConfigError where a setting names a number twice."""
    if len(set(numbers)) != len(numbers):
        raise ConfigError(f"{key} = {list(numbers)}: names a number twice")
