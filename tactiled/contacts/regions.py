"""Regions of an array that somebody watches: which cells lie in one, and what an image holds there."""

from typing import Annotated, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from tactiled.contacts.felt import is_known
from tactiled.frames import SensorImage
from tactiled.geometry import Raster
from tactiled.units import FORCE_SCALES, FORCE_UNITS, Unit

Quantity = Literal["force", "mean", "peak", "area"]
CONTACT_SIGMAS = 3.0  # noise standard deviations above which a cell is in contact, as contacts go on down to
MAX_CORNERS = 64
TOTAL = "total"  # what a series calls the whole array, beside its regions
Coordinate = Annotated[float, Field(allow_inf_nan=False, strict=True)]
HYSTERESIS = 0.1  # of a threshold, by which a value falls under it again where nobody says otherwise


def _below(above: float) -> float:
    """A value that is less than another by the default hysteresis, in few digits."""
    return float(f"{above - HYSTERESIS * abs(above):.6g}")


class Threshold(BaseModel):
    """A limit with hysteresis: an event comes above `above`, and another once the value is below `below` again."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    quantity: Quantity = Field(examples=["force"])
    above: Coordinate = Field(description="in the quantity's unit", examples=[5.0])
    below: Coordinate = Field(
        default_factory=lambda known: _below(known.get("above", 0.0)),
        description="at most `above`; left out: 10 % less",
        examples=[4.0],
    )


class Region(BaseModel):
    """A part of an array, in the array's own coordinates."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    shape: Literal["rectangle", "ellipse", "polygon"] = Field(examples=["rectangle"])
    points_mm: tuple[tuple[Coordinate, Coordinate], ...] = Field(
        min_length=2,
        max_length=MAX_CORNERS,
        description="two opposite corners of a rectangle or of the one round an ellipse; a polygon's corners",
        examples=[[[2.0, 3.0], [10.0, 8.0]]],
    )
    threshold: Threshold | None = None

    def check(self) -> None:
        """ValueError where its corners make no shape, or its threshold no hysteresis."""
        corners, limit = len(self.points_mm), self.threshold
        if self.shape == "polygon" and corners < 3:
            raise ValueError(f"points_mm: a polygon has three corners at least, not {corners}")
        if self.shape != "polygon" and corners != 2:
            raise ValueError(f"points_mm: two corners make the {self.shape}, not {corners}")
        if limit is not None and limit.below > limit.above:
            raise ValueError(f"threshold: below = {limit.below:g} is more than above = {limit.above:g}")

    def cells(self, cells: Raster) -> NDArray[np.int64]:
        """Numbers of the felt cells whose centres lie in it; ValueError where there are none."""
        self.check()
        points = np.array(self.points_mm)
        if self.shape == "polygon":
            from skimage.measure import points_in_poly

            inside = points_in_poly(cells.positions, points)
        else:
            half = np.abs(points[1] - points[0]) / 2
            offset = np.abs(cells.positions - points.mean(axis=0)) / np.where(half > 0, half, 1e-9)
            inside = offset.max(axis=1) <= 1 if self.shape == "rectangle" else (offset**2).sum(axis=1) <= 1
        inside &= cells.felt.ravel()
        if not inside.any():
            raise ValueError("points_mm: no cell of the image has its centre in it")
        return np.flatnonzero(inside)


class Measures(NamedTuple):
    """What an image holds in a region; NaN where nothing is known."""

    force: float  # N, or counts mm2
    mean: float  # pressure in the image's unit
    peak: float
    area: float  # mm2 in contact


NOT_KNOWN = Measures(*4 * (np.nan,))


def measure_units(unit: Unit) -> dict[str, str]:
    """Units of images in a unit, by the fields of Measures."""
    return dict(zip(Measures._fields, (FORCE_UNITS[unit], unit, unit, "mm2"), strict=True))


def headings(unit: Unit) -> list[str]:
    """Measures of a region, of an image in a unit, as headings."""
    return [f"{name}_{each.replace(' ', '_')}" for name, each in measure_units(unit).items()]


class RegionMeter:
    """Measures a region (None: the whole array) in restored images; ValueError where no cell lies in it."""

    def __init__(self, region: Region | None, cells: Raster) -> None:
        self._cells = np.flatnonzero(cells.felt) if region is None else region.cells(cells)
        self._area = cells.side**2

    def __call__(self, image: SensorImage) -> Measures:
        """What an image holds in the region; nothing where a cell is unknown: a contact may be on it."""
        pressure = image.restored.reshape(-1)[self._cells]
        if np.isnan(pressure).any():
            return NOT_KNOWN
        if image.shares is not None and not is_known(image.shares.reshape(-1)[self._cells].mean(), summed=True):
            return NOT_KNOWN
        total = float(pressure.sum(dtype=float))
        contact = self._area * np.count_nonzero(pressure > CONTACT_SIGMAS * image.cell_noise)
        force = total * self._area * FORCE_SCALES[image.unit]
        return Measures(force, total / len(pressure), float(pressure.max()), contact)
