"""The blur's own modes: patterns that it passes on unchanged but for a gain.

A circularly symmetric blur with nothing outside the array is all but diagonal in products of the singular vectors
of its marginal along each axis (within 1 % of its norm at t/pitch 0.5 to 3), and its true boundary comes along.
Two small matrix products on either side then replace a padded Fourier transform.
"""

from dataclasses import dataclass
from types import EllipsisType

import numpy as np

from tactiled.arrays import Floats, Floats32
from tactiled.core import coefficients

DEPTHS = np.linspace(0, 40, 2001)  # over the wavelength, times 2 pi
HALF_SPACE = (1 + DEPTHS) * np.exp(-DEPTHS)  # gain, by Boussinesq


class Transform:
    """x -> left x right for frames (m, n), or x -> left x for vectors (m,)."""

    def __init__(self, bases: tuple[Floats, ...]) -> None:
        self.left = np.ascontiguousarray(bases[0], np.float32)
        self.right = np.ascontiguousarray(bases[1].T if len(bases) == 2 else np.eye(1), np.float32)
        self.shape = tuple(len(basis) for basis in bases)

    def __call__(self, x: Floats32, out: Floats32) -> Floats32:
        """Fill `out` and return it; float32, C-contiguous."""
        if len(self.shape) == 1:
            self.left.dot(x, out)
        else:
            coefficients.transform(self.left, x, self.right, out)
        return out

    def empty(self) -> Floats32:
        """Give a buffer for the result."""
        return np.empty(self.shape, np.float32)


class SumOfProducts:
    """x -> sum lefts[k] x rights[k] for images x (m, n), by two products of matrices, on buffers of its own."""

    def __init__(self, lefts: list[Floats], rights: list[Floats]) -> None:
        # Row i of every left beside row i of the others: the second product then sums over k.
        self._lefts = np.ascontiguousarray(np.stack(lefts, axis=1), np.float32).reshape(-1, lefts[0].shape[1])
        self._rights = np.concatenate(rights).astype(np.float32)
        self._between = np.empty((len(self._lefts), rights[0].shape[0]), np.float32)
        self._stacked = self._between.reshape(len(lefts[0]), -1)

    def __call__(self, x: Floats32, out: Floats32) -> Floats32:
        """Fill `out` and return it; float32, C-contiguous."""
        self._lefts.dot(x, self._between)
        self._stacked.dot(self._rights, out)
        return out


@dataclass(frozen=True, slots=True, eq=False)
class Modes:
    """H ~ U diag(gain) V': taxel modes U, surface modes V, both orthonormal and complete, smoothest first."""

    gain: Floats  # taxel modes' shape: what a surface mode loses on its way to the taxels
    frequency: Floats  # surface modes' shape, cycles per surface cell, 0 for the mean
    taxel: tuple[Floats, ...]  # U: one orthonormal basis (n, modes) an axis
    surface: tuple[Floats, ...]  # V: the same for the surface

    @property
    def head(self) -> tuple[EllipsisType | slice, ...]:
        """Where among the surface's modes, the last axes, those are that the taxels can see."""
        return ..., *(slice(n) for n in self.gain.shape)

    def gain_variance(self, thickness_variance: float) -> Floats:
        """Variance of every gain under a cover whose thickness has a relative `thickness_variance`.

        As in a half-space: h = (1 + kt) e^-kt, dh / d(ln t) = -(kt)^2 e^-kt. Rubber on a board is within a quarter
        where h is below 0.7.
        """
        kt = np.interp(self.gain, HALF_SPACE[::-1], DEPTHS[::-1])
        return np.asarray(thickness_variance * (kt**2 * np.exp(-kt)) ** 2)

    def to_taxel_modes(self) -> Transform:
        """U': a frame to its coefficients."""
        return Transform(tuple(basis.T for basis in self.taxel))

    def to_taxels(self) -> Transform:
        """U: coefficients to a frame."""
        return Transform(self.taxel)

    def to_surface_modes(self) -> Transform:
        """V': a surface image to all its coefficients."""
        return Transform(tuple(basis.T for basis in self.surface))

    def to_surface(self) -> Transform:
        """V: all coefficients to a surface image."""
        return Transform(self.surface)

    def head_to_surface(self) -> Transform:
        """V: the coefficients that the taxels can see to a surface image."""
        return Transform(tuple(basis[:, :n] for basis, n in zip(self.surface, self.gain.shape, strict=True)))


def grid_modes(rows: list[Floats], columns: list[Floats], stencil_rows: Floats, stencil_columns: Floats) -> Modes:
    """Give the modes of sum_k rows[k] x columns[k]' from the blur's marginals along each axis (n, k n)."""
    Uy, Vy = _axis(stencil_rows)
    Ux, Vx = _axis(stencil_columns)
    gain = np.zeros((len(Uy), len(Ux)))
    for A, B in zip(rows, columns, strict=True):
        down, across = (((U.T @ part) * V[:, : len(U)].T).sum(axis=1) for U, part, V in ((Uy, A, Vy), (Ux, B, Vx)))
        gain += np.outer(down, across)
    y, x = (np.arange(len(V)) / (2 * len(V)) for V in (Vy, Vx))
    return Modes(gain, np.hypot(y[:, None], x), (Uy, Ux), (Vy, Vx))


def matrix_modes(matrix: Floats) -> Modes:
    """Give the modes that taxels of any layout feel, of its matrix (N, M); nothing is known of their frequency."""
    U, gain, Vt = np.linalg.svd(matrix, full_matrices=False)
    return Modes(gain, np.full(len(gain), np.nan), (U,), (Vt.T,))


def _axis(marginal: Floats) -> tuple[Floats, Floats]:
    U, _, Vt = np.linalg.svd(marginal)
    return U, Vt.T
