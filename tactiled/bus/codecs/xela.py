"""XELA uSkin: three axes a taxel, a message a taxel; the normal axis is the image.

Source of the layout: the vendor's manual of the 4 x 6 module (August 2023) for today's ids; community drivers for
those of older generations, whose payload is the same. Source of the models: public notes on the vendor's server,
which tells modules by their ids, and a public capture of what it sends.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from tactiled.bounds import WORD, Bounds, Syntax
from tactiled.bus.batch import Batch, Key
from tactiled.bus.codec import (
    Match,
    OrderedSkin,
    Readings,
    ShearCodec,
    Traffic,
    missing,
    require_distinct,
    standard_ids,
    understands,
)
from tactiled.bus.polling import Polling
from tactiled.errors import ConfigError
from tactiled.frames import Counts, Message

STATUS = 0x83  # first byte of what `encode` makes
REST = 0x4000  # counts near which X and Y of the modules that were recorded rest
START = 0x200  # id, with the board's number, on which older boards are started and stopped
Profile = Literal["current", "4x4-old", "4x4-new", "4x6-old", "single"]
OLDER_IDS: dict[Profile, tuple[int, ...]] = {
    "4x6-old": tuple(0x100 | row << 4 | column for row in range(4) for column in range(6)),
    "4x4-old": tuple(0x100 | row << 4 | column for row in range(4) for column in range(4)),
    "4x4-new": tuple(0x200 + 8 * row + column for row in range(4) for column in range(4)),
    "single": tuple(range(0x710, 0x720)),
}  # the largest first, whose ids hold another's
MODELS = {(2, 2): "uSPa22", (4, 4): "uSPa44", (4, 6): "uSPa46", (2, 8): "XR1944"}  # SDAs and taxels, today's ids
OLDER_MODELS = {"4x4-old": "XR1944", "4x4-new": "XR1944", "4x6-old": "XR1946"}


@dataclass(frozen=True)
class Xela(OrderedSkin, ShearCodec):
    """XELA uSkin, one 3-axis module: the normal axis is the image."""

    profile: Profile = "current"
    """Layout of the CAN ids: the present generation, or an older one."""
    controller: Annotated[int, Bounds(0, 15)] = 1
    """Number of the microcontroller."""
    rows: Annotated[tuple[Annotated[int, Bounds(0, 7)], ...], Field(min_length=1, max_length=8)] = (4, 3, 2, 1)
    """SDA lines, from the top row down."""
    columns: Annotated[tuple[Annotated[int, Bounds(0, 15)], ...], Field(min_length=1, max_length=16)] = (
        *range(5, -1, -1),
    )
    """Taxel numbers of a row, from left to right."""
    start: bool = False
    """Start a board of an older profile when the service starts, and stop it at the end."""
    model: Annotated[str, Syntax(r"^[A-Za-z0-9_-]{0,32}$", f"up to 32 {WORD}")] = ""
    """Model name that XELA's clients receive; empty: derived from ids and size."""

    taxels, full_scale = 1, 0xFFFF
    ordered = 1  # no segments are known to come in order

    def __post_init__(self) -> None:
        """Refuse an SDA or a taxel named twice, and settings that the profile does not use."""
        require_distinct("rows", self.rows)
        require_distinct("columns", self.columns)
        if self.start and self.profile == "current":
            raise ConfigError("start = true: modules of the current profile send by themselves: leave it out")
        if self.profile == "current":
            return
        unused = dict.fromkeys(("rows", "columns"), 'profile = "current"')
        if not self.start:
            unused["controller"] = "start = true"
        for key, use in unused.items():
            if (value := getattr(self, key)) != getattr(type(self), key):
                setting = list(value) if isinstance(value, tuple) else value
                raise ConfigError(
                    f'{key} = {setting}: used only with {use}, not with "{self.profile}": leave it out'
                )

    @property
    def model_name(self) -> str:
        """The vendor's name for the module; "unknown" where neither settings nor ids tell."""
        if self.profile == "current":
            return self.model or MODELS.get((len(self.rows), len(self.columns)), "unknown")
        return self.model or OLDER_MODELS.get(self.profile, "unknown")

    @cached_property
    def polling(self) -> Polling:
        """Start, and at the end stop, an older board."""
        if not self.start:
            return Polling()
        start, stop = (Message(0.0, START | self.controller, data) for data in (b"\x07\x00", b"\x07\x01"))
        return Polling(start=((0.0, start),), stop=(stop,))

    @cached_property
    def _segments(self) -> dict[int, int]:
        """The segment, which is the taxel, of every id, row by row."""
        today = (sda << 8 | taxel << 4 | self.controller for sda in self.rows for taxel in self.columns)
        return {id_: at for at, id_ in enumerate(OLDER_IDS.get(self.profile, today))}

    @cached_property
    def size(self) -> int:
        """Taxels in a frame."""
        return len(self._segments)

    @cached_property
    def ids(self) -> frozenset[Key]:
        """An id a taxel."""
        return standard_ids(*self._segments)

    @cached_property
    def _of_ids(self) -> NDArray[np.int64]:
        """The segment (2048,) of every id of 11 bits; -1 where it is not the module's."""
        of_ids = np.full(0x800, -1)
        of_ids[list(self._segments)] = list(self._segments.values())
        return of_ids

    def readings(self, batch: Batch) -> Readings:
        """A taxel's status, X, Y, Z and status, eight bytes."""
        segments = self._of_ids[batch.ids & 0x7FF]
        good = (segments >= 0) & (batch.ids < 0x800) & (batch.lengths == 8) & ~batch.fd
        return Readings(batch.times, segments, batch.data[:, 1:7], good)

    def axes(self, payloads: Sequence[bytes | None]) -> NDArray[np.uint16]:
        """The counts of X, Y and Z (N, 3) of one frame; 0 where a segment is None."""
        return self.stacked(payloads, 6).view(">u2").astype(np.uint16)

    def unpack(self, payloads: Sequence[bytes | None]) -> NDArray[np.uint16]:
        """The counts of Z (N,), normal to the skin; 0 where a segment is None."""
        return self.axes(payloads)[:, 2]

    def shear(self, payloads: Sequence[bytes | None]) -> NDArray[np.float32]:
        """Counts of X and Y (2, N) less `REST`; NaN where a segment is None."""
        shear = self.axes(payloads)[:, :2].T.astype(np.float32) - REST
        shear[:, missing(payloads)] = np.nan
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
        rows = zip(self._segments, axes, strict=True)
        return [Message(time, id_, bytes((STATUS, *row.tobytes(), 0))) for id_, row in rows]

    @classmethod
    def recognise(cls, traffic: Traffic) -> Iterator[Match]:
        """A message a taxel, in one of the id schemes."""
        for profile, ids in OLDER_IDS.items():
            keys = traffic.standard(ids)
            if len(keys) == len(ids) and _is_xela(cls(profile), traffic.messages(keys)):
                width = 6 if profile == "4x6-old" else 4
                description = f"XELA uSkin, older ids ({profile})"
                yield Match({"profile": profile}, cls(profile), keys, (len(ids) // width, width), description)
        for controller in range(16):
            if match := cls._recognise_current(traffic, controller):
                yield match

    @classmethod
    def _recognise_current(cls, traffic: Traffic, controller: int) -> Match | None:
        """The module of a microcontroller, by today's ids: row, column and microcontroller in each."""
        ids = [id_ for id_, extended in traffic if not extended and id_ & 0xF == controller]
        taxels = [id_ for id_ in ids if _has_status(traffic[id_, False])]
        rows = tuple(sorted({id_ >> 8 for id_ in taxels}, reverse=True))
        columns = tuple(sorted({id_ >> 4 & 0xF for id_ in taxels}, reverse=True))
        codec = cls("current", controller, rows, columns)
        keys = traffic.standard(sorted(id_ for id_, _ in codec.ids))
        if not (len(keys) == codec.size >= 4 and _is_xela(codec, traffic.messages(keys))):
            return None
        settings = {"controller": controller, "rows": list(rows), "columns": list(columns)}
        description = f"XELA uSkin, microcontroller {controller}, SDAs {', '.join(map(str, rows))}"
        note = "rows, columns: as on the 4 x 6 module with its connector on the left"
        return Match(settings, codec, keys, (len(rows), len(columns)), description, (note,))


def _has_status(messages: Sequence[Message]) -> bool:
    return all(len(each.data) == 8 and each.data[0] & 0xEF == STATUS for each in messages)


def _is_xela(codec: Xela, messages: Sequence[Message]) -> bool:
    return _has_status(messages) and understands(codec, messages)


SKIN = Xela
