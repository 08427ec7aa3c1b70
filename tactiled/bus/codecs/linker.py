"""LinkerHand fingers: matrices of 12 x 6 taxels of 8 bits, a message a row, sent when asked for.

Source of the layout: Linkerbot's public SDKs (request code C6). The replies bear the hand's own id, as does all
else that it says.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from tactiled.bus.codecs import Plain, Poll, Talk
from tactiled.errors import CodecError, ConfigError
from tactiled.frames import Counts, Message, Reading

HANDS = {"right": 0x27, "left": 0x28}
FINGER = 0xB0  # first byte, with the finger: 1 thumb, 2 index, 3 middle, 4 ring, 5 little
MATRIX = 0xC6  # asks for a matrix
ROWS, COLUMNS = 12, 6


@dataclass(frozen=True)
class Linker(Plain):
    """Some fingers of one hand as one array, one finger's rows after the other's."""

    hand: Literal["right", "left"] = "right"
    fingers: tuple[int, ...] = (1,)
    poll_hz: float = 20.0  # requests a second to each finger; 0: only listen
    taxels = COLUMNS

    def __post_init__(self) -> None:
        """Refuse a finger named twice."""
        if len(set(self.fingers)) != len(self.fingers):
            raise ConfigError(f"codec.fingers = {list(self.fingers)}: names a finger twice")

    @property
    def size(self) -> int:
        """Taxels in a frame."""
        return ROWS * COLUMNS * len(self.fingers)

    @property
    def ordered(self) -> int:
        """Segments that come in order: a finger's rows."""
        return ROWS

    @property
    def full_scale(self) -> int:
        """Largest count."""
        return 0xFF

    @property
    def ids(self) -> frozenset[tuple[int, bool]]:
        """The (id, extended) of the messages it listens to."""
        return frozenset({(HANDS[self.hand], False)})

    @property
    def talk(self) -> Talk:
        """A request to each finger at the same time, which answers by its rows."""
        if not self.poll_hz:
            return Talk()
        asked = (Message(0.0, HANDS[self.hand], bytes((FINGER + finger, MATRIX))) for finger in self.fingers)
        return Talk(
            polls=tuple(
                Poll(each, 1 / self.poll_hz, range(ROWS * place, ROWS * (place + 1)))
                for place, each in enumerate(asked)
            )
        )

    def decode(self, message: Message) -> Reading:
        """What one message says: the finger, the row in the high digit, six taxels."""
        data = message.data
        if message.fd or len(data) != 8 or data[1] & 0xF or data[1] >> 4 >= ROWS:
            raise CodecError(f"message {message.id:#x} of {len(data)} bytes is no row of a finger")
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
        rows = self.checked(counts).reshape(-1, ROWS, COLUMNS).tolist()
        return [
            Message(time, HANDS[self.hand], bytes((FINGER + finger, row << 4, *taxels)))
            for finger, matrix in zip(self.fingers, rows, strict=True)
            for row, taxels in enumerate(matrix)
        ]
