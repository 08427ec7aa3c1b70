"""Every skin there is: the files of `codecs/`, and the entry points `tactiled.codecs` of other packages."""

import difflib
import logging
import sys
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping
from dataclasses import asdict, is_dataclass
from functools import cache, lru_cache
from importlib import import_module
from importlib.metadata import EntryPoints, entry_points
from pathlib import Path
from pkgutil import iter_modules
from typing import Any, cast, get_args

import numpy as np
from numpy.typing import NDArray
from pydantic import TypeAdapter, ValidationError
from pydantic_core import ErrorDetails
from pydantic_core.core_schema import ErrorType

from tactiled.bounds import place, reason
from tactiled.bus import codecs
from tactiled.bus.assembler import unpacked
from tactiled.bus.codec import Codec, Match, ShearCodec, Skin, Traffic, read_one
from tactiled.bus.redact import redactor, seal, show
from tactiled.errors import ConfigError, TactileError
from tactiled.frames import Counts, Message
from tactiled.geometry import Array

GROUP = "tactiled.codecs"
BUILT_IN = tuple(each.name for each in iter_modules(codecs.__path__))
LARGE_SEQUENCE = 1 << 20  # no skin sends such a number: it wraps before
PYDANTICS = {*get_args(ErrorType)} - {"value_error", "assertion_error"}  # no codec's own
LOG = logging.getLogger(__name__)


def skins() -> Iterator[tuple[str, type[Skin]]]:
    """Every skin by its name; one that cannot be imported is logged and left out."""
    for name in (*BUILT_IN, *_offers().names):
        try:
            yield name, load(name)
        except ConfigError as error:
            LOG.warning("%s", error)


def recognised(name: str, skin: type[Skin], traffic: Traffic) -> list[Match]:
    """Every array of a skin in what came on a bus; a recogniser that fails is logged, and has none."""
    try:
        matches = list(skin.recognise(traffic))
        if wrong := [each for each in matches if not isinstance(each, Match)]:
            raise TypeError(f"{wrong[0]!r} is no Match")
        return matches
    except Exception as error:  # of another package's skin: none of ours raises here
        LOG.warning("%r of %s: recognise fails: %s", name, _packages(_offers(), name), _line(error))
        return []


def load(name: str) -> type[Skin]:
    """Import a skin; ConfigError where its name is unknown or not unique, or its package fails."""
    everything = _offers()
    offers, packages = everything.select(name=name), _packages(everything, name)
    if name in BUILT_IN and offers:
        raise ConfigError(
            f"{name!r}: built in, and {packages} offers a codec of the same name: uninstall that one"
        )
    if len(offers) > 1:
        raise ConfigError(f"{name!r}: offered by {packages}: uninstall one")
    if name not in (names := (*BUILT_IN, *sorted(everything.names))):
        near = difflib.get_close_matches(name, names, 1)
        hint = f": did you mean {near[0]}?" if near else ""
        raise ConfigError(f"unknown codec {name!r}; available: {', '.join(names)}{hint}")
    try:
        skin: Any = offers[name].load() if offers else import_module(f"{codecs.__name__}.{name}").SKIN
    except Exception as error:  # what another package's import may raise
        raise ConfigError(f"{name!r} of {packages}: fails to import: {_line(error)}") from error
    if not (is_dataclass(skin) and isinstance(skin, type) and issubclass(skin, Skin)):
        raise ConfigError(f"{name!r} of {packages}: is no dataclass of tactiled.bus.codec.Skin")
    return skin


def _offers() -> EntryPoints:
    """What other packages offer."""
    return _offers_on(tuple(sys.path))


@lru_cache(maxsize=1)
def _offers_on(path: tuple[str, ...]) -> EntryPoints:
    """What packages on a path offer; kept, as looking takes 20 ms for every sensor."""
    del path  # always sys.path; only the key of the cache
    return entry_points(group=GROUP)


@cache
def _adapter(skin: Hashable) -> TypeAdapter[Any]:
    """What checks the settings of a codec; to make one takes milliseconds."""
    return TypeAdapter(cast(type[Any], skin))


def read_settings(name: str, table: Mapping[str, Any], folder: Path) -> Skin:
    """A codec's settings, checked; paths begin in `folder`.

    pydantic's ValidationError where it may show keys and values; ValueError where these are another package's.
    """
    try:
        checked: Skin = _adapter(cast(Hashable, load(name))).validate_python(table, context={"folder": folder})
    except ValidationError as error:
        if name in BUILT_IN:
            raise
        redact = _redactor(name, table)
        raise ValueError("; ".join(_fault(each, redact) for each in error.errors())) from None
    except Exception as error:
        raise ValueError(_redactor(name, table)(_line(error))) from error
    return checked


