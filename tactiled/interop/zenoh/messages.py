"""The door of a server of readers: the one schema of what comes over Zenoh, each value with its bounds.

ValueError, one line that names the field and the value, is all that a message can do here.
"""

import re
from io import BytesIO
from math import isfinite, prod
from typing import Annotated, Literal, TypeVar

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, JsonValue, ValidationError, model_validator

from tactiled import __version__, units
from tactiled.bounds import NAME, Bounds, Name, Pitch, Place, Syntax, place, reason, shown
from tactiled.diagnostics.warning_codes import WarningCode
from tactiled.frames import Direction, FrameWarning
from tactiled.live.events import Kind as EventKind
from tactiled.live.status import State
from tactiled.wire import Unpacked, unpack

ROBOT_AND_SENSOR = re.compile(rf"{NAME[1:-1]}/{NAME[1:-1]}")
SESSION = re.compile(r"[0-9a-f]{16}")
RELEASE = __version__  # which all of a network have: any change of it may change the messages
MAX_TAXELS, MAX_REFINE = 16384, 8
MAX_SENSOR_CELLS, MAX_CELLS = 1 << 18, 1 << 20  # of the restored images of a sensor, and of a robot's sensors
MAX_STATE_BYTES, MAX_EVENT_BYTES, MAX_DETAIL_BYTES, MAX_HEAD_BYTES = 1 << 16, 1 << 13, 1 << 14, 1 << 14
MAX_LINE_BYTES = 200  # of a clock's time, and of a challenge
MAX_JSON_BYTES = 2 << 20  # of a geometry or a configuration
MAX_ANSWER_BYTES = 8 << 20  # of any other answer
MAX_VALUE = 1e9  # of a pressure or a count, and all that is measured in them
MAX_SEQUENCE = 2**53
MAX_TIME_S = 1e12  # 30 000 years

Text = Annotated[
    str,
    Field(max_length=500),
    Syntax(r"[^\x00-\x1f\x7f-\x9f\u2028-\u202e\u2066-\u2069]*", "one line without control characters"),
]
Word = Annotated[str, Field(max_length=100), Syntax(r"[A-Za-z0-9_.:+-]*", "ASCII letters, digits or _ . : + -")]
Number = Annotated[int, Bounds(0, MAX_SEQUENCE)]
Seconds = Annotated[float, Bounds(0, MAX_TIME_S, "s")]
Measure = Annotated[float, Bounds(0, MAX_VALUE, signed=True)]
Cells = Annotated[int, Bounds(1, 1024 * MAX_REFINE)]
Model = TypeVar("Model", bound="Message")


class Message(BaseModel):
    """A JSON object of a reader; keys that a later release adds are left out."""

    model_config = ConfigDict(frozen=True, strict=True)


class Warned(Message):
    """A warning of an image."""

    code: WarningCode
    text: Text
    taxels: Number | None = None
    thickness_mm: Measure | None = None
    direction: Direction | None = None
    interval_mm: tuple[Measure, Measure] | None = None

    def warning(self) -> FrameWarning:
        """As images have it."""
        return FrameWarning(**dict(self))


class ReportedState(Message):
    """A sensor as its reader has it."""

    state: State
    detail: Text
    rate_hz: Annotated[float, Bounds(0, 1e6, "Hz")]
    jitter_s: Seconds | None
    skew_s: Seconds | None
    tared_at: Seconds | None = None
    loss: Annotated[dict[Word, Number], Field(max_length=64)]
    bus: Name
    codec: Word
    shear: bool
    unit: units.Unit
    method: Word
    clock: Text | None
    references: Annotated[list[Measure | None], Field(max_length=1024, fail_fast=True)] | None = None
    error_kinds: Annotated[dict[Word, Number], Field(max_length=64)]
    stale_after_s: Annotated[float, Bounds(0.001, 3600.0, "s")]
    closing: bool
    release: Text = "unknown"


class ImageShape(Message):
    """Cells of an image."""

    rows: Cells
    columns: Cells
    cell_mm: Annotated[float, Bounds(1e-4, 1000.0, units.LENGTH)]


