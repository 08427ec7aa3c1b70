"""What a configuration file may hold: every key, its unit in its name, its bounds."""

import math
import re
from itertools import combinations
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    InstanceOf,
    PlainSerializer,
    SecretStr,
    ValidationInfo,
    ValidatorFunctionWrapHandler,
    WithJsonSchema,
    WrapValidator,
    model_serializer,
    model_validator,
)

from tactiled import bounds
from tactiled.bounds import Bounds, Counts, Endpoint, FileBeside, FrameId, Key, Name, Pitch, Place, Port, Prefix
from tactiled.bus import skins
from tactiled.bus.codec import Skin
from tactiled.bus.redact import HARMLESS, reveal, seal, show
from tactiled.units import FORCE, LENGTH, PRESSURE, STIFFNESS

Quaternion: TypeAlias = tuple[float, float, float, float]
NORM_TOLERANCE = 10e-3  # of the squared norm of a quaternion, as tf2's buffer_core.cpp has it
EVERY_ADDRESS = frozenset({"", "0.0.0.0", "::"})
LOOPBACK = frozenset({"localhost", "127.0.0.1", "::1"})
PUSHED = {"interface": "virtual", "rx_queue_size": 1 << 7}  # for pushed frames: a fast program waits for the queue
TOKEN = re.compile(r"[A-Za-z0-9!$'()*./:<=>?@\[\]^_`{|}~-]*")  # header, cookie and address carry these unchanged


def _check_token(token: SecretStr) -> SecretStr:
    """Refuse a token that no client could show."""
    if not TOKEN.fullmatch(token.get_secret_value()):
        raise ValueError(
            'holds what a client cannot show: give visible ASCII characters, none of " # % & + , ; \\'
        )
    return token


Token = Annotated[SecretStr, Field(min_length=16, max_length=200), AfterValidator(_check_token)]


class Section(BaseModel):
    """A table of the file: refuses a key that it does not know. The text below a key describes it in the guide."""

    model_config = ConfigDict(extra="forbid", frozen=True, use_attribute_docstrings=True)


# As it may be printed, in JSON; as it is, Secrets included, in Python.
Redacted = PlainSerializer(lambda value, info: show(value) if info.mode == "json" else value)


class Server(Section):
    """Where HTTP clients find the service, and what they must show."""

    host: str = "127.0.0.1"
    """Address that the service listens on; any address beyond loopback needs `control_token`."""
    port: Port = 8000
    """Port; 0: any free one."""
    read_token: Token | None = None
    """Secret that a client shows to see images."""
    control_token: Token | None = None
    """Secret that a client shows to see images and to change anything."""
    allowed_origins: bounds.Origins = ()
    """Pages of other sites that may use the service, such as `["https://app.example"]`; they show a token."""
    tls_certificate: Path | None = None
    """PEM file of the certificate; belongs with `tls_key`."""
    tls_key: Path | None = None
    """PEM file of the private key."""
    foxglove: Port | None = None
    """Port on loopback for Foxglove's apps; 0: any free one; left out: not served."""
    xela: Port | None = None
    """Port for clients of XELA's server, without a token; 0: any free one; left out: not served."""
    xela_host: str = "127.0.0.1"
    """Address of that port."""
    bridges: tuple[str, ...] = ()
    """Names of [bridges](interop.md#a-bridge-of-your-own) of other packages to run."""
    recordings: Path | None = None
    """Folder that clients may record the buses into; left out: they may not record."""
    recordings_leave_mb: Annotated[float, Bounds(0, 1e9, "MB")] = 1000.0
    """Free space that recordings leave on the disk; 0: no bound."""
    state: Path | None = None
    """File of methods, tares and regions that are kept over a restart; left out: in the user's state directory."""
    history_s: Annotated[float, Bounds(0, 3600, "s")] = 5.0
    """Age up to which images are kept for clients that ask for past frames."""
    history_mb: Annotated[float, Bounds(0, 16384, "MB")] = 64.0
    """Memory for those images, all sensors together."""
    control_per_minute: Annotated[int, Bounds(0, 1_000_000)] = 600
    """Changes per minute and client, a sixth of them at once, and as many costly answers; 0: no bound."""
    streams_per_client: Annotated[int, Bounds(0, 65535)] = 64
    """WebSockets that one client may have open; 0: no bound."""
    streams: Annotated[int, Bounds(0, 65535)] = 256
    """WebSockets that all clients together may have open; 0: no bound."""

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
        for key in ("read_token", "allowed_origins"):
            if getattr(self, key) and self.control_token is None:
                raise ValueError(f"{key} without control_token: anyone could control it: give both")
        if (self.tls_certificate is None) != (self.tls_key is None):
            raise ValueError("tls_certificate and tls_key: give both or neither")
        if self.xela is None and "xela_host" in self.model_fields_set:
            raise ValueError(f"xela_host = {self.xela_host!r} without xela: give the port, too")
        return self

    @model_validator(mode="after")
    def _ports_of_their_own(self) -> "Server":
        places = {
            "port": (self.port, self.host),
            "foxglove": (self.foxglove, "127.0.0.1"),
            "xela": (self.xela, self.xela_host),
        }
        for (key, (port, host)), (other, (same, beside)) in combinations(places.items(), 2):
            hosts = {"127.0.0.1" if each == "localhost" else each for each in (host, beside)}
            if port and port == same and (len(hosts) == 1 or hosts & EVERY_ADDRESS):
                raise ValueError(f"{key} and {other} are both {port}: give each a port of its own")
        return self


