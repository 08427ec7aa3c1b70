"""Where an array's taxels are: a grid, or any layout."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from tactiled.errors import ConfigError

Aperture = Literal["square", "round"]


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

    def __post_init__(self) -> None:
        """Refuse lengths that no array can have."""
        for name, value in (("pitch", self.pitch), ("width", self.width)):
            if not (np.isfinite(value) and value > 0):
                raise ConfigError(f"array {name} is {value} mm: give a length above 0 mm")
        if self.width > self.pitch * (1 + 1e-9):
            raise ConfigError(
                f"array width is {self.width} mm: apertures overlap past the pitch of {self.pitch} mm"
            )
        if self.positions.ndim != 2 or self.positions.shape[1] != 2 or not len(self.positions):
            raise ConfigError(f"array positions have shape {self.positions.shape}: give a list of (x, y) in mm")
        if not np.isfinite(self.positions).all():
            raise ConfigError("array positions hold a number that is not finite")

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
    if rows < 1 or columns < 1:
        raise ConfigError(f"array of {rows} x {columns} taxels: give at least one row and one column")
    y, x = np.mgrid[:rows, :columns] * pitch
    return Array(np.column_stack([x.ravel(), y.ravel()]), pitch, width or pitch, aperture, (rows, columns))


def layout(positions: NDArray[np.float64], width: float | None = None, aperture: Aperture = "round") -> Array:
    """Lay out taxels at `positions` (N, 2) in mm; the pitch is the least distance between two of them."""
    positions = np.asarray(positions, float)
    if positions.ndim != 2 or len(positions) < 2 or not np.isfinite(positions).all():
        return Array(positions, width or 1.0, width or 1.0, aperture)
    gaps = np.linalg.norm(positions[:, None] - positions[None], axis=-1)
    gaps[np.diag_indices_from(gaps)] = np.inf
    pitch = float(gaps.min())
    return Array(positions, pitch, width or pitch, aperture)
