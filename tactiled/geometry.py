"""Where an array's taxels are: a grid, or any layout."""

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from tactiled.errors import ConfigError

Aperture = Literal["square", "round"]
Sides = tuple[float, float, float, float]

NEIGHBOURS = 3  # nearest taxels whose mean distance is a layout's spacing
RIM_SPACINGS = 0.7  # that a cell at the rim of a layout reaches out from its taxel
GAP_SPACINGS = 1.25  # radius of the largest circle between taxels that is part of the array
SQUARES_PER_SPACING = 8  # that a layout's cells are made of
MAX_SQUARES = 1_000_000  # of a layout: ten times what 1024 evenly spread taxels need


@dataclass(frozen=True, slots=True, eq=False)
class Array:
    """Taxels in the plane: x to the right along a row, y down along a column, both in mm.

    `shape` is (rows, columns) for a grid in row-major order and None for any other layout; `pitch` is
    the distance (mm) between neighbours; `width` the side or diameter (mm) of a taxel's aperture.
    """

    positions: NDArray[np.float64]  # (N, 2), mm
    pitch: float
    width: float
    aperture: Aperture = "square"
    shape: tuple[int, int] | None = None
    beyond: Sides | None = None  # mm that the cover goes on above, below, left and right; None: as far as matters

    def __post_init__(self) -> None:
        """Refuse lengths that no array can have."""
        for name, value in (("pitch", self.pitch), ("width", self.width)):
            if not (np.isfinite(value) and value > 0):
                raise ConfigError(f"array {name} is {value} mm: give a length above 0 mm")
        if self.width > self.pitch * (1 + 1e-9):
            raise ConfigError(
                f"array width is {self.width} mm: apertures overlap past the pitch of {self.pitch} mm"
            )

    @property
    def size(self) -> int:
        """Number of taxels."""
        return len(self.positions)

    @property
    def frame_shape(self) -> tuple[int, ...]:
        """Shape of a frame: (rows, columns), or (N,) where there is no grid."""
        return self.shape or (self.size,)


def grid(
    rows: int, columns: int, pitch: float, width: float | None = None, aperture: Aperture = "square"
) -> Array:
    """Lay out rows x columns taxels at `pitch` (mm), the first at (0, 0); `width` (mm) defaults to the pitch."""
    y, x = np.mgrid[:rows, :columns] * pitch
    return Array(np.column_stack([x.ravel(), y.ravel()]), pitch, width or pitch, aperture, (rows, columns))


def layout(positions: NDArray[np.float64], width: float | None = None, aperture: Aperture = "round") -> Array:
    """Lay out taxels at `positions` (N, 2) in mm; the pitch is the least distance between two of them."""
    positions = np.asarray(positions, float)
    if len(positions) == 1:
        if width is None:
            raise ConfigError("array has one position and no aperture: give aperture_mm, the size of its taxel")
        return Array(positions, width, width, aperture)
    distances = np.linalg.norm(positions[:, None] - positions[None], axis=-1)
    np.fill_diagonal(distances, np.inf)
    pitch = float(distances.min())
    if pitch == 0:
        one, other = np.argwhere(distances == 0)[0]
        x, y = positions[one]
        raise ConfigError(
            f"array.positions_mm: taxels {one} and {other} are both at [{x:g}, {y:g}]: "
            "give each taxel a position of its own"
        )
    return Array(positions, pitch, width or pitch, aperture)


@dataclass(frozen=True, slots=True)
class Pose:
    """Where an array is in another frame of reference, such as a link of a robot."""

    frame_id: str
    origin_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)  # of the array's (0, 0)
    orientation: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)  # x, y, z, w: from the array's axes


