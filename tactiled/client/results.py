"""What requests of the client return: frozen values, and how they are read from an answer."""

from collections.abc import Mapping, Sequence
from dataclasses import MISSING, dataclass, fields, is_dataclass, replace
from http.client import HTTPMessage
from io import BytesIO
from typing import Any, get_args, get_type_hints

import numpy as np
from numpy.typing import NDArray

from tactiled.arrays import Flags, Floats, Floats32
from tactiled.client.display import html
from tactiled.client.stream import Cells, Image, ImageCells
from tactiled.frames import LOST, FrameWarning
from tactiled.units import FORCE_SCALES, ForceUnit, Unit
from tactiled.wire import Kept

Answer = tuple[bytes, HTTPMessage]  # content and headers
MAX_LOST = 0.2  # of an image's taxels, with more of which its force is unknown
ARRAYS = "sequence", "time", "method", "flags", "values"  # of a window


@dataclass(frozen=True, slots=True)
class Contact:
    """One contact; x to the right and y down, in the array's own coordinates."""

    id: int  # the same while it lasts
    x_mm: float  # centre of pressure
    y_mm: float
    force: float  # in `Contacts.force_unit`
    area_mm2: float
    peak: float  # in `Contacts.unit`
    major_mm: float  # standard deviation of the pressure along its longer axis
    minor_mm: float
    angle_rad: float  # of the longer axis from x towards y, -pi/2 to pi/2
    cut_off: bool = False  # it reaches the border of the array: what presses beyond is not in its force
    force_deviation: float | None = None  # standard deviation of `force`; None where it is unknown


@dataclass(frozen=True, slots=True)
class Contacts:
    """The contacts in the newest restored image."""

    sensor: str
    state: str  # live, stale, down or ended
    sequence: int  # of the image
    timestamp: float  # s, Unix, of the frame's first CAN message
    unit: Unit
    force_unit: ForceUnit
    contacts: tuple[Contact, ...]
    unknown_cells: int | None = None  # where no contact is found, as their pressure is unknown; None: not told


@dataclass(frozen=True, slots=True)
class Event:
    """One thing that happened."""

    id: int  # 1, 2, 3, ... since the service was started
    time: float  # s, Unix
    kind: str  # for programs: sensor_stale, warning_raised, ...
    sensor: str | None
    bus: str | None
    text: str  # for people
    warning: FrameWarning | None  # that was raised or cleared


@dataclass(frozen=True, slots=True)
class Recording:
    """A recording in the service's folder."""

    name: str
    bytes: int | None  # size of its file; None: it was removed
    running: bool
    bus: str | None  # None: recorded before this start of the service
    messages: int | None  # in the file so far
    unreadable: int | None  # messages lost: the interface could not decode them
    error: str | None  # why it ended early
    modified: float | None = None  # s, Unix time of its last message, or of its upload; None: it was removed
    duration_s: float | None = None  # from its first to its last message; None: not known without reading it all


@dataclass(frozen=True, slots=True)
class RegionMeasures:
    """What an image holds in a region; NaN: unknown."""

    force: float  # N, or counts mm2
    mean: float  # pressure, in `Region.unit`
    peak: float  # pressure, in `Region.unit`
    area: float  # mm2 in contact


@dataclass(frozen=True, slots=True)
class Region:
    """A region of an array, what it holds, and what it has held since `since`."""

    name: str
    shape: str  # rectangle, ellipse or polygon
    points_mm: tuple[tuple[float, float], ...]  # x and y of two opposite corners, or of each of a polygon
    threshold: dict[str, Any] | None  # quantity, and its bounds `above` and `below`
    unit: Unit
    now: RegionMeasures | None  # None: no image yet
    highest: RegionMeasures | None  # each on its own
    impulse: float  # integral of force over time, N s or counts mm2 s
    pressure_time: float  # integral of the peak pressure over time, `unit` times s
    since: float | None  # s, Unix, of the first image, or of the first after a reset
    exceeded: bool  # whether the threshold is


