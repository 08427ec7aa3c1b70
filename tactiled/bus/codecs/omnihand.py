"""AgiBot OmniHand 2025: 16 taxels of 8 bits a finger, 25 on palm and back, a CAN FD message each, on request.

Source of the layout: AgiBot's Omnihand-2025-SDK (src/proto.h, GetTactileSensorData of
src/implementation/c_agibot_hand_can/c_agibot_hand_can.cc, document/pic/tactile_sensor_array.jpg).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from tactiled.bounds import Bounds
from tactiled.bus.batch import Key
from tactiled.bus.codec import ClassicSkin, Match, Traffic, require_distinct, understands
from tactiled.bus.polling import Poll, Polling
from tactiled.errors import CodecError
from tactiled.frames import Counts, Message, Reading

TACTILE = 5 << 16 | 1 << 8  # kind of message and product in the id; the part stands above, the device below
LITTLE = 5  # the last finger; after it come palm and back
FINGER, PALM = 16, 25  # taxels
ROWS, COLUMNS = 8, 2  # of a finger
LENGTHS = (16, 20, 24, 32, 48, 64)  # of CAN FD
REQUEST = bytes(64)


@dataclass(frozen=True)
class OmniHand(ClassicSkin):
    """AgiBot OmniHand 2025: 8 x 2 taxels of 8 bits a finger, 25 on palm and back."""

    device: Annotated[int, Bounds(0, 127)] = 1
    """Number of the hand."""
    hand: Literal["right", "left"] = "right"
    """Which hand it is: the columns of a finger are mirrored."""
    parts: Annotated[tuple[Annotated[int, Bounds(1, 7)], ...], Field(min_length=1, max_length=7)] = (1,)
    """Parts of the array: 1 is the thumb, 5 the little finger, 6 the palm, 7 the back."""
    poll_hz: Annotated[float, Bounds(0.01, 1000.0, "Hz")] = 20.0
    """Requests per second for each part."""

    full_scale = 0xFF

    def __post_init__(self) -> None:
        """Refuse a part named twice."""
        require_distinct("parts", self.parts)

    @cached_property
    def _sizes(self) -> NDArray[np.int64]:
        """Taxels of each part."""
        return np.where(np.array(self.parts) <= LITTLE, FINGER, PALM)

    @cached_property
    def _order(self) -> NDArray[np.int64]:
        """Where each taxel of a finger, from its upper row down, is in a message."""
        order = np.arange(FINGER).reshape(ROWS, COLUMNS)[::-1]
        return (order if self.hand == "right" else order[:, ::-1]).ravel()

    @cached_property
    def _bytes(self) -> NDArray[np.int64]:
        """Where each taxel (N,) is in the messages of a frame, PALM bytes each."""
        orders = (self._order if size == FINGER else np.arange(PALM) for size in self._sizes)
        return np.concatenate([PALM * at + order for at, order in enumerate(orders)])

    @cached_property
    def size(self) -> int:
        """Taxels of all parts."""
        return int(self._sizes.sum())

    @cached_property
    def segments(self) -> int:
        """A message a part."""
        return len(self.parts)

    def _id(self, part: int) -> int:
        """The id of a part's requests and replies."""
        return part << 24 | TACTILE | self.device

    @cached_property
    def ids(self) -> frozenset[Key]:
        """An id a part."""
        return frozenset((self._id(each), True) for each in self.parts)

    @cached_property
    def polling(self) -> Polling:
        """A request to each part at the same time, which answers by a message."""
        requests = (Message(0.0, self._id(each), REQUEST, True, True) for each in self.parts)
        return Polling(
            polls=tuple(Poll(each, 1 / self.poll_hz, range(at, at + 1)) for at, each in enumerate(requests))
        )

    def span(self, segment: int) -> slice:
        """The taxels that a segment carries."""
        first = int(self._sizes[:segment].sum())
        return slice(first, first + int(self._sizes[segment]))

    def decode(self, message: Message) -> Reading:
        """The taxels of a part, and padding."""
        segment, data = self.parts.index(message.id >> 24), message.data
        size = int(self._sizes[segment])
        if not message.fd or len(data) < size or len(data) not in LENGTHS:
            raise CodecError(f"message {message.id:#x} of {len(data)} bytes is not one of {size} taxels")
        return Reading(message.time, segment, data[:size])

    def unpack(self, payloads: Sequence[bytes | None]) -> NDArray[np.uint16]:
        """The counts (N,) of one frame; 0 where a segment is None."""
        return self.stacked(payloads, PALM).ravel()[self._bytes].astype(np.uint16)

    def encode(self, counts: Counts, sequence: int, time: float) -> list[Message]:
        """The messages of one frame (N,); the sequence number has no place in them."""
        del sequence
        parts = np.zeros(PALM * self.segments, np.uint8)
        parts[self._bytes] = self.checked(counts)
        messages = []
        for part, size, row in zip(self.parts, self._sizes.tolist(), parts.reshape(-1, PALM), strict=True):
            padded = row[:size].tobytes().ljust(min(each for each in LENGTHS if each >= size), b"\0")
            messages.append(Message(time, self._id(part), padded, True, True))
        return messages

    @classmethod
    def recognise(cls, traffic: Traffic) -> Iterator[Match]:
        """Parts by their ids, as replies to somebody's requests."""
        tactile = sorted(
            id_ for id_, extended in traffic if extended and id_ & 0xFFFF80 == TACTILE and 1 <= id_ >> 24 <= 7
        )
        for device in sorted({each & 0x7F for each in tactile}):
            parts = tuple(each >> 24 for each in tactile if each & 0x7F == device)
            codec = cls(device, parts=parts)
            keys = tuple((codec._id(each), True) for each in parts)
            if understands(codec, traffic.messages(keys)):
                notes = ["hand: left where it is one", "let no other program ask: it looks like taxels of zero"]
                shape = (ROWS * len(parts), COLUMNS)
                if parts[-1] > LITTLE:
                    shape = (codec.size, 1)
                    notes.append("array: the order on palm and back is not documented: give positions_mm")
                listed = ", ".join(map(str, parts))
                description = f"AgiBot OmniHand 2025, device {device}, parts {listed}, polled by another node"
                settings = {"device": device, "parts": list(parts)}
                yield Match(settings, codec, keys, shape, description, tuple(notes))


SKIN = OmniHand