@dataclass(frozen=True, eq=False)
class Cells:
    """The cells of a surface, of any form, each made of small squares, all of one side."""

    pieces: NDArray[np.float64]  # (P, 2) mm, the squares' centres
    side: float  # mm
    owner: NDArray[np.int64]  # (P,) the cell that a square belongs to; every cell has one at least

    @cached_property
    def areas(self) -> NDArray[np.float64]:
        """(M,) mm^2."""
        return np.asarray(np.bincount(self.owner) * self.side**2, float)

    @cached_property
    def positions(self) -> NDArray[np.float64]:
        """(M, 2) mm, the cells' centres."""
        count = np.bincount(self.owner)
        sums = [np.bincount(self.owner, self.pieces[:, axis]) for axis in (0, 1)]
        return np.asarray(np.column_stack(sums) / count[:, None], float)

    @cached_property
    def raster(self) -> NDArray[np.int64]:
        """(R, C) The cells' map in squares of `side`: the cell of each square, -1 where there is none."""
        column, row = np.rint((self.pieces - self.corner) / self.side).astype(np.int64).T
        owners = np.full((row.max() + 1, column.max() + 1), -1)
        owners[row, column] = self.owner
        return owners

    @property
    def rim(self) -> NDArray[np.bool_]:
        """Cells (M,) at the border of the surface."""
        return np.isin(np.arange(self.owner.max() + 1), self.raster[_rim(self.raster >= 0)])

    @property
    def corner(self) -> NDArray[np.float64]:
        """(2,) mm, the centre of the raster's first square."""
        return np.asarray(self.pieces.min(axis=0), float)

    def picture(self, values: NDArray[np.float32]) -> NDArray[np.float32]:
        """Values of the cells, of any shape, on the raster (R, C); NaN where there is no cell."""
        return np.append(values.ravel(), np.float32(np.nan))[self.raster]


@dataclass(frozen=True, eq=False)
class Raster:
    """The square cells of an image, in rows and columns, and the taxel that each of them belongs to."""

    corner: NDArray[np.float64]  # (2,) mm, the centre of the first cell
    side: float  # mm
    taxel: NDArray[np.int64]  # (R, C) the nearest taxel; -1 where none feels the cell, whose value is unknown

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        rows, columns = self.taxel.shape
        return rows, columns

    @property
    def felt(self) -> NDArray[np.bool_]:
        """(R, C) which cells taxels feel."""
        return np.asarray(self.taxel >= 0)

    @cached_property
    def positions(self) -> NDArray[np.float64]:
        """(R C, 2) mm, the cells' centres."""
        row, column = np.indices(self.shape)
        return np.asarray(self.corner + self.side * np.column_stack([column.ravel(), row.ravel()]))

    @property
    def rim(self) -> NDArray[np.bool_]:
        """(R, C) which felt cells have a side at the border of those."""
        return _rim(self.felt)

    def at_taxels(self, values: NDArray[np.floating], size: int) -> NDArray[np.float32]:
        """Mean of the known values (..., R, C) on each of `size` taxels (..., N); NaN where none is known."""
        flat, felt = values.reshape(-1, self.taxel.size), self.felt.ravel()
        known = np.isfinite(flat) & felt
        cell = np.where(felt, self.taxel.ravel(), 0) + size * np.arange(len(flat))[:, None]
        counts = np.bincount(cell[known], minlength=size * len(flat))
        sums = np.bincount(cell[known], flat[known], size * len(flat))
        means = np.divide(sums, counts, out=np.full(len(sums), np.nan), where=counts > 0)
        return np.asarray(means.reshape(*values.shape[:-2], size), np.float32)


def raster(array: Array, refine: int) -> Raster:
    """Lay an image's cells over an array, `refine` along the distance between its taxels.

    Those of a layout reach half of that beyond its taxels; a cell is felt where the layout's tiling has it.
    """
    side = spacing(array) / refine
    if array.shape is not None:
        corner = array.positions.min(axis=0) - (array.pitch - side) / 2
        taxels = np.arange(array.size).reshape(array.shape)
        return Raster(corner, side, taxels.repeat(refine, 0).repeat(refine, 1))
    _square_side(array)
    low, high = array.positions.min(axis=0), array.positions.max(axis=0)
    columns, rows = (refine + np.maximum(np.ceil((high - low) / side - 0.01), 0)).astype(int).tolist()
    corner = (low + high - side * (np.array([columns, rows]) - 1)) / 2
    empty = Raster(corner, side, np.full((rows, columns), -1))
    owner, within = _nearest(array, empty.positions)
    taxel = np.where(within, owner, -1)
    column, row = np.rint((array.positions - corner) / side).astype(int).T
    alone = np.bincount(taxel[within], minlength=array.size) == 0
    taxel[(row * columns + column)[alone]] = np.flatnonzero(alone)
    return Raster(corner, side, taxel.reshape(rows, columns))


