"""What the taxels of a grid sense of one small load anywhere between them, and how that changes with its place."""

import numpy as np
from scipy.interpolate import make_interp_spline

from tactiled.restore.modes import Floats, Image

PHASES = 64  # places a pitch that are tabulated: between them, the slope
RANK = 1e-4  # of the largest separable part: less is left out


class Loads:
    """Responses as sums of products of a column's and a row's part, each tabulated along its axis.

    Made from a stencil of cells `refine` times finer than the pitch: such a cell is the load. Places are counted
    in pitches from the first taxel; a unit load is 1 kPa over a square of one pitch.
    """

    def __init__(self, stencil: Floats, shape: tuple[int, int], refine: int) -> None:
        self.shape, self.side = shape, 1 / refine
        U, s, Vt = np.linalg.svd(stencil * refine**2)
        parts = max(1, int(np.count_nonzero(s > RANK * s[0])))
        self._down = [np.asarray(each, np.float32) for each in _table(U[:, :parts] * s[:parts], shape[0], refine)]
        self._across = [np.asarray(each, np.float32) for each in _table(Vt[:parts].T, shape[1], refine)]

    def jacobian(self, y: float, x: float, out: Image) -> None:
        """Fill out (4, R C) with a unit load's frame at row y, column x, its slopes, and half its Laplacian.

        The last is what it gains for each square pitch of the load's variance.
        """
        down, slope_down, curve_down = _at(self._down, y, self.shape[0])
        across, slope_across, curve_across = _at(self._across, x, self.shape[1])
        view = out.reshape(4, *self.shape)
        np.dot(down.T, across, out=view[0])
        np.dot(slope_down.T, across, out=view[1])
        np.dot(down.T, slope_across, out=view[2])
        np.dot((0.5 * curve_down).T, across, out=view[3])
        view[3] += np.dot(down.T, 0.5 * curve_across)


def _at(tables: list[Image], place: float, n: int) -> tuple[Image, Image, Image]:
    """Give (parts, n): the axis' factors at `place` as taxels 0..n-1 see them, their slopes and curvatures."""
    nearest = round(place * PHASES)
    ahead = np.float32(place - nearest / PHASES)
    # Taxel i sees the load place - i away; the tables run backwards, so that i runs forwards.
    turn, phase = divmod(n * PHASES - nearest, PHASES)
    value, slope, curve = (table[phase, :, turn : turn + n] for table in tables)
    return value + ahead * slope, slope + ahead * curve, curve


def _table(parts: Floats, n: int, refine: int) -> tuple[Floats, Floats, Floats]:
    """Give values, slopes and curvatures (PHASES, parts, 2n+1) of an axis' factors, at offsets from n to -n-1."""
    offsets = (np.arange(refine * (2 * n - 1)) - refine * (n - 1) - (refine - 1) / 2) / refine
    degree = min(3, len(offsets) - 1)
    spline = make_interp_spline(offsets, parts, k=degree)
    places = n - np.arange(PHASES * (2 * n + 1)) / PHASES
    inside = np.clip(places, offsets[0], offsets[-1])

    def phases(order: int) -> Floats:
        values = spline(inside, order) if order <= degree else np.zeros((len(inside), parts.shape[1]))
        return np.ascontiguousarray(values.reshape(2 * n + 1, PHASES, -1).transpose(1, 2, 0))

    return phases(0), phases(1), phases(2)
