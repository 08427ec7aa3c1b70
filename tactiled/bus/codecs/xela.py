"""XELA uSkin: three axes a taxel, a message a taxel; the normal axis is the image.

Source of the layout: the vendor's manual of the 4 x 6 module (August 2023) for today's ids; community drivers for
those of older generations, whose payload is the same. Source of the models: public notes on the vendor's server,
which tell modules by their ids, and a public capture of what it sends.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tactiled.bus.codecs import Plain, Talk
from tactiled.errors import CodecError, ConfigError
from tactiled.frames import Counts, Message, Reading

STATUS = 0x83  # first byte of what `encode` makes
REST = 0x4000  # counts near which X and Y of the modules that were heard rest; what `encode` says of them
START = 0x200  # id, with the board's number, on which older boards are started and stopped
OLDER = {
    "4x4-old": tuple(0x100 | row << 4 | column for row in range(4) for column in range(4)),
    "4x4-new": tuple(0x200 + 8 * row + column for row in range(4) for column in range(4)),
    "4x6-old": tuple(0x100 | row << 4 | column for row in range(4) for column in range(6)),
    "single": tuple(range(0x710, 0x720)),
}
MODELS = {(2, 2): "uSPa22", (4, 4): "uSPa44", (4, 6): "uSPa46", (2, 8): "XR1944"}  # SDAs and taxels, today's ids
OLDER_MODELS = {"4x4-old": "XR1944", "4x4-new": "XR1944", "4x6-old": "XR1946"}


@dataclass(frozen=True)
class Xela(Plain):
    """One module. In the profile "current" an id is SDA << 8 | taxel << 4 | microcontroller.

    `rows` are the SDAs from the top row down, `columns` the taxels of each from left to right (the 4 x 6 module
    with its connector on the left); the older profiles have fixed ids instead.
    """

    profile: str = "current"
    controller: int = 1
    rows: tuple[int, ...] = (4, 3, 2, 1)
    columns: tuple[int, ...] = (5, 4, 3, 2, 1, 0)
    start: bool = False  # start an older board, whose number is `controller`
    model: str = ""  # as the vendor's software calls the module; left out: as its ids and size say
    taxels = 1

    def __post_init__(self) -> None:
        """Refuse a profile that is not known, and an SDA or a taxel named twice."""
        if self.profile != "current" and self.profile not in OLDER:
            raise ConfigError(f"codec.profile = {self.profile!r}: choose current or one of {', '.join(OLDER)}")
        if self.start and self.profile == "current":
            raise ConfigError(
                "codec.start = true: modules of the current profile send by themselves: leave it out"
            )
        if len(set(self._ids)) != len(self._ids):
            raise ConfigError("codec.rows or codec.columns names an SDA or a taxel twice")

    @property
    def told_model(self) -> str:
        """The module's model, by the vendor's name for it; "unknown" where nothing says."""
        if self.model:
            return self.model
        if self.profile != "current":
            return OLDER_MODELS.get(self.profile, "unknown")
        return MODELS.get((len(self.rows), len(self.columns)), "unknown")

    @property
    def talk(self) -> Talk:
        """Start, and at the end stop, an older board."""
        if not self.start:
            return Talk()
        id_ = START | self.controller
        return Talk(start=((0.0, Message(0.0, id_, b"\x07\x00")),), stop=(Message(0.0, id_, b"\x07\x01"),))

    @cached_property
    def _ids(self) -> tuple[int, ...]:
        """The id of every taxel, row by row."""
        if self.profile != "current":
            return OLDER[self.profile]
        return tuple(sda << 8 | taxel << 4 | self.controller for sda in self.rows for taxel in self.columns)

    @cached_property
    def _place(self) -> dict[int, int]:
        return {id_: taxel for taxel, id_ in enumerate(self._ids)}

    @property
    def size(self) -> int:
        """Taxels in a frame."""
        return len(self._ids)

    @property
    def ordered(self) -> int:
        """Segments that come in order: none is known to."""
        return 1

    @property
    def full_scale(self) -> int:
        """Largest count."""
        return 0xFFFF

    @property
    def ids(self) -> frozenset[tuple[int, bool]]:
        """The (id, extended) of the messages it listens to."""
        return frozenset((id_, False) for id_ in self._ids)

    def decode(self, message: Message) -> Reading:
        """What one message says: a taxel's status, X, Y, Z and status, eight bytes."""
        if message.fd or len(message.data) != 8 or message.id not in self._place:
            raise CodecError(f"message {message.id:#x} of {len(message.data)} bytes is no taxel's classic eight")
        return Reading(message.time, self._place[message.id], message.data[1:7])

    def axes(self, payloads: Sequence[bytes | None]) -> NDArray[np.uint16]:
        """The counts of X, Y and Z (N, 3) of one frame; 0 where a segment is None."""
        return self.stacked(payloads, 6).copy().view(">u2").astype(np.uint16)

    def unpack(self, payloads: Sequence[bytes | None]) -> NDArray[np.uint16]:
        """The counts of Z (N,), normal to the skin; 0 where a segment is None."""
        return self.axes(payloads)[:, 2]

    def shear(self, payloads: Sequence[bytes | None]) -> NDArray[np.float32]:
        """Counts of X and Y (2, N) less `REST`; NaN where a segment is None."""
        shear = self.axes(payloads)[:, :2].T.astype(np.float32) - REST
        shear[:, [each is None for each in payloads]] = np.nan
        return shear

    def encode(self, counts: Counts, sequence: int, time: float) -> list[Message]:
        """The messages of one frame (N,) without shear; the sequence number has no place in them."""
        return self.encode_sheared(counts, np.zeros((2, self.size), np.float32), sequence, time)

    def encode_sheared(
        self, counts: Counts, shear: NDArray[np.float32], sequence: int, time: float
    ) -> list[Message]:
        """The messages of one frame (N,) and its shear (2, N), which ends where an axis does."""
        del sequence
        axes = np.empty((self.size, 3), ">u2")
        axes[:, :2] = np.clip(np.round(shear.T) + REST, 0, self.full_scale)
        axes[:, 2] = self.checked(counts)
        return [
            Message(time, id_, bytes((STATUS, *one.tobytes(), 0)))
            for id_, one in zip(self._ids, axes, strict=True)
        ]
