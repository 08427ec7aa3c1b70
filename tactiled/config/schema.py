"""What a configuration file may say: every key, its unit in its name, its bounds."""

import difflib
import re
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    PlainSerializer,
    SecretStr,
    SerializationInfo,
    Tag,
    ValidationInfo,
    ValidatorFunctionWrapHandler,
    WrapValidator,
    model_validator,
)

from tactiled.bus.codecs import plugins
from tactiled.bus.redact import HARMLESS, reveal, seal, show
from tactiled.config.bounds import Bounds, Counts, Pitch, Place, Port

Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]{0,63}$")]


class Section(BaseModel):
    """A table of the file: refuses a key that it does not know."""

    model_config = ConfigDict(extra="forbid", frozen=True)


LOOPBACK = frozenset({"localhost", "127.0.0.1", "::1"})
SHOWN = re.compile(r"[A-Za-z0-9!$'()*./:<=>?@\[\]^_`{|}~-]*")  # all that header, cookie and address carry as it is


def _shown(token: SecretStr) -> SecretStr:
    """Refuse a token that no client could show."""
    if not SHOWN.fullmatch(token.get_secret_value()):
        raise ValueError(
            'holds what a client cannot show: give visible ASCII characters, none of " # % & + , ; \\'
        )
    return token


Token = Annotated[SecretStr, Field(min_length=16, max_length=200), AfterValidator(_shown)]


class Server(Section):
    """Where HTTP clients find the service, and what they must show."""

    host: str = "127.0.0.1"
    port: Port = 8000
    read_token: Token | None = None  # to see images
    control_token: Token | None = None  # to see them and to change methods and tare
    tls_certificate: Path | None = None  # PEM
    tls_key: Path | None = None  # PEM
    foxglove: Port | None = None  # port on loopback for Foxglove's apps; None: not served
    xela: Port | None = None  # port for XELA's clients alone, without a token; None: none
    xela_host: str = "127.0.0.1"  # address of that port
    recordings: Path | None = None  # folder that clients may record the buses into; None: they may not
    recordings_leave_mb: Annotated[float, Bounds(0, 1e9, "MB")] = 1000.0  # of their disk, left free; 0: no bound
    state: Path | None = None  # file of what clients want kept; None: in the user's state directory
    history_s: Annotated[float, Bounds(0, 3600, "s")] = 5.0  # of images kept for clients that ask
    history_mb: Annotated[float, Bounds(0, 16384, "MB")] = 64.0  # and no more memory than this for all
    control_per_minute: Annotated[int, Bounds(0, 1_000_000)] = (
        600  # changes, costly answers, a client; 0: no bound
    )
    streams_per_client: Annotated[int, Bounds(0, 65535)] = (
        64  # WebSockets that a client may have open; 0: no bound
    )
    streams: Annotated[int, Bounds(0, 65535)] = 256  # and all clients together; 0: no bound

    @property
    def loopback(self) -> bool:
        """Whether only this machine can reach it."""
        return self.host in LOOPBACK

    @model_validator(mode="after")
    def _open_to_the_network(self) -> "Server":
        if not self.loopback and self.control_token is None:
            raise ValueError(
                "other machines could reach it: give control_token, a secret of 16 characters or more"
            )
        if self.read_token is not None and self.control_token is None:
            raise ValueError("read_token without control_token: anyone could control it: give both")
        if (self.tls_certificate is None) != (self.tls_key is None):
            raise ValueError("tls_certificate and tls_key: give both or neither")
        if self.xela is None and "xela_host" in self.model_fields_set:
            raise ValueError(f"xela_host = {self.xela_host!r} without xela: give the port, too")
        return self


def _serialize(value: Any, info: SerializationInfo) -> Any:
    """As it may be printed, in JSON; as it is, Secrets included, in Python."""
    return show(value) if info.mode == "json" else value


Shown = PlainSerializer(_serialize)


class Foreign(BaseModel):
    """A table whose other keys another package knows, passed on as they are; its texts are secrets."""

    model_config = ConfigDict(extra="allow", frozen=True)
    __pydantic_extra__: dict[str, Annotated[Any, Shown]]
    harmless: ClassVar[frozenset[str]] = frozenset({"name"})  # keys whose texts are none

    @model_validator(mode="before")
    @classmethod
    def _seal(cls, given: Any) -> Any:
        return seal(given, cls.harmless) if isinstance(given, dict) else given


def _channel(value: Any, check: ValidatorFunctionWrapHandler) -> Any:
    """A channel, a Secret where it is an address with a login or a query."""
    check(reveal(value))
    return value


class Bus(Foreign):
    """A CAN interface: these keys and all that python-can's interface takes besides."""

    harmless = HARMLESS

    interface: str
    channel: Annotated[str | int | None, WrapValidator(_channel), Shown] = None

    def settings(self) -> dict[str, Any]:
        """All of it, by python-can's names."""
        return self.model_dump(exclude_none=True)


class Layer(Section):
    """A flat elastic layer."""

    thickness_mm: Annotated[float, Bounds(0.001, 100.0, "mm")]  # from a sputtered film to a mattress
    young_mpa: Annotated[float, Bounds(0.001, 1e7, "MPa")]  # from the softest gel to ten times diamond: rigid
    poisson: Annotated[float, Bounds(0, 0.49999)]  # rubber: 0.49 to 0.4999; at 0.5 nothing gives way
    bonded: bool = True  # to what lies under it; false: it slides without friction


def _listed(value: Any) -> Any:
    return [value] if isinstance(value, dict) else value


