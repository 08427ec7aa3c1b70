"""From surface pressure to taxels and back: the blur, exact to rounding, for a grid or for any layout."""

from collections.abc import Callable
from functools import cache, cached_property

import numpy as np
from scipy.interpolate import make_interp_spline

from tactiled.errors import PhysicsError
from tactiled.restore.aliases import Aliases
from tactiled.restore.forms import Array, Forms, Pair, dense
from tactiled.restore.loads import Loads
from tactiled.restore.modes import Floats, Image, Modes, grid_modes, matrix_modes

ROUNDING = 1e-7  # of the largest: a separable part below this is lost in float32 anyway
FINE = 4  # cells along each side of a taxel, of which one is the load of a point


class Blur:
    """H: surface image, (k R, k C) or (M,), to frame, (R, C) or (N,); both methods take leading batch axes."""

    def __init__(
        self,
        shapes: tuple[tuple[int, ...], tuple[int, ...]],
        cell_mm: float,
        pair: Pair,
        modes: Callable[[], Modes],
        loads: Callable[[], Loads] | None = None,
        cut: Callable[[tuple[int, int]], "Blur"] | None = None,
        aliases: Callable[[], Aliases | None] | None = None,
    ) -> None:
        self.frame_shape, self.surface_shape = shapes
        self.cell_mm = cell_mm
        self._forward, self._adjoint = pair
        self._modes, self._loads, self._cut, self._aliases = modes, loads, cut, aliases

    @classmethod
    def grid(
        cls,
        stencil: Floats,
        shape: tuple[int, int],
        refine: int = 1,
        cell_mm: float = 1.0,
        pick: Callable[[Forms], str] | None = None,
        finer: Callable[[int], Floats] | None = None,
    ) -> "Blur":
        """Make the blur of a grid from the cover's stencil (k (2R-1), k (2C-1)) in the form that `pick` names.

        Without it the form follows from the size. `finer` gives the stencil for any other k: pressure is
        then smooth between the cells, whose means the image holds, and loads smaller than a cell are known;
        without it, pressure steps from cell to cell. PhysicsError where stencil and shape disagree.
        """
        expected = tuple(refine * (2 * n - 1) for n in shape)
        if stencil.shape != expected or not np.isfinite(stencil).all():
            raise PhysicsError(f"stencil of shape {stencil.shape} for a grid of {shape}: give finite {expected}")
        # A step's own modes in either case: what they are sorted by, its gain, falls with frequency.
        marginals = _slide(stencil.sum(1), shape[0], refine), _slide(stencil.sum(0), shape[1], refine)
        surface = (refine * shape[0], refine * shape[1])
        if finer is None:
            rows, columns = _terms(np.asarray(stencil, float), shape, refine)
            forms = Forms(rows, columns, stencil)
        else:
            finer = cache(finer)
            rows, columns = _smooth(finer, shape, refine)
            forms = Forms(rows, columns)
        pair = forms.make(pick(forms) if pick else forms.usual)

        def loads() -> Loads:
            return Loads(finer(FINE), shape, FINE) if finer else Loads(stencil, shape, refine)

        def cut(part: tuple[int, int]) -> Blur:
            less = (lambda k: _middle(finer(k), part, k)) if finer else None
            return cls.grid(_middle(stencil, part, refine), part, refine, cell_mm, pick, less)

        def modes() -> Modes:
            return grid_modes(rows, columns, *marginals)

        def aliases() -> Aliases | None:
            return Aliases(finer(FINE), shape, FINE) if finer and refine == 1 else None

        return cls((shape, surface), cell_mm, pair, modes, loads, cut, aliases)

    @classmethod
    def matrix(cls, A: Floats, cell_mm: float = 1.0) -> "Blur":
        """Make the blur of any layout from its matrix (N, M); PhysicsError where it is none."""
        if A.ndim != 2 or not A.size or not np.isfinite(A).all():
            raise PhysicsError(f"blur matrix of shape {A.shape}: give finite (taxels, cells)")
        shapes = (len(A),), (A.shape[1],)
        return cls(shapes, cell_mm, dense(A, *shapes), lambda: matrix_modes(A))

    @cached_property
    def modes(self) -> Modes:
        """The patterns that the blur only weakens."""
        return self._modes()

    @cached_property
    def loads(self) -> Loads | None:
        """What a small load anywhere is to the taxels; None where there is no grid."""
        return self._loads() if self._loads else None

    def cut(self, shape: tuple[int, int]) -> "Blur":
        """Make the blur of fewer taxels, of `shape`, under the same cover; PhysicsError where this is no grid."""
        if self._cut is None or any(n > m for n, m in zip(shape, self.frame_shape, strict=True)):
            raise PhysicsError(f"no {shape} taxels to cut out of {self.frame_shape}: cut less out of a grid")
        return self._cut(shape)

    @cached_property
    def aliases(self) -> Aliases | None:
        """What pressure finer than the grid does to the taxels; None where cells are finer or no grid is known."""
        return self._aliases() if self._aliases else None

    def forward(self, x: Array) -> Array:
        """H x, in x's own precision."""
        return self._forward(x)

    def adjoint(self, y: Array) -> Array:
        """H' y, in y's own precision."""
        return self._adjoint(y)

    @cached_property
    def reach(self) -> Image:
        """H' 1: how much of each surface cell's pressure the taxels get to feel."""
        return np.asarray(self._adjoint(np.ones(self.frame_shape)), np.float32)


def _middle(stencil: Floats, shape: tuple[int, int], refine: int) -> Floats:
    """The middle of a stencil, as long as a grid of `shape` needs it."""
    lengths = [refine * (2 * n - 1) for n in shape]
    starts = [(length - n) // 2 for length, n in zip(stencil.shape, lengths, strict=True)]
    rows, columns = (slice(start, start + n) for start, n in zip(starts, lengths, strict=True))
    return stencil[rows, columns]


def _slide(line: Floats, n: int, refine: int) -> Floats:
    """Give (n, k n): row i is `line` from k (n - 1 - i) on, as taxel i sees the cells."""
    starts = refine * (n - 1 - np.arange(n))
    return np.asarray(line[starts[:, None] + np.arange(refine * n)])


def _terms(stencil: Floats, shape: tuple[int, int], refine: int) -> tuple[list[Floats], list[Floats]]:
    """Split the stencil into separable parts: H x = sum rows[k] x columns[k]'."""
    U, s, Vt = np.linalg.svd(stencil)
    parts = range(max(1, int(np.count_nonzero(s > ROUNDING * s[0]))))
    rows = [_slide(U[:, k] * s[k], shape[0], refine) for k in parts]
    return rows, [_slide(Vt[k], shape[1], refine) for k in parts]


def _smooth(
    finer: Callable[[int], Floats], shape: tuple[int, int], refine: int
) -> tuple[list[Floats], list[Floats]]:
    """Give the separable parts of pressure that is smooth between cells."""
    parts = max(FINE // refine, 2)
    rows, columns = _terms(np.asarray(finer(refine * parts), float), shape, refine * parts)
    down, across = (_between(refine * n, parts) for n in shape)
    return [A @ down for A in rows], [B @ across for B in columns]


def _between(n: int, parts: int) -> Floats:
    """Give (parts n, n): means over each cell's `parts` of the parabolic spline that has the n cells' means."""
    sums = np.vstack([np.zeros(n), np.cumsum(np.eye(n), axis=0)])
    integral = make_interp_spline(np.arange(n + 1.0), sums, bc_type="natural")
    return np.asarray(parts * np.diff(integral(np.arange(parts * n + 1) / parts), axis=0))