def _fault(fault: ErrorDetails, redact: Callable[[str], str]) -> str:
    """One fault of a setting in words; its value where that is a number, or its name says that it is no secret."""
    at, value, why = place(fault["loc"]), fault["input"], reason(fault)
    why = why if fault["type"] in PYDANTICS else redact(why)  # whose words have no value in them
    if not at:
        return why
    if fault["type"] in ("missing", "unexpected_keyword_argument") or isinstance(value, dict | list):
        return f"{at}: {why}"
    (text,) = show([*seal({at: value}).values()])
    return f"{at} = {text}: {why}"


def redacted(name: str, skin: Skin) -> dict[str, Any]:
    """A codec's settings as they may be printed: the texts of another package are secrets."""
    table: dict[str, Any] = _adapter(cast(Hashable, type(skin))).dump_python(skin, mode="json")
    return table if name in BUILT_IN else show(seal(table))


def make(name: str, skin: Skin, array: Array) -> Codec:
    """The codec for an array, tried out; ConfigError where it refuses the array or breaks its interface."""
    try:
        codec = skin.codec(array)
        _try_out(codec)
    except Exception as error:
        reason = _redactor(name, asdict(cast(Any, skin)))(_line(error))
        package = "" if name in BUILT_IN else f"{name!r} of {_packages(_offers(), name)}: "
        raise ConfigError(f"{package}{reason}") from error
    return codec


def _try_out(codec: Codec) -> None:
    """Refuse a codec that does not give back what it encodes, or takes a lost message for one of other taxels."""
    counts = (np.arange(codec.size) % (codec.full_scale + 1)).astype(np.uint16)
    payloads = _payloads(codec, codec.encode(counts, 0, 0.0))
    unpacked(codec, [None] * codec.segments)
    _require_counts(counts, unpacked(codec, payloads)[0])
    for lost in {0, codec.segments // 2, codec.segments - 1}:
        others = counts.copy()
        others[codec.span(lost)] = 0
        decoded, _ = unpacked(codec, [*payloads[:lost], None, *payloads[lost + 1 :]])
        if wrong := np.flatnonzero(decoded != others).tolist():
            raise ConfigError(
                f"without segment {lost} taxel {wrong[0]} is {decoded[wrong[0]]} and not {others[wrong[0]]}: "
                f"span({lost}) must give the taxels of this segment"
            )
    if not isinstance(codec, ShearCodec):
        _payloads(codec, codec.encode(counts, LARGE_SEQUENCE, 0.0))
        return
    shear = (np.arange(2 * codec.size, dtype=np.float32) % 3 - 1).reshape(2, -1)
    decoded, felt = unpacked(codec, _payloads(codec, codec.encode_sheared(counts, shear, LARGE_SEQUENCE, 0.0)))
    _require_counts(counts, decoded)
    if felt is not None and not np.allclose(felt, shear, rtol=0, atol=1):
        axis, taxel = np.unravel_index(np.nanargmax(np.abs(felt - shear)), shear.shape)
        raise ConfigError(
            f"shear of taxel {taxel} along {'xy'[axis]} was encoded as {shear[axis, taxel]:g} and decoded as "
            f"{felt[axis, taxel]:g}"
        )


def _payloads(codec: Codec, messages: Iterable[Message]) -> list[bytes | None]:
    """The payloads of the segments of one encoded frame; ConfigError where they are not each there once."""
    payloads: list[bytes | None] = [None] * codec.segments
    covered = np.zeros(codec.size, int)
    for message in messages:
        if (message.id, message.extended) not in codec.ids:
            raise ConfigError(f"encode made a message with id {message.id:#x}, which the codec does not list")
        reading = read_one(codec, message)
        if not 0 <= reading.segment < codec.segments:
            raise ConfigError(
                f"decode gave segment {reading.segment} of message {message.id:#x}: expected 0 to "
                f"{codec.segments - 1}"
            )
        if codec.modulus is not None and reading.sequence is None:
            raise ConfigError(
                f"decode gave no sequence number of message {message.id:#x}: every one needs it, as modulus is "
                f"{codec.modulus}"
            )
        payloads[reading.segment] = reading.payload
        covered[codec.span(reading.segment)] += 1
    if None in payloads or not np.all(covered == 1):
        raise ConfigError("the segments that encode made do not carry every taxel once")
    return payloads


def _require_counts(encoded: NDArray[np.uint16], decoded: Counts) -> None:
    if wrong := np.flatnonzero(decoded != encoded).tolist():
        raise ConfigError(
            f"taxel {wrong[0]} was encoded as {encoded[wrong[0]]} and decoded as {decoded[wrong[0]]}"
        )


def _redactor(name: str, table: Mapping[str, Any]) -> Callable[[str], str]:
    """What hides the texts of another package's settings in what it says of them."""
    return str if name in BUILT_IN else redactor(seal(table))


def _packages(offers: EntryPoints, name: str) -> str:
    """Names and versions of the packages that offer a codec."""
    dists = ((each, each.dist) for each in offers.select(name=name))
    return " and ".join(f"{dist.name} {dist.version}" if dist else offer.value for offer, dist in dists)


def _line(error: Exception) -> str:
    text = " ".join(str(error).split())
    return text if isinstance(error, TactileError) else f"{type(error).__name__}: {text}"
