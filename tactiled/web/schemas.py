"""The JSON objects of the API, field by field: the models behind OpenAPI and AsyncAPI."""

from typing import Annotated, Any, Literal, Optional

from pydantic import BaseModel, ConfigDict, Discriminator, Field, Tag, create_model

from tactiled import units
from tactiled.bounds import MAX_READING
from tactiled.diagnostics.warning_codes import WarningCode
from tactiled.frames import Direction, Loss
from tactiled.live.status import State
from tactiled.restore.methods import METHODS

PressureKind = Literal["raw", "restored", "deviation"]
ImageCells = Literal["raster", "taxels"]
IMAGE_CELLS = "cells of a restored image: its raster, or one value a taxel, the mean of the taxel's cells"
SensorName = Annotated[str, Field(description="as in the configuration", examples=["palm"])]
MethodName = Annotated[str, Field(json_schema_extra={"enum": list(METHODS)})]
Values = Annotated[
    list[list[float | None]] | list[float | None],
    Field(
        description="rows of a raster, or one list of taxels; null: no data",
        examples=[[[0.0, 12.5], [3.25, None]]],
    ),
]
Reading = Annotated[float, Field(ge=-MAX_READING, le=MAX_READING, allow_inf_nan=False)]
MAX_TIME_S = 4e9  # Unix time: the year 2096
Flags = Annotated[
    list[list[int]] | list[int],
    Field(
        description="of the raw image: 1 missing + 2 bad + 4 dead + 8 saturated + 16 out of range + 32 faulty",
        examples=[[[0, 0], [0, 8]]],
    ),
]
Unit = Annotated[
    units.Unit, Field(description="of pressures; counts: the sensor is uncalibrated", examples=["kPa"])
]
OptionalRows = Annotated[int | None, Field(description="null where the layout is no grid", examples=[32])]


class Schema(BaseModel):
    """A JSON object of the API; it can be filled from any object with attributes of the same names."""

    model_config = ConfigDict(frozen=True, from_attributes=True)

    @classmethod
    def shared(cls, source: object) -> dict[str, Any]:
        """The fields that an object has by the same names."""
        return {name: getattr(source, name) for name in cls.model_fields if hasattr(source, name)}


class RequestBody(Schema):
    """A JSON object that a client sends: an unknown key is refused, and so is 0 for false."""

    model_config = ConfigDict(extra="forbid", strict=True)


def _or_null(schema: type[Schema]) -> Any:
    """The same fields, each null where there is no image yet."""
    fields: dict[str, Any] = {}
    for name, each in schema.model_fields.items():
        field = Field(None, description=each.description, examples=each.examples)
        fields[name] = (Optional[each.annotation], field)  # noqa: UP045, of a variable
    return create_model(f"{schema.__name__}OrNull", __base__=Schema, **fields)


class Status(Schema):
    """Health of a sensor."""

    state: State = Field(
        description="live; stale: no new frame; silent: none yet; down: the bus is gone; ended: the replay"
    )
    age_s: float | None = Field(description="since the last frame came in", examples=[0.004])
    rate_hz: float = Field(description="frames a second", examples=[100.0])
    jitter_s: float | None = Field(description="standard deviation of the last 100 periods", examples=[0.0002])
    skew_s: float | None = Field(description="from a frame's first message to its last", examples=[0.0031])
    detail: str = Field(description="one line on the state", examples=[""])
    tared_at: float | None = Field(None, description="Unix time of the tare that holds; null: none")
    position_s: float | None = Field(
        None, description="in the replayed recording; null: of a bus", examples=[None]
    )
    loss: Loss = Field(description="what went wrong on the way in, counted by kind since the start")


class SensorState(Status):
    """A sensor and its health."""

    name: SensorName
    bus: str = Field(examples=["can0"])
    codec: str = Field(examples=["packed"])
    rows: OptionalRows
    columns: OptionalRows
    taxels: int = Field(examples=[1024])
    pitch_mm: float = Field(examples=[1.0])
    shear: bool = Field(description="whether the skin feels it", examples=[False])
    traction: bool = Field(False, description="whether it is restored", examples=[False])
    unit: Unit
    method: str = Field(description="selected method", examples=["auto"])
    methods: tuple[str, ...] = Field(examples=[tuple(METHODS)])
    clock: str | None = Field(description="source of the frames' times; null before the bus was first open")
    sequence: int | None = Field(description="of the newest image", examples=[5123])
    references: list[float | None] | None = Field(
        description="counts of pads that follow temperature, not pressure; null: the skin has none",
        examples=[[240.0, 241.0]],
    )
    error_kinds: dict[str, int] = Field(description="error frames of the bus, by kind", examples=[{"other": 0}])


class Sensors(Schema):
    """Every sensor."""

    sensors: tuple[SensorState, ...]


class Health(Schema):
    """Whether the service runs, and whether its sensors do."""

    status: Literal["ok", "degraded"] = Field(description="degraded: a sensor is not live, or a part has a fault")
    sensors: dict[str, SensorState]
    faults: dict[str, str] = Field(description="parts that failed in the last second, and why", examples=[{}])


