"""A few isolated indenters: where each of them is, below the pitch, how hard it presses, and how wide it is.

Their places are read off a non-negative image and refined, with the forces. The answer stands only if it leaves
nothing but noise behind, and all of it is certain.
"""

from math import sqrt
from typing import NamedTuple

import numpy as np

from tactiled.core import points
from tactiled.restore.modes import Floats, Image
from tactiled.restore.point_fit import MAX_POINTS, Fit, Fitter
from tactiled.restore.point_image import MIN_PLACE_ERROR, MODEL_ERROR, PointImage, PointLoads
from tactiled.restore.scene import Scene

# Chosen on the scenes of `python -m tests.bench judge --family first` and on those that the network is trained on.
MIN_SIDE = 3  # taxels a side that tell a place on it
MIN_SENSITIVITY = 3.0 * MODEL_ERROR  # that a quarter of a pitch changes of a load's frame, or no place is known
MAX_SPREAD_CELLS = 5.7  # that a point's pressure is spread over in an image of them
LEARNED_SPREAD_CELLS = 3.5  # the same in the network's: of 35 fits to more spread none stood, of 197 to less 107
MAX_REMAINDER = 0.05  # of the image's pressure: no more peaks are looked for once less remains
MAX_OUTSIDE = 0.15  # of the image's pressure that may lie outside the neighbourhoods of its peaks
TOUCHING = 3.5  # pitches between two peaks whose neighbourhoods touch
REACH = 4.0  # standard deviations of two loads together: nearer ones are neighbours
MAX_NEIGHBOURS = 1.2  # that touch, in the mean; a pair has one, a chain of three 4/3: that is one contact
RESIDUAL_SIGMAS = 3.0  # standard deviations of the residual's square that noise may stray by
NEIGHBOURHOOD_SIGMAS = 4.0  # the same about any one load: of so few taxels it strays further
OWN_WIDTH, OWN_SHARE = 0.03, 0.4  # square pitches, and of the common width: what a load's own may differ by
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


