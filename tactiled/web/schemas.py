"""What the API says, field by field: the models behind OpenAPI."""

from typing import Annotated, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field

from tactiled.bus.error_frames import KINDS
from tactiled.diagnostics.warning_codes import WarningCode
from tactiled.restore.methods import METHODS
from tactiled.runtime.pipeline import TARE_FRAMES
from tactiled.runtime.sensor import State

Shown = Literal["raw", "restored", "deviation"]
DECIMALS = 4  # of a pressure in JSON: 0.1 Pa

Name = Annotated[str, Field(description="as in the configuration", examples=["palm"])]


Values = Annotated[
    list[list[float | None]] | list[float | None],
    Field(
        description="rows of a grid, or one list; null where nothing is known",
        examples=[[[0.0, 12.5], [3.25, 0.0]]],
    ),
]
MethodName = Annotated[str, Field(json_schema_extra={"enum": list(METHODS)})]


T = TypeVar("T")
Pair = Annotated[list[T], Field(min_length=2, max_length=2)]
Color = Annotated[list[Annotated[int, Field(ge=0, le=255)]], Field(min_length=3, max_length=3)]


class Form(BaseModel):
    """A JSON object of the API."""

    model_config = ConfigDict(frozen=True)


class Asked(Form):
    """A JSON object that a client sends: a key that there is not is refused, and so is 0 for false."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)


class Loss(Form):
    """What went wrong on the way in, counted since the start."""

    lost: int = Field(description="messages that never came", examples=[0])
    repeated: int = Field(description="messages that came twice", examples=[0])
    late: int = Field(description="messages out of order", examples=[0])
    foreign: int = Field(description="messages on the bus that belong to no sensor", examples=[0])
    malformed: int = Field(description="messages that the codec cannot mean", examples=[0])
    incomplete: int = Field(description="frames with taxels missing", examples=[0])
    skipped: int = Field(description="frames not restored because a newer one was there", examples=[0])
    dropped: int = Field(description="messages that the kernel threw away, not taken in time", examples=[0])
    errors: int = Field(description="error frames of the bus interface", examples=[0])
    bus_off: int = Field(description="times that the bus interface left the bus", examples=[0])
    unsent: int = Field(description="requests to skins that the bus did not take", examples=[0])
    unreadable: int = Field(description="messages that the bus interface could not decode", examples=[0])


class SensorState(Form):
    """A sensor and how it is doing."""

    name: Name
    bus: str = Field(examples=["can0"])
    codec: str = Field(examples=["packed"])
    rows: int | None = Field(description="null where the layout is no grid", examples=[32])
    columns: int | None = Field(description="null where the layout is no grid", examples=[32])
    taxels: int = Field(examples=[1024])
    pitch_mm: float = Field(examples=[1.0])
    shear: bool = Field(description="whether the skin feels it", examples=[False])
    method: str = Field(description="asked for", examples=["auto"])
    methods: tuple[str, ...] = Field(examples=[tuple(METHODS)])
    state: State = Field(description="live; stale: no new frame; silent: none yet; down: the bus is gone")
    age_s: float | None = Field(description="s since the last frame came in", examples=[0.004])
    rate_hz: float = Field(description="frames a second", examples=[100.0])
    jitter_s: float | None = Field(
        description="standard deviation of the last 100 periods from frame to frame, by the bus's clock",
        examples=[0.0002],
    )
    clock: str | None = Field(
        description="that gives the frames' times: kernel (Linux, Unix time), python-can INTERFACE (as its driver "
        "tells), recording; null before the bus was first open",
        examples=["kernel"],
    )
    skew_s: float | None = Field(
        description="from the newest frame's first message to its last", examples=[0.0031]
    )
    detail: str = Field(description="one line on the state", examples=[""])
    sequence: int | None = Field(description="of the newest image", examples=[5123])
    loss: Loss
    error_kinds: dict[str, int] = Field(
        description="what the bus's error frames told, by kind; one may tell of several",
        examples=[dict.fromkeys(KINDS, 0)],
    )


class Sensors(Form):
    """Every sensor."""

    sensors: tuple[SensorState, ...]


class Health(Form):
    """Whether the service runs, and whether its sensors do."""

    status: Literal["ok", "degraded"] = Field(description="degraded: a sensor is not live, or a part has a fault")
    sensors: dict[str, SensorState]
    faults: dict[str, str] = Field(
        description="parts of the service that failed within the last second or so and go on, and why",
        examples=[{}],
    )


class WarningForm(Form):
    """Something known against an image."""

    model_config = ConfigDict(frozen=True, from_attributes=True)

    code: WarningCode = Field(description="for programs: it does not change", examples=["saturated"])
    taxels: int | None = Field(
        None, description="how many it is about; null where that does not apply", examples=[3]
    )
    text: str = Field(
        description="for people: it may change", examples=["3 taxels saturated: their pressure is a lower bound"]
    )


class Frame(Form):
    """One image of one sensor."""

    type: Literal["frame"] = "frame"
    sensor: Name
    kind: Shown
    unit: Literal["kPa"] = "kPa"
    sequence: int = Field(examples=[5123])
    timestamp: float = Field(description="s, of the frame's first CAN message", examples=[1763712000.25])
    state: State
    age_s: float | None = Field(description="s since the last frame came in", examples=[0.004])
    values: Values
    flags: list[list[int]] | list[int] = Field(
        description="a raw taxel's 1 missing + 2 bad + 4 dead + 8 saturated; always of the raw image's shape",
        examples=[[[0, 0], [0, 0]]],
    )
    method: str = Field(description="that ran", examples=["nnls"])
    why: str = Field(examples=["selected by hand"])
    iterations: int = Field(examples=[3])
    microseconds: float = Field(description="from counts to the restored image", examples=[62.0])
    noise_kpa: float = Field(description="standard deviation of a raw taxel", examples=[0.2])
    noise_gain: float = Field(description="restored noise over raw noise", examples=[1.4])
    resolution_mm: float = Field(description="finest half-period above the noise", examples=[1.2])
    loss: Loss
    warnings: tuple[WarningForm, ...]


class StreamStatus(Form):
    """What a stream says in text, at least once a second and on every change."""

    type: Literal["status"] = "status"
    sensor: Name
    state: State
    age_s: float | None = Field(examples=[0.004])
    rate_hz: float = Field(examples=[100.0])
    jitter_s: float | None = Field(examples=[0.0002])
    skew_s: float | None = Field(examples=[0.0031])
    detail: str = Field(examples=[""])
    loss: Loss
    method: str = Field(examples=["auto"])
    sequence: int | None = Field(
        None, description="of the newest image, which all that follows is of", examples=[5123]
    )
    timestamp: float | None = Field(
        None, description="s, of its frame's first CAN message", examples=[1763712000.25]
    )
    ran: str | None = Field(None, examples=["nnls"])
    why: str | None = Field(None, examples=["selected by hand"])
    iterations: int | None = Field(None, examples=[3])
    microseconds: float | None = Field(None, examples=[62.0])
    noise_kpa: float | None = Field(None, examples=[0.2])
    noise_gain: float | None = Field(None, examples=[1.4])
    resolution_mm: float | None = Field(None, examples=[1.2])
    warnings: tuple[WarningForm, ...] = ()


class ContactForm(Form):
    """Where something touches."""

    id: int = Field(description="the same while the contact lasts", examples=[3])
    x_mm: float = Field(description="centre of pressure", examples=[10.3])
    y_mm: float = Field(examples=[12.0])
    force_n: float = Field(examples=[1.68])
    area_mm2: float = Field(examples=[42.0])
    peak_kpa: float = Field(examples=[98.5])
    major_mm: float = Field(description="standard deviation of pressure along the longer axis", examples=[1.49])
    minor_mm: float = Field(examples=[1.47])
    angle_rad: float = Field(description="of the longer axis, from x towards y", examples=[0.1])


class Contacts(Form):
    """The contacts in the newest restored image."""

    type: Literal["contacts"] = "contacts"
    sensor: Name
    sequence: int = Field(examples=[5123])
    timestamp: float = Field(description="s, of the frame's first CAN message", examples=[1763712000.25])
    state: State
    contacts: tuple[ContactForm, ...]


class Next(Form):
    """What a client of a stream says with flow=credit, to be sent the newest image."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    type: Literal["next"]
    sensor: str | None = Field(None, description="of this one; else of all", examples=["palm"])


