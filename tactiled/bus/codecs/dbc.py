"""Any skin that a DBC file describes, through cantools: the configuration names the signal of every taxel.

Counts are what stands in the messages: the file's scale and offset are left to the calibration.
"""

import difflib
import itertools
import struct
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from pydantic import Field

from tactiled.bounds import MAX_READING, FileBeside
from tactiled.bus.codec import MessageCodec, Skin
from tactiled.bus.codecs.packed import LENGTHS
from tactiled.errors import CodecError, ConfigError
from tactiled.frames import Counts, Message, Reading
from tactiled.geometry import Array

if TYPE_CHECKING:
    from cantools.database import Database
    from cantools.database.can import Message as Layout
    from cantools.database.can import Signal

MAX_COUNT = 0xFFFF  # largest count that `_range` gives, however many bits a signal has


@dataclass(frozen=True)
class _Segment:
    """The taxels of one message, or of one of a multiplexed message's variants."""

    layout: "Layout"
    selector: str | None  # the multiplexor's name
    variant: int | None  # its value
    signals: tuple["Signal", ...]
    taxels: tuple[int, ...]


class Dbc(MessageCodec):
    """The signals `names` ("Message.Signal" of every taxel in turn) of a DBC file as one array."""

    def __init__(self, file: Path, names: Sequence[str]) -> None:
        self.size, self.source = len(names), file.read_bytes() if file.is_file() else b""
        self._parts = tuple(_segments(_signals(_load(file), file, names)))
        self.segments = len(self._parts)
        self._of: dict[tuple[int, bool], list[int]] = {}
        for segment, part in enumerate(self._parts):
            self._of.setdefault((part.layout.frame_id, part.layout.is_extended_frame), []).append(segment)
        self.ids = frozenset(self._of)
        signals = [each for part in self._parts for each in part.signals]
        scalings = {(float(each.scale), float(each.offset), each.unit or "") for each in signals}
        # Factor, offset and unit, if all have the same.
        self.scaling = scalings.pop() if len(scalings) == 1 else None
        ranges = {_range(each) for each in signals}
        self.full_scale = min(high for _, high in ranges)
        narrow = all(not each.is_float and each.length <= 16 for each in signals)
        self.ends = ranges.pop() if narrow and len(ranges) == 1 else (-np.inf, np.inf)
        unsigned = narrow and not any(each.is_signed for each in signals)
        self._type: type[np.uint16 | np.float32] = np.uint16 if unsigned else np.float32

    def span(self, segment: int) -> list[int]:
        """The taxels that a segment carries, as an index into a frame."""
        return list(self._parts[segment].taxels)

    def decode(self, message: Message) -> Reading:
        """One message; a float that is not finite, or past MAX_READING, makes its taxel bad."""
        segments = self._of.get((message.id, message.extended))
        if segments is None or len(message.data) != _length(self._parts[segments[0]].layout):
            raise CodecError(f"message {message.id:#x} of {len(message.data)} bytes is not in the DBC file")
        raw = _decoded(self._parts[segments[0]].layout, message.data)
        for segment in segments:
            part = self._parts[segment]
            if part.selector is None or raw[part.selector] == part.variant:
                values = [raw[each.name] for each in part.signals]
                good = [abs(value) <= MAX_READING for value in values]  # False of a NaN, too
                bad = tuple(taxel for taxel, ok in zip(part.taxels, good, strict=True) if not ok)
                counts = (value if ok else 0.0 for value, ok in zip(values, good, strict=True))
                return Reading(message.time, segment, struct.pack(f"<{len(values)}d", *counts), bad=bad)
        raise CodecError(f"message {message.id:#x} is a variant without taxels")

    def unpack(self, payloads: Sequence[bytes | None]) -> Counts:
        """The counts (N,) of one frame; 0 where a segment is None."""
        counts: Counts = np.zeros(self.size, self._type)
        for part, payload in zip(self._parts, payloads, strict=True):
            if payload is not None:
                counts[list(part.taxels)] = np.frombuffer(payload, "<f8")
        return counts

    def encode(self, counts: Counts, sequence: int, time: float) -> list[Message]:
        """The messages of one frame (N,), signals that are no taxels 0; CodecError where a count does not fit."""
        del sequence
        if counts.shape != (self.size,):
            raise CodecError(f"counts {counts.shape}: expected {self.size}")
        return [_encoded(part, counts, time) for part in self._parts]


