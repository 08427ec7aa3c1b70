"""CySkin on a CPM-Finger: 16 taxels of 16 bits, four messages a frame.

Source of the layout: wngfra's drivers of that finger (Apache-2.0), in which value n of a frame is taxel ORDER[n].
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tactiled.bus.codecs.plain import Plain
from tactiled.errors import CodecError
from tactiled.frames import Counts, Message, Reading

ORDER = (11, 15, 14, 12, 9, 13, 8, 10, 6, 7, 4, 5, 2, 0, 3, 1)
BASE, STEP = 0x405, 2  # the first message's id, and from one to the next


@dataclass(frozen=True)
class CySkin(Plain):
    """One finger."""

    taxels = 4

    @property
    def size(self) -> int:
        """Taxels in a frame."""
        return len(ORDER)

    @property
    def full_scale(self) -> int:
        """Largest count."""
        return 0xFFFF

    @property
    def ids(self) -> frozenset[tuple[int, bool]]:
        """The (id, extended) of the messages it listens to."""
        return frozenset((BASE + STEP * segment, False) for segment in range(self.segments))

    def span(self, segment: int) -> list[int]:
        """The taxels that a segment carries, as an index into a frame."""
        return list(ORDER[self.taxels * segment : self.taxels * (segment + 1)])

    def decode(self, message: Message) -> Reading:
        """What one message says: four taxels, little-endian."""
        segment, odd = divmod(message.id - BASE, STEP)
        if message.fd or len(message.data) != 8 or odd or not 0 <= segment < self.segments:
            raise CodecError(f"message {message.id:#x} of {len(message.data)} bytes is none of a finger's four")
        return Reading(message.time, segment, message.data)

    def unpack(self, payloads: Sequence[bytes | None]) -> NDArray[np.uint16]:
        """The counts (N,) of one frame; 0 where a segment is None."""
        counts = np.empty(self.size, np.uint16)
        counts[list(ORDER)] = self.stacked(payloads, 8).view("<u2").ravel()
        return counts

    def encode(self, counts: Counts, sequence: int, time: float) -> list[Message]:
        """The messages of one frame (N,); the sequence number has no place in them."""
        del sequence
        sent = self.checked(counts)[list(ORDER)].astype("<u2").reshape(-1, 4)
        return [Message(time, BASE + STEP * segment, each.tobytes()) for segment, each in enumerate(sent)]
