"""The surface that an array is restored on: square cells on a raster that reaches beyond the taxels."""

from functools import partial

import numpy as np

from tactiled.cover.kernel import Kernel
from tactiled.cover.operator import cached, stencil, surface_matrix
from tactiled.cover.stack import Stack
from tactiled.cover.tangential import responses
from tactiled.errors import ConfigError
from tactiled.geometry import Array, Raster, grid, raster, spacing
from tactiled.restore.blur import Blur, GridBlur, MatrixBlur, Wide
from tactiled.restore.traction import Coupled

BEYOND = 2  # pitches that the surface reaches beyond the taxels: with 3 or 4 errors grow again
THIN_BEYOND, THIN_PITCHES = 1, 0.75  # the same under a cover that is thinner than so many pitches
APERTURE = 0.8  # of a cell: what the model has on each where the taxels are elsewhere, as in training
CELLS_A_PITCH = 2  # where the taxels are no grid
MIN_THICKNESSES = 3.0  # of the cover, along a skin's shorter side, from which on pressure is told from shear there
MAX_BEYOND_VALUES = 1 << 22  # of a grid: taxels beyond it times its own, as 64 x 64 have
MAX_CELLS, MAX_VALUES = 4096, 1 << 20  # of a surface with taxels elsewhere: it, and times the taxels
MAX_LAYOUT_CELLS, MAX_LAYOUT_VALUES = 1 << 14, 1 << 22  # the same of a layout: it takes seconds to solve


def cells_a_pitch(array: Array, refine: int | None) -> int:
    """Give how many cells an image has along the distance between taxels: `refine`, or by need.

    ConfigError where the surface of a layout has more cells than can be restored.
    """
    if array.shape is not None:
        return refine or 1
    k = refine or CELLS_A_PITCH
    cells = _surface_cells(array, k)
    if refine is None and (cells > MAX_CELLS or cells * array.size > MAX_VALUES):
        k, cells = 1, _surface_cells(array, 1)
    most = min(MAX_LAYOUT_CELLS, MAX_LAYOUT_VALUES // array.size)
    if cells > most:
        width, height = np.ptp(array.positions, axis=0)
        raise ConfigError(
            f"refine = {k}: {array.size} taxels over {width:g} x {height:g} mm have a surface of {cells} cells: "
            f"at most {most}: give a smaller refine, or split the array into several sensors"
        )
    return k


def _surface_cells(array: Array, refine: int) -> int:
    """Cells of a layout's surface with all that may lie beyond."""
    rows, columns = raster(array, refine).shape
    return (rows + 2 * BEYOND * refine) * (columns + 2 * BEYOND * refine)


def make(kernel: Kernel, array: Array, refine: int) -> Blur:
    """Make the operator from the cells of an array's image to its taxels, `refine` of them a pitch."""
    pitch = spacing(array)
    most = THIN_BEYOND if kernel.stack.depth < THIN_PITCHES * pitch else BEYOND
    beyond = [
        most if array.beyond is None else min(most, round(side / pitch)) for side in array.beyond or (0,) * 4
    ]
    if array.shape is None:
        return _around(kernel, array, refine, beyond)
    blur = grid_blur(kernel, array, refine)
    blur.wide = _beyond(kernel, array, refine, beyond)
    return blur


def coupled(stack: Stack, blur: Blur, array: Array) -> Coupled:
    """Give what taxels feel of pressure and tangential load on the surface that `blur` restores, by flat layers.

    PhysicsError where a layer slides.
    """
    image, pitch = raster(array, blur.refine), spacing(array)
    own = blur.wide.own if blur.wide else (slice(None),) * 2
    rows, columns = (blur.wide.blur if blur.wide else blur).surface_shape
    y, x = (np.arange(n) - (each.start or 0) for n, each in zip((rows, columns), own, strict=True))
    cells = image.corner + image.side * np.column_stack([np.tile(x, rows), np.repeat(y, columns)])
    each = np.eye(rows * columns).reshape(-1, rows, columns)
    pressure = np.stack([blur.wide.forward(cell).ravel() for cell in each]) if blur.wide else blur.forward(each)
    felt = responses(stack, array, cells, image.side)
    matrix = np.block([[pressure.reshape(len(cells), -1).T, felt.tilt], [felt.apart, felt.tangential]])
    narrow = float((np.ptp(array.positions, axis=0) + pitch).min()) < MIN_THICKNESSES * stack.depth
    return Coupled(matrix, cells / pitch, (rows, columns), own, not narrow)


def _beyond(kernel: Kernel, array: Array, refine: int, sides: list[int]) -> Wide | None:
    """Lay the surface around a grid; None where it has too many cells for that, or is the grid's own."""
    assert array.shape is not None
    above, below, left, right = sides
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


def _around(kernel: Kernel, array: Array, refine: int, sides: list[int]) -> MatrixBlur:
    """Lay the surface around taxels that are no grid."""
    image = raster(array, refine)
    above, below, left, right = (refine * each for each in sides)
    taxel = np.pad(image.taxel, ((above, below), (left, right)), constant_values=-1)
    surface = Raster(image.corner - image.side * np.array([left, above]), image.side, taxel)
    felt = cached(surface_matrix, kernel, array, surface)
    rows, columns = image.shape
    own = slice(above, above + rows), slice(left, left + columns)
    blur = MatrixBlur(felt.reshape(-1, *surface.shape)[:, *own], image.side, refine, image.taxel)
    blur.wide = Wide(_raster_blur(kernel, surface.shape, image.side), own, felt)
    return blur


def _raster_blur(kernel: Kernel, shape: tuple[int, ...], side: float) -> GridBlur:
    """Give the blur of a grid with a taxel on every cell."""
    return grid_blur(kernel, grid(shape[0], shape[1], side, APERTURE * side))


def grid_blur(kernel: Kernel, array: Array, refine: int = 1) -> GridBlur:
    """Give the blur of a grid alone, with no surface beyond it."""
    assert array.shape is not None
    return GridBlur(partial(cached, stencil, kernel, array), array.shape, refine, array.pitch / refine)
