"""CAN bytes to readings and back: one file a skin, pure functions of bytes."""

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from tactiled.frames import Message, Reading


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

    def unpack(self, payloads: Sequence[bytes | None]) -> NDArray[np.uint16]:
        """The counts (N,) of one frame from the payloads of its segments; 0 where a segment is None."""

    def encode(self, counts: NDArray[np.uint16], sequence: int, time: float) -> list[Message]:
        """The messages of one frame (N,), the inverse of `decode` and `unpack`."""
