"""Any skin that a DBC file describes, through cantools: which signal is which taxel is told beside the file.

Counts are what stands in the messages: the file's scale and offset are left to the calibration.
"""

import difflib
import struct
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tactiled.bus.codecs.packed import LENGTHS
from tactiled.errors import CodecError, ConfigError
from tactiled.frames import Counts, Message, Reading

if TYPE_CHECKING:
    from cantools.database import Database
    from cantools.database.can import Message as Layout
    from cantools.database.can import Signal

MOST = 0xFFFF  # counts that are asked of a signal that could say more
LARGEST = float(np.finfo(np.float32).max)


@dataclass(frozen=True)
class _Part:
    """The taxels of one message, or of one of a multiplexed message's variants."""

    layout: "Layout"
    selector: str | None  # the multiplexor's name
    variant: int | None  # its value
    signals: tuple["Signal", ...]
    taxels: tuple[int, ...]


class Dbc:
    """The signals `names` ("Message.Signal" of every taxel in turn) of a DBC file as one array."""

    modulus = None  # a DBC file does not say which signal counts frames
    ordered = 1  # nor in which order messages come

    def __init__(self, file: Path, names: Sequence[str]) -> None:
        self.size = len(names)
        self._parts = tuple(_parts(_found(_load(file), file, names)))
        self.segments = len(self._parts)
        self.ids = frozenset((each.layout.frame_id, each.layout.is_extended_frame) for each in self._parts)
        self._of: dict[tuple[int, bool], list[int]] = {key: [] for key in self.ids}
        for segment, part in enumerate(self._parts):
            self._of[part.layout.frame_id, part.layout.is_extended_frame].append(segment)
        signals = [each for part in self._parts for each in part.signals]
        self.full_scale = min(_range(each)[1] for each in signals)
        whole = all(not each.is_float and not each.is_signed and each.length <= 16 for each in signals)
        self._type: type[np.uint16 | np.float32] = np.uint16 if whole else np.float32

    def span(self, segment: int) -> list[int]:
        """The taxels that a segment carries, as an index into a frame."""
        return list(self._parts[segment].taxels)

    def decode(self, message: Message) -> Reading:
        """What one message says; a float that is no number, or past float32, makes its taxel bad."""
        segments = self._of.get((message.id, message.extended))
        if segments is None or len(message.data) != _length(self._parts[segments[0]].layout):
            raise CodecError(f"message {message.id:#x} of {len(message.data)} bytes is none of the DBC file's map")
        raw = _decoded(self._parts[segments[0]].layout, message.data)
        for segment in segments:
            part = self._parts[segment]
            if part.selector is None or raw[part.selector] == part.variant:
                values = [raw[each.name] for each in part.signals]
                fine = [abs(value) <= LARGEST for value in values]  # False of a NaN, too
                kept = (value if good else 0.0 for value, good in zip(values, fine, strict=True))
                bad = tuple(taxel for taxel, good in zip(part.taxels, fine, strict=True) if not good)
                return Reading(message.time, segment, struct.pack(f"<{len(values)}d", *kept), bad=bad)
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


def expand(taxels: str | Sequence[str], shape: tuple[int, int] | None, size: int, first: int) -> tuple[str, ...]:
    """The signal of every taxel: as listed, or a template of {row}, {column} and {taxel}, counted from `first`.

    ConfigError where a template holds anything else, or wants rows where there is no grid (`shape` None).
    """
    if not isinstance(taxels, str):
        return tuple(taxels)
    names = []
    for taxel in range(size):
        places = {"taxel": taxel + first}
        if shape is not None:
            places |= {"row": taxel // shape[1] + first, "column": taxel % shape[1] + first}
        try:
            names.append(taxels.format(**places))
        except (KeyError, IndexError, ValueError, AttributeError) as error:
            known = ", ".join(f"{{{each}}}" for each in places)
            raise ConfigError(f"codec.taxels = {taxels!r}: {error}: a template may hold {known}") from error
    return tuple(names)


def _load(file: Path) -> "Database":
    try:
        from cantools import database, errors
    except ModuleNotFoundError as error:
        raise ConfigError("codec.name = 'dbc': needs cantools: pip install 'tactiled[dbc]'") from error
    try:
        found = database.load_file(file, database_format="dbc")
    except OSError as error:
        raise ConfigError(f"codec.file = {str(file)!r}: {error.strerror}") from error
    except (errors.Error, ValueError) as error:
        raise ConfigError(f"codec.file = {str(file)!r}: {' '.join(str(error).split())}") from error
    return found  # type: ignore[return-value]  # the format asked for has no other kind


def _found(database: "Database", file: Path, names: Sequence[str]) -> Iterator[tuple["Layout", "Signal"]]:
    """The message and the signal of every name; ConfigError for one that is not there, or there twice."""
    known = {
        f"{layout.name}.{each.name}": (layout, each) for layout in database.messages for each in layout.signals
    }
    twice = [name for name, count in Counter(names).items() if count > 1]
    if twice:
        raise ConfigError(f"codec.taxels names {twice[0]} twice: every taxel has a signal of its own")
    for name in names:
        if name not in known:
            near = difflib.get_close_matches(name, known, 1)
            meant = f": did you mean {near[0]}?" if near else f": it has {len(known)} signals"
            raise ConfigError(f"codec.taxels names {name!r}: {file.name} has no such signal{meant}")
        yield known[name]


def _parts(signals: Iterator[tuple["Layout", "Signal"]]) -> Iterator[_Part]:
    """Taxels by message and variant, in the order of their first taxels."""
    groups: dict[tuple[str, str | None, int | None], list[tuple[int, Layout, Signal]]] = {}
    for taxel, (layout, signal) in enumerate(signals):
        selector, variant = _variant(layout, signal)
        groups.setdefault((layout.name, selector, variant), []).append((taxel, layout, signal))
    for (_, selector, variant), group in groups.items():
        taxels, layouts, found = zip(*group, strict=True)
        yield _Part(layouts[0], selector, variant, found, taxels)


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
    """Least and largest count of a signal that are asked of it."""
    if signal.is_float:
        return -MOST, MOST
    bits = signal.length - signal.is_signed
    return -(1 << bits) if signal.is_signed else 0, min((1 << bits) - 1, MOST)


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


def _encoded(part: _Part, counts: Counts, time: float) -> Message:
    layout = part.layout
    values: dict[str, float] = {each.name: 0 for each in layout.signals}
    if part.selector is not None and part.variant is not None:
        values[part.selector] = part.variant
    for taxel, signal in zip(part.taxels, part.signals, strict=True):
        count, (low, high) = float(counts[taxel]), _range(signal)
        if not low <= count <= high:
            raise CodecError(f"count {count:g} of taxel {taxel}: {signal.name} says {low} to {high}")
        values[signal.name] = count if signal.is_float else int(count)
    data = layout.encode(values, scaling=False, strict=False)
    fd = layout.is_fd or layout.length > 8
    return Message(time, layout.frame_id, data.ljust(_length(layout), b"\0"), layout.is_extended_frame, fd)
