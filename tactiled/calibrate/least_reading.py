"""The least that a taxel can read while its neighbours read what they do, whatever presses on the cover.

Pressure is never negative. So if a weighted sum of the neighbours' responses to a spot of pressure is nowhere
above the taxel's own response, the same sum of their readings is never above its reading. The weights with the
largest sum are a linear program. Under a thin cover they are small: a hole of the object may lie over the taxel.
"""

from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog
from scipy.spatial import cKDTree

from tactiled.cover.kernel import Kernel
from tactiled.cover.operator import matrix
from tactiled.geometry import Array, layout

REACH_PITCHES = 2.3  # of the neighbours that count: 24 on a grid
BEYOND_PITCHES = 1.5  # of these, from which a load counts
CELL_PITCHES = 0.5  # side of the squares that a load is made of
THICKNESSES = (0.9, 1.1)  # times the configured one: the weights hold for all between
GAIN_ERROR = 0.2  # of the neighbours, part of the weights' sum that it may cost
SAME_PLACES = 6  # decimals, in pitches, to which neighbours of two taxels lie alike

Floats = NDArray[np.floating]
Indices = NDArray[np.intp]
Start = Callable[[Callable[[], None]], object]  # runs a search, at once or on a thread


class LeastReading:
    """Least readings of one array's taxels; the weights of a taxel are found when it is first asked for."""

    def __init__(self, kernel: Kernel, array: Array, start: Start) -> None:
        """`start` runs what takes longer than a frame; until it is done a taxel has no least reading."""
        self._kernel, self._array, self._start = kernel, array, start
        self._tree = cKDTree(array.positions)
        self._near: dict[int, tuple[Indices, bytes]] = {}  # neighbours (n,) of a taxel, and how they lie
        self._weights: dict[bytes, Floats] = {}  # (2, n) by how n neighbours lie: of any sign, none below 0
        self._searching = False

    def __call__(self, taxels: Indices, load: Floats, trusted: NDArray[np.bool_]) -> NDArray[np.float32]:
        """Least loads of `taxels` under loads (N,) of which some are trusted; 0 where nothing is known."""
        alike: dict[bytes, list[int]] = {}
        for at, taxel in enumerate(taxels.tolist()):
            alike.setdefault(self._neighbours(taxel)[1], []).append(at)
        lowest = np.zeros(len(taxels), np.float32)
        for places, of in alike.items():
            if places not in self._weights and not self._searching:
                self._searching = True
                self._start(partial(self._search, places))
            if (weights := self._weights.get(places)) is not None:
                near = np.array([self._neighbours(each)[0] for each in taxels[of].tolist()])
                felt = np.where(trusted[near], load[near], 0.0) @ weights.T
                unknown = ~trusted[near] @ (weights < 0).T  # what is subtracted must be known
                lowest[of] = np.where(unknown, 0.0, felt).max(axis=1)
        return np.maximum(lowest, 0)

    def _neighbours(self, taxel: int) -> tuple[Indices, bytes]:
        if taxel not in self._near:
            place, pitch = self._array.positions[taxel], self._array.pitch
            near = sorted({*self._tree.query_ball_point(place, REACH_PITCHES * pitch)} - {taxel})
            places = ((self._array.positions[near] - place) / pitch).round(SAME_PLACES) + 0.0
            self._near[taxel] = np.array(near, int), places.tobytes()
        return self._near[taxel]

    def _search(self, places: bytes) -> None:
        try:
            offsets = np.frombuffer(places).reshape(-1, 2) * self._array.pitch
            self._weights[places] = weights(self._kernel, self._array, offsets)
        finally:
            self._searching = False


def weights(kernel: Kernel, array: Array, places: Floats) -> Floats:
    """Weights (2, n) of neighbours at `places` (n, 2), mm from a taxel: of any sign, and none below 0."""
    reach = float(np.abs(places).max()) + BEYOND_PITCHES * array.pitch
    side = CELL_PITCHES * array.pitch
    line = np.arange(-reach + side / 2, reach, side)
    cells = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    taxels = np.vstack([np.zeros((1, 2)), places])
    responses = [
        matrix(kernel, layout(taxels / s, array.width / s, array.aperture), cells / s, side / s)
        for s in THICKNESSES
    ]
    own, beside = np.split(np.concatenate(responses, axis=1), [1])
    own, n = np.maximum(own[0], 0.0), len(places)
    worth = np.concatenate([np.full(n, 1 - GAIN_ERROR), np.full(n, -1 - GAIN_ERROR)])
    solutions = []
    for subtracted in (None, 0.0):
        bounds = [(0.0, None)] * n + [(0.0, subtracted)] * n
        solved = linprog(-worth, np.vstack([beside, -beside]).T, own, bounds=bounds, method="highs-ds")
        up, down = (np.zeros(2 * n) if solved.x is None else solved.x).reshape(2, n)
        solutions.append(up - down)
    return np.array(solutions)
