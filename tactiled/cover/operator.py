"""From the cover's gain to what taxels sense: integrals over surface cell and aperture, never point samples.

The response to a square cell of unit pressure, d away from a taxel, is the Fourier integral of G times the
transforms of cell and aperture. It is taken octave by octave, so that a film's fine detail and a foam's wide skirt
each have their own period and cut-off; as the integral runs to the cut-off, every alias of the sampling is in it.
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import scipy
from scipy.interpolate import RectBivariateSpline
from scipy.special import j1

from tactiled.arrays import Floats
from tactiled.cover.cache import cached_table
from tactiled.cover.kernel import Kernel
from tactiled.geometry import Array, Raster

BAND_RATIO = 4.0  # of neighbouring bands' cut-offs
GAUSSIAN_END = 4.6  # where exp(-x^2) is as good as 0 (1e-9)
Way = tuple[int, ...]  # odd in u, odd in v, and which of these
WAVES = np.cos, np.sin  # even, and odd
REACH = 6.0  # over q, in space, of a band from q on: four times its Gaussian's own GAUSSIAN_END / pi
CODE = (  # a cached table of other code is not ours
    np.__version__,
    scipy.__version__,
    *(each.read_bytes() for each in sorted(Path(__file__).parent.glob("*.py"))),
)
PARTS = 4  # squares along a cell
STEPS = 4  # along a square, in which responses are tabulated: with one, thin covers sum to 0.9
MAX_CYCLES = 1000.0  # a cell or, if wider, its mean with the aperture, beyond which they leave 1e-7 of the peak


def stencil(kernel: Kernel, array: Array, refine: int = 1) -> Floats:
    """Give (k (2R-1), k (2C-1)), k = refine: the mean pressure on a taxel for unit pressure on one surface cell.

    Cells are squares of side pitch / k. Entry [d_y + k (R-1), d_x + k (C-1)] belongs to the index offset
    d = cell - k taxel, that is to a cell's centre (d - (k-1)/2) pitch / k mm from the taxel's centre.
    """
    assert array.shape is not None, "only grids have a stencil"
    side = array.pitch / refine
    y, x = ((np.arange(-refine * (n - 1), refine * n) - (refine - 1) / 2) * side for n in array.shape)
    return _response(kernel, array, side, np.abs(x), np.abs(y))


def matrix(kernel: Kernel, array: Array, cells: Floats, side: float) -> Floats:
    """Give (N, M): the mean pressure on every taxel under 1 on squares of `side` at `cells` (M, 2), mm."""
    offsets = np.abs(array.positions[:, None] - np.asarray(cells, float)[None]).round(9)
    x, column = np.unique(offsets[..., 0], return_inverse=True)
    y, row = np.unique(offsets[..., 1], return_inverse=True)
    table = _response(kernel, array, side, x, y)
    return np.asarray(table[row.reshape(offsets.shape[:2]), column.reshape(offsets.shape[:2])])


def surface_matrix(kernel: Kernel, array: Array, surface: Raster) -> Floats:
    """Give (N, R C): the mean pressure on every taxel for unit pressure on one cell of a surface (R, C).

    Taxels may lie anywhere on the cells. So pressure within a cell follows the slope between its neighbours, about
    the cell's own; with steps between cells the frame would not fit. The response to one of a cell's PARTS x
    PARTS squares is tabulated in steps of it and interpolated; cover and aperture keep it smooth.
    """
    side = surface.side / PARTS
    across, down = (
        corner + ((np.arange(PARTS * n) + 0.5) / PARTS - 0.5) * surface.side
        for corner, n in zip(surface.corner, reversed(surface.shape), strict=True)
    )
    span = [np.ptp([*line, *places]) for line, places in zip((across, down), array.positions.T, strict=True)]
    step = side / STEPS
    x, y = (np.asarray(np.arange(int(end / step) + 5) * step, float) for end in span)
    table = RectBivariateSpline(y, x, _response(kernel, array, side, x, y))
    rows, columns = (_lines(n) for n in surface.shape)
    response = np.empty((array.size, surface.taxel.size))
    for taxel, (middle_x, middle_y) in enumerate(array.positions):
        (offset_y, of_y), (offset_x, of_x) = (
            np.unique(np.abs(line - middle), return_inverse=True)
            for line, middle in ((down, middle_y), (across, middle_x))
        )
        squares = table(offset_y, offset_x)[of_y][:, of_x]
        response[taxel] = (rows.T @ squares @ columns).ravel()
    return response


def _lines(n: int) -> Floats:
    """Give (PARTS n, n): the pressure on parts of n cells in a row, along lines that keep each cell's mean."""
    cells = np.eye(n)
    slopes = (np.vstack([cells[1:], cells[-1:]]) - np.vstack([cells[:1], cells[:-1]])) / 2
    offsets = (np.arange(PARTS) + 0.5) / PARTS - 0.5
    return np.asarray((cells[:, None] + offsets[:, None] * slopes[:, None]).reshape(PARTS * n, n))


