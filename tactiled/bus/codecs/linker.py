"""LinkerHand: matrices of taxels of 8 bits on fingers and palm, sent on request.

Sources of the layouts: linkerbot 0.5.4 (hand/l6/force_sensor.py, hand/o6/force_sensor.py), linkerhand-ros2-sdk
(LinkerHand/core/can/linker_hand_g20_can.py), linkerhand-o20-ros2 (core/canfd/linker_hand_o20_canfd.py). On classic
CAN the replies bear the hand's own id, as does all else that it sends.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from tactiled.bounds import Bounds
from tactiled.bus.batch import Key
from tactiled.bus.codec import ClassicSkin, Match, Traffic, require_distinct, standard_ids, understands
from tactiled.bus.polling import Poll, Polling
from tactiled.errors import CodecError, ConfigError
from tactiled.frames import Counts, Message, Reading

HANDS: dict[Literal["right", "left"], int] = {"right": 0x27, "left": 0x28}  # ids
DEVICES = {"right": 1, "left": 2}  # of an O20
FINGER = 0xB0  # first byte, with the finger: 1 thumb, 2 index, 3 middle, 4 ring, 5 little, 6 the palm
PALM = 6
TOTALS = 0xFF  # in place of a row: the forces on whole pads, which end a G20's reply
TACTILE = 0x09  # the first of an O20's registers of taxels: two a finger
# Between requests: a hand on classic CAN takes one at a time (linkerbot, hand/o6/force_sensor.py).
PAUSE_S = 0.0025
G20_PAUSE_S = 0.015  # linker_hand_g20_can.py
Piece = tuple[int, int, int]  # finger, first taxel of its matrix in a message, number of them


class Layout(NamedTuple):
    """What one kind of matrix has."""

    finger: tuple[int, int]  # rows, columns
    taxels: int  # in a message; the last may have fewer
    palm: tuple[int, int] | None = None  # rows, columns
    code: int | None = None  # of a request for a matrix whose messages carry a row number alone


LAYOUTS: dict[Literal["12x6", "10x4", "g20-5", "g20-7", "o20"], Layout] = {
    "12x6": Layout((12, 6), 6, code=0xC6),
    "10x4": Layout((10, 4), 4, code=0xA4),
    "g20-5": Layout((23, 9), 5, (28, 20)),
    "g20-7": Layout((12, 6), 5, (14, 16)),
    "o20": Layout((12, 6), 63),
}


@dataclass(frozen=True)
class Linker(ClassicSkin):
    """LinkerHand: taxels of 8 bits on fingers and palm."""

    hand: Literal["right", "left"] = "right"
    """Which hand it is."""
    fingers: Annotated[tuple[Annotated[int, Bounds(1, 6)], ...], Field(min_length=1, max_length=6)] = (1,)
    """Fingers of the array: 1 is the thumb, 5 the little finger, 6 the palm of a G20."""
    poll_hz: Annotated[float, Bounds(0.01, 1000.0, "Hz", zero=True)] = 20.0
    """Requests per second for each finger; 0: the service only listens."""
    layout: Literal["12x6", "10x4", "g20-5", "g20-7", "o20"] = "12x6"
    """Matrix of a finger: 10x4 of an O6; g20-5 and g20-7 of a G20, by the type that it reports; o20 on CAN FD."""

    full_scale = 0xFF

    def __post_init__(self) -> None:
        """Refuse a finger named twice, and a palm without taxels."""
        require_distinct("fingers", self.fingers)
        if PALM in self.fingers and not LAYOUTS[self.layout].palm:
            raise ConfigError(f'fingers = {list(self.fingers)}: 6, the palm, has no taxels with "{self.layout}"')

    def _shape(self, finger: int) -> tuple[int, int]:
        """Rows and columns of a finger, or the palm."""
        kind = LAYOUTS[self.layout]
        return kind.palm if finger == PALM and kind.palm else kind.finger

    @cached_property
    def _pieces(self) -> tuple[Piece, ...]:
        """What each segment carries; none of the taxels where it ends a G20's reply."""
        kind, pieces = LAYOUTS[self.layout], list[Piece]()
        for finger in self.fingers:
            size = int(np.prod(self._shape(finger)))
            pieces += [(finger, at, min(kind.taxels, size - at)) for at in range(0, size, kind.taxels)]
            pieces += [(finger, size, 0)] if kind.palm else []
        return tuple(pieces)

    @cached_property
    def _places(self) -> dict[tuple[int, int], int]:
        """The segment of each finger and first taxel."""
        return {(finger, first): at for at, (finger, first, _) in enumerate(self._pieces)}

    @cached_property
    def _filled(self) -> NDArray[np.bool_]:
        """Which bytes (segments, taxels) of the payloads are taxels."""
        sizes = np.array([size for *_, size in self._pieces])
        return np.arange(LAYOUTS[self.layout].taxels) < sizes[:, None]

    @cached_property
    def size(self) -> int:
        """Taxels of all fingers, one finger's rows after the other's."""
        return int(self._filled.sum())

    @cached_property
    def segments(self) -> int:
        """Messages of all fingers."""
        return len(self._pieces)

    @cached_property
    def ordered(self) -> int:
        """The messages of a finger come in order."""
        return sum(finger == self.fingers[0] for finger, *_ in self._pieces)

    @cached_property
    def ids(self) -> frozenset[Key]:
        """The hand's one id; of an O20 two a message, with its write bit clear and set."""
        if self.layout != "o20":
            return standard_ids(HANDS[self.hand])
        registers = range(TACTILE, TACTILE + 2 * (PALM - 1))
        return frozenset((self._id(each) | writes << 12, True) for each in registers for writes in (0, 1))

    def _id(self, register: int) -> int:
        """The id by which an O20 is asked for a register."""
        return DEVICES[self.hand] << 21 | register << 13

    @cached_property
    def polling(self) -> Polling:
        """Requests to the fingers, one after the other; each answers by its messages."""
        if not self.poll_hz:
            return Polling()
        polls, first, kind = [], 0, LAYOUTS[self.layout]
        pause_s = 0.0 if self.layout == "o20" else G20_PAUSE_S if kind.palm else PAUSE_S
        pause_s = min(pause_s, 1 / self.poll_hz / len(self.fingers))
        for at, finger in enumerate(self.fingers):
            count = sum(each == finger for each, *_ in self._pieces)
            requests = self._requests(finger)
            step = count // len(requests)
            for each in requests:
                polls.append(Poll(each, 1 / self.poll_hz, range(first, first + step), at * pause_s))
                first += step
        return Polling(polls=tuple(polls))

    def _requests(self, finger: int) -> list[Message]:
        """What asks for all taxels of a finger."""
        if self.layout == "o20":
            registers = (TACTILE + 2 * (finger - 1), TACTILE + 2 * (finger - 1) + 1)
            return [Message(0.0, self._id(each), b"", True, True) for each in registers]
        code = LAYOUTS[self.layout].code
        request = (*self._shape(finger), 1) if code is None else (code,)
        return [Message(0.0, HANDS[self.hand], bytes((FINGER + finger, *request)))]

    def span(self, segment: int) -> slice:
        """The taxels that a segment carries."""
        first = int(self._filled[:segment].sum())
        return slice(first, first + self._pieces[segment][2])

    def decode(self, message: Message) -> Reading:
        """Some taxels of a finger, or the end of a G20's reply."""
        o20, data = self.layout == "o20", message.data
        if message.fd != o20 or len(data) < 3:
            raise CodecError(f"message {message.id:#x} of {len(data)} bytes is not of a finger")
        finger, first, payload = self._registered(message) if o20 else self._placed(data)
        segment = self._places.get((finger, first))
        if segment is None or len(payload) != self._pieces[segment][2]:
            raise CodecError(f"message {message.id:#x} of {len(data)} bytes is not of a configured finger")
        absent = o20 and not first and not data[0]
        bad = range(self.span(segment).start, self.span(segment + 1).stop) if absent else ()
        return Reading(message.time, segment, payload, bad=tuple(bad))

    def _registered(self, message: Message) -> tuple[int, int, bytes]:
        """Finger, first taxel and taxels of an O20: a status and 63 taxels, then 9 taxels and padding."""
        finger, second = divmod((message.id >> 13 & 0xFF) - TACTILE, 2)
        return finger + 1, 63 * second, message.data[:9] if second else message.data[1:]

    def _placed(self, data: bytes) -> tuple[int, int, bytes]:
        """Finger, first taxel and taxels of a classic message; its row is a digit or a byte beside the column."""
        finger, row = data[0] - FINGER, data[1]
        rows, columns = self._shape(finger)
        if LAYOUTS[self.layout].code is not None:
            return finger, row // 16 * columns if row % 16 == 0 else -1, data[2 : 2 + columns]
        if row == TOTALS:
            return finger, rows * columns, b""
        return finger, row * columns + data[2] if row < rows and data[2] < columns else -1, data[3:]

    def unpack(self, payloads: Sequence[bytes | None]) -> NDArray[np.uint16]:
        """The counts (N,) of one frame; 0 where a segment is None."""
        return self.stacked(payloads, LAYOUTS[self.layout].taxels)[self._filled].astype(np.uint16)

    def encode(self, counts: Counts, sequence: int, time: float) -> list[Message]:
        """The messages of one frame (N,); the sequence number has no place in them."""
        del sequence
        taxels = self.checked(counts).astype(np.uint8)
        carried = (taxels[self.span(at)].tobytes() for at in range(self.segments))
        return [self._message(each, data, time) for each, data in zip(self._pieces, carried, strict=True)]

    def _message(self, piece: Piece, taxels: bytes, time: float) -> Message:
        """One message; what ends a G20's reply has no force on its pads."""
        finger, first, _ = piece
        _, columns = self._shape(finger)
        if self.layout == "o20":
            register = TACTILE + 2 * (finger - 1) + bool(first)
            data = taxels.ljust(12, b"\0") if first else b"\x01" + taxels
            return Message(time, self._id(register), data, True, True)
        row, column = divmod(first, columns)
        head = (row << 4,) if LAYOUTS[self.layout].code is not None else (row, column)
        data = bytes((FINGER + finger, *head)) + taxels if taxels else bytes((FINGER + finger, TOTALS, 0, 0))
        return Message(time, HANDS[self.hand], data)

    @classmethod
    def recognise(cls, traffic: Traffic) -> Iterator[Match]:
        """Taxels of fingers, as replies to somebody's requests."""
        for layout, hand in ((layout, hand) for layout in LAYOUTS for hand in HANDS):
            every = cls(hand, tuple(range(1, 7 if LAYOUTS[layout].palm else 6)), layout=layout)
            keys = tuple(sorted(every.ids & traffic.keys()))
            requests = [(each.id, each.data) for finger in every.fingers for each in every._requests(finger)]
            replies = [each for each in traffic.messages(keys) if (each.id, each.data) not in requests]
            if layout != "o20":
                replies = [
                    each for each in replies if len(each.data) > 3 and each.data[0] - FINGER in every.fingers
                ]
            if not (replies and understands(every, replies)):
                continue
            pieces = {every._pieces[every.decode(each).segment] for each in replies}
            fingers = tuple(sorted({finger for finger, *_ in pieces}))
            codec = cls(hand, fingers, layout=layout)
            if pieces == set(codec._pieces):
                yield codec._match(keys)

    def _match(self, keys: tuple[Key, ...]) -> Match:
        """What was found on some ids, if it is all of this array."""
        settings: dict[str, Any] = {"hand": self.hand, "fingers": list(self.fingers)}
        settings |= {"layout": self.layout} if self.layout != "12x6" else {}
        (_, columns), *others = shapes = [self._shape(each) for each in self.fingers]
        grid, notes = (sum(rows for rows, _ in shapes), columns), tuple[str, ...]()
        if any(each != columns for _, each in others):
            grid, notes = (self.size, 1), ("array: fingers and palm are no grid: give positions_mm",)
        listed = ", ".join(map(str, self.fingers))
        description = f"LinkerHand, {self.layout}, {self.hand} hand, fingers {listed}, polled by another node"
        return Match(settings, self, keys, grid, description, notes)


SKIN = Linker
