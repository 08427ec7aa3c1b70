"""PowerON TouchDetect: 6 x 6 taxels of 12 bits, twelve messages of half a row each.

Source of the layout: PowerON's touch_detect_sdk (MIT).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from tactiled.bounds import Bounds
from tactiled.bus.batch import Key
from tactiled.bus.codec import ClassicSkin, Match, Traffic, standard_ids, understands
from tactiled.errors import CodecError
from tactiled.frames import Counts, Message, Reading

PAYLOAD = 5  # bytes of a message that carry taxels
LAST_BASE_ID = 0x7F4  # twelve ids of 11 bits begin there at the latest


@dataclass(frozen=True)
class PowerOn(ClassicSkin):
    """PowerON TouchDetect: 6 x 6 taxels of 12 bits."""

    base_id: Annotated[int, Bounds(0, LAST_BASE_ID, hexadecimal=True)] = 0x300
    """First CAN id of the skin."""

    size, full_scale, taxels = 36, 0xFFF, 3

    @cached_property
    def ids(self) -> frozenset[Key]:
        """`base_id` and the eleven ids behind it."""
        return standard_ids(*range(self.base_id, self.base_id + self.segments))

    def decode(self, message: Message) -> Reading:
        """The low bytes of three taxels, then their high digits."""
        data, segment = message.data, message.id - self.base_id
        if message.fd or len(data) != 8 or not 0 <= segment < self.segments:
            raise CodecError(f"message {message.id:#x} of {len(data)} bytes does not belong to the array")
        return Reading(message.time, segment, data[:PAYLOAD])

    def unpack(self, payloads: Sequence[bytes | None]) -> NDArray[np.uint16]:
        """The counts (N,) of one frame; 0 where a segment is None."""
        data = self.stacked(payloads, PAYLOAD).astype(np.uint16)
        high = np.column_stack([data[:, 3] & 0xF, data[:, 3] >> 4, data[:, 4] & 0xF])
        return np.asarray(high << 8 | data[:, :3], np.uint16).ravel()

    def encode(self, counts: Counts, sequence: int, time: float) -> list[Message]:
        """The messages of one frame (N,); the sequence number has no place in them."""
        del sequence
        rows = self.checked(counts).reshape(self.segments, self.taxels).tolist()
        data = ((a & 0xFF, b & 0xFF, c & 0xFF, b >> 8 << 4 | a >> 8, c >> 8, 0, 0, 0) for a, b, c in rows)
        return [Message(time, self.base_id + segment, bytes(each)) for segment, each in enumerate(data)]

    @classmethod
    def recognise(cls, traffic: Traffic) -> Iterator[Match]:
        """Twelve ids in a row that came equally often, and whose last bytes never change."""
        for id_, extended in sorted(traffic):
            codec = cls(id_)
            keys = traffic.standard(range(id_, id_ + codec.segments))
            if extended or id_ > LAST_BASE_ID or len(keys) != codec.segments or not traffic.even(keys):
                continue
            messages = traffic.messages(keys)
            if not understands(codec, messages) or any(each.data[4] > 0xF for each in messages):
                continue
            if len({each.data[PAYLOAD:] for each in messages}) == 1:
                yield Match({"base_id": id_}, codec, keys, (6, 6), f"PowerON TouchDetect at {id_:#x}")


SKIN = PowerOn
