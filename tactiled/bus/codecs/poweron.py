"""PowerON TouchDetect: 6 x 6 taxels of 12 bits, twelve messages of half a row each.

Source of the layout: PowerON's touch_detect_sdk (MIT).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tactiled.bus.codecs.plain import Plain
from tactiled.errors import CodecError
from tactiled.frames import Counts, Message, Reading

USED = 5  # bytes of a message that say something


@dataclass(frozen=True)
class PowerOn(Plain):
    """One array, its messages on `base_id` and the eleven ids behind it."""

    base_id: int = 0x300
    taxels = 3

    @property
    def size(self) -> int:
        """Taxels in a frame."""
        return 36

    @property
    def full_scale(self) -> int:
        """Largest count."""
        return 0xFFF

    @property
    def ids(self) -> frozenset[tuple[int, bool]]:
        """The (id, extended) of the messages it listens to."""
        return frozenset((self.base_id + segment, False) for segment in range(self.segments))

    def decode(self, message: Message) -> Reading:
        """What one message says: the low bytes of three taxels, then their high digits."""
        data, segment = message.data, message.id - self.base_id
        if message.fd or len(data) != 8 or not 0 <= segment < self.segments:
            raise CodecError(f"message {message.id:#x} of {len(data)} bytes is none of an array's twelve")
        return Reading(message.time, segment, data[:USED])

    def unpack(self, payloads: Sequence[bytes | None]) -> NDArray[np.uint16]:
        """The counts (N,) of one frame; 0 where a segment is None."""
        data = self.stacked(payloads, USED).astype(np.uint16)
        high = np.column_stack([data[:, 3] & 0xF, data[:, 3] >> 4, data[:, 4] & 0xF])
        return (high << 8 | data[:, :3]).astype(np.uint16).ravel()

    def encode(self, counts: Counts, sequence: int, time: float) -> list[Message]:
        """The messages of one frame (N,); the sequence number has no place in them."""
        del sequence
        return [
            Message(
                time,
                self.base_id + segment,
                bytes((a & 0xFF, b & 0xFF, c & 0xFF, b >> 8 << 4 | a >> 8, c >> 8, 0, 0, 0)),
            )
            for segment, (a, b, c) in enumerate(self.checked(counts).reshape(-1, 3).tolist())
        ]
