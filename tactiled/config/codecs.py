"""Settings of the codecs: the table `[sensor.NAME.codec]`."""

import difflib
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Discriminator, Field, Tag, ValidationInfo

from tactiled.bus.codecs import plugins
from tactiled.config.bounds import Bounds
from tactiled.config.section import Foreign, Section


class Packed(Section):
    """Any array, in this project's own open layout."""

    name: Literal["packed"]
    array_id: Annotated[int, Bounds(0, 15)] = 0
    """Number of the array: its messages have the CAN id `base_id` + `array_id`."""
    base_id: Annotated[int, Bounds(0, 0x1FFFFFF0)] = 0x500
    """First CAN id of the layout."""
    extended: bool = False
    """Ids have 29 bits; false: 11 bits."""
    bits: Annotated[int, Bounds(8, 16)] = 12
    """Bits of one taxel."""
    fd: bool = False
    """CAN FD messages of up to 64 bytes; false: classic messages of up to 8 bytes."""


class Icub(Section):
    """iCub MTB board with triangles of 10 or 12 taxels."""

    name: Literal["icub"]
    board: Annotated[int, Bounds(0, 15)]
    """Number of the board."""
    triangles: tuple[Annotated[int, Bounds(0, 15)], ...] = Field(min_length=1, max_length=16)
    """Numbers of the triangles, in the order of their taxels."""
    thermal_pads: bool = True
    """Pads 6 and 10 measure temperature and are left out; false: they are taxels, as on a fingertip."""
    start: bool = False
    """Set up and start the board when the service starts."""
    period_ms: Annotated[int, Bounds(1, 255, "ms")] = 30
    """Time between two frames of a board that the service starts."""


class Xela(Section):
    """XELA uSkin, one 3-axis module: the normal axis is the image."""

    name: Literal["xela"]
    profile: Literal["current", "4x4-old", "4x4-new", "4x6-old", "single"] = "current"
    """Layout of the CAN ids: the present generation, or an older one."""
    controller: Annotated[int, Bounds(0, 15)] = 1
    """Number of the microcontroller."""
    rows: tuple[Annotated[int, Bounds(0, 7)], ...] = Field((4, 3, 2, 1), min_length=1, max_length=8)
    """SDA lines, from the top row down."""
    columns: tuple[Annotated[int, Bounds(0, 15)], ...] = Field((5, 4, 3, 2, 1, 0), min_length=1, max_length=16)
    """Taxel numbers of a row, from left to right."""
    start: bool = False
    """Start a board of an older profile when the service starts, and stop it at the end."""
    model: str = Field("", pattern=r"^[A-Za-z0-9_-]{0,32}$")
    """Model name that XELA's clients receive; empty: derived from ids and size."""


class Barrett(Section):
    """BarrettHand, the pad of one node: 24 taxels of 12 bits."""

    name: Literal["barrett"]
    node: Annotated[int, Bounds(0, 31)]
    """Number of the node."""


class PowerOn(Section):
    """PowerON TouchDetect: 6 x 6 taxels of 12 bits."""

    name: Literal["poweron"]
    base_id: Annotated[int, Bounds(0, 0x7F4)] = 0x300
    """First CAN id of the skin."""


class CySkin(Section):
    """CySkin on a CPM-Finger: 16 taxels of 16 bits."""

    name: Literal["cyskin"]


class Linker(Section):
    """LinkerHand: 72 taxels of 8 bits a finger."""

    name: Literal["linker"]
    hand: Literal["right", "left"] = "right"
    """Which hand it is."""
    fingers: tuple[Annotated[int, Bounds(1, 5)], ...] = Field((1,), min_length=1, max_length=5)
    """Fingers of the array: 1 is the thumb, 5 the little finger."""
    poll_hz: Annotated[float, Bounds(0.01, 1000.0, "Hz", zero=True)] = 20.0
    """Requests per second for each finger; 0: the service only listens."""


def _beside(file: Path, info: ValidationInfo) -> Path:
    """A path of the file, relative to the folder it lies in."""
    folder: Path = (info.context or {}).get("folder", Path())
    return folder / file


class Dbc(Section):
    """Any array whose signals a DBC file describes."""

    name: Literal["dbc"]
    file: Annotated[Path, AfterValidator(_beside)]
    """DBC file; a relative path starts at the folder of the configuration file."""
    taxels: str | tuple[str, ...] = Field(min_length=1)
    """`Message.Signal` of every taxel in a list, or one template with {row}, {column} or {taxel}."""
    first: Literal[0, 1] = 0
    """Number of a template's first row, column and taxel."""


BUILT_IN = ("packed", "icub", "xela", "barrett", "poweron", "cyskin", "linker", "dbc")


def _offered(name: str) -> str:
    """Refuse a name that no installed package offers, or two."""
    offers = [each for each in plugins.offers() if each.name == name]
    if len(offers) > 1:
        raise ValueError(f"{name!r}: offered by {' and '.join(map(plugins.package, offers))}: uninstall one")
    if not offers:
        known = (*BUILT_IN, *(each.name for each in plugins.offers()))
        near = difflib.get_close_matches(name, known, 1)
        meant = f": did you mean {near[0]}?" if near else ""
        raise ValueError(f"unknown codec {name!r}; available: {', '.join(known)}{meant}")
    return name


class Plugin(Foreign):
    """A codec of another installed package; it receives its own settings unchanged."""

    name: Annotated[str, AfterValidator(_offered), Field(json_schema_extra={"not": {"enum": list(BUILT_IN)}})]


def _kind(codec: Any) -> str:
    """Which of the codecs a table means."""
    name = codec.get("name") if isinstance(codec, dict) else getattr(codec, "name", None)
    return name if name in BUILT_IN else "plug-in"


Codec = Annotated[
    Annotated[Packed, Tag("packed")]
    | Annotated[Icub, Tag("icub")]
    | Annotated[Xela, Tag("xela")]
    | Annotated[Barrett, Tag("barrett")]
    | Annotated[PowerOn, Tag("poweron")]
    | Annotated[CySkin, Tag("cyskin")]
    | Annotated[Linker, Tag("linker")]
    | Annotated[Dbc, Tag("dbc")]
    | Annotated[Plugin, Tag("plug-in")],
    Discriminator(_kind),
]
