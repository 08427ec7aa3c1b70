"""CySkin on a CPM-Finger: 16 taxels of 16 bits, four messages a frame.

Source of the layout: wngfra's drivers of that finger (Apache-2.0), in which value n of a frame is taxel ORDER[n].
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tactiled.bus.codec import ClassicSkin, Match, Traffic, standard_ids, understands
from tactiled.errors import CodecError
from tactiled.frames import Counts, Message, Reading

ORDER = (11, 15, 14, 12, 9, 13, 8, 10, 6, 7, 4, 5, 2, 0, 3, 1)
IDS = (0x405, 0x407, 0x409, 0x40B)  # of the four messages


@dataclass(frozen=True)
class CySkin(ClassicSkin):
    """CySkin on a CPM-Finger: 16 taxels of 16 bits."""

    size, full_scale, taxels = len(ORDER), 0xFFFF, 4
    ids = standard_ids(*IDS)

    def span(self, segment: int) -> list[int]:
        """The taxels that a segment carries, as an index into a frame."""
        return list(ORDER[self.taxels * segment : self.taxels * (segment + 1)])

    def decode(self, message: Message) -> Reading:
        """Four taxels, little-endian."""
        if message.fd or len(message.data) != 8 or message.id not in IDS:
            raise CodecError(f"message {message.id:#x} of {len(message.data)} bytes does not belong to the finger")
        return Reading(message.time, IDS.index(message.id), message.data)

    def unpack(self, payloads: Sequence[bytes | None]) -> NDArray[np.uint16]:
        """The counts (N,) of one frame; 0 where a segment is None."""
        counts = np.empty(self.size, np.uint16)
        counts[list(ORDER)] = self.stacked(payloads, 8).view("<u2").ravel()
        return counts

    def encode(self, counts: Counts, sequence: int, time: float) -> list[Message]:
        """The messages of one frame (N,); the sequence number has no place in them."""
        del sequence
        rows = self.checked(counts)[list(ORDER)].astype("<u2").reshape(-1, self.taxels)
        return [Message(time, id_, row.tobytes()) for id_, row in zip(IDS, rows, strict=True)]

    @classmethod
    def recognise(cls, traffic: Traffic) -> Iterator[Match]:
        """Four ids that came equally often."""
        codec, keys = cls(), traffic.standard(IDS)
        if len(keys) == len(IDS) and traffic.even(keys) and understands(codec, traffic.messages(keys)):
            note = "array: 4 x 4 stands for the 16 taxels: give their positions_mm"
            yield Match({}, codec, keys, (4, 4), "CySkin finger", (note,))


SKIN = CySkin