class Message(Schema):
    """What every message on a sensor begins with."""

    type: str
    sensor: SensorName
    state: State


class FrameId(Schema):
    """Which frame it is."""

    sequence: int = Field(description="number of the frame; lost frames leave gaps", examples=[5123])
    timestamp: float = Field(description="s, of the frame's first CAN message", examples=[1763712000.25])


class Restoration(Schema):
    """How an image was made."""

    why: str = Field(description="why this method was used", examples=["selected by hand"])
    iterations: int = Field(examples=[3])
    microseconds: float = Field(description="from counts to the restored image", examples=[62.0])
    unit: Unit
    noise: float = Field(description="standard deviation of a raw taxel, in `unit`", examples=[0.2])
    noise_kpa: float | None = Field(description="the same; null in counts", examples=[0.2])
    noise_gain: float = Field(description="restored noise over raw noise", examples=[1.4])
    resolution_mm: float = Field(description="finest half-period above the noise", examples=[1.2])
    calibration: str = Field(description="id of the calibration file, or configured", examples=["3f9a0c52d1e7"])


class FrameWarning(Schema):
    """Something known against an image."""

    code: WarningCode = Field(description="for programs: it does not change", examples=["saturated"])
    taxels: int | None = Field(None, description="how many, where the warning counts them", examples=[3])
    thickness_mm: float | None = Field(
        None, description="of the cover that explains a cover_mismatch, where one does", examples=[None]
    )
    direction: Direction | None = Field(None, description="of that cover to the configured one", examples=[None])
    interval_mm: tuple[float, float] | None = Field(
        None, description="95 %, of thickness_mm; null: it is the most that the cover has", examples=[None]
    )
    text: str = Field(description="for people: it may change", examples=["3 taxels saturated: ..."])


class Frame(Restoration, FrameId, Message):
    """One image of one sensor."""

    type: Literal["frame"] = "frame"
    kind: PressureKind
    age_s: float | None = Field(description="since the last frame came in", examples=[0.004])
    values: Values
    flags: Flags
    method: str = Field(description="method used", examples=["nnls"])
    loss: Loss
    warnings: tuple[FrameWarning, ...]


class Surface(FrameId, Message):
    """The newest restored image with what lies beyond the taxels, and its standard deviation; null: unknown."""

    type: Literal["surface"] = "surface"
    unit: Unit
    cell_mm: float = Field(examples=[0.5])
    origin_mm: list[float] = Field(
        min_length=2, max_length=2, description="x and y of the first cell's centre", examples=[[-2.0, -2.0]]
    )
    own: list[int] = Field(
        min_length=4,
        max_length=4,
        description="cells of `restored`: first row, end of rows, first column, end of columns",
        examples=[[4, 36, 4, 36]],
    )
    values: Values
    deviation: Values


class Shear(FrameId, Message):
    """Shear of one frame, as the skin senses it under its cover: tared, not restored, not calibrated."""

    type: Literal["shear"] = "shear"
    unit: units.Shear = units.SHEAR
    x: Values
    y: Values


class Traction(FrameId, Message):
    """Tangential load on the restored cells, by shear, and its standard deviation; null before the first tare."""

    type: Literal["traction"] = "traction"
    unit: Literal["kPa"] = units.PRESSURE
    x: Values
    y: Values
    x_deviation: Values
    y_deviation: Values


class StreamStatus(_or_null(Restoration), _or_null(FrameId), Status, Message):  # type: ignore[misc]
    """A sensor's state, at least once a second and on every change, and how its newest image was made."""

    type: Literal["status"] = "status"
    unit: Unit
    method: str = Field(description="selected method", examples=["auto"])
    ran: str | None = Field(None, description="method used", examples=["nnls"])
    warnings: tuple[FrameWarning, ...] = ()


class Contact(Schema):
    """One contact; x to the right and y down, in the array's own coordinates."""

    id: int = Field(description="the same while it lasts")
    x_mm: float = Field(description="centre of pressure")
    y_mm: float
    force: float = Field(description="in `force_unit`", examples=[0.52])
    force_n: float | None = Field(description="the same; null in counts", examples=[0.52])
    area_mm2: float
    peak: float = Field(description="in `unit`", examples=[34.0])
    peak_kpa: float | None = Field(description="the same; null in counts", examples=[34.0])
    major_mm: float = Field(description="standard deviation of the pressure along its longer axis")
    minor_mm: float
    angle_rad: float = Field(description="of the longer axis from x towards y, -pi/2 to pi/2")
    cut_off: bool = Field(description="it reaches the border: what presses beyond is not in its force")
    force_deviation: float | None = Field(
        description="standard deviation of `force`; null where it is unknown", examples=[0.02]
    )


