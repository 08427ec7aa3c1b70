"""CAN bytes to readings and back: one file a skin, pure functions of bytes."""

from collections.abc import Iterable, Sequence
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from tactiled.bus.codecs.plain import Plain
from tactiled.errors import CodecError
from tactiled.frames import Counts, Message, Reading

__all__ = ["Codec", "Plain", "Poll", "ShearEncoding", "Shearing", "Talk", "Talking", "talk_of", "understands"]


class Codec(Protocol):
    """What every skin's codec offers."""

    @property
    def size(self) -> int:
        """Taxels in a frame."""

    @property
    def segments(self) -> int:
        """Messages in a whole frame."""

    @property
    def modulus(self) -> int | None:
        """What the sequence counter wraps at; None where the skin sends none."""

    @property
    def ordered(self) -> int:
        """Neighbouring segments that always come in order: what a skin without sequence numbers is paired by."""

    @property
    def ids(self) -> frozenset[tuple[int, bool]]:
        """The (id, extended) of the messages it listens to."""

    @property
    def full_scale(self) -> int:
        """Largest count."""

    def span(self, segment: int) -> slice | list[int]:
        """The taxels that a segment carries, as an index into a frame."""

    def decode(self, message: Message) -> Reading:
        """What a message on one of `ids` says; CodecError if it says nothing that can be meant."""

    def unpack(self, payloads: Sequence[bytes | None]) -> Counts:
        """The counts (N,) of one frame from the payloads of its segments; 0 where a segment is None."""

    def encode(self, counts: Counts, sequence: int, time: float) -> list[Message]:
        """The messages of one frame (N,), the inverse of `decode` and `unpack`."""


def understands(codec: Codec, messages: Iterable[Message]) -> bool:
    """Whether a codec knows what to make of every one of some messages."""
    try:
        for each in messages:
            codec.decode(each)
    except CodecError:
        return False
    return True


class Poll(NamedTuple):
    """A request that is sent over and over."""

    message: Message
    period_s: float
    segments: range  # that answer it


class Talk(NamedTuple):
    """What has to be said to a skin so that it sends."""

    start: tuple[tuple[float, Message], ...] = ()  # once, each so many s after the bus was opened
    polls: tuple[Poll, ...] = ()  # over and over from then on
    stop: tuple[Message, ...] = ()  # once, before the bus is closed


@runtime_checkable
class Talking(Protocol):
    """What a codec offers besides, whose skin sends nothing by itself."""

    @property
    def talk(self) -> Talk:
        """What has to be said to the skin."""


def talk_of(codec: Codec) -> Talk:
    """What has to be said to a codec's skin; nothing for most."""
    return codec.talk if isinstance(codec, Talking) else Talk()


@runtime_checkable
class Shearing(Protocol):
    """What a codec offers besides, whose skin feels shear."""

    def shear(self, payloads: Sequence[bytes | None]) -> NDArray[np.float32]:
        """Shear (2, N) of one frame along x and y, counts from the skin's nominal rest; NaN where missing."""


@runtime_checkable
class ShearEncoding(Protocol):
    """What such a codec offers besides, to be simulated with shear."""

    def encode_sheared(
        self, counts: Counts, shear: NDArray[np.float32], sequence: int, time: float
    ) -> list[Message]:
        """The messages of one frame (N,) and its shear (2, N), the inverse of `decode`, `unpack` and `shear`."""
