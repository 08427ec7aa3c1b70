"""What the neighbours of a taxel say of its load, whatever presses on the cover.

Pressure is never negative. So if a weighted sum of the neighbours' responses to a spot of pressure is nowhere
above the taxel's own response, the same sum of their readings is never above its reading. The weights with the
largest sum are a linear program. Under a thin cover they are small: a hole of the object may lie over the taxel.
The other way round, the least that a spot gives to the neighbours, over what it gives to the taxel, is the least
that any load does.
"""

from collections.abc import Callable, Iterator
from functools import lru_cache, partial
from typing import NamedTuple

import numpy as np
from scipy.optimize import linprog
from scipy.spatial import cKDTree

from tactiled.arrays import Floats32, Ints, Mask, Reals
from tactiled.cover.kernel import Kernel
from tactiled.cover.operator import matrix
from tactiled.geometry import Aperture, Array

REACH_PITCHES = 2.3  # of the neighbours that count: 24 on a grid
CLOSE_PITCHES, CLOSE = 1.6, 8  # of those that feel what lies on a taxel: eight on a grid
BEYOND_PITCHES = 1.5  # of the neighbours, from which a load counts
CELL_PITCHES = 0.5  # side of the squares that a load is made of
THICKNESSES = (0.9, 1.1)  # times the configured one: what is stated holds for all between
GAIN_ERROR = 0.2  # of the neighbours, part of the weights' sum that it may cost
SAME_PLACES = 6  # decimals, in pitches, to which neighbours of two taxels lie alike
SHARE = 0.5  # of the least that a load gives to the neighbours: less, and no load explains a reading
MIN_RESPONSE = 1e-4  # of a spot on a taxel over its largest one: less is no load of it

Start = Callable[[Callable[[], None]], object]  # runs a search, at once or on a thread


class _Surroundings(NamedTuple):
    """How the cover joins a taxel and its n neighbours."""

    weights: Reals  # (2, n) of a sum that is never above its own reading: of any sign, and none below 0
    close: Mask  # (n,) neighbours that feel what lies on it
    shares: Reals  # (n, M) of what M spots of pressure give to it
    share: float  # least sum over all close neighbours


class Neighbourhood:
    """Neighbours of one array's taxels; their weights are computed at the first request for a taxel."""

    def __init__(self, kernel: Kernel, array: Array, start: Start) -> None:
        """`start` runs what takes longer than a frame; until it is done nothing is known of a taxel."""
        self._kernel, self._array, self._start = kernel, array, start
        self._tree = cKDTree(array.positions)
        self._kinds: dict[bytes, int] = {}  # by how the neighbours of a taxel lie
        self._kind = np.full(array.size, -1)  # of each taxel; -1: not asked for so far
        self._near: dict[int, Ints] = {}  # neighbours (n,) of each of these
        self._joints: dict[int, _Surroundings] = {}  # of each kind
        self._searching = False
        count = min(CLOSE, array.size - 1) + 1
        distance, close = self._tree.query(array.positions, np.arange(1, count + 1))
        self._close = np.where(distance < CLOSE_PITCHES * array.pitch, close, array.size)[:, 1:]

    def peaks(self, taxels: Ints, values: Reals) -> Ints:
        """Those of `taxels` whose close neighbours all have less than SHARE of their value, of values (N,)."""
        beside = np.append(values, -np.inf)[self._close[taxels]].max(axis=1, initial=-np.inf)
        return np.asarray(taxels[beside < SHARE * values[taxels]])

    def lowest(self, taxels: Ints, load: Reals, trusted: Mask) -> Floats32:
        """Lowest loads that `taxels` may have under loads (N,) of which some are trusted; 0: any."""
        lowest = np.zeros(len(taxels), np.float32)
        for of, near, joint in self._alike(taxels):
            felt = np.where(trusted[near], load[near], 0.0) @ joint.weights.T
            unknown = ~trusted[near] @ (joint.weights < 0).T  # what is subtracted must be known
            lowest[of] = np.where(unknown, 0.0, felt).max(axis=1)
        return np.maximum(lowest, 0)

    def beside(self, taxels: Ints, values: Reals, trusted: Mask) -> tuple[Reals, Floats32]:
        """Sums (..., k) of values (..., N) over the trusted close neighbours of k taxels, and a share (k,).

        The sum of what any load gives to those is this share or more of what it gives to the taxel; 0: any.
        """
        sums, share = np.zeros((*values.shape[:-1], len(taxels)), np.float32), np.zeros(len(taxels), np.float32)
        for of, near, joint in self._alike(taxels):
            counted = trusted[near] & joint.close
            sums[..., of] = (values[..., near] * counted).sum(axis=-1)
            share[of] = joint.share
            some = np.flatnonzero((counted != joint.close).any(axis=1))
            share[of[some]] = (counted[some] @ joint.shares).min(axis=1)
        return sums, share

    def _alike(self, taxels: Ints) -> Iterator[tuple[Ints, Ints, _Surroundings]]:
        """Numbers (k,) in `taxels` of those that are joined alike, their neighbours (k, n), and the joint."""
        for taxel in taxels[self._kind[taxels] < 0].tolist():
            near = self._tree.query_ball_point(self._array.positions[taxel], REACH_PITCHES * self._array.pitch)
            self._near[taxel] = np.array(sorted({*near} - {taxel}), int)
            self._kind[taxel] = self._kinds.setdefault(self._places(taxel).tobytes(), len(self._kinds))
        kinds = self._kind[taxels]
        for kind in np.unique(kinds).tolist():
            of = np.flatnonzero(kinds == kind)
            near = [self._near[each] for each in taxels[of].tolist()]
            if kind not in self._joints and not self._searching and near[0].size:
                self._searching = True
                self._start(partial(self._search, kind, int(taxels[of[0]])))
            if (joint := self._joints.get(kind)) is not None:
                yield of, np.array(near), joint

    def _places(self, taxel: int) -> Reals:
        """Places (n, 2) of its neighbours, in pitches from it."""
        offsets = self._array.positions[self._near[taxel]] - self._array.positions[taxel]
        return np.asarray((offsets / self._array.pitch).round(SAME_PLACES) + 0.0)

    def _search(self, kind: int, taxel: int) -> None:
        try:
            array = self._array
            taxels = array.pitch, array.width, array.aperture
            self._joints[kind] = _surroundings(self._kernel, *taxels, self._places(taxel).tobytes())
        finally:
            self._searching = False