class Estimate(NamedTuple):
    """The last step of a fit's unknowns, with what is left and how certain it is."""

    step: Floats  # (4 n,) of n times force, row, column and width
    force: Floats
    shift: Floats  # (n, 2) pitches
    width: Floats  # (n,) square pitches: each load's own, a variance along any axis
    own: Floats  # (n,) square pitches: the same, held near no other
    own_variance: Floats  # of these, for a noise of 1
    common_width: float  # square pitches
    residual: float  # of the frame, squared
    variance: Floats  # (n, 3) of force and place for a noise of 1
    common_variance: float  # of the loads' common width, for a noise of 1


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
        self._unexplained = np.empty(scene.size, np.float32)
        surface = blur.surface_shape if self._fitter else (1, 1)  # where nothing is fitted nothing is drawn
        self._refine = k = blur.refine
        self._widest = spread_cells * k**2  # cells
        self.drawing = PointImage(surface, self._refine, scene.noise)
        self._model = 0.0  # kPa^2, summed over taxels: what the model may miss this frame by
        self.loads: PointLoads | None = None

    def __call__(self, y: Image, image: Image) -> int:
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
        done, fit = self._fitter(y, places)
        self.loads = self._accepted(self._fitter, fit, y) if fit else None
        return done if self.loads else 0

    def _peaks(self, image: Image) -> Floats:
        """Places (n, 2) of an image's peaks, in pitches; none if they are too many or too wide."""
        k, places = self._refine, np.empty((MAX_POINTS, 2))
        n, pairs, total, squares, rest = points.peaks(image, k, MAX_REMAINDER, TOUCHING * k, places)
        too_wide = rest > MAX_OUTSIDE * total or total**2 > n * self._widest * squares
        if too_wide or 2 * pairs > MAX_NEIGHBOURS * n:
            return NOWHERE
        return places[:n] / k + (0.5 / k - 0.5)

    def _accepted(self, fitter: Fitter, fit: Fit, y: Image) -> PointLoads | None:
        """Draw and give what stands of a fit; None where anything is uncertain."""
        noise, last = self._scene.noise**2, _estimate(fit, self._scene.noise**2)
        free = max(fitter.residual.size - 4 * len(fit.force), 1)
        if last.residual > noise * (free + RESIDUAL_SIGMAS * sqrt(2 * free)) + self._model:
            return None
        if np.abs(last.shift).max() > MAX_LAST_SHIFT or (np.abs(last.force) > MAX_LAST_STRETCH * fit.force).any():
            return None
        variance = max(last.residual / free, noise)
        errors = last.variance * variance
        too_uncertain = (errors[:, 0] > (MAX_FORCE_ERROR * fit.force) ** 2).any()
        if too_uncertain or errors[:, 1:].max() > MAX_PLACE_ERROR**2:
            return None
        if last.common_width > MAX_WIDTH or last.common_variance * variance > MAX_WIDTH_ERROR**2:
            return None
        loads = PointLoads(
            places=fitter.within(fit.places + last.shift),
            force=np.maximum(fit.force + last.force, 0),
            spread=np.asarray(np.sqrt(np.maximum(errors[:, 1:], MIN_PLACE_ERROR**2) + last.width[:, None])),
            variance=errors,
            width=last.common_variance * variance,
            noise=noise / variance,
        )
        crowded = _neighbours(loads.places, REACH**2 * (loads.spread**2).mean(axis=1)) > MAX_NEIGHBOURS
        if crowded or self._leaves_signal(fitter, fit, last.step):
            return None
        self.drawing(loads)
        widest = float((last.own + np.sqrt(last.own_variance * variance)).max())
        return None if widest > PAIR_WIDTH and self._raw_is_near(y) else loads

    def _raw_is_near(self, y: Image) -> bool:
        """Whether the raw image may be nearer to the truth than the points just drawn, were one of them two."""
        image, k = self.drawing.image, self._refine
        rows, columns = self._scene.array.frame_shape
        square = float(np.vdot(image, image))
        both = float(np.einsum("ij,ikjl->", y.reshape(rows, columns), image.reshape(rows, k, columns, k)))
        return k**2 * float(y.dot(y)) - 2 * both + square < RAW_ERROR**2 * square

    def _leaves_signal(self, fitter: Fitter, fit: Fit, last: Floats) -> bool:
        """Whether a fit leaves more than noise about one of its loads: all of a frame would hide that."""
        explained = (last * fit.scale).astype(np.float32) @ fitter.jacobian[: len(last)]
        np.subtract(fitter.residual, explained, out=self._unexplained)
        unexplained = self._unexplained.reshape(fitter.shape)
        noise = self._scene.noise**2
        about = (_around(unexplained, each) for each in fit.places)
        return any(
            float(np.vdot(each, each))
            > noise * (each.size + NEIGHBOURHOOD_SIGMAS * sqrt(2 * each.size)) + self._model
            for each in about
        )


def _estimate(fit: Fit, noise: float) -> Estimate:
    """The last step of all unknowns of a fit, each load's width held near the common one."""
    n = len(fit.force)
    inverse = np.linalg.inv(fit.normal)
    own, own_variance = inverse[3 * n :] @ fit.right, np.maximum(inverse.diagonal()[3 * n :], 1e-30)
    weight = 1 / own_variance
    common = max(float(own @ weight) / float(weight.sum()), 0.0)
    firm = noise / (OWN_WIDTH + OWN_SHARE * common) ** 2
    stiff, pull = fit.normal.copy(), fit.right.copy()
    stiff.flat[3 * n * (4 * n + 1) :: 4 * n + 1] += firm
    pull[3 * n :] += firm * common
    inverse = np.linalg.inv(stiff)
    last = inverse @ pull
    force, row, column, width = last.reshape(4, n)
    return Estimate(
        step=last,
        force=force,
        shift=np.stack([row, column], axis=1),
        width=np.maximum(width, 0),
        own=own,
        own_variance=own_variance,
        common_width=common,
        residual=fit.residual + float(last @ (fit.normal @ last - 2 * fit.right)),
        variance=np.asarray(inverse.diagonal()[: 3 * n].reshape(3, n).T),
        common_variance=1 / float(weight.sum()),
    )


def _neighbours(places: Floats, reach: Floats) -> float:
    """How many others a load has that are nearer than the root of both squared reaches (n,), in the mean."""
    apart = ((places[:, None] - places) ** 2).sum(axis=-1)
    return float((apart <= reach[:, None] + reach).sum() / len(places) - 1)


def _around(image: Image, middle: Floats) -> Image:
    """Give the taxel at a place and its neighbours, as far as they lie inside."""
    i, j = (min(max(round(at), 0), n - 1) for at, n in zip(middle.tolist(), image.shape, strict=True))
    return image[max(i - 1, 0) : i + 2, max(j - 1, 0) : j + 2]
