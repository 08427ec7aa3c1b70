"""Rows and columns of an array whose taxels come in one row after the other, from what presses on it; pure.

Cover and contacts spread over neighbours. So in the right grid a taxel changes like those beside and below it, and
the last taxel of a row changes unlike the first of the next row.
"""

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

MAX_FRAMES = 100  # the strongest ones are used
MIN_SIGNAL = 4.0  # mean square of the changes over that of the noise
MAX_UNLIKE = 0.4  # of neighbours in the right grid: with more there is no answer
MIN_UNLIKE = 0.01  # of neighbours: less counts as this
TIE = 1.2  # times the best grid's unlikeness: up to that another grid may be right, too
LINE = 3.0  # if a single line is so many times better than every grid, only edges along it pressed: no answer
SEAM_SHARE = 0.6  # of the signal that taxels at the ends of rows must have to count against a grid
MAX_SEAM_ALIKE = 0.5  # unlikeness of the ends of rows: with less the row goes on, and the grid is wrong


class _Likeness(NamedTuple):
    """How alike some pairs of taxels change."""

    unlike: float  # mean square of their difference over that of both: 0: the same, 1: independent
    energy: float  # mean square of both


def alike_shapes(counts: NDArray[Any], sizes: Iterable[int]) -> list[tuple[int, int]]:
    """Rows x columns in which neighbours change most alike, the squarest first; none where none is clear.

    `counts` (T, N) are of at least as many taxels as the largest of `sizes`, those that the array may have.
    """
    every, sizes = np.asarray(counts, np.float64), list(sizes)
    rest = np.median(every, axis=0)
    moves, lies = every - rest, every - np.median(rest)
    return _alike(moves, sizes) or _alike(lies, sizes)


def _alike(changes: NDArray[np.float64], sizes: list[int]) -> list[tuple[int, int]]:
    """The same of changes from rest (T, N)."""
    grids = [each for size in sizes for each in _grids(changes[:, :size])]
    plane = [each for each in grids if 1 not in each[1:]]
    if not plane:
        return []
    best, line = min(plane)[0], min((each[0] for each in grids if 1 in each[1:]), default=np.inf)
    if best > MAX_UNLIKE or LINE * line < best:
        return []
    good = [(rows, columns) for unlike, rows, columns in plane if unlike <= TIE * best]
    return sorted(good, key=lambda each: (max(each) / min(each), each))


def _grids(changes: NDArray[np.float64]) -> list[tuple[float, int, int]]:
    """(unlikeness of neighbours, rows, columns) of every grid that the ends of its rows allow."""
    size = changes.shape[1]
    if len(changes) < 2:
        return []
    noise = float(np.median(np.diff(changes, axis=0).var(axis=0))) / 2
    changes = changes[np.argsort(-np.square(changes).sum(axis=1))[:MAX_FRAMES]]
    signal = float(np.square(changes).mean()) - noise
    if signal < MIN_SIGNAL * noise or signal <= 0:
        return []
    grids = []
    for columns in (each for each in range(1, size + 1) if not size % each):
        place = np.arange(size).reshape(-1, columns)
        beside = _likeness(changes, noise, place[:, :-1], place[:, 1:])
        below = _likeness(changes, noise, place[:-1], place[1:])
        seam = _likeness(changes, noise, place[:-1, -1], place[1:, 0])
        goes_on = seam and seam.energy > SEAM_SHARE * signal and seam.unlike < MAX_SEAM_ALIKE
        unlike = [each.unlike for each in (beside, below) if each]
        if unlike and not goes_on:
            grids.append((max(*unlike, MIN_UNLIKE), size // columns, columns))
    return grids


def _likeness(
    changes: NDArray[np.float64], noise: float, first: NDArray[np.intp], second: NDArray[np.intp]
) -> _Likeness | None:
    """How alike pairs of taxels change, the noise taken off; None where nothing changes."""
    if not first.size:
        return None
    one, other = changes[:, first.ravel()], changes[:, second.ravel()]
    energy = float((np.square(one) + np.square(other)).mean()) - 2 * noise
    return _Likeness((float(np.square(one - other).mean()) - 2 * noise) / energy, energy) if energy > 0 else None