def _channel(value: Any, check: ValidatorFunctionWrapHandler) -> Any:
    """A channel, a Secret where it is an address with a login or a query."""
    check(reveal(value))
    return value


class Bus(BaseModel):
    """A CAN interface: these keys and all that python-can's interface takes besides."""

    model_config = ConfigDict(extra="allow", frozen=True, use_attribute_docstrings=True)
    __pydantic_extra__: dict[str, Annotated[Any, Redacted]]

    interface: str
    """Interface of python-can: `socketcan`, `slcan`, `pcan`, `kvaser`, `udp_multicast`, `virtual`, ..."""
    channel: Annotated[str | int | None, WrapValidator(_channel), Redacted] = None
    """Channel of that interface, such as `can0` or `/dev/ttyUSB0`."""

    @model_validator(mode="before")
    @classmethod
    def _seal(cls, table: Any) -> Any:
        return seal(table, HARMLESS) if isinstance(table, dict) else table

    def settings(self) -> dict[str, Any]:
        """All of it, by python-can's names."""
        return self.model_dump(exclude_none=True)


class Codec(Section):
    """Codec of an array: its name and, beside it, its own settings."""

    name: str
    settings: Annotated[InstanceOf[Skin], WithJsonSchema({"type": "object"})] = Field(
        default_factory=Skin,
        repr=False,  # may hold another package's secrets
    )

    @model_validator(mode="before")
    @classmethod
    def _read(cls, table: Any, info: ValidationInfo) -> Any:
        if not isinstance(table, dict):
            return table
        if not isinstance(table.get("name"), str):
            return {key: value for key, value in table.items() if key == "name"}
        name, folder = table["name"], (info.context or {}).get("folder", Path())
        own = {key: value for key, value in table.items() if key != "name"}
        return {"name": name, "settings": skins.read_settings(name, own, folder)}

    @model_serializer
    def _show(self) -> dict[str, Any]:
        return {"name": self.name} | skins.redacted(self.name, self.settings)


class Layer(Section):
    """A flat elastic layer."""

    thickness_mm: Annotated[float, Bounds(0.001, 100.0, LENGTH)]  # from a sputtered film to a mattress
    """Thickness."""
    young_mpa: Annotated[float, Bounds(0.001, 1e7, STIFFNESS)]  # from the softest gel to ten times diamond: rigid
    """Young's modulus."""
    poisson: Annotated[float, Bounds(0, 0.49999)]  # rubber: 0.49 to 0.4999; at 0.5 nothing gives way
    """Poisson's ratio."""
    bonded: bool = True
    """Bonded to the layer below it; false: it slides without friction."""


def _listed(value: Any) -> Any:
    return [value] if isinstance(value, dict) else value


Layers = Annotated[tuple[Layer, ...], Field(max_length=8), BeforeValidator(_listed)]  # 16 are solved in seconds


class Kernel(Section):
    """How the cover is solved."""

    model: Literal["fem", "layered", "measured"] = "fem"
    """Finite elements, the exact solution for flat layers, or the kernel of the calibration file."""
    accuracy: Annotated[float, Bounds(1e-4, 0.1)] = 1e-3  # finer needs more elements than there may be
    """Largest error of the cover's gain."""


