"""A few isolated indenters: where each of them is, below the pitch, how hard it presses, and how wide it is.

Their places are read off a non-negative image and refined, with the forces. The answer stands only if it leaves
nothing but noise behind, and all of it is certain.
"""

from math import sqrt

import numpy as np

from tactiled.arrays import Floats, Floats32
from tactiled.core import points
from tactiled.restore.point_fit import MAX_POINTS, Fit, Fitter
from tactiled.restore.point_image import MIN_PLACE_ERROR, MODEL_ERROR, PointImage, PointLoads
from tactiled.restore.scene import Scene

# Chosen on the scenes of `python -m tests.bench judge --family first` and on those that the network is trained on.
MIN_SIDE = 3  # taxels a side: with fewer no place along it can be found
MIN_SENSITIVITY = 3.0 * MODEL_ERROR  # of a load's frame: what a move by a quarter of a pitch must change at least
MAX_SPREAD_CELLS = 5.7  # cells that a load's pressure may be spread over in the linear image
LEARNED_SPREAD_CELLS = 3.5  # the same in the network's image: above it 0 of 35 fits held, below it 107 of 197
MAX_REMAINDER = 0.05  # of the image's pressure: no more peaks are looked for once less remains
MAX_OUTSIDE = 0.15  # of the image's pressure that may lie outside the neighbourhoods of its peaks
TOUCHING = 3.5  # pitches between two peaks whose neighbourhoods touch
REACH = 4.0  # standard deviations of two loads together: nearer ones are neighbours
MAX_NEIGHBOURS = 1.2  # that touch, in the mean; a pair has one, a chain of three 4/3: that is one contact
RESIDUAL_SIGMAS = 3.0  # standard deviations of the residual's square that noise may stray by
NEIGHBOURHOOD_SIGMAS = 4.0  # the same about any one load: of so few taxels it strays further
MAX_WIDTH = 0.12  # square pitches: wider loads change their frame by more than in proportion
MAX_WIDTH_ERROR = 0.1  # square pitches, standard deviation of the common width
PAIR_WIDTH = 0.02  # square pitches of width, in the mean of both axes: two loads half a pitch apart have more
RAW_ERROR = 0.6  # of the points' image, that the raw one misses: if less, two that were fitted as one do worse
MAX_LAST_SHIFT = 0.25  # pitches that the last step may move a point: it is linear, and holds no further
MAX_LAST_STRETCH = 0.5  # of a force that it may change
MAX_FORCE_ERROR = 0.2  # of a force
MAX_PLACE_ERROR = 0.5  # pitches
NOWHERE = np.zeros((0, 2))
NO_GRID = "points need a grid of three taxels a side at least: restored by nnls"
TOO_THIN = "the cover is too thin to locate loads within a taxel: restored by nnls"