@lru_cache(maxsize=1024)  # arrays under one cover, and the same one once more, have the same
def _surroundings(kernel: Kernel, pitch: float, width: float, aperture: Aperture, near: bytes) -> _Surroundings:
    """How the cover joins a taxel and its neighbours, at places (n, 2) of float64 in pitches from it."""
    offsets = np.frombuffer(near).reshape(-1, 2)

    def responses(reach: float, side: float) -> tuple[Reals, Reals]:
        """Responses (M,) of the taxel, and (n, M) of its neighbours, to squares of `side` out to `reach`."""
        line = np.arange(-reach + side / 2, reach, side)
        cells = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
        taxels = np.vstack([np.zeros((1, 2)), offsets])
        found = []
        for s in THICKNESSES:  # a thicker cover is as a finer array
            unit = pitch / s
            scaled = Array(taxels * unit, unit, width / s, aperture)
            found.append(matrix(kernel, scaled, cells * unit, side * unit))
        own, beside = np.split(np.concatenate(found, axis=1), [1])
        return np.maximum(own[0], 0.0), np.maximum(beside, 0.0)

    own, beside = responses(float(np.abs(offsets).max()) + BEYOND_PITCHES, CELL_PITCHES)
    spots = own > MIN_RESPONSE * own.max()
    near_own, near_beside = responses(CLOSE_PITCHES, CELL_PITCHES / 2)
    at = near_own > MIN_RESPONSE * near_own.max()
    shares = np.hstack([beside[:, spots] / own[spots], near_beside[:, at] / near_own[at]])
    close = np.hypot(*offsets.T) < CLOSE_PITCHES
    return _Surroundings(_weights(own, beside), close, shares, float(shares[close].sum(axis=0).min()))


def _weights(own: Reals, beside: Reals) -> Reals:
    """Weights (2, n) of the neighbours' responses (n, M) with the largest sum that is nowhere above `own` (M,)."""
    n = len(beside)
    worth = np.concatenate([np.full(n, 1 - GAIN_ERROR), np.full(n, -1 - GAIN_ERROR)])
    solutions = []
    for subtracted in (None, 0.0):
        bounds = [(0.0, None)] * n + [(0.0, subtracted)] * n
        solved = linprog(-worth, np.vstack([beside, -beside]).T, own, bounds=bounds, method="highs-ds")
        up, down = (np.zeros(2 * n) if solved.x is None else solved.x).reshape(2, n)
        solutions.append(up - down)
    return np.array(solutions)
