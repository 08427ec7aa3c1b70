"""Codecs of other packages: entry points of the group `tactiled.codecs`, held to the interface."""

from collections.abc import Sequence
from importlib.metadata import EntryPoint, entry_points
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactiled.bus.codecs import Codec, Shearing, Talk, talk_of
from tactiled.bus.redact import redactor, reveal
from tactiled.errors import CodecError, ConfigError
from tactiled.frames import Counts, Message, Reading

GROUP = "tactiled.codecs"


def offers() -> tuple[EntryPoint, ...]:
    """Every codec that an installed package offers; none is imported."""
    return tuple(entry_points(group=GROUP))


def package(offer: EntryPoint) -> str:
    """Name and version of the package that offers a codec."""
    return f"{offer.dist.name} {offer.dist.version}" if offer.dist else offer.value


def make(name: str, options: dict[str, Any]) -> Codec:
    """The codec that a package offers by `name`, made with the options; ConfigError where it cannot be."""
    offer = next((each for each in offers() if each.name == name), None)
    if offer is None:
        raise ConfigError(f"codec.name = {name!r}: no installed package offers it")
    says, redact = f"codec.name = {name!r} of {package(offer)}", redactor(options)
    try:
        made = offer.load()
    except Exception as error:  # what another package's import may raise
        raise ConfigError(f"{says}: fails to import: {_line(error)}") from error
    try:
        codec: Codec = made(**reveal(options))
    except ConfigError as error:
        raise ConfigError(f"{says}: {redact(str(error))}") from error
    except Exception as error:
        raise ConfigError(f"{says}: refuses its settings: {redact(_line(error))}") from error
    try:
        plugged = PluggedShear(name, codec) if isinstance(codec, Shearing) else Plugged(name, codec)
        _try(plugged)
    except Exception as error:
        raise ConfigError(f"{says}: breaks the interface of a codec: {redact(_line(error))}") from error
    return plugged


class Plugged:
    """Another package's codec: whatever it raises is a CodecError with its name."""

    def __init__(self, name: str, codec: Codec) -> None:
        self.name, self._codec = name, codec
        self.size, self.segments, self.modulus = codec.size, codec.segments, codec.modulus
        self.ordered, self.ids, self.full_scale = codec.ordered, frozenset(codec.ids), codec.full_scale

    @property
    def talk(self) -> Talk:
        """What has to be said to the skin."""
        return talk_of(self._codec)

    def span(self, segment: int) -> slice | list[int]:
        """The taxels that a segment carries, as an index into a frame."""
        return self._codec.span(segment)

    def decode(self, message: Message) -> Reading:
        """What a message says."""
        try:
            reading = self._codec.decode(message)
            if not 0 <= reading.segment < self.segments:
                raise CodecError(f"segment {reading.segment} of {self.segments}")
            if not all(0 <= taxel < self.size for taxel in reading.bad):
                raise CodecError(f"bad taxels {reading.bad} of {self.size}")
        except CodecError as error:
            raise CodecError(f"codec {self.name}: {error}") from error
        except Exception as error:
            raise CodecError(f"codec {self.name}: {_line(error)}") from error
        return reading

    def unpack(self, payloads: Sequence[bytes | None]) -> Counts:
        """The counts (N,) of one frame."""
        try:
            counts: NDArray[Any] = np.asarray(self._codec.unpack(payloads))
        except Exception as error:
            raise CodecError(f"codec {self.name}: {_line(error)}") from error
        if counts.shape != (self.size,) or counts.dtype not in (np.uint16, np.float32):
            found = f"{counts.dtype} {counts.shape}"
            raise CodecError(f"codec {self.name}: unpack gave {found}, not uint16 or float32 {(self.size,)}")
        return counts

    def encode(self, counts: Counts, sequence: int, time: float) -> list[Message]:
        """The messages of one frame (N,)."""
        return self._codec.encode(counts, sequence, time)


class PluggedShear(Plugged):
    """The same of a skin that feels shear."""

    def shear(self, payloads: Sequence[bytes | None]) -> NDArray[np.float32]:
        """Shear (2, N) of one frame, counts; NaN where it is missing."""
        try:
            shear = np.asarray(self._codec.shear(payloads), np.float32)  # type: ignore[attr-defined]
        except Exception as error:
            raise CodecError(f"codec {self.name}: {_line(error)}") from error
        if shear.shape != (2, self.size):
            raise CodecError(f"codec {self.name}: shear gave {shear.shape}, not {(2, self.size)}")
        return shear


def _try(codec: Plugged) -> None:
    """Refuse a codec whose `decode` and `unpack` do not give back what `encode` was given."""
    sent = (np.arange(codec.size) % (codec.full_scale + 1)).astype(np.uint16)
    payloads: list[bytes | None] = [None] * codec.segments
    covered = np.zeros(codec.size, int)
    for message in codec.encode(sent, 0, 0.0):
        if (message.id, message.extended) not in codec.ids:
            raise ValueError(f"encode made a message on id {message.id:#x}, which is none of its ids")
        reading = codec.decode(message)
        payloads[reading.segment] = reading.payload
        covered[codec.span(reading.segment)] += 1
    if None in payloads or not np.all(covered == 1):
        raise ValueError("the segments that encode made do not carry every taxel once")
    got = codec.unpack(payloads)
    if wrong := np.flatnonzero(got != sent).tolist():
        raise ValueError(f"taxel {wrong[0]} was encoded as {sent[wrong[0]]} and decoded as {got[wrong[0]]}")
    for some in (payloads, [None] * codec.segments):
        codec.unpack(some)
        if isinstance(codec, PluggedShear):
            codec.shear(some)


def _line(error: Exception) -> str:
    return f"{type(error).__name__}: {' '.join(str(error).split())}"
