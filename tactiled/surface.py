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
CELLS_A_PITCH = 1.5  # where the taxels are no grid
MAX_CELLS, MAX_VALUES = 4096, 1 << 20  # of a surface with taxels elsewhere: it, and times the taxels


def make(kernel: Kernel, array: Array, refine: int) -> Wide | None:
    """Lay the surface around an array; None where it has too many cells, or too little area, for that."""
    beyond = THIN_BEYOND if kernel.stack.depth < THIN_PITCHES * spacing(array) else BEYOND
    if array.shape is None:
        return _around(kernel, array, beyond)
    rows, columns = (n + 2 * beyond for n in array.shape)
    own = tuple(slice(refine * beyond, refine * (beyond + n)) for n in array.shape)
    if refine == 1:
        return Wide(_grid_blur(kernel, grid(rows, columns, array.pitch, array.width, array.aperture)), own)
    cells = refine**2 * rows * columns
    if cells > MAX_CELLS or cells * array.size > MAX_VALUES:
        return None
    wide = grid(rows, columns, array.pitch, array.width, array.aperture)
    fine = _grid_blur(kernel, wide, refine)
    each = np.eye(cells).reshape(-1, *fine.surface_shape)
    taxels = slice(beyond, beyond + array.shape[0]), slice(beyond, beyond + array.shape[1])
    felt = fine.forward(each)[:, *taxels].reshape(cells, -1).T
    return Wide(_raster_blur(kernel, fine.surface_shape, array.pitch / refine), own, felt)


def _around(kernel: Kernel, array: Array, beyond: int) -> Wide | None:
    """Lay it around taxels that are no grid; their cells' means are what is shown of it."""
    pitch, low = spacing(array), array.positions.min(axis=0)
    side = pitch / CELLS_A_PITCH
    size = np.ptp(array.positions, axis=0) + 2 * beyond * pitch + pitch
    columns, rows = (max(int(np.ceil(each / side)), 1) for each in size)
    if rows * columns > MAX_CELLS or rows * columns * array.size > MAX_VALUES:
        return None
    middle = low + np.ptp(array.positions, axis=0) / 2
    corner = middle - np.array([columns, rows]) * side / 2
    felt = cached(tiled, kernel, array, raster(corner, (rows, columns), side, PARTS))
    cells = tiling(array)
    column, row = ((cells.pieces - corner) / side).astype(int).T
    shown = np.zeros((cells.owner.max() + 1, rows * columns))
    np.add.at(shown, (cells.owner, row * columns + column), 1)
    shown /= shown.sum(axis=1, keepdims=True)
    return Wide(_raster_blur(kernel, (rows, columns), side), (slice(rows), slice(columns)), felt, shown)


def _raster_blur(kernel: Kernel, shape: tuple[int, ...], side: float) -> GridBlur:
    """Give the blur of a grid with a taxel on every cell."""
    return _grid_blur(kernel, grid(shape[0], shape[1], side, APERTURE * side))


def _grid_blur(kernel: Kernel, array: Array, refine: int = 1) -> GridBlur:
    assert array.shape is not None
    return GridBlur(partial(cached, stencil, kernel, array), array.shape, refine, array.pitch / refine)
