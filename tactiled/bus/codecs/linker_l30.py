"""LinkerHand L30: five fingers of 12 x 6 taxels of 8 bits on CAN FD, sent on request in two messages a finger.

Source of the layout: linker-bot/linkerhand-l30-sdk, LinkerHandL30API/core/linker_hand_l30_v6_2_canfd.py (protocol
1.0.6). An id of 29 bits is parent command << 21 | finger << 13 | destination << 8 | source << 3; the master is 0.
A reply has its number of taxels, messages less one << 4 | message, a status and taxels.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from tactiled.bounds import Bounds
from tactiled.bus.batch import Key
from tactiled.bus.codec import ClassicSkin, Match, Traffic, require_distinct, understands
from tactiled.bus.polling import Poll, Polling
from tactiled.errors import CodecError
from tactiled.frames import Counts, Message, Reading

ROWS, COLUMNS = 12, 6
FINGER = ROWS * COLUMNS  # taxels
FIRST = 61  # of them in the first message, the rest is in the second
HEADER = 3  # bytes
TOUCH = 2  # parent command
LENGTHS = (64, 16)  # of the two messages, padded


@dataclass(frozen=True)
class LinkerL30(ClassicSkin):
    """LinkerHand L30: 12 x 6 taxels of 8 bits a finger."""

    node: Annotated[int, Bounds(1, 31)] = 1
    """Number of the hand (NodeID)."""
    fingers: Annotated[tuple[Annotated[int, Bounds(1, 5)], ...], Field(min_length=1, max_length=5)] = (1,)
    """Fingers of the array: 1 is the thumb, 5 the little finger."""
    poll_hz: Annotated[float, Bounds(0.01, 1000.0, "Hz", zero=True)] = 20.0
    """Requests per second for each finger; 0: the service only listens."""

    full_scale, ordered = 0xFF, 2

    def __post_init__(self) -> None:
        """Refuse a finger named twice."""
        require_distinct("fingers", self.fingers)

    @cached_property
    def size(self) -> int:
        """Taxels of all fingers, one finger's rows after the other's."""
        return FINGER * len(self.fingers)

    @cached_property
    def segments(self) -> int:
        """Two messages a finger."""
        return 2 * len(self.fingers)

    @cached_property
    def ids(self) -> frozenset[Key]:
        """An id a finger, from the hand to the master."""
        return frozenset((_id(each, source=self.node), True) for each in self.fingers)

    @cached_property
    def polling(self) -> Polling:
        """A request to each finger, evenly spaced."""
        if not self.poll_hz:
            return Polling()
        period_s, step_s = 1 / self.poll_hz, 1 / self.poll_hz / len(self.fingers)
        requests = (Message(0.0, _id(each, self.node), bytes(2), True, True) for each in self.fingers)
        return Polling(
            polls=tuple(
                Poll(each, period_s, range(2 * at, 2 * at + 2), at * step_s) for at, each in enumerate(requests)
            )
        )

    def span(self, segment: int) -> slice:
        """The taxels that a segment carries."""
        place, second = divmod(segment, 2)
        start = FINGER * place
        return slice(start + FIRST, start + FINGER) if second else slice(start, start + FIRST)

    def decode(self, message: Message) -> Reading:
        """One of the two messages of a finger."""
        data, finger = message.data, message.id >> 13 & 0xFF
        second = len(data) > 1 and data[1] & 0xF
        if not message.fd or finger not in self.fingers or second not in (0, 1) or len(data) != LENGTHS[second]:
            raise CodecError(f"message {message.id:#x} of {len(data)} bytes is not of a finger")
        count = FINGER - FIRST if second else FIRST
        if data[:HEADER] != bytes((count, 1 << 4 | second, 0)):
            raise CodecError(f"message {message.id:#x} begins {data[:HEADER].hex(' ')}: no taxels, or a status")
        segment = 2 * self.fingers.index(finger) + second
        return Reading(message.time, segment, data[HEADER : HEADER + count])

    def unpack(self, payloads: Sequence[bytes | None]) -> NDArray[np.uint16]:
        """The counts (N,) of one frame; 0 where a segment is None."""
        return self.stacked(payloads, FIRST).reshape(-1, 2 * FIRST)[:, :FINGER].ravel().astype(np.uint16)

    def encode(self, counts: Counts, sequence: int, time: float) -> list[Message]:
        """The messages of one frame (N,); the sequence number has no place in them."""
        del sequence
        taxels, messages = self.checked(counts).astype(np.uint8), []
        for segment in range(self.segments):
            place, second = divmod(segment, 2)
            own = taxels[self.span(segment)].tobytes()
            data = bytes((len(own), 1 << 4 | second, 0)) + own
            id_ = _id(self.fingers[place], source=self.node)
            messages.append(Message(time, id_, data.ljust(LENGTHS[second], b"\0"), True, True))
        return messages

    @classmethod
    def recognise(cls, traffic: Traffic) -> Iterator[Match]:
        """Both messages of every finger, as replies to somebody's requests."""
        for node in range(1, 32):
            keys = tuple(key for key in sorted(cls(node, (1, 2, 3, 4, 5)).ids) if key in traffic)
            fingers = tuple(id_ >> 13 & 0xFF for id_, _ in keys)
            if not keys:
                continue
            codec, messages = cls(node, fingers), traffic.messages(keys)
            if understands(codec, messages) and {codec.decode(each).segment for each in messages} == {
                *range(codec.segments)
            }:
                listed = ", ".join(map(str, fingers))
                description = f"LinkerHand L30, node {node}, fingers {listed}, polled by another node"
                shape = (ROWS * len(fingers), COLUMNS)
                yield Match({"node": node, "fingers": list(fingers)}, codec, keys, shape, description)


def _id(finger: int, destination: int = 0, source: int = 0) -> int:
    return TOUCH << 21 | finger << 13 | destination << 8 | source << 3


SKIN = LinkerL30