class Geometry(Message):
    """Where a sensor's taxels and cells are."""

    shape: tuple[Annotated[int, Bounds(1, 1024)], Annotated[int, Bounds(1, 1024)]] | None
    positions_mm: Annotated[
        tuple[tuple[Place, Place], ...], Field(min_length=1, max_length=MAX_TAXELS, fail_fast=True)
    ]
    pitch_mm: Pitch
    aperture: Literal["square", "round"]
    aperture_mm: Annotated[float, Bounds(0.001, 1000.0, units.LENGTH)]
    raw: ImageShape
    restored: ImageShape
    areas_mm2: (
        Annotated[
            tuple[Annotated[float, Bounds(0, 1e8, "mm2")], ...], Field(max_length=MAX_TAXELS, fail_fast=True)
        ]
        | None
    ) = None

    @model_validator(mode="after")
    def _consistent(self) -> "Geometry":
        raw, restored = (self.raw.rows, self.raw.columns), (self.restored.rows, self.restored.columns)
        if raw != (self.shape or (1, len(self.positions_mm))) or prod(raw) != len(self.positions_mm):
            raise ValueError(f"raw: {raw[0]} x {raw[1]} cells do not fit {len(self.positions_mm)} positions")
        if prod(restored) > MAX_SENSOR_CELLS:
            raise ValueError(f"restored: {restored[0]} x {restored[1]} cells: give {MAX_SENSOR_CELLS} at most")
        refine, fits = restored[0] // raw[0], restored == tuple(restored[0] // raw[0] * each for each in raw)
        if self.shape and not (fits and 1 <= refine <= MAX_REFINE):
            raise ValueError(
                f"restored: {restored[0]} x {restored[1]} cells do not fit {raw[0]} x {raw[1]} taxels"
            )
        return self


class Detail(Message):
    """What the binary form of an image has no place for."""

    why: Text
    method: Word
    calibration: Word
    warnings: Annotated[tuple[Warned, ...], Field(max_length=64, fail_fast=True)]


class Event(Message):
    """What happened at a reader."""

    kind: EventKind
    text: Text
    sensor: Name | None
    bus: Name | None
    warning: Warned | None = None


class AnswerHead(Message):
    """How a reader answers a request."""

    status: Annotated[int, Bounds(200, 599)]
    headers: Annotated[dict[Word, Text], Field(max_length=16)]
    claim: Text = ""


class Override(Message):
    """A setting that is not as configured."""

    sensor: Name
    key: Literal["method"]
    configured: Word
    value: Word
    kept: bool


class Settings(Message):
    """What a reader runs with."""

    bus: Annotated[dict[Name, dict[Word, JsonValue]], Field(max_length=64)]
    sensor: Annotated[dict[Name, dict[Word, JsonValue]], Field(max_length=64)]
    overrides: Annotated[list[Override], Field(max_length=64)]


def read(model: type[Model], data: bytes, max_bytes: int) -> Model:
    """A message as its model has it."""
    name = model.__name__.removeprefix("Reported").removesuffix("Head").lower()
    if len(data) > max_bytes:
        raise ValueError(f"{name}: {len(data)} bytes: give {max_bytes} at most")
    try:
        return model.model_validate_json(data)
    except ValidationError as error:
        raise ValueError(f"{name}: {first_fault(error)}") from None


def first_fault(error: ValidationError) -> str:
    """The first fault of a message, in one line of printable ASCII."""
    fault = error.errors(include_url=False, include_context=False)[0]
    is_value = fault["type"] != "missing" and not isinstance(fault["input"], dict | list)
    value = f" = {shown(fault['input']):.60}" if is_value else ""
    line = f"{place(fault['loc']):.100}{value}: {reason(fault):.150}"
    return line.encode("unicode_escape").decode()


def image(kind: str, message: bytes, shape: tuple[int, ...]) -> Unpacked:
    """An image of this kind and shape, its values in that."""
    part = unpack(message)
    numbers = part.noise, part.noise_gain, part.resolution_mm, part.microseconds, part.timestamp, part.made_at
    if part.kind != kind or part.values.size != prod(shape):
        raise ValueError(f"{kind}: {part.kind} of {part.values.size} values: its geometry has {prod(shape)}")
    if part.flags.size != (prod(shape) if kind == "raw" else 0):
        raise ValueError(f"{kind}: {part.flags.size} flags: one a taxel belongs to the raw image")
    if part.sequence >= MAX_SEQUENCE or not all(isfinite(each) and abs(each) < MAX_TIME_S for each in numbers):
        raise ValueError(f"{kind}: sequence {part.sequence}, times and noise {numbers}: one is out of bounds")
    if (np.abs(part.values) > MAX_VALUE).any():  # NaN: unknown
        raise ValueError(f"{kind}: a value is infinite, or above {MAX_VALUE:g}")
    return part._replace(values=part.values.reshape(shape))


def deviation(body: bytes, shape: tuple[int, ...]) -> NDArray[np.float32]:
    """The numbers of a .npy file of this shape."""
    file = BytesIO(body)
    version = npy.read_magic(file)
    header = npy.read_array_header_1_0(file) if version == (1, 0) else None
    if header != (shape, False, np.dtype("<f4")) or len(body) - file.tell() != 4 * prod(shape):
        raise ValueError(f"deviation: a .npy of {header}: expected float32 of {shape}")
    return np.frombuffer(body, "<f4", offset=file.tell()).reshape(shape)
