"""iCub MTB skin: triangles of twelve pads of 8 bits, two messages a triangle; the value falls as pressure rises.

Source of the layout: robotology's icub-firmware-shared (canProtocolLib), icub-firmware (embot/prot/can) and
icub-main (canBusSkin, skinLib).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tactiled.bus.codecs import Talk
from tactiled.errors import CodecError, ConfigError
from tactiled.frames import Counts, Message, Reading

PERIODIC, OLD, POLL = 0x400, 0x300, 0x200  # message classes: skin data, skin data of older boards, set-up
HEAD, TAIL = 0x40, 0xC0  # first byte: pads 0-6, pads 7-11 and diagnostics
PADS = 12
THERMAL = (6, 10)  # pads that follow temperature, not pressure
NO_LOAD = 240  # counts of an unloaded pad, the host's default
UNIT = 40  # parts of a millimetre in the table below
PLACES = (
    (257.2, 0.0),
    (385.83, -222.83),
    (128.62, -222.83),
    (0.0, 0.0),
    (-128.62, -222.83),
    (-385.83, -222.83),
    (-256.3, -147.64),
    (-257.2, 0.0),
    (-128.62, 222.83),
    (0.0, 445.54),
    (0.0, 296.55),
    (128.62, 222.83),
)
SET_UP_S = 0.5  # that a board is given between its set-up and its start
APART = 25.0  # mm between the centres of triangles drawn side by side


@dataclass(frozen=True)
class Icub:
    """Some triangles of one board as one array, `triangles` in the order in which they are drawn."""

    board: int
    triangles: tuple[int, ...]
    thermal_pads: bool = True  # False: pads 6 and 10 are taxels too, as on a fingertip
    start: bool = False  # set the board up and start it; False: another program does
    period_ms: int = 30  # of what it sends once started

    def __post_init__(self) -> None:
        """Refuse a triangle named twice."""
        if len(set(self.triangles)) != len(self.triangles):
            raise ConfigError(f"codec.triangles = {list(self.triangles)}: names a triangle twice")

    @property
    def talk(self) -> Talk:
        """Set up, half a second later start, at the end stop: what the robot's own software says to a board."""
        if not self.start:
            return Talk()
        set_up = (configure_board(self.board, self.period_ms), configure_triangles(self.board, 0, 15))
        begun = ((0.0, set_up[0]), (0.0, set_up[1]), (SET_UP_S, start(self.board)))
        return Talk(start=begun, stop=(stop(self.board),))

    @cached_property
    def pads(self) -> tuple[int, ...]:
        """The pads of a triangle that are taxels."""
        return tuple(pad for pad in range(PADS) if not (self.thermal_pads and pad in THERMAL))

    @cached_property
    def _parts(self) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """The taxel pads that a head and a tail carry."""
        return tuple(pad for pad in self.pads if pad < 7), tuple(pad for pad in self.pads if pad >= 7)

    @cached_property
    def _order(self) -> dict[int, int]:
        return {triangle: place for place, triangle in enumerate(self.triangles)}

    @property
    def positions(self) -> NDArray[np.float64]:
        """Where the taxels are (N, 2), mm: each triangle flat, side by side along x."""
        one = np.array([PLACES[pad] for pad in self.pads]) / UNIT
        return np.concatenate([one + np.array([APART * place, 0]) for place in range(len(self.triangles))])

    @property
    def size(self) -> int:
        """Taxels in a frame."""
        return len(self.pads) * len(self.triangles)

    @property
    def segments(self) -> int:
        """Messages in a whole frame: a head and a tail for each triangle."""
        return 2 * len(self.triangles)

    @property
    def modulus(self) -> None:
        """None: this skin sends no sequence number."""
        return

    @property
    def ordered(self) -> int:
        """Segments that come in order: a head, then its tail."""
        return 2

    @property
    def full_scale(self) -> int:
        """Largest count."""
        return 255

    @property
    def ids(self) -> frozenset[tuple[int, bool]]:
        """The (id, extended) of the messages it listens to, of both generations of boards."""
        return frozenset(
            (kind | self.board << 4 | each, False) for kind in (PERIODIC, OLD) for each in self.triangles
        )

    def span(self, segment: int) -> slice:
        """The taxels that a segment carries."""
        place, tail = divmod(segment, 2)
        start = place * len(self.pads) + (len(self._parts[0]) if tail else 0)
        return slice(start, start + len(self._parts[tail]))

    def decode(self, message: Message) -> Reading:
        """What one message says; CodecError where it is neither a head nor a tail."""
        data, place = message.data, self._order.get(message.id & 0xF)
        if message.fd or place is None:
            raise CodecError(f"message {message.id:#x} is no classic message of a configured triangle")
        if len(data) == 8 and data[0] == HEAD:
            return Reading(message.time, 2 * place, data[1:])
        if len(data) in (6, 8) and data[0] == TAIL:
            bad = self._bad(place, data) if any(data[6:]) else ()
            return Reading(message.time, 2 * place + 1, data[1:6], bad=bad)
        raise CodecError(
            f"message {message.id:#x} of {len(data)} bytes is neither the head nor the tail of a triangle"
        )

    def unpack(self, payloads: Sequence[bytes | None]) -> NDArray[np.uint16]:
        """The counts (N,) of one frame; 0 where a segment is None."""
        whole = (bytes(5 if at % 2 else 7) if each is None else each for at, each in enumerate(payloads))
        pads = np.frombuffer(b"".join(whole), np.uint8).reshape(-1, PADS)
        return pads[:, self.pads].astype(np.uint16).ravel()

    def _bad(self, place: int, data: bytes) -> tuple[int, ...]:
        """Taxels that a tail's diagnostics call out of range; all of them where the triangle does not answer."""
        code = data[6] << 8 | data[7]
        lost = code & 0xF != 0
        first = place * len(self.pads)
        return tuple(first + at for at, pad in enumerate(self.pads) if lost or code >> (4 + pad) & 1)

    def encode(self, counts: Counts, sequence: int, time: float) -> list[Message]:
        """The messages of one frame (N,); thermal pads say no load; the sequence number has no place in them."""
        del sequence
        if counts.shape != (self.size,) or int(counts.max()) > self.full_scale:
            raise CodecError(
                f"counts {counts.shape} up to {counts.max()}: expected {self.size} up to {self.full_scale}"
            )
        pads = np.full((len(self.triangles), PADS), NO_LOAD, np.uint8)
        pads[:, self.pads] = counts.reshape(len(self.triangles), -1)
        messages = []
        for triangle, data in zip(self.triangles, map(bytes, pads), strict=True):
            id_ = PERIODIC | self.board << 4 | triangle
            messages.append(Message(time, id_, bytes((HEAD, *data[:7]))))
            messages.append(Message(time, id_, bytes((TAIL, *data[7:], 0, 0))))
        return messages


def start(board: int) -> Message:
    """The message that makes a board stream."""
    return Message(0.0, POLL | board, b"\x07\x00")


def stop(board: int) -> Message:
    """The message that makes a board fall silent."""
    return Message(0.0, POLL | board, b"\x07\x01")


def configure_board(board: int, period_ms: int, no_load: int = NO_LOAD, skin: int = 0) -> Message:
    """The message that sets a board's period (ms) and its no-load value (counts)."""
    return Message(0.0, POLL | board, bytes((0x4D, skin, period_ms, no_load)))


def configure_triangles(board: int, first: int, last: int, shift: int = 0, cdc: int = 0x2200) -> Message:
    """The message that enables triangles `first` to `last`; `cdc` is the capacitance converter's set-up."""
    return Message(0.0, POLL | board, bytes((0x50, first, last, shift, 1, cdc & 0xFF, cdc >> 8)))