@dataclass(frozen=True)
class Settings(Skin):
    """Any array whose signals a DBC file describes."""

    file: FileBeside
    """DBC file; a relative path starts at the folder of the configuration file."""
    taxels: Annotated[str | tuple[str, ...], Field(min_length=1)]
    """`Message.Signal` of each taxel, or one template with {row}, {column}, {taxel}, {message}, {signal}."""
    first: Literal[0, 1] = 0
    """First number of whatever a template counts."""

    def codec(self, array: Array) -> Dbc:
        """The codec for an array; ConfigError where file or taxels are at fault."""
        if isinstance(self.taxels, tuple):
            return Dbc(self.file, self.taxels)
        if any(key in self.taxels for key in ("{message", "{signal")):
            known = {name for name, *_ in _named(_load(self.file))}
            return Dbc(self.file, numbered(self.taxels, array, self.first, known))
        return Dbc(self.file, expand(self.taxels, array.shape, array.size, self.first))


SKIN = Settings


def expand(template: str, shape: tuple[int, int] | None, size: int, first: int) -> tuple[str, ...]:
    """The signal of every taxel by a template of {row}, {column} and {taxel}, counted from `first`.

    ConfigError where it holds anything else, or rows where there is no grid (`shape` None).
    """
    return tuple(_name(template, _place(taxel, shape, first)) for taxel in range(size))


def numbered(template: str, array: Array, first: int, known: Collection[str]) -> tuple[str, ...]:
    """The signal of every taxel where messages are numbered, each filled before the next one begins.

    {message} counts messages and {signal} the taxels of one message, both from `first`; a message ends where the
    file's names (`known`) do. ConfigError where the names end before the array.
    """
    names: list[str] = []
    for message in itertools.count(first):
        begin = len(names)
        for signal in itertools.count(first):
            place = _place(len(names), array.shape, first)
            name = _name(template, {"message": message, "signal": signal} | place)
            if name not in known or name in names[begin:]:
                break
            names.append(name)
            if len(names) == array.size:
                return tuple(names)
        if len(names) == begin:
            raise ConfigError(
                f"codec.taxels = {template!r}: the file has no {name}: it has names for {begin} of "
                f"{array.size} taxels"
            )
    raise AssertionError