def tiling(array: Array) -> Cells:
    """What each taxel stands for: a square of a grid; of a layout what is nearest to the taxel.

    At a layout's rim a cell reaches RIM_SPACINGS times the spacing around it out from its taxel.
    """
    if array.shape is not None:
        return Cells(array.positions, array.pitch, np.arange(array.size))
    side, reach = _square_side(array), RIM_SPACINGS * spacings(array).max()
    low, high = array.positions.min(axis=0) - reach, array.positions.max(axis=0) + reach
    x, y = np.meshgrid(*(np.arange(a + side / 2, b, side) for a, b in zip(low, high, strict=True)))
    pieces = np.column_stack([x.ravel(), y.ravel()])
    owner, within = _nearest(array, pieces)
    return Cells(pieces[within], side, owner[within].astype(np.int64))


def _square_side(array: Array) -> float:
    """Side (mm) of the squares that a layout's tiling is made of; ConfigError where they would be too many."""
    side, reach = min(spacing(array), 2 * array.pitch) / SQUARES_PER_SPACING, RIM_SPACINGS * spacings(array).max()
    width, height = np.ptp(array.positions, axis=0)
    if (width + 2 * reach) * (height + 2 * reach) > MAX_SQUARES * side**2:
        raise ConfigError(
            f"array positions spread over {width:g} x {height:g} mm, and two are {array.pitch:g} mm apart: "
            "too far from even; split it into several sensors"
        )
    return float(side)


def spacing(array: Array) -> float:
    """Give the distance (mm) between neighbours: of a layout the median of what is around each taxel."""
    return array.pitch if array.shape is not None else float(np.median(spacings(array)))


def spacings(array: Array) -> NDArray[np.float64]:
    """Give a layout's spacing (N,), mm: mean distance to the nearest, the median of these and the taxel's own."""
    if array.size == 1:
        return np.array([array.pitch])
    from scipy.spatial import cKDTree  # here: what reads a recording of a grid starts in half the time

    tree = cKDTree(array.positions)
    near = min(NEIGHBOURS, array.size - 1) + 1  # the first is the taxel itself
    distances, taxels = map(np.asarray, tree.query(array.positions, k=near))
    return np.asarray(np.median(distances[:, 1:].mean(axis=1)[taxels], axis=1))


def _nearest(array: Array, points: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """The taxel (P,) of a layout that each point is nearest to, and whether the layout reaches there."""
    from scipy.spatial import cKDTree

    around = spacings(array)
    distance, owner = (np.asarray(each) for each in cKDTree(array.positions).query(points))
    within = (distance <= RIM_SPACINGS * around[owner]) | _between(array.positions, around, points)
    return owner.astype(np.int64), within


def _rim(felt: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which of the squares (R, C) that are there have a side at their border."""
    there = np.pad(felt, 1)
    return np.asarray(felt & ~(there[:-2, 1:-1] & there[2:, 1:-1] & there[1:-1, :-2] & there[1:-1, 2:]))


def _between(
    positions: NDArray[np.float64], spacings: NDArray[np.float64], points: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Which points (P, 2) lie between neighbouring taxels of a layout: in triangles no wider than GAP_SPACINGS."""
    from scipy.spatial import Delaunay, QhullError

    try:
        triangles = Delaunay(positions)
    except (QhullError, ValueError):  # fewer than three taxels, or all on a line
        return np.zeros(len(points), bool)
    corners = positions[triangles.simplices]
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    one, other = np.moveaxis(corners[:, 1:] - corners[:, :1], 1, 0)
    areas = np.abs(one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]) / 2
    widest = GAP_SPACINGS * spacings[triangles.simplices].max(axis=1)
    inner = sides.prod(axis=1) <= 4 * areas * widest  # the radius of a circle is the product over four areas
    simplex = triangles.find_simplex(points)
    return np.asarray((simplex >= 0) & inner[simplex])
