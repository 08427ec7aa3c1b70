"""What the taxels of a grid sense of one small load anywhere between them, and how that changes with its place."""

import numpy as np
from scipy.interpolate import make_interp_spline

from tactiled.arrays import Floats, Floats32
from tactiled.core import points

PHASES = 64  # places a pitch that are tabulated: half of a step is left to a fit's last, linear step
RANK_TOLERANCE = 1e-4  # of the largest separable part: smaller ones are dropped


class PointResponse:
    """Responses as sums of products of a column's and a row's part, each tabulated along its axis.

    Made from a stencil of cells `refine` times finer than the pitch: such a cell is the load. Places are counted
    in pitches from the first taxel; a unit load is 1 kPa over a square of one pitch. `down` and `across` are the
    tables, as of `core.points.responses`.
    """

    def __init__(self, stencil: Floats, shape: tuple[int, int], refine: int) -> None:
        self.shape = shape
        U, s, Vt = np.linalg.svd(stencil * refine**2, full_matrices=False)
        parts = max(1, int(np.count_nonzero(s > RANK_TOLERANCE * s[0])))
        along = U[:, :parts] * s[:parts], Vt[:parts].T
        self.down, self.across = (_table(part, n, refine) for part, n in zip(along, shape, strict=True))

    def sensitivity(self) -> float:
        """Share of a load's frame that another of any force does not give, a quarter of a pitch across a taxel."""
        middle = [(n - 1) // 2 for n in self.shape]
        places = np.add.outer([-0.125, 0.125], middle)
        out = np.empty((1, 2, self.shape[0] * self.shape[1]), np.float32)
        points.responses(self.down, self.across, (places * PHASES).round().astype(np.int64), 0, out)
        first, second = out[0].astype(float)
        across = second - first * (first @ second) / (first @ first)
        return float(np.linalg.norm(across) / np.linalg.norm(second))


def _table(parts: Floats, n: int, refine: int) -> Floats32:
    """Give values, slopes and curvatures (PHASES, 3, parts, 2n+1) of an axis' factors, offsets n to -n-1."""
    offsets = (np.arange(refine * (2 * n - 1)) - refine * (n - 1) - (refine - 1) / 2) / refine
    degree = min(3, len(offsets) - 1)
    spline = make_interp_spline(offsets, parts, k=degree)
    places = n - np.arange(PHASES * (2 * n + 1)) / PHASES
    inside = np.clip(places, offsets[0], offsets[-1])

    def phases(order: int) -> Floats:
        values = spline(inside, order) if order <= degree else np.zeros((len(inside), parts.shape[1]))
        return np.asarray(values.reshape(2 * n + 1, PHASES, -1).transpose(1, 2, 0))

    return np.ascontiguousarray(np.stack([phases(0), phases(1), phases(2)], axis=1), np.float32)
