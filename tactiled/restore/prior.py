"""How rough is this scene? Its spectrum, picked by likelihood from the frame, ties regularisation to the noise.

A surface mode of frequency q is taken to be normal with variance S(q) = A / (1 + (q/q0)^2)^p, so a taxel mode has
variance h^2 S + sigma^2. Of a fixed family of (A, q0, p) the most likely one is taken, from the power of the taxel
modes pooled in blocks: a small matrix product a frame, and no cross-validation that small arrays mislead.
"""

from collections.abc import Callable
from dataclasses import dataclass
from hashlib import sha256
from itertools import product
from typing import Any, Generic, TypeVar
from weakref import WeakValueDictionary

import numpy as np
from numpy.typing import NDArray

from tactiled.arrays import Floats, Floats32
from tactiled.core import coefficients
from tactiled.restore.modes import Modes, Transform

# The family was chosen on the scenes of `python -m tests.bench judge --family first`.
CORNERS = (0.02, 0.06, 0.2, 0.6)  # q0, cycles a cell: from one wide press to points
POWERS = (1.25, 1.75)  # p, on either side of 1.5, the fall of a sharp edge in the plane
LEVELS = 4.0 ** np.arange(-2, 19)  # A over the noise's variance: from no signal to noise of 1e-4 of it all
MAX_KEPT = 256  # things of one kind: more than there are spectra
MAX_KEPT_VALUES = 1 << 24  # of all matrices of one kind that are kept: 64 MB
MAX_AMPLIFICATION = 100.0  # a filter that amplifies more leans on gains under 1 %, which no cover's model knows


@dataclass(frozen=True, slots=True, eq=False)
class Spectrum:
    """One of the family, S over the noise's variance."""

    level: float  # A
    shape: Floats  # of every surface mode, 1 at no frequency
    corner: float  # q0, cycles a cell
    power: float  # p

    @property
    def ratio(self) -> Floats:
        """S over the noise's variance, for every surface mode."""
        return np.asarray(self.level * self.shape)

    def fall(self, q: Floats) -> Floats:
        """S at any frequency q (cycles a cell) over what it is at none."""
        return np.asarray((1 + (q / self.corner) ** 2) ** -self.power)


T = TypeVar("T")


class Kept(Generic[T]):
    """What is made of spectra for arrays that are alike, whatever their noise; any thread."""

    def __init__(self) -> None:
        self._made: dict[tuple[float, float, float, bytes], tuple[T, int]] = {}  # with its numbers

    def __len__(self) -> int:
        """Of how many spectra it has something."""
        return len(self._made)

    def __call__(self, spectrum: Spectrum, make: Callable[[], T], values: int = 0, of: bytes = b"") -> T:
        """Give what was made of a spectrum, and `of` something else, or make it, of so many numbers.

        Where room ends, what was made, or with `of` used, longest ago goes.
        """
        key = spectrum.level, spectrum.corner, spectrum.power, of
        if (kept := self._made.get(key)) is not None:
            if of:
                self._made.pop(key, None)
                self._made[key] = kept
            return kept[0]
        made = make()
        held = [*self._made.items()]
        total = values + sum(size for _, (_, size) in held)
        for oldest, (_, size) in held:
            if len(self._made) < MAX_KEPT and total <= MAX_KEPT_VALUES:
                break
            self._made.pop(oldest, None)
            total -= size
        self._made[key] = made, values
        return made


_STORES: WeakValueDictionary[bytes, Kept[Any]] = WeakValueDictionary()  # of the arrays in use


def kept(kind: str, *arrays: NDArray[Any]) -> Kept[Any]:
    """Give the store of one kind for all arrays that have these numbers."""
    hashed = sha256(kind.encode())
    for each in arrays:
        hashed.update(f"{each.dtype}{each.shape}".encode())
        hashed.update(np.ascontiguousarray(each).tobytes())
    return _STORES.setdefault(hashed.digest(), Kept())


class Prior:
    """The family of spectra for one blur and one noise."""

    def __init__(
        self,
        modes: Modes,
        noise: float,
        bases: tuple[Floats, ...],
        variances: Callable[[Floats], Floats],
        amplifications: Callable[[Floats], Floats],
    ) -> None:
        """Give the surface's modes; the rest is as in Kriging."""
        self._analyse = Transform(tuple(basis.T for basis in bases))
        own_shape = self._analyse.shape
        self._first = [_half_octaves(n) for n in own_shape]
        count = self._pool(np.ones((1, *own_shape)))
        kept: list[tuple[float, int, Spectrum, Floats]] = []
        for at, (q0, p) in enumerate(product(CORNERS, POWERS)):
            shape = (1 + (modes.frequency / q0) ** 2) ** -p
            ratios = LEVELS[:, None, None] * shape
            levels = LEVELS[amplifications(ratios) <= MAX_AMPLIFICATION]
            if not (at or len(levels)):
                levels = LEVELS[:1]  # one is kept in any case
            v = noise**2 * variances(ratios[: len(levels)])  # amplification rises with the level
            # The logarithms ride along as one more block, whose power is always 1.
            logarithms = np.log(v).reshape(len(v), -1).sum(axis=1, keepdims=True)
            costs = np.hstack([(self._pool(1 / v) / count).reshape(len(v), -1), logarithms])
            kept += (
                (level, at, Spectrum(level, shape, q0, p), cost) for level, cost in zip(levels, costs, strict=True)
            )
        kept.sort(key=lambda each: each[:2])
        self.spectra = [each[2] for each in kept]  # their levels rise
        self._costs = np.array([each[3] for each in kept], np.float32)
        self._blocks = self._first[0], self._first[1] if len(own_shape) == 2 else np.zeros(1, np.int64)

    def _pool(self, values: Floats) -> Floats:
        # Not by a matrix product: BLAS kernels may raise floating-point flags from lanes that they then discard.
        for axis, first in enumerate(self._first, start=1):
            values = np.add.reduceat(values, first, axis=axis)
        return np.asarray(values, float)

    def pick(self, y: Floats32) -> Spectrum:
        """Give the most likely spectrum for a frame without gaps."""
        analyse, (rows, columns), frame = self._analyse, self._blocks, y.reshape(len(y), -1)
        return self.spectra[coefficients.likeliest(analyse.left, frame, analyse.right, rows, columns, self._costs)]


def _half_octaves(n: int) -> NDArray[np.int64]:
    """Where blocks of half an octave of n modes begin."""
    edges = [0, 1, 2, 3]
    while edges[-1] < n:
        edges.append(edges[-2] * 2)
    return np.array([edge for edge in edges if edge < n])