def _place(taxel: int, shape: tuple[int, int] | None, first: int) -> dict[str, int]:
    place = {"taxel": taxel + first}
    if shape is not None:
        place |= {"row": taxel // shape[1] + first, "column": taxel % shape[1] + first}
    return place


def _name(template: str, numbers: dict[str, int]) -> str:
    try:
        return template.format(**numbers)
    except (KeyError, IndexError, ValueError, AttributeError) as error:
        keys = ", ".join(f"{{{each}}}" for each in dict.fromkeys((*numbers, "message", "signal")))
        raise ConfigError(f"codec.taxels = {template!r}: {error}: a template may hold {keys}") from error


def _load(file: Path) -> "Database":
    try:
        from cantools import database, errors
    except ModuleNotFoundError as error:
        raise ConfigError("codec.name = 'dbc': needs cantools: pip install 'tactiled[dbc]'") from error
    try:
        return database.load_file(file, database_format="dbc")  # type: ignore[return-value]  # no other kind
    except (OSError, errors.Error, ValueError) as error:
        reason = getattr(error, "strerror", None) or " ".join(str(error).split())
        raise ConfigError(f"codec.file = {str(file)!r}: {reason}") from error


def _named(database: "Database") -> Iterator[tuple[str, "Layout", "Signal"]]:
    for layout in database.messages:
        for each in layout.signals:
            yield f"{layout.name}.{each.name}", layout, each


def _signals(database: "Database", file: Path, names: Sequence[str]) -> Iterator[tuple["Layout", "Signal"]]:
    """The message and the signal of every name; ConfigError for one that is not there, or there twice."""
    signals = {name: (layout, each) for name, layout, each in _named(database)}
    for at, name in enumerate(names):
        if name in names[:at]:
            raise ConfigError(f"codec.taxels names {name} twice: every taxel has a signal of its own")
        if name not in signals:
            near = difflib.get_close_matches(name, signals, 1)
            hint = f": did you mean {near[0]}?" if near else f": it has {len(signals)} signals"
            raise ConfigError(f"codec.taxels names {name!r}: {file.name} has no such signal{hint}")
        yield signals[name]


def _segments(signals: Iterator[tuple["Layout", "Signal"]]) -> Iterator[_Segment]:
    """Taxels by message and variant, in the order of their first taxels."""
    groups: dict[tuple[str, str | None, int | None], list[tuple[int, Layout, Signal]]] = {}
    for taxel, (layout, signal) in enumerate(signals):
        groups.setdefault((layout.name, *_variant(layout, signal)), []).append((taxel, layout, signal))
    for (_, selector, variant), group in groups.items():
        taxels, layouts, members = zip(*group, strict=True)
        if layouts[0].length > LENGTHS[-1]:
            raise ConfigError(
                f"codec.taxels names {layouts[0].name}.{members[0].name}: the message has {layouts[0].length} "
                f"bytes, and CAN FD carries {LENGTHS[-1]}"
            )
        yield _Segment(layouts[0], selector, variant, members, taxels)


def _variant(layout: "Layout", signal: "Signal") -> tuple[str | None, int | None]:
    """The multiplexor and its value with which a signal comes; ConfigError where one frame could hold it twice."""
    if not layout.is_multiplexed():
        return None, None
    ids, selector = signal.multiplexer_ids or [], signal.multiplexer_signal
    if selector is None or len(ids) != 1 or layout.get_signal_by_name(selector).multiplexer_ids:
        raise ConfigError(
            f"codec.taxels names {layout.name}.{signal.name}, which comes with several variants of a multiplexed "
            f"message: a taxel needs a signal of one value of the message's one multiplexor"
        )
    return selector, ids[0]


def _range(signal: "Signal") -> tuple[int, int]:
    """Smallest and largest count that the array may have from a signal."""
    if signal.is_float:
        return -MAX_COUNT, MAX_COUNT
    bits = signal.length - signal.is_signed
    return -(1 << bits) if signal.is_signed else 0, min((1 << bits) - 1, MAX_COUNT)


def _length(layout: "Layout") -> int:
    """Bytes of a message on the bus: the shortest length that CAN and CAN FD know."""
    return next(each for each in LENGTHS if each >= layout.length)


def _decoded(layout: "Layout", data: bytes) -> dict[str, float]:
    """Raw values by signal; CodecError where cantools finds none."""
    from cantools.database import DecodeError

    try:
        return layout.decode_simple(data, decode_choices=False, scaling=False)  # type: ignore[return-value]
    except DecodeError as error:
        raise CodecError(f"message {layout.frame_id:#x}: {error}") from error


def _encoded(part: _Segment, counts: Counts, time: float) -> Message:
    layout = part.layout
    values: dict[str, float] = {each.name: 0 for each in layout.signals}
    if part.selector is not None and part.variant is not None:
        values[part.selector] = part.variant
    for taxel, signal in zip(part.taxels, part.signals, strict=True):
        count, (low, high) = float(counts[taxel]), _range(signal)
        if not low <= count <= high:
            raise CodecError(f"count {count:g} of taxel {taxel}: {signal.name} carries {low} to {high}")
        values[signal.name] = count if signal.is_float else int(count)
    data = layout.encode(values, scaling=False, strict=False)
    fd = layout.is_fd or layout.length > 8
    return Message(time, layout.frame_id, data.ljust(_length(layout), b"\0"), layout.is_extended_frame, fd)
