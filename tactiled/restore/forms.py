"""One blur in several forms, equal to rounding: which is soonest depends on its size and on the machine."""

from collections.abc import Callable
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft2, next_fast_len, rfft2

from tactiled.restore.modes import Floats

DENSE = 1 << 16  # entries up to which one matrix product usually beats several smaller ones
MOST = 16 * DENSE  # entries up to which it is worth a try
SEPARABLE = 128  # cells along a side up to which products of small matrices usually beat a transform
TRIALS = 20  # runs that a form is timed over

Array = NDArray[Any]  # float32 or float64: the result has the argument's kind
Apply = Callable[[Array], Array]
Pair = tuple[Apply, Apply]  # forward, adjoint


class Forms:
    """H x = sum rows[k] x columns[k]' as such, as one matrix if that is small, and as a transform.

    The last needs the stencil of pressure that steps from cell to cell.
    """

    def __init__(self, rows: list[Floats], columns: list[Floats], stencil: Floats | None = None) -> None:
        self._rows, self._columns = rows, columns
        self.shape = len(rows[0]), len(columns[0])
        self.surface = rows[0].shape[1], columns[0].shape[1]
        self.parts = len(rows)
        self._make: dict[str, Callable[[], Pair]] = {"separable": lambda: _separable(rows, columns)}
        if stencil is not None:
            self._make["fourier"] = lambda: _fourier(stencil, self.shape, self.surface[0] // self.shape[0])
        if self._entries <= MOST:
            self._make["dense"] = self._dense

    @property
    def names(self) -> tuple[str, ...]:
        """Those that there are."""
        return tuple(self._make)

    def make(self, name: str) -> Pair:
        """Forward and adjoint in one of the forms."""
        return self._make[name]()

    @property
    def usual(self) -> str:
        """The soonest, by size, on machines that were measured."""
        if self._entries <= DENSE:
            return "dense"
        return "fourier" if "fourier" in self._make and max(self.surface) > SEPARABLE else "separable"

    def fastest(self, clock: Callable[[], float]) -> str:
        """The one that blurs a frame and goes back soonest by a clock (s), of many runs each."""
        if len(self._make) == 1:
            return self.usual
        return min(self._make, key=lambda name: self._seconds(self.make(name), clock))

    def _seconds(self, pair: Pair, clock: Callable[[], float]) -> float:
        x, times = np.ones(self.surface, np.float32), []
        for _ in range(TRIALS):
            start = clock()
            pair[1](pair[0](x))
            times.append(clock() - start)
        return min(times)

    @property
    def _entries(self) -> int:
        return prod(self.shape) * prod(self.surface)

    def _dense(self) -> Pair:
        A = sum(np.kron(a, b) for a, b in zip(self._rows, self._columns, strict=True))
        return dense(np.asarray(A), self.shape, self.surface)


def dense(A: Floats, shape: tuple[int, ...], surface: tuple[int, ...]) -> Pair:
    """One matrix for all."""

    def apply(matrix: Floats, before: tuple[int, ...], after: tuple[int, ...]) -> Apply:
        transposed = _twice(matrix.T)

        def multiply(x: Array) -> Array:
            batch = x.shape[: x.ndim - len(before)]
            flat = x.reshape(*batch, matrix.shape[1]) @ transposed[x.dtype]
            return np.asarray(flat.reshape(*batch, *after))

        return multiply

    return apply(A, surface, shape), apply(A.T, shape, surface)


def _separable(rows: list[Floats], columns: list[Floats]) -> Pair:
    """A few products of small matrices: sum rows[k] x columns[k]'."""

    def apply(lefts: list[Floats], rights: list[Floats]) -> Apply:
        left, right = _twice(np.concatenate(lefts, axis=1)), _twice(np.stack(rights))

        def multiply(x: Array) -> Array:
            across = x[..., None, :, :] @ right[x.dtype]
            stacked = across.reshape(*x.shape[:-2], -1, across.shape[-1])
            return np.asarray(left[x.dtype] @ stacked)

        return multiply

    return apply(rows, [B.T for B in columns]), apply([A.T for A in rows], columns)


def _fourier(stencil: Floats, shape: tuple[int, ...], refine: int) -> Pair:
    """Padded transforms, their spectrum planned once."""
    surface = (refine * shape[0], refine * shape[1])
    size = [next_fast_len(n + length - 1, real=True) for n, length in zip(surface, stencil.shape, strict=True)]
    there = rfft2(stencil[::-1, ::-1], size)
    back = rfft2(stencil, size)
    spectra = {np.dtype(np.float32): np.complex64, np.dtype(np.float64): np.complex128}
    seen = tuple(slice(n - 1, n - 1 + n, refine) for n in surface)
    # The adjoint starts from taxels spread out to cells, and its stencil is not turned.
    first = tuple(refine * (n - 1) for n in shape)
    cells = tuple(slice(start, start + n) for start, n in zip(first, surface, strict=True))

    def forward(x: Array) -> Array:
        full = irfft2(rfft2(x, size) * there.astype(spectra[x.dtype]), size)
        return np.ascontiguousarray(full[..., seen[0], seen[1]])

    def adjoint(y: Array) -> Array:
        spread = np.zeros((*y.shape[:-2], *surface), y.dtype)
        spread[..., ::refine, ::refine] = y
        full = irfft2(rfft2(spread, size) * back.astype(spectra[y.dtype]), size)
        return np.ascontiguousarray(full[..., cells[0], cells[1]])

    return forward, adjoint


def _twice(matrix: Floats) -> dict[np.dtype[Any], Array]:
    return {np.dtype(kind): np.ascontiguousarray(matrix, kind) for kind in (np.float32, np.float64)}