Beyond = Annotated[float, Bounds(0.0, 1000.0, LENGTH)]


def _check_norm(quaternion: Quaternion) -> Quaternion:
    """Refuse what is no rotation."""
    norm = math.hypot(*quaternion)
    if not abs(norm**2 - 1) <= NORM_TOLERANCE:
        raise ValueError(f"{list(quaternion)} has the norm {norm:.6g}: give a unit quaternion [x, y, z, w]")
    return quaternion


class Array(Section):
    """Where the taxels are: rows and columns of a grid, or positions; and where the array is, for ROS 2."""

    rows: Annotated[int, Bounds(1, 1024)] | None = None
    """Rows of a grid."""
    columns: Annotated[int, Bounds(1, 1024)] | None = None
    """Columns of a grid."""
    pitch_mm: Pitch | None = None
    """Distance between neighbouring taxels of a grid."""
    positions_mm: Annotated[tuple[tuple[Place, Place], ...], Field(min_length=1, max_length=1024)] | None = None
    """Centre `[x, y]` of every taxel of any other layout: x to the right, y down."""
    aperture_mm: Annotated[float, Bounds(0.001, 1000.0, LENGTH)] | None = None
    """Side, or diameter, of the area that a taxel senses; left out: the smallest distance between two taxels."""
    aperture: Literal["square", "round"] | None = None
    """Shape of that area; left out: square on a grid, round otherwise."""
    beyond_mm: tuple[Beyond, Beyond, Beyond, Beyond] | None = None
    """How far the cover goes on beyond the taxels, `[above, below, left, right]`, 0 where a housing ends it; left
    out: as far as it matters."""
    frame_id: FrameId | None = None
    """Frame of reference that the array is fixed in, such as a link of a robot; left out: not known."""
    origin_mm: tuple[Place, Place, Place] | None = None
    """`[x, y, z]` of the array's (0, 0) in `frame_id`; left out: at its origin."""
    orientation: Annotated[Quaternion, AfterValidator(_check_norm)] | None = None
    """Unit quaternion `[x, y, z, w]`, the array's rotation in `frame_id`; left out: none."""

    @model_validator(mode="after")
    def _placed_in_a_frame(self) -> "Array":
        for key in ("origin_mm", "orientation"):
            if self.frame_id is None and (value := getattr(self, key)) is not None:
                raise ValueError(f"{key} = {list(value)} without frame_id: give the frame of reference, too")
        return self


class Calibration(Section):
    """Counts to kPa."""

    file: FileBeside | None = None
    """Calibration file; a relative path starts at the folder of the configuration."""
    kpa_per_count: Annotated[float, Bounds(1e-9, 1e6, PRESSURE, signed=True)] | None = None  # to 1 GPa
    """Pressure of one count, negative if counts fall under pressure; left out: 1 (`icub`: -1), with a warning."""
    no_load: Counts | None = None
    """Counts of an unloaded taxel; left out: 0 (`icub`: 240)."""
    saturation: Counts | None = None
    """Counts from which (if counts fall: down to which) a taxel is saturated; left out: never."""
    noise_kpa: Annotated[float, Bounds(1e-9, 1e6, PRESSURE)] | None = None  # as fine as the finest count
    """Standard deviation of one taxel; left out: measured from the first frames."""
    dead: tuple[Annotated[int, Bounds(0, 2**20)], ...] = ()
    """Indices of taxels that do not work: row x columns + column."""
    track_drift: bool = True
    """Follow the drift of zeros that a tare or the calibration file has measured; false: they stay as measured."""
    shear_n_per_count: Annotated[float, Bounds(1e-12, 1e6, FORCE, signed=True)] | None = None
    """Force along the skin of one count of shear, to restore it and for XELA's clients."""


class Sensor(Section):
    """One array on one bus; without `bus` and `codec` one whose frames a program pushes."""

    bus: Name
    """Name of the bus that it sends on; without `bus` and `codec` frames are pushed."""
    codec: Codec
    array: Array = Array()
    cover: Layers
    substrate: Layers = ()
    kernel: Kernel = Kernel()
    calibration: Calibration = Calibration()
    method: str = "auto"
    """Restoration method."""
    budget_ms: Annotated[float, Bounds(0.01, 1000.0, "ms")] | None = None
    """Processor time for restoring a frame, after which its image is the best so far; left out: a tenth of the
    frame period, or with more than four sensors 0.4 of it divided by their number; 1 ms at most."""
    refine: Annotated[int, Bounds(1, 8)] | None = None
    """Cells of the restored image along the distance between taxels; left out: 1 of a grid, else 2."""
    stale_after_s: Annotated[float, Bounds(0.001, 3600.0, "s")] = 0.5
    """Age of the last frame from which the sensor is stale."""


