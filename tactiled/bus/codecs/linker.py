"""LinkerHand fingers: matrices of 12 x 6 taxels of 8 bits, a message a row, sent when asked for.

Source of the layout: Linkerbot's public SDKs (request code C6). The replies bear the hand's own id, as does all
else that it sends.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from tactiled.bounds import Bounds
from tactiled.bus.codec import ClassicSkin, Key, Match, Traffic, require_distinct, standard_ids, understands
from tactiled.bus.polling import Poll, Polling
from tactiled.errors import CodecError
from tactiled.frames import Counts, Message, Reading

HANDS: dict[Literal["right", "left"], int] = {"right": 0x27, "left": 0x28}  # ids
FINGER = 0xB0  # first byte, with the finger: 1 thumb, 2 index, 3 middle, 4 ring, 5 little
MATRIX = 0xC6  # asks for a matrix
ROWS, COLUMNS = 12, 6


@dataclass(frozen=True)
class Linker(ClassicSkin):
    """LinkerHand: 72 taxels of 8 bits a finger."""

    hand: Literal["right", "left"] = "right"
    """Which hand it is."""
    fingers: Annotated[tuple[Annotated[int, Bounds(1, 5)], ...], Field(min_length=1, max_length=5)] = (1,)
    """Fingers of the array: 1 is the thumb, 5 the little finger."""
    poll_hz: Annotated[float, Bounds(0.01, 1000.0, "Hz", zero=True)] = 20.0
    """Requests per second for each finger; 0: the service only listens."""

    taxels, full_scale, ordered = COLUMNS, 0xFF, ROWS

    def __post_init__(self) -> None:
        """Refuse a finger named twice."""
        require_distinct("fingers", self.fingers)

    @cached_property
    def size(self) -> int:
        """Taxels of all fingers, one finger's rows after the other's."""
        return ROWS * COLUMNS * len(self.fingers)

    @cached_property
    def ids(self) -> frozenset[Key]:
        """The hand's one id."""
        return standard_ids(HANDS[self.hand])

    @cached_property
    def polling(self) -> Polling:
        """A request to each finger at the same time, which answers by its rows."""
        if not self.poll_hz:
            return Polling()
        requests = (Message(0.0, HANDS[self.hand], bytes((FINGER + each, MATRIX))) for each in self.fingers)
        return Polling(
            polls=tuple(
                Poll(each, 1 / self.poll_hz, range(ROWS * place, ROWS * (place + 1)))
                for place, each in enumerate(requests)
            )
        )

    def decode(self, message: Message) -> Reading:
        """The finger, the row in the high digit, six taxels."""
        data = message.data
        if message.fd or len(data) != 8 or data[1] & 0xF or data[1] >> 4 >= ROWS:
            raise CodecError(f"message {message.id:#x} of {len(data)} bytes is not a row of a finger")
        if data[0] - FINGER not in self.fingers:
            raise CodecError(f"message {message.id:#x} is of finger {data[0] - FINGER}, which is not configured")
        place = self.fingers.index(data[0] - FINGER)
        return Reading(message.time, ROWS * place + (data[1] >> 4), data[2:])

    def unpack(self, payloads: Sequence[bytes | None]) -> NDArray[np.uint16]:
        """The counts (N,) of one frame; 0 where a segment is None."""
        return self.stacked(payloads, COLUMNS).astype(np.uint16).ravel()

    def encode(self, counts: Counts, sequence: int, time: float) -> list[Message]:
        """The messages of one frame (N,); the sequence number has no place in them."""
        del sequence
        matrices = self.checked(counts).reshape(-1, ROWS, COLUMNS).tolist()
        return [
            Message(time, HANDS[self.hand], bytes((FINGER + finger, row << 4, *taxels)))
            for finger, matrix in zip(self.fingers, matrices, strict=True)
            for row, taxels in enumerate(matrix)
        ]

    @classmethod
    def recognise(cls, traffic: Traffic) -> Iterator[Match]:
        """Rows of fingers, as replies to somebody's requests."""
        for hand, id_ in HANDS.items():
            keys = traffic.standard((id_,))
            rows = [m for m in traffic.messages(keys) if len(m.data) == 8 and 1 <= m.data[0] - FINGER <= 5]
            fingers = tuple(sorted({each.data[0] - FINGER for each in rows}))
            codec = cls(hand, fingers)
            if len({each.data[1] >> 4 for each in rows}) == ROWS and understands(codec, rows):
                settings, shape = {"hand": hand, "fingers": list(fingers)}, (ROWS * len(fingers), COLUMNS)
                listed = ", ".join(map(str, fingers))
                description = f"LinkerHand, {hand} hand, fingers {listed}, polled by another node"
                yield Match(settings, codec, keys, shape, description)


SKIN = Linker
