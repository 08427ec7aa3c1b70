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

Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]{0,63}$")]
Length = Annotated[float, Field(gt=0, le=1000, allow_inf_nan=False)]  # mm


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
    port: int = Field(8000, ge=0, le=65535)
    read_token: Token | None = None  # to see images
    control_token: Token | None = None  # to see them and to change methods and tare
    tls_certificate: Path | None = None  # PEM
    tls_key: Path | None = None  # PEM
    foxglove: int | None = Field(None, ge=0, le=65535)  # port on loopback for Foxglove's apps; None: not served
    xela: int | None = Field(None, ge=0, le=65535)  # port for XELA's clients alone, without a token; None: none
    xela_host: str = "127.0.0.1"  # address of that port
    recordings: Path | None = None  # folder that clients may record the buses into; None: they may not
    recordings_leave_mb: float = Field(1000.0, ge=0, allow_inf_nan=False)  # of their disk, left free; 0: no bound
    state: Path | None = None  # file of what clients want kept; None: in the user's state directory
    history_s: float = Field(5.0, ge=0, le=3600, allow_inf_nan=False)  # of images kept for clients that ask
    history_mb: float = Field(64.0, ge=0, le=16384, allow_inf_nan=False)  # and no more memory than this for all
    control_per_minute: int = Field(
        600, ge=0, le=1_000_000
    )  # changes, as many costly answers, a client; 0: no bound
    streams_per_client: int = Field(64, ge=0, le=65535)  # WebSockets that a client may have open; 0: no bound
    streams: int = Field(256, ge=0, le=65535)  # and all clients together; 0: no bound

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

    thickness_mm: Length
    young_mpa: float = Field(gt=0, le=1e7, allow_inf_nan=False)
    poisson: float = Field(ge=0, lt=0.5, allow_inf_nan=False)
    bonded: bool = True  # to what lies under it; false: it slides without friction


def _listed(value: Any) -> Any:
    return [value] if isinstance(value, dict) else value


Layers = Annotated[tuple[Layer, ...], BeforeValidator(_listed)]


class Kernel(Section):
    """How the cover is solved."""

    model: Literal["fem", "layered"] = "fem"
    accuracy: float = Field(1e-3, ge=1e-5, le=0.1, allow_inf_nan=False)  # of the gain


class Array(Section):
    """Where the taxels are: rows and columns of a grid, or positions."""

    rows: int | None = Field(None, ge=1, le=1024)
    columns: int | None = Field(None, ge=1, le=1024)
    pitch_mm: Length | None = None
    positions_mm: tuple[tuple[float, float], ...] | None = None
    aperture_mm: Length | None = None
    aperture: Literal["square", "round"] | None = None


class Packed(Section):
    """The packed layout, in this project's README."""

    name: Literal["packed"]
    array_id: int = Field(0, ge=0, le=15)
    base_id: int = Field(0x500, ge=0, le=0x1FFFFFF0)
    extended: bool = False
    bits: int = Field(12, ge=8, le=16)
    fd: bool = False


class Icub(Section):
    """iCub MTB boards."""

    name: Literal["icub"]
    board: int = Field(ge=0, le=15)
    triangles: tuple[Annotated[int, Field(ge=0, le=15)], ...] = Field(min_length=1)
    thermal_pads: bool = True  # false: pads 6 and 10 are taxels too, as on a fingertip
    start: bool = False  # set the board up and start it
    period_ms: int = Field(30, ge=1, le=255)  # that a started board sends at


class Xela(Section):
    """XELA uSkin: the normal axis of one module."""

    name: Literal["xela"]
    profile: Literal["current", "4x4-old", "4x4-new", "4x6-old", "single"] = "current"
    controller: int = Field(1, ge=0, le=15)
    rows: tuple[Annotated[int, Field(ge=0, le=7)], ...] = Field((4, 3, 2, 1), min_length=1)  # SDAs, top row first
    columns: tuple[Annotated[int, Field(ge=0, le=15)], ...] = Field((5, 4, 3, 2, 1, 0), min_length=1)  # taxels
    start: bool = False  # start an older board
    model: str = Field("", pattern=r"^[A-Za-z0-9_-]{0,32}$")  # told to XELA's clients; "": as ids and size say


class Barrett(Section):
    """BarrettHand pads."""

    name: Literal["barrett"]
    node: int = Field(ge=0, le=31)


class PowerOn(Section):
    """PowerON TouchDetect."""

    name: Literal["poweron"]
    base_id: int = Field(0x300, ge=0, le=0x7F4)


class CySkin(Section):
    """CySkin on a CPM-Finger."""

    name: Literal["cyskin"]


class Linker(Section):
    """LinkerHand fingers."""

    name: Literal["linker"]
    hand: Literal["right", "left"] = "right"
    fingers: tuple[Annotated[int, Field(ge=1, le=5)], ...] = Field((1,), min_length=1)  # 1 thumb ... 5 little
    poll_hz: float = Field(20.0, ge=0, le=1000, allow_inf_nan=False)  # 0: only listen


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

    kpa_per_count: float | None = Field(None, allow_inf_nan=False)
    no_load: float | None = Field(None, allow_inf_nan=False)
    saturation: float | None = Field(None, allow_inf_nan=False)
    noise_kpa: float | None = Field(None, gt=0, allow_inf_nan=False)
    dead: tuple[Annotated[int, Field(ge=0)], ...] = ()
    shear_n_per_count: float | None = Field(None, allow_inf_nan=False)


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
    refine: int = Field(1, ge=1, le=8)  # surface cells a taxel, along each side
    stale_after_s: float = Field(0.5, gt=0, le=3600, allow_inf_nan=False)


class Config(Section):
    """A whole file."""

    server: Server = Server()
    bus: dict[Name, Bus] = Field(min_length=1)
    sensor: dict[Name, Sensor] = Field(min_length=1)