class KernelForm(Form):
    """What the cover does."""

    model: str = Field(examples=["fem"])
    error_estimate: float = Field(description="of the gain", examples=[4e-4])
    r_mm: list[float] = Field(description="distance from a point load", examples=[[0.0, 0.5, 1.0]])
    g_per_mm2: list[float] = Field(
        description="normal stress under the cover for a unit point load", examples=[[0.9, 0.4, 0.05]]
    )
    q_per_mm: list[float] = Field(description="spatial frequency, cycles/mm", examples=[[0.0, 0.25, 0.5]])
    gain: list[float] = Field(description="contrast left at q", examples=[[1.0, 0.6, 0.1]])
    nyquist_per_mm: float = Field(description="1 / (2 pitch)", examples=[0.5])
    nyquist_gain: float = Field(examples=[0.1])
    smallest_gap_mm: float | None = Field(
        description="between two indenters that is still seen at a noise of 1 %; null: none", examples=[1.3]
    )


class ImageShape(Form):
    """Cells of an image."""

    rows: int = Field(examples=[32])
    columns: int = Field(examples=[32])
    cell_mm: float = Field(examples=[1.0])


class Geometry(Form):
    """Where the taxels are: x to the right, y down, mm."""

    shape: Pair[int] | None = Field(description="null where the layout is no grid", examples=[[32, 32]])
    positions_mm: list[Pair[float]] = Field(examples=[[[0.0, 0.0], [1.0, 0.0]]])
    pitch_mm: float = Field(examples=[1.0])
    aperture: Literal["square", "round"]
    aperture_mm: float = Field(description="side, or diameter", examples=[0.8])
    raw: ImageShape
    restored: ImageShape
    areas_mm2: list[float] | None = Field(
        description="that a taxel's pressure acts on, where the layout is no grid", examples=[None]
    )


