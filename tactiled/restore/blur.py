"""The blur H of a cover, from surface pressure to taxels and back: for a grid, or for any layout."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline

from tactiled.arrays import Floats, Floats32
from tactiled.restore.aliasing import Aliasing
from tactiled.restore.modes import Modes, SumOfProducts, grid_modes, matrix_modes
from tactiled.restore.point_response import PointResponse

RANK_TOLERANCE = 1e-7  # of the largest separable part: float32 loses smaller ones anyway
MODES_RANK_TOLERANCE = 1e-4  # of the largest part: far below what the modes themselves miss
FINE = 4  # cells along each side of a taxel, of which one is the load of a point
THICKNESS_ERROR = 0.03  # of a cover's thickness: better is hardly known without a calibration

Array = NDArray[Any]  # float32 or float64: the result has the argument's kind
Apply = Callable[[Array], Array]
Stencil = Callable[[int], Floats]  # k -> response (k (2R-1), k (2C-1)) to cells k times finer than the pitch


class Blur:
    """H: surface image, of rows and columns, to frame, (R, C) or (N,); both take leading batch axes."""

    frame_shape: tuple[int, ...]
    surface_shape: tuple[int, ...]
    refine: int  # cells along the distance between taxels
    cell_mm: float
    taxel: NDArray[np.int64]  # of the surface's shape: the nearest taxel; -1 where none feels the cell
    forward: Apply  # H x
    adjoint: Apply  # H' y
    thickness_error: float = THICKNESS_ERROR  # relative standard deviation of the cover's thickness
    wide: "Wide | None" = None  # where the surface goes on beyond the taxels, or has finer cells

    @cached_property
    def modes(self) -> Modes:
        """The patterns that the blur only weakens."""
        raise NotImplementedError

    def forward_in_modes(self) -> SumOfProducts | None:
        """Give x -> U' H x, what the taxels feel without the error of `modes`; None where these have none."""
        return None

    @cached_property
    def response(self) -> PointResponse | None:
        """What a small load anywhere is to the taxels; None where there is no grid."""
        return None

    @cached_property
    def aliasing(self) -> Aliasing | None:
        """What pressure finer than the grid does to the taxels; None where cells are finer or there is no grid."""
        return None

    @cached_property
    def reach(self) -> Floats32:
        """H' 1: how much of each surface cell's pressure the taxels get to feel."""
        return np.asarray(self.adjoint(np.ones(self.frame_shape)), np.float32)


class MatrixBlur(Blur):
    """The blur of any layout by its matrix (N, R, C)."""

    def __init__(self, matrix: Floats, cell_mm: float, refine: int, taxel: NDArray[np.int64]) -> None:
        self.frame_shape, self.surface_shape = (len(matrix),), matrix.shape[1:]
        self.cell_mm, self.refine, self.taxel = cell_mm, refine, taxel
        self._matrix = matrix.reshape(len(matrix), -1)
        forward, adjoint = _product(self._matrix.T), _product(self._matrix)
        self.forward = lambda x: forward(x.reshape(*x.shape[:-2], -1))
        self.adjoint = lambda y: adjoint(y).reshape(*y.shape[:-1], *self.surface_shape)

    def __reduce__(self) -> Any:
        matrix = self._matrix.reshape(-1, *self.surface_shape)
        state = {"thickness_error": self.thickness_error, "wide": self.wide}
        return MatrixBlur, (matrix, self.cell_mm, self.refine, self.taxel), state

    @cached_property
    def modes(self) -> Modes:
        """The matrix's singular vectors."""
        return matrix_modes(self._matrix)


