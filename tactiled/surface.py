"""The surface that an array is restored on: square cells on a raster that reaches beyond the taxels."""

from functools import partial

import numpy as np

from tactiled.cover.kernel import Kernel
from tactiled.cover.operator import cached, stencil, tiled
from tactiled.geometry import Array, grid, raster, spacing, tiling
from tactiled.restore.blur import GridBlur, Wide

BEYOND = 2  # pitches that the surface reaches beyond the taxels: with 3 or 4 errors grow again
THIN_BEYOND, THIN_PITCHES = 1, 0.75  # the same under a cover that is thinner than so many pitches
APERTURE = 0.8  # of a cell: what the model has on each where the taxels are elsewhere, as in training
PARTS = 4  # squares along a cell, of which a taxel elsewhere feels each
CELLS_A_PITCH = 2  # where the taxels are no grid
MAX_BEYOND_VALUES = 1 << 22  # of a grid: taxels beyond it times its own, as 64 x 64 have
MAX_CELLS, MAX_VALUES = 4096, 1 << 20  # of a surface with taxels elsewhere: it, and times the taxels


def make(kernel: Kernel, array: Array, refine: int) -> Wide | None:
    """Lay the surface around an array; None where it has too many cells for that, or is the array's own."""
    pitch = spacing(array)
    most = THIN_BEYOND if kernel.stack.depth < THIN_PITCHES * pitch else BEYOND
    beyond = [
        most if array.beyond is None else min(most, round(side / pitch)) for side in array.beyond or (0,) * 4
    ]
    if array.shape is None:
        return _around(kernel, array, pitch, beyond)
    above, below, left, right = beyond
    wide_shape = array.shape[0] + above + below, array.shape[1] + left + right
    taxels = slice(above, above + array.shape[0]), slice(left, left + array.shape[1])
    wide = grid(*wide_shape, array.pitch, array.width, array.aperture)
    if refine == 1:
        values = (wide.size - array.size) * array.size
        return Wide(grid_blur(kernel, wide), taxels) if 0 < values <= MAX_BEYOND_VALUES else None
    cells = refine**2 * wide.size
    if cells > MAX_CELLS or cells * array.size > MAX_VALUES:
        return None
    fine = grid_blur(kernel, wide, refine)
    felt = fine.forward(np.eye(cells).reshape(-1, *fine.surface_shape))[:, *taxels].reshape(cells, -1).T
    own = tuple(slice(refine * each.start, refine * each.stop) for each in taxels)
    return Wide(_raster_blur(kernel, fine.surface_shape, array.pitch / refine), own, felt)


def _around(kernel: Kernel, array: Array, pitch: float, beyond: list[int]) -> Wide | None:
    """Lay it around taxels that are no grid; their cells' means are what is shown of it."""
    cells, side = tiling(array), pitch / CELLS_A_PITCH
    above, below, left, right = (each * pitch for each in beyond)
    low, high = array.positions.min(axis=0) - pitch / 2, array.positions.max(axis=0) + pitch / 2
    size = high - low + [left + right, above + below]
    columns, rows = (max(int(np.ceil(each / side - 0.01)), 1) for each in size)
    if rows * columns > MAX_CELLS or rows * columns * array.size > MAX_VALUES:
        return None
    corner = low - [left, above] - (np.array([columns, rows]) * side - size) / 2
    felt = cached(tiled, kernel, array, raster(corner, (rows, columns), side, PARTS))
    last = columns - 1, rows - 1
    column, row = np.clip((cells.pieces - corner) / side, 0, last).astype(int).T
    shown = np.zeros((array.size, rows * columns))
    np.add.at(shown, (cells.owner, row * columns + column), 1)
    shown /= shown.sum(axis=1, keepdims=True)
    return Wide(_raster_blur(kernel, (rows, columns), side), (slice(rows), slice(columns)), felt, shown)


def _raster_blur(kernel: Kernel, shape: tuple[int, ...], side: float) -> GridBlur:
    """Give the blur of a grid with a taxel on every cell."""
    return grid_blur(kernel, grid(shape[0], shape[1], side, APERTURE * side))


def grid_blur(kernel: Kernel, array: Array, refine: int = 1) -> GridBlur:
    """Give the blur of a grid alone, with no surface beyond it."""
    assert array.shape is not None
    return GridBlur(partial(cached, stencil, kernel, array), array.shape, refine, array.pitch / refine)