class MethodAsked(Asked):
    """How a sensor's frames shall be restored."""

    method: MethodName = Field(examples=["nnls"])
    keep: bool = Field(False, description="over a restart of the service", examples=[True])


class Method(Form):
    """How a sensor's frames are restored."""

    method: MethodName = Field(description="asked for", examples=["nnls"])
    configured: MethodName = Field(examples=["auto"])
    kept: MethodName | None = Field(
        description="what a restart restores by; null: as configured", examples=["nnls"]
    )


class Tare(Form):
    """A tare that has begun."""

    frames: int = Field(description="whose mean is taken as no load", examples=[TARE_FRAMES])


class CalibrationForm(Form):
    """From counts to kPa: (counts - no_load) * kpa_per_count."""

    calibrated: bool = Field(description="false: one count is shown as one kPa", examples=[True])
    kpa_per_count: float = Field(description="negative where counts fall under pressure", examples=[0.05])
    no_load: list[float] = Field(description="counts of each taxel, as last tared", examples=[[80.0, 81.5]])
    tared: int = Field(description="times since the start", examples=[0])
    saturation: float | None = Field(description="counts of the ceiling; null: none", examples=[4095.0])
    noise_kpa: float = Field(description="standard deviation of a taxel, configured or measured", examples=[0.2])
    dead: list[int] = Field(description="taxels that do not work", examples=[[17]])
    shear_n_per_count: float | None = Field(
        description="N for one count of shear; null: not known, or none is felt", examples=[None]
    )


class Colormap(Form):
    """The viewer's colours, dark for no pressure."""

    name: str = Field(examples=["magma"])
    colors: list[Color] = Field(description="256 of red, green, blue", examples=[[[0, 0, 4]]])


class Problem(Form):
    """RFC 9457 problem details."""

    type: str = Field("about:blank", examples=["about:blank"])
    title: str = Field(examples=["Not Found"])
    status: int = Field(examples=[404])
    detail: str = Field(examples=["sensor 'plam': no such sensor: there are palm"])
    code: Literal["loaded"] | None = Field(
        None, description="only where a program may act on it; loaded: force=true tares anyway"
    )
    seen: str | None = Field(
        None, description="what stands in the way", examples=["contact of 12 kPa on 34 taxels"]
    )