class Zenoh(Section):
    """A Zenoh network that carries images from readers to servers: give `connect`, `listen` or both."""

    mode: Literal["peer", "client"] = "peer"
    """`client` of a router, or `peer` that talks to other peers directly."""
    connect: tuple[Endpoint, ...] = ()
    """Endpoints to connect to, such as `tcp/192.168.1.2:7447` or `tls/fleet.example:7447`."""
    listen: tuple[Endpoint, ...] = ()
    """Endpoints to listen on, of a peer."""
    prefix: Prefix = "tactiled"
    """First part of every key."""
    robot: Name | None = None
    """Name of the robot whose sensors are published; `tactiled run --publish` needs it."""
    ros_domain: Annotated[int, Field(ge=0, le=232)] | None = None
    """Domain of ROS 2 (`ROS_DOMAIN_ID`) that `--publish` sends images in, too, for nodes with `rmw_zenoh`."""
    tls_root_certificate: FileBeside | None = None
    """PEM file of the authority that signed the other side's certificate; left out: public authorities."""
    tls_certificate: FileBeside | None = None
    """PEM file of this side's certificate; belongs with `tls_key`. With both sides' it is mutual TLS."""
    tls_key: FileBeside | None = None
    """PEM file of its private key."""
    user: Annotated[str, Field(min_length=1, max_length=200)] | None = None
    """User that this side connects as; belongs with `password`."""
    password: Annotated[SecretStr, Field(min_length=1, max_length=200)] | None = None
    """Password of that user."""
    control_key: Key | None = None
    """Key of changes. For a server, make one (`openssl rand -hex 32`); a reader has the one that
    `tactiled serve FILE --key ROBOT` prints. Left out: nothing can be changed."""

    @model_validator(mode="after")
    def _complete(self) -> "Zenoh":
        if not self.connect and not self.listen:
            raise ValueError("connect and listen are missing: give endpoints, such as tcp/127.0.0.1:7447")
        if self.mode == "client" and (not self.connect or self.listen):
            raise ValueError("mode = 'client': give connect, the router's endpoint, and no listen")
        for one, other in (("tls_certificate", "tls_key"), ("user", "password")):
            if (getattr(self, one) is None) != (getattr(self, other) is None):
                raise ValueError(f"{one} and {other}: give both or neither")
        return self

    @property
    def loopback(self) -> bool:
        """Whether only this machine can reach it."""
        hosts = [each.split("/", 1)[1].rsplit(":", 1)[0].strip("[]") for each in (*self.connect, *self.listen)]
        return LOOPBACK.issuperset(hosts)


class Config(Section):
    """A complete file."""

    server: Server = Server()
    zenoh: Zenoh | None = None
    bus: dict[Name, Bus] = Field(min_length=1)
    sensor: dict[Name, Sensor] = Field(min_length=1)

    @model_validator(mode="before")
    @classmethod
    def _give_pushed_buses(cls, file: Any) -> Any:
        """A bus of its own, inside the process, for each sensor whose frames are pushed."""
        if not (isinstance(file, dict) and isinstance(sensors := file.get("sensor"), dict)):
            return file
        pushed = {
            name: each
            for name, each in sensors.items()
            if isinstance(each, dict) and not {"bus", "codec"} & each.keys()
        }
        if not pushed or not isinstance(buses := file.get("bus", {}), dict):
            return file
        if twice := pushed.keys() & buses.keys():
            name = min(twice)
            raise ValueError(
                f"sensor.{name}: without bus and codec its frames are pushed: rename bus {name}, or give both"
            )
        own = {name: {**PUSHED, "channel": f"pushed {name}"} for name in pushed}
        sensors = sensors | {
            name: {**each, "bus": name, "codec": {"name": "pushed"}} for name, each in pushed.items()
        }
        return {**file, "bus": buses | own, "sensor": sensors}


class Served(Section):
    """What `tactiled serve` reads: no bus, no sensor."""

    server: Server = Server()
    zenoh: Zenoh
