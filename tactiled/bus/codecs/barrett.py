"""BarrettHand tactile pads: 24 taxels of 12 bits, five messages a frame.

Source of the layout: Barrett Technology's libbarrett (TactilePuck, full format).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tactiled.bus.codecs.plain import Plain
from tactiled.errors import CodecError
from tactiled.frames import Counts, Message, Reading

FULL = 0x409  # group and property of the full format; the node stands above


@dataclass(frozen=True)
class Barrett(Plain):
    """The pad of one node (puck)."""

    node: int
    taxels = 5

    @property
    def size(self) -> int:
        """Taxels in a frame."""
        return 24

    @property
    def full_scale(self) -> int:
        """Largest count."""
        return 0xFFF

    @property
    def ids(self) -> frozenset[tuple[int, bool]]:
        """The (id, extended) of the messages it listens to."""
        return frozenset({(FULL | self.node << 5, False)})

    def decode(self, message: Message) -> Reading:
        """What one message says: 4 bits of segment, five taxels of 12 bits, all big-endian."""
        data = message.data
        if message.fd or len(data) != 8 or data[0] >> 4 >= self.segments:
            raise CodecError(f"message {message.id:#x} of {len(data)} bytes is none of a pad's five")
        return Reading(message.time, data[0] >> 4, data)

    def unpack(self, payloads: Sequence[bytes | None]) -> NDArray[np.uint16]:
        """The counts (N,) of one frame; 0 where a segment is None."""
        data = self.stacked(payloads, 8)
        digits: NDArray[np.int_] = (
            np.stack([data >> 4, data & 0xF], axis=-1).reshape(self.segments, 16)[:, 1:].astype(int)
        )
        taxels = digits[:, 0::3] << 8 | digits[:, 1::3] << 4 | digits[:, 2::3]
        return np.asarray(taxels.ravel()[: self.size], np.uint16)

    def encode(self, counts: Counts, sequence: int, time: float) -> list[Message]:
        """The messages of one frame (N,); the 25th taxel is 0, the sequence number has no place in them."""
        del sequence
        ((id_, _),) = self.ids
        padded = [*self.checked(counts).tolist(), 0]
        return [
            Message(
                time, id_, bytes.fromhex(f"{n:x}" + "".join(f"{each:03x}" for each in padded[5 * n : 5 * n + 5]))
            )
            for n in range(self.segments)
        ]