class GridBlur(Blur):
    """The blur of a grid, H x = sum rows[k] x columns[k]', of pressure that is smooth between the cells.

    An image holds the cells' means; loads smaller than a cell are known, too.
    """

    def __init__(self, stencil: Stencil, shape: tuple[int, int], refine: int = 1, cell_mm: float = 1.0) -> None:
        self.frame_shape, self.surface_shape = shape, (refine * shape[0], refine * shape[1])
        self.cell_mm, self.refine = cell_mm, refine
        self.taxel = np.arange(prod(shape)).reshape(shape).repeat(refine, 0).repeat(refine, 1)
        self._stencil, self._shape = cache(stencil), shape
        self._rows, self._columns = _smooth_parts(self._stencil, shape, refine)
        self.forward = _sum_of_products(self._rows, [B.T for B in self._columns])
        self.adjoint = _sum_of_products([A.T for A in self._rows], self._columns)

    def __reduce__(self) -> Any:
        arguments = self._stencil.__wrapped__, self._shape, self.refine, self.cell_mm
        state = {"thickness_error": self.thickness_error, "wide": self.wide}
        return GridBlur, arguments, state

    @cached_property
    def modes(self) -> Modes:
        """Products of the modes along either axis: a step's own, whose gain falls with frequency."""
        step, (rows, columns) = self._stencil(self.refine), self._shape
        marginals = _slide(step.sum(1), rows, self.refine), _slide(step.sum(0), columns, self.refine)
        return grid_modes(self._rows, self._columns, *marginals)

    def forward_in_modes(self) -> SumOfProducts | None:
        """Give x -> U' H x, what the taxels feel without the error of `modes`."""
        Uy, Ux = self.modes.taxel
        parts = [(Uy.T @ A, B.T @ Ux) for A, B in zip(self._rows, self._columns, strict=True)]
        size = [float(np.linalg.norm(A) * np.linalg.norm(B)) for A, B in parts]
        large = [part for part, each in zip(parts, size, strict=True) if each > MODES_RANK_TOLERANCE * max(size)]
        return SumOfProducts(*(list(each) for each in zip(*large, strict=True)))

    @cached_property
    def response(self) -> PointResponse | None:
        """What a small load anywhere is to the taxels."""
        return PointResponse(self._stencil(FINE), self._shape, FINE)

    @cached_property
    def aliasing(self) -> Aliasing | None:
        """What pressure finer than the grid does to the taxels; None where cells are finer."""
        return Aliasing(self._stencil(FINE), self._shape, FINE) if self.refine == 1 else None


@dataclass(frozen=True, slots=True, eq=False)
class Wide:
    """The surface that an array's frames are restored on: a raster of square cells, with a taxel on each."""

    blur: GridBlur
    own: tuple[slice, ...]  # the cells that are the array's
    felt: Floats | None = None
    """(N, R C): what each of its taxels feels of every cell; None: they are the taxels on its cells."""

    def forward(self, wide: Array) -> Array:
        """Give what the array's taxels feel of an image of all cells (R, C): (N,) or of a grid's shape."""
        if self.felt is None:
            return self.blur.forward(wide)[self.own]
        return self.felt.astype(wide.dtype) @ wide.reshape(-1)


def _product(right: Floats) -> Apply:
    """Give x -> x right, in x's own precision."""
    rights = in_both_precisions(right)
    return lambda x: np.asarray(x @ rights[x.dtype])


def _sum_of_products(a: list[Floats], b: list[Floats]) -> Apply:
    """Give x -> sum a[k] x b[k], in x's own precision."""
    lefts, rights = in_both_precisions(np.concatenate(a, axis=1)), in_both_precisions(np.stack(b))

    def apply(x: Array) -> Array:
        across = x[..., None, :, :] @ rights[x.dtype]
        stacked = across.reshape(*x.shape[:-2], -1, across.shape[-1])
        return np.asarray(lefts[x.dtype] @ stacked)

    return apply


def in_both_precisions(matrix: Floats) -> dict[np.dtype[Any], Array]:
    """Give a matrix by the kind of what it is multiplied with."""
    return {np.dtype(kind): np.ascontiguousarray(matrix, kind) for kind in (np.float32, np.float64)}


def _smooth_parts(stencil: Stencil, shape: tuple[int, int], refine: int) -> tuple[list[Floats], list[Floats]]:
    """Split the response to pressure that is smooth between cells into separable parts: rows and columns."""
    parts = max(FINE // refine, 2)
    U, s, Vt = np.linalg.svd(np.asarray(stencil(refine * parts), float), full_matrices=False)
    rank = max(1, int(np.count_nonzero(s > RANK_TOLERANCE * s[0])))
    down, across = (_between(refine * n, parts) for n in shape)
    rows = [_slide(U[:, k] * s[k], shape[0], refine * parts) @ down for k in range(rank)]
    return rows, [_slide(Vt[k], shape[1], refine * parts) @ across for k in range(rank)]


def _slide(line: Floats, n: int, refine: int) -> Floats:
    """Give (n, k n): row i is `line` from k (n - 1 - i) on, as taxel i sees the cells."""
    starts = refine * (n - 1 - np.arange(n))
    return np.asarray(line[starts[:, None] + np.arange(refine * n)])


def _between(n: int, parts: int) -> Floats:
    """Give (parts n, n): means over each cell's `parts` of the parabolic spline that has the n cells' means."""
    sums = np.vstack([np.zeros(n), np.cumsum(np.eye(n), axis=0)])
    integral = make_interp_spline(np.arange(n + 1.0), sums, bc_type="natural")
    return np.asarray(parts * np.diff(integral(np.arange(parts * n + 1) / parts), axis=0))