class Contacts(FrameId, Message):
    """The contacts in the newest restored image."""

    type: Literal["contacts"] = "contacts"
    unit: Unit
    force_unit: units.ForceUnit = Field(examples=["N"])
    unknown_cells: int = Field(
        description="cells whose pressure is unknown: no contact is found there", examples=[0]
    )
    contacts: tuple[Contact, ...]


def _form(values: Any) -> str:
    """Tag of the form that values have; in `[]`, as names of types that no error shows."""
    return "[rows]" if isinstance(values, list) and values and isinstance(values[0], list) else "[list]"


class PushedFrame(RequestBody):
    """A frame that a program pushes."""

    values: Annotated[
        Annotated[list[list[Reading | None]], Tag("[rows]")] | Annotated[list[Reading | None], Tag("[list]")],
        Discriminator(_form),  # else each value would have the errors of both forms
        Field(
            max_length=1 << 14,
            description="counts, or kPa with `kpa_per_count = 1`: rows of a grid, or one list; null: unknown",
            examples=[[[0.0, 12.5], [3.25, None]]],
        ),
    ]
    sequence: int | None = Field(
        None, ge=0, lt=1 << 32, description="number of the frame; left out: one more than the frame before"
    )
    time: float | None = Field(
        None,
        ge=0,
        le=MAX_TIME_S,
        allow_inf_nan=False,
        description="Unix time of the frame, s; left out: when it comes",
    )


class PushedNumber(Schema):
    """A frame was taken."""

    sequence: int = Field(description="its number; gaps between numbers count as lost frames", examples=[17])


class Next(Schema):
    """What a client of a stream sends with flow=credit, to be sent the newest image."""

    model_config = ConfigDict(extra="forbid")

    type: Literal["next"]
    sensor: str | None = Field(None, description="of this one; else of all", examples=["palm"])


class CoverKernel(Schema):
    """What the cover does."""

    model: str = Field(examples=["fem"])
    error_estimate: float = Field(description="of the gain", examples=[4e-4])
    r_mm: list[float] = Field(description="distance from a point load", examples=[[0.0, 0.5, 1.0]])
    g_per_mm2: list[float] = Field(description="stress for a unit point load", examples=[[0.9, 0.4, 0.05]])
    q_per_mm: list[float] = Field(description="spatial frequency, cycles/mm", examples=[[0.0, 0.25, 0.5]])
    gain: list[float] = Field(description="contrast left at q", examples=[[1.0, 0.6, 0.1]])
    nyquist_per_mm: float = Field(description="1 / (2 pitch)", examples=[0.5])
    nyquist_gain: float = Field(examples=[0.1])
    smallest_gap_mm: float | None = Field(description="smallest resolvable gap at 1 % noise; null: none")


class ImageShape(Schema):
    """Cells of an image."""

    rows: int = Field(examples=[32])
    columns: int = Field(examples=[32])
    cell_mm: float = Field(examples=[1.0])


class RestoredShape(ImageShape):
    """Cells of the restored image: a raster over the taxels."""

    origin_mm: tuple[float, float] = Field(description="x and y of the first cell's centre", examples=[[0.0, 0.0]])
    mask: list[list[bool]] | None = Field(
        description="cells that taxels feel; the others have no data; null: all", examples=[None]
    )


class Geometry(Schema):
    """Where the taxels are: x to the right, y down, mm."""

    shape: list[int] | None = Field(description="null where the layout is no grid", examples=[[32, 32]])
    positions_mm: list[list[float]] = Field(examples=[[[0.0, 0.0], [1.0, 0.0]]])
    pitch_mm: float = Field(examples=[1.0])
    aperture: Literal["square", "round"]
    aperture_mm: float = Field(description="side, or diameter", examples=[0.8])
    raw: ImageShape
    restored: RestoredShape
    areas_mm2: list[float] | None = Field(description="of each taxel, where the layout is no grid")


class MethodSelection(RequestBody):
    """How a sensor's frames shall be restored."""

    method: MethodName = Field(examples=["nnls"])
    keep: bool = Field(False, description="over a restart of the service", examples=[True])


class Method(Schema):
    """How a sensor's frames are restored."""

    method: MethodName = Field(description="selected method", examples=["nnls"])
    configured: MethodName = Field(examples=["auto"])
    kept: MethodName | None = Field(description="method after a restart; null: as configured", examples=["nnls"])


class Colormap(Schema):
    """The viewer's colours, dark for no pressure."""

    name: str = Field(examples=["magma"])
    colors: list[list[int]] = Field(description="256 of red, green, blue", examples=[[[0, 0, 4]]])


class Problem(Schema):
    """RFC 9457 problem details."""

    type: str = Field("about:blank", examples=["about:blank"])
    title: str = Field(examples=["Not Found"])
    status: int = Field(examples=[404])
    detail: str = Field(examples=["sensor 'plam': no such sensor: there are palm"])
    code: Literal["loaded"] | None = Field(None, description="for programs; loaded: force=true tares anyway")
    seen: str | None = Field(None, description="of loaded: the load", examples=["contact of 12 kPa on 34 taxels"])
