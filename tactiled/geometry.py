"""Where an array's taxels are: a grid, or any layout."""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from tactiled.errors import ConfigError

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

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
    """The cells of a surface, each made of small squares, all of one side."""

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
        empty = np.pad(self.raster, 1, constant_values=-1) < 0
        beside = empty[:-2, 1:-1] | empty[2:, 1:-1] | empty[1:-1, :-2] | empty[1:-1, 2:]
        return np.isin(np.arange(self.owner.max() + 1), self.raster[beside])

    @property
    def corner(self) -> NDArray[np.float64]:
        """(2,) mm, the centre of the raster's first square."""
        return np.asarray(self.pieces.min(axis=0), float)

    def picture(self, values: NDArray[np.float32]) -> NDArray[np.float32]:
        """Values of the cells, of any shape, on the raster (R, C); NaN where there is no cell."""
        return np.append(values.ravel(), np.float32(np.nan))[self.raster]


def tiling(array: Array, refine: int = 1) -> Cells:
    """Cells that cover the surface over an array: squares of a grid, refined; else what is nearest to each taxel.

    At a layout's rim a cell reaches RIM_SPACINGS times the spacing around it out from its taxel.
    """
    if array.shape is not None:
        side = array.pitch / refine
        rows, columns = (n * refine for n in array.shape)
        y, x = np.mgrid[:rows, :columns] * side
        low = array.positions.min(axis=0) - (array.pitch - side) / 2
        return Cells(np.column_stack([x.ravel(), y.ravel()]) + low, side, np.arange(rows * columns))
    from scipy.spatial import cKDTree  # here: what reads a recording of a grid starts in half the time

    tree = cKDTree(array.positions)
    spacings = _spacings(array, tree)
    spacing, reach = float(np.median(spacings)), RIM_SPACINGS * spacings
    side = min(spacing, 2 * array.pitch) / SQUARES_PER_SPACING
    low, high = array.positions.min(axis=0) - reach.max(), array.positions.max(axis=0) + reach.max()
    if np.prod((high - low) / side) > MAX_SQUARES:
        width, height = np.ptp(array.positions, axis=0)
        raise ConfigError(
            f"array positions spread over {width:g} x {height:g} mm, and two are {array.pitch:g} mm apart: "
            "too far from even; split it into several sensors"
        )
    x, y = np.meshgrid(*(np.arange(a + side / 2, b, side) for a, b in zip(low, high, strict=True)))
    pieces = np.column_stack([x.ravel(), y.ravel()])
    distance, owner = (np.asarray(each) for each in tree.query(pieces))
    within = (distance <= reach[owner]) | _between(array.positions, spacings, pieces)
    return Cells(pieces[within], side, owner[within].astype(np.int64))


def raster(corner: NDArray[np.float64], shape: tuple[int, int], side: float, parts: int) -> Cells:
    """Give (R, C) square cells of `side` (mm) from a corner (x, y), each made of parts x parts squares."""
    y, x = np.mgrid[: parts * shape[0], : parts * shape[1]]
    squares = np.column_stack([x.ravel() + 0.5, y.ravel() + 0.5]) * side / parts + corner
    return Cells(squares, side / parts, (y // parts * shape[1] + x // parts).ravel())


def spacing(array: Array) -> float:
    """Give the distance (mm) between neighbours: of a layout the median of what is around each taxel."""
    if array.shape is not None:
        return array.pitch
    from scipy.spatial import cKDTree

    return float(np.median(_spacings(array, cKDTree(array.positions))))


def _spacings(array: Array, tree: "cKDTree") -> NDArray[np.float64]:
    """A layout's spacing (N,) in mm: mean distance to the nearest, the median of these and the taxel's own."""
    if array.size == 1:
        return np.array([array.pitch])
    near = min(NEIGHBOURS, array.size - 1) + 1  # the first is the taxel itself
    distances, taxels = map(np.asarray, tree.query(array.positions, k=near))
    return np.asarray(np.median(distances[:, 1:].mean(axis=1)[taxels], axis=1))


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