Layers = Annotated[tuple[Layer, ...], Field(max_length=8), BeforeValidator(_listed)]  # 16 are solved in seconds


class Kernel(Section):
    """How the cover is solved."""

    model: Literal["fem", "layered"] = "fem"
    accuracy: Annotated[float, Bounds(1e-4, 0.1)] = (
        1e-3  # of the gain; finer needs more elements than there may be
    )


class Array(Section):
    """Where the taxels are: rows and columns of a grid, or positions."""

    rows: Annotated[int, Bounds(1, 1024)] | None = None
    columns: Annotated[int, Bounds(1, 1024)] | None = None
    pitch_mm: Pitch | None = None
    positions_mm: Annotated[tuple[tuple[Place, Place], ...], Field(max_length=1024)] | None = None
    aperture_mm: Annotated[float, Bounds(0.001, 1000.0, "mm")] | None = None
    aperture: Literal["square", "round"] | None = None


class Packed(Section):
    """The packed layout, in this project's README."""

    name: Literal["packed"]
    array_id: Annotated[int, Bounds(0, 15)] = 0
    base_id: Annotated[int, Bounds(0, 0x1FFFFFF0)] = 0x500
    extended: bool = False
    bits: Annotated[int, Bounds(8, 16)] = 12
    fd: bool = False


class Icub(Section):
    """iCub MTB boards."""

    name: Literal["icub"]
    board: Annotated[int, Bounds(0, 15)]
    triangles: tuple[Annotated[int, Bounds(0, 15)], ...] = Field(min_length=1, max_length=16)
    thermal_pads: bool = True  # false: pads 6 and 10 are taxels too, as on a fingertip
    start: bool = False  # set the board up and start it
    period_ms: Annotated[int, Bounds(1, 255, "ms")] = 30  # that a started board sends at


class Xela(Section):
    """XELA uSkin: the normal axis of one module."""

    name: Literal["xela"]
    profile: Literal["current", "4x4-old", "4x4-new", "4x6-old", "single"] = "current"
    controller: Annotated[int, Bounds(0, 15)] = 1
    rows: tuple[Annotated[int, Bounds(0, 7)], ...] = Field((4, 3, 2, 1), min_length=1, max_length=8)  # SDAs
    columns: tuple[Annotated[int, Bounds(0, 15)], ...] = Field((5, 4, 3, 2, 1, 0), min_length=1, max_length=16)
    start: bool = False  # start an older board
    model: str = Field("", pattern=r"^[A-Za-z0-9_-]{0,32}$")  # told to XELA's clients; "": as ids and size say


class Barrett(Section):
    """BarrettHand pads."""

    name: Literal["barrett"]
    node: Annotated[int, Bounds(0, 31)]


class PowerOn(Section):
    """PowerON TouchDetect."""

    name: Literal["poweron"]
    base_id: Annotated[int, Bounds(0, 0x7F4)] = 0x300


class CySkin(Section):
    """CySkin on a CPM-Finger."""

    name: Literal["cyskin"]


class Linker(Section):
    """LinkerHand fingers."""

    name: Literal["linker"]
    hand: Literal["right", "left"] = "right"
    fingers: tuple[Annotated[int, Bounds(1, 5)], ...] = Field(
        (1,), min_length=1, max_length=5
    )  # 1 thumb ... 5 little
    poll_hz: Annotated[float, Bounds(0.01, 1000.0, "Hz", zero=True)] = 20.0  # 0: only listen


def _beside(file: Path, info: ValidationInfo) -> Path:
    """A path of the file, relative to the folder it lies in."""
    folder: Path = (info.context or {}).get("folder", Path())
    return folder / file


class Dbc(Section):
    """The signals of a DBC file."""

    name: Literal["dbc"]
    file: Annotated[Path, AfterValidator(_beside)]
    taxels: str | tuple[str, ...] = Field(min_length=1)  # "Message.Signal" of each, or a template
    first: Literal[0, 1] = 0  # number of a template's first row, column, taxel


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
        raise ValueError(f"{name!r} is no codec: there are {', '.join(known)}{meant}")
    return name


class Plugin(Foreign):
    """A codec that another package offers."""

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


class Calibration(Section):
    """Counts to kPa."""

    kpa_per_count: Annotated[float, Bounds(1e-9, 1e6, "kPa", signed=True)] | None = (
        None  # 2^30 counts a Pa to 1 GPa
    )
    no_load: Counts | None = None
    saturation: Counts | None = None
    noise_kpa: Annotated[float, Bounds(1e-9, 1e6, "kPa")] | None = None  # as fine as the finest count
    dead: tuple[Annotated[int, Bounds(0, 2**20)], ...] = ()
    shear_n_per_count: Annotated[float, Bounds(1e-12, 1e6, "N", signed=True)] | None = None


class Sensor(Section):
    """One array on one bus."""

    bus: Name
    codec: Codec
    array: Array = Array()
    cover: Layers
    substrate: Layers = ()
    kernel: Kernel = Kernel()
    calibration: Calibration = Calibration()
    method: str = "auto"
    refine: Annotated[int, Bounds(1, 8)] = 1  # surface cells a taxel, along each side
    stale_after_s: Annotated[float, Bounds(0.001, 3600.0, "s")] = 0.5


class Config(Section):
    """A whole file."""

    server: Server = Server()
    bus: dict[Name, Bus] = Field(min_length=1)
    sensor: dict[Name, Sensor] = Field(min_length=1)