@dataclass(frozen=True, slots=True, eq=False)
class Window:
    """T images of one sensor, oldest first."""

    sensor: str
    kind: Kept
    unit: Unit  # counts of shear, and of an uncalibrated sensor
    cut: bool  # whether the service may have discarded images of the window's beginning
    sequence: NDArray[np.int64]  # (T,); lost frames leave gaps
    time: Floats  # (T,) s, Unix, of each frame's first CAN message
    method: NDArray[np.str_]  # (T,) that restored each
    flags: Flags  # (T, rows, columns) or (T, taxels) of the raw image, as `frames.FLAG_BITS`
    values: Floats32  # (T, rows, columns) or (T, taxels); shear (T, 2, ...), x and y; NaN: no data

    def _repr_html_(self) -> str:
        """Show the highest value of each cell in a notebook."""
        values = np.hypot(*self.values.swapaxes(0, 1)) if self.kind == "shear" else self.values
        facts = {
            "images": len(values),
            "frames lost": np.sum(np.diff(self.sequence) - 1),
            "duration": f"{np.sum(np.diff(self.time)):.3f} s",
        }
        images = {"highest": np.fmax.reduce(values, axis=0, initial=np.nan)}
        return html(f"{self.sensor}, {self.kind}", images, self.unit, np.nan, facts)


def parse(kind: Any, data: Any) -> Any:
    """A value of a type from its JSON: objects become dataclasses, lists tuples, null of a float NaN.

    Keys that the type lacks are left out; LookupError or TypeError where the JSON has not what it needs.
    """
    if isinstance(kind, type) and is_dataclass(kind):
        defaults = {field.name for field in fields(kind) if field.default is not MISSING}  # of older services
        named = (
            (name, each) for name, each in get_type_hints(kind).items() if name in data or name not in defaults
        )
        return kind(**{name: parse(each, data[name]) for name, each in named})
    if data is None:
        return np.nan if kind is float else None
    if isinstance(data, list):
        return tuple(parse(get_args(kind)[0], each) for each in data)
    objects = filter(is_dataclass, get_args(kind))  # of a type that may be None
    return next((parse(each, data) for each in objects), data)


def measured(image: Image, geometry: Mapping[str, Any], values: ImageCells = "raster") -> Image:
    """The image with its cells and its total force (N, counts mm2), NaN where a cell is unknown.

    Of one value a taxel the force is over what each taxel stands for, and there are no cells.
    """
    if values == "taxels":
        areas = np.array(geometry["areas_mm2"] or geometry["pitch_mm"] ** 2)
        return replace(image, force=_force(image, image.restored.ravel(), areas))
    side_mm, origin_mm, mask = (geometry["restored"].get(key) for key in ("cell_mm", "origin_mm", "mask"))
    felt = np.ones(image.restored.shape, bool) if mask is None else np.array(mask, bool)
    force = _force(image, image.restored[felt], side_mm**2)
    cells = None if origin_mm is None else Cells(side_mm, (origin_mm[0], origin_mm[1]), felt)  # None: of 0.4.2
    return replace(image, cells=cells, force=force)


def _force(image: Image, pressure: Floats32, areas: Any) -> float:
    """Total force of pressure over areas (mm2), N or counts mm2; NaN where it is unknown, as for the service."""
    known = (image.flags & LOST > 0).mean() <= MAX_LOST
    return float((pressure * areas).sum()) * FORCE_SCALES[image.unit] if known else np.nan


def parse_window(sensor: str, kind: Kept, pages: Sequence[Answer]) -> Window:
    """The window of pages with their headers, the newest first; ValueError if its images have several units."""
    units: set[Any] = {headers["X-Tactiled-Unit"] for _, headers in pages}
    if len(units) > 1:
        raise ValueError(f"images in {' and '.join(units)}: read them again")
    loaded = [dict(np.load(BytesIO(content))) for content, _ in reversed(pages)]
    arrays = [np.concatenate([page[name] for page in loaded]) for name in ARRAYS]
    return Window(sensor, kind, units.pop(), any("X-Tactiled-Cut" in headers for _, headers in pages), *arrays)