def cached(
    make: Callable[..., Floats], kernel: Kernel, array: Array, more: int | Raster, folder: Path | None = None
) -> Floats:
    """Give make(kernel, array, more), from `folder` (by default the user's cache) where it is already there."""
    cover = make.__name__, kernel.q, kernel.gain
    taxels = array.positions, array.shape, array.pitch, array.width, array.aperture
    cells = (more.corner, more.side, more.shape) if isinstance(more, Raster) else (more,)
    return cached_table(folder, (*CODE, *cover, *taxels, *cells), lambda: make(kernel, array, more))


def _response(kernel: Kernel, array: Array, side: float, x: Floats, y: Floats) -> Floats:
    """Give (len(y), len(x)): the mean pressure on a taxel for a unit cell at every |offset| x, y (mm)."""
    return fourier_sums(kernel.q, array, side, (x, y), lambda u, v: {(0, 0): kernel.gain_at(np.hypot(u, v))})[0, 0]


def fourier_sums(
    ends: Floats,
    array: Array,
    side: float,
    offsets: tuple[Floats, Floats],
    gains: Callable[..., dict[Way, Floats]],
) -> dict[Way, Floats]:
    """Sum gains times the footprints of unit cell and aperture over all waves, at offsets x, y (mm) from 0 on.

    `gains` gives those of waves u, v (cycles/mm) by their way: whether they are odd in u and in v, and so sines
    along x and along y. `ends` begin with 0 and the lowest frequency, and end with the highest.
    """
    x, y = offsets
    results: dict[Way, Floats] = {}
    cuts = [np.inf]
    while cuts[-1] > ends[1]:
        cuts.append(min(cuts[-1], ends[-1]) / BAND_RATIO)
    for high, low in zip(cuts, [*cuts[1:], 0.0], strict=True):
        cutoff = min(GAUSSIAN_END * high, ends[-1], MAX_CYCLES / np.sqrt(side * max(side, array.width)))
        reach = REACH / (low or high) + (side + array.width) / 2
        frequency = np.arange(int(cutoff * 2 * reach) + 2) / (2 * reach)
        u, v = np.meshgrid(frequency, frequency, sparse=True)
        q = np.hypot(u, v)
        window = np.exp(-((q / high) ** 2)) - (np.exp(-((q / low) ** 2)) if low else 0.0)
        footprints = side**2 * np.sinc(u * side) * np.sinc(v * side) * aperture_mean(array, u, v)
        weight = np.where(frequency > 0, 2.0, 1.0) / (2 * reach)
        columns, rows = x <= reach, y <= reach
        found = gains(u, v)
        odd_x, odd_y = ({way[axis] for way in found} for axis in (0, 1))
        along = {odd: WAVES[odd](2 * np.pi * np.outer(frequency, x[columns])) * weight[:, None] for odd in odd_x}
        down = {odd: WAVES[odd](2 * np.pi * np.outer(y[rows], frequency)) * weight for odd in odd_y}
        for way, gain in found.items():
            spectrum = window * gain * footprints
            result = results.setdefault(way, np.zeros((len(y), len(x))))
            result[np.ix_(rows, columns)] += down[way[1]] @ spectrum @ along[way[0]]
    return results


def aperture_mean(array: Array, u: Floats, v: Floats | float = 0.0) -> Floats:
    """Give what is left of a unit wave of frequency u, v (1/mm) in its mean over an aperture."""
    if array.aperture == "square":
        return np.asarray(np.sinc(u * array.width) * np.sinc(v * array.width))
    x = np.pi * array.width * np.hypot(u, v)
    return np.divide(2 * j1(x), x, out=np.ones_like(x), where=x > 0)