class Points:
    """Fits the frame that its scene last looked at; `loads` are of a fit that stands, `drawing` is their image."""

    def __init__(self, scene: Scene, spread_cells: float = MAX_SPREAD_CELLS) -> None:
        """`spread_cells`: how many a load's pressure may be spread over in the images that fits start from."""
        blur = scene.array
        self._scene = scene
        response = blur.response if min(blur.frame_shape) >= MIN_SIDE else None
        self.unavailable = NO_GRID if response is None else ""  # why no points are ever fitted
        self._fitter: Fitter | None = None
        if response is not None and response.sensitivity() < MIN_SENSITIVITY:
            self.unavailable = TOO_THIN
        elif response is not None:
            self._fitter = Fitter(response, scene.noise)
        surface = blur.surface_shape if self._fitter else (1, 1)  # where nothing is fitted nothing is drawn
        self._refine = k = blur.refine
        self._widest = spread_cells * k**2  # cells
        self.drawing = PointImage(surface, self._refine, scene.noise)
        self._model = 0.0  # kPa^2, summed over taxels: what the model may miss this frame by
        self.loads: PointLoads | None = None

    def __call__(self, y: Floats32, image: Floats32) -> int:
        """Fit points to a frame, starting from an image without negative values; gives the steps made, or 0.

        A fit is refused if it leaves more than noise, or if a point's place, force or width is uncertain.
        """
        self.loads = None
        if self._fitter is None:
            return 0
        y = y.reshape(-1)
        self._model = MODEL_ERROR**2 * float(y.dot(y))
        places = self._peaks(image)
        if not len(places) or self._scene.cut():
            return 0
        fit = self._fitter(y, places)
        self.loads = self._accepted(self._fitter, fit, y) if fit else None
        return fit.steps if fit and self.loads else 0

    def _peaks(self, image: Floats32) -> Floats:
        """Places (n, 2) of an image's peaks, in pitches; none if they are too many or too wide."""
        k, places = self._refine, np.empty((MAX_POINTS, 2))
        n, pairs, total, squares, rest = points.peaks(image, k, MAX_REMAINDER, TOUCHING * k, places)
        too_wide = rest > MAX_OUTSIDE * total or total**2 > n * self._widest * squares
        if too_wide or 2 * pairs > MAX_NEIGHBOURS * n:
            return NOWHERE
        return places[:n] / k + (0.5 / k - 0.5)

    def _accepted(self, fitter: Fitter, fit: Fit, y: Floats32) -> PointLoads | None:
        """Draw and give what stands of a fit; None where anything is uncertain."""
        noise, free = self._scene.noise**2, max(fit.left.size - 4 * len(fit.force), 1)
        residual = float(fit.left.dot(fit.left))
        if residual > noise * (free + RESIDUAL_SIGMAS * sqrt(2 * free)) + self._model:
            return None
        variance = max(residual / free, noise)
        errors = fit.variance * variance
        if fit.common_width > MAX_WIDTH or fit.common_variance * variance > MAX_WIDTH_ERROR**2:
            return None
        for force, change, shift, error in zip(
            *(each.tolist() for each in (fit.force, fit.change, fit.shift, errors)), strict=True
        ):
            if abs(change) > MAX_LAST_STRETCH * force or max(map(abs, shift)) > MAX_LAST_SHIFT:
                return None
            if error[0] > (MAX_FORCE_ERROR * force) ** 2 or max(error[1:]) > MAX_PLACE_ERROR**2:
                return None
        loads = PointLoads(
            places=fitter.within(fit.places + fit.shift),
            force=np.maximum(fit.force + fit.change, 0),
            spread=np.sqrt(np.maximum(errors[:, 1:], MIN_PLACE_ERROR**2) + fit.width[:, None]),
            variance=errors,
            width=fit.common_variance * variance,
            noise=noise / variance,
        )
        crowded = _neighbours(loads.places, REACH**2 * (loads.spread**2).mean(axis=1)) > MAX_NEIGHBOURS
        if crowded or self._leaves_signal(fitter, fit):
            return None
        self.drawing(loads)
        widest = float((fit.own + np.sqrt(fit.own_variance * variance)).max())
        return None if widest > PAIR_WIDTH and self._raw_is_near(y) else loads

    def _raw_is_near(self, y: Floats32) -> bool:
        """Whether the raw image may be nearer to the truth than the points just drawn, were one of them two."""
        image, k = self.drawing.image, self._refine
        rows, columns = self._scene.array.frame_shape
        square = float(np.vdot(image, image))
        both = float(np.einsum("ij,ikjl->", y.reshape(rows, columns), image.reshape(rows, k, columns, k)))
        return k**2 * float(y.dot(y)) - 2 * both + square < RAW_ERROR**2 * square

    def _leaves_signal(self, fitter: Fitter, fit: Fit) -> bool:
        """Whether a fit leaves more than noise about one of its loads: all of a frame would hide that."""
        left, noise = fit.left.reshape(fitter.shape), self._scene.noise**2
        about = (_around(left, each) for each in fit.places)
        return any(
            float(np.vdot(each, each))
            > noise * (each.size + NEIGHBOURHOOD_SIGMAS * sqrt(2 * each.size)) + self._model
            for each in about
        )


def _neighbours(places: Floats, reach: Floats) -> float:
    """How many others a load has that are nearer than the root of both squared reaches (n,), in the mean."""
    apart = ((places[:, None] - places) ** 2).sum(axis=-1)
    return float((apart <= reach[:, None] + reach).sum() / len(places) - 1)


def _around(image: Floats32, middle: Floats) -> Floats32:
    """Give the taxel at a place and its neighbours, as far as they lie inside."""
    i, j = (min(max(round(at), 0), n - 1) for at, n in zip(middle.tolist(), image.shape, strict=True))
    return image[max(i - 1, 0) : i + 2, max(j - 1, 0) : j + 2]
