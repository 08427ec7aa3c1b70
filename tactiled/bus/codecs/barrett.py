"""BarrettHand tactile pads: 24 taxels of 12 bits, five messages a frame.

Source of the layout: Barrett Technology's libbarrett (TactilePuck, full format). Of the requests: its
src/products/tactile_puck.cpp, include/barrett/products/detail/puck-inl.h, and property_list.cpp for firmware of
motor pucks from the first that knows TACT on.
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
from tactiled.bus.polling import Poll, Polling
from tactiled.errors import CodecError
from tactiled.frames import Counts, Message, Reading

FULL_FORMAT = 0x409  # group and property in the id; the node stands above
TACT, SET = 106, 0x80  # number of the property; the bit that sets one
FULL = 2  # value of TACT


@dataclass(frozen=True)
class Barrett(ClassicSkin):
    """BarrettHand, the pad of one node: 24 taxels of 12 bits."""

    node: Annotated[int, Bounds(0, 31)]
    """Number of the node."""
    poll_hz: Annotated[float, Bounds(0.01, 1000.0, "Hz", zero=True)] = 0.0
    """Requests per second; 0: the service only listens, and another program has to ask."""

    size, full_scale, taxels = 24, 0xFFF, 5

    @cached_property
    def ids(self) -> frozenset[Key]:
        """The pad's one id."""
        return standard_ids(FULL_FORMAT | self.node << 5)

    @cached_property
    def polling(self) -> Polling:
        """The full format once, then a request for every frame."""
        if not self.poll_hz:
            return Polling()
        full = Message(0.0, self.node, bytes((TACT | SET, 0)) + FULL.to_bytes(4, "little"))
        request = Message(0.0, self.node, bytes((TACT,)))
        return Polling(start=((0.0, full),), polls=(Poll(request, 1 / self.poll_hz, range(self.segments)),))

    def decode(self, message: Message) -> Reading:
        """4 bits of segment, five taxels of 12 bits, all big-endian."""
        data = message.data
        if message.fd or len(data) != 8 or data[0] >> 4 >= self.segments:
            raise CodecError(f"message {message.id:#x} of {len(data)} bytes does not belong to the pad")
        return Reading(message.time, data[0] >> 4, data)

    def unpack(self, payloads: Sequence[bytes | None]) -> NDArray[np.uint16]:
        """The counts (N,) of one frame; 0 where a segment is None."""
        data = self.stacked(payloads, 8).astype(np.uint16)
        digits = np.stack([data >> 4, data & 0xF], axis=-1).reshape(self.segments, 16)[:, 1:]
        counts = digits[:, 0::3] << 8 | digits[:, 1::3] << 4 | digits[:, 2::3]
        return np.asarray(counts, np.uint16).ravel()[: self.size]

    def encode(self, counts: Counts, sequence: int, time: float) -> list[Message]:
        """The messages of one frame (N,); the 25th taxel is 0, the sequence number has no place in them."""
        del sequence
        ((id_, _),) = self.ids
        rows = np.append(self.checked(counts), 0).reshape(self.segments, self.taxels).tolist()
        digits = (f"{n:x}" + "".join(f"{each:03x}" for each in row) for n, row in enumerate(rows))
        return [Message(time, id_, bytes.fromhex(each)) for each in digits]

    @classmethod
    def recognise(cls, traffic: Traffic) -> Iterator[Match]:
        """Five messages on one id, in turn."""
        notes = (
            "array: 8 x 3 is a fingertip's; the palm has positions of its own",
            "poll_hz: 20 where no other program asks",
        )
        for node in range(32):
            codec = cls(node)
            keys = traffic.standard(id_ for id_, _ in codec.ids)
            messages = traffic.messages(keys)
            if understands(codec, messages) and len({each.data[0] >> 4 for each in messages}) == codec.segments:
                yield Match({"node": node}, codec, keys, (8, 3), f"BarrettHand pad, node {node}", notes)


SKIN = Barrett
