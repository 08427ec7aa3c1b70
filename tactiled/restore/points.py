"""A few isolated indenters: where each of them is, below the pitch, and how hard it presses.

Their places are read off the non-negative image and refined, with the forces. The answer stands only if it leaves
nothing but noise behind.
"""

from math import sqrt

import numpy as np

from tactiled.restore.modes import Floats, Image
from tactiled.restore.point_fit import MAX_POINTS, Fit, Fitter
from tactiled.restore.point_image import MIN_PLACE_ERROR, MODEL_ERROR, PointImage, PointLoads
from tactiled.restore.scene import Scene

# Chosen on the scenes of `python -m tests.study judge --family first` and on pairs of loads half a pitch apart.
MIN_SIDE = 3  # taxels a side that tell a place on it
MIN_SENSITIVITY = 3.0 * MODEL_ERROR  # that a quarter of a pitch changes of a load's frame, or no place is known
MAX_STEPS = 12  # of all fits from one start: on 156 frames, 31 of them fitted, as good as any number
MAX_SPREAD_CELLS = 5.7  # that a point's pressure is spread over in an image of them
MAX_REMAINDER = 0.05  # of the image's pressure: no more peaks are looked for once less remains
MAX_OUTSIDE = 0.15  # of the image's pressure that may lie outside the neighbourhoods of its peaks
TOUCHING = 3.5  # pitches between two peaks whose neighbourhoods touch
MAX_NEIGHBOURS = 1.2  # that do, in the mean; a pair has one, a chain of three 4/3: that is one contact
RESIDUAL_SIGMAS = 3.0  # standard deviations of the residual's square that noise may stray by
NEIGHBOURHOOD_SIGMAS = 4.0  # the same about any one load: of so few taxels it strays further
MAX_WIDTH = 0.05  # square pitches of a load's variance along an axis: a disc of 0.45 pitch has it, and is no point
WIDTH_SIGMAS = 3.0  # standard deviations that the width must stay below that by
MAX_WIDTH_SURPLUS = 0.03  # square pitches of width by which points may differ
MAX_LENGTH_SURPLUS = 0.02  # square pitches of width that a point may have along one axis above the common one
LENGTH_SIGMAS = 2.0  # standard deviations beyond these: one so wide is two
PAIR_WIDTH = 0.0625  # square pitches of width, at most, that two loads half a pitch apart have
MAX_CUTS = 4  # fits cut short one after the other: the time that there is does not do for one
PAUSE_FRAMES = 64  # that follow without a fit
RAW_ERROR = (
    0.6  # of the points' image, that the raw one misses: if more, points hardly do worse, though one were two
)
MAX_LAST_SHIFT = 0.25  # pitches that the last step may move a point: it is linear, and holds no further
MAX_LAST_STRETCH = 0.5  # of a force that it may change
MAX_FORCE_ERROR = 0.2  # of a force
MAX_PLACE_ERROR = 0.5  # pitches
AXES = np.array([[1, 0, 0], [0, 1, 0], [0.5, 0.5, 1], [0.5, 0.5, -1]])  # of a width: down, across, between these
NO_GRID = "points need a grid of three taxels a side at least: non-negative instead"
TOO_THIN = "under so thin a cover a frame hardly tells where on a taxel a load is: non-negative instead"


class Points:
    """Fits the frame that its scene last looked at; `loads` are those of a fit that stands, `drawing` their image.

    If `wary`, one load that may be two half a pitch apart is drawn only where the raw image is much worse anyway.
    """

    def __init__(self, scene: Scene, wary: bool = False) -> None:
        blur = scene.blur
        self._scene, self._wary = scene, wary
        response = blur.response if min(blur.frame_shape) >= MIN_SIDE else None
        self.unavailable = NO_GRID if response is None else ""  # why no points are ever fitted
        self._fitter: Fitter | None = None
        if response is not None and response.sensitivity() < MIN_SENSITIVITY:
            self.unavailable = TOO_THIN
        elif response is not None:
            self._fitter = Fitter(response, scene.noise, scene.cut)
            self._load_width = response.side**2 / 6  # of a load itself, which is no point
        self._frame: Image  # flat, the last
        self._unexplained = np.empty(scene.flat.size, np.float32)
        self._peeled = np.empty(blur.surface_shape, np.float32)
        self._ones = np.ones(self._peeled.size, np.float32)
        self._refine = blur.surface_shape[0] // blur.frame_shape[0]
        self.drawing = PointImage(blur.surface_shape, self._refine, scene.noise)
        self._model = 0.0  # kPa^2, summed over taxels: what the model may miss this frame by
        self.loads: PointLoads | None = None
        self._steps = 0  # made from the same start
        self._cuts = self._pause = 0  # frames in a row whose fit was cut short; frames to come without a fit
        self._before: tuple[Floats, float] | None = None  # places and width of a fit that stood or was cut short

    def __call__(self, y: Image, image: Image) -> int:
        """Fit points to a frame, starting from an image without negative values; gives the steps made, or 0.

        A fit is refused if it leaves more than noise, or if a point's place, force or smallness is uncertain.
        """
        self.loads = None
        if self._fitter is None:
            return 0
        y = self._frame = y.reshape(-1)
        self._model = MODEL_ERROR**2 * float(y.dot(y))
        if self._pause:
            self._pause -= 1
            return 0
        before, self._before = self._before, None
        done = self._fits(*before, image) if before else 0
        if self.loads is None and not self._scene.cut_short and (places := self._peaks(image)):
            done += self._fits(np.array(places), 0.0, image)
        self._cuts = self._cuts + 1 if self._scene.cut_short and not self.loads else 0
        if self._cuts == MAX_CUTS:
            self._cuts, self._pause = 0, PAUSE_FRAMES
        return done if self.loads else 0

    def _fits(self, places: Floats, width: float, image: Image) -> int:
        """Fit loads from places on; gives the steps made, MAX_STEPS at most."""
        self._steps = 0
        self._fit(places, width, image)
        return self._steps

    def _fit(self, places: Floats, width: float, image: Image) -> None:
        """Fit as many points as there are places, or one more."""
        del width
        assert self._fitter is not None
        fit = self._try(self._fitter, places, 0.0)
        if fit is not None and len(fit.force) < MAX_POINTS:
            self._try(self._fitter, self._split(self._fitter, fit, image), 0.0)

    def _try(self, fitter: Fitter, places: Floats, width: float) -> Fit | None:
        """Fit loads of a width at places and keep them if they stand; gives a fit that another may improve on."""
        done, fit = fitter(self._frame, places, self._model, MAX_STEPS - self._steps)
        self._steps += done
        cut = self._scene.cut()
        if fit is not None and not cut:
            self.loads = self._accepted(fitter, fit, width)
        if cut or self.loads:
            self._before = self.loads.places if self.loads else fitter.places, width
        return None if cut or self.loads else fit

    def _peaks(self, image: Image) -> list[tuple[float, float]]:
        """Places (row, column, in pitches) of an image's peaks; empty if they are too many or too wide."""
        k, flat = self._refine, image.reshape(-1)
        total, squares = float(flat.dot(self._ones)), float(flat.dot(flat))
        spread = total**2 / (MAX_SPREAD_CELLS * k**2 * squares) if squares else np.inf  # over so many points
        if spread > MAX_POINTS:
            return []
        self._peeled[...] = image
        places: list[tuple[float, float]] = []
        remainder = total
        while remainder > MAX_REMAINDER * total and len(places) < MAX_POINTS:
            i, j = divmod(int(self._peeled.argmax()), image.shape[1])
            top, start = max(i - k, 0), max(j - k, 0)
            around = self._peeled[top : i + k + 1, start : j + k + 1]
            weight = float(around.sum())
            rows, columns = np.arange(around.shape[0]), np.arange(around.shape[1])
            row = top + float(around.sum(axis=1) @ rows) / weight
            column = start + float(around.sum(axis=0) @ columns) / weight
            around[...] = 0
            remainder -= weight
            places.append(((row + 0.5) / k - 0.5, (column + 0.5) / k - 0.5))
        if remainder > MAX_OUTSIDE * total or spread > len(places) or _neighbours(places) > MAX_NEIGHBOURS:
            return []
        return places

    def _split(self, fitter: Fitter, fit: Fit, image: Image) -> Floats:
        """Give the places, the one that leaves most behind split in two along the image's longer axis there."""
        k = self._refine
        energy = fitter.residual.reshape(fitter.shape) ** 2
        worst = int(np.argmax([_window(energy, each, 1).sum() for each in fit.places]))
        window = _window(image, (fit.places[worst] + 0.5) * k - 0.5, k)
        y, x = (each.astype(float) / k for each in np.mgrid[: window.shape[0], : window.shape[1]])
        weight = window / max(float(window.sum()), 1e-30)
        y -= (y * weight).sum()
        x -= (x * weight).sum()
        mixed = (x * y * weight).sum()
        _, axes = np.linalg.eigh([[(y * y * weight).sum(), mixed], [mixed, (x * x * weight).sum()]])
        pair = fit.places[worst] + 0.5 * np.array([axes[:, -1], -axes[:, -1]])
        return fitter.within(np.concatenate([np.delete(fit.places, worst, axis=0), pair]))

    def _accepted(self, fitter: Fitter, fit: Fit, width: float) -> PointLoads | None:
        """Draw and give what stands, each load allowed a width of its own; None where anything is uncertain."""
        del width
        n = len(fit.force)
        normal, right = fit.isotropic()
        inverse = np.linalg.inv(normal)
        noise, free = self._scene.noise**2, max(fitter.residual.size - 4 * n, 1)
        widths = inverse[3 * n :] @ right
        spread = np.maximum(inverse.diagonal()[3 * n :], 1e-30)
        common = max(float(widths @ (1 / spread) / (1 / spread).sum()), 0.0)
        last = self._last_step(normal, right, common)
        residual = fit.residual + float(last @ (normal @ last - 2 * right))
        if residual > noise * (free + RESIDUAL_SIGMAS * sqrt(2 * free)) + self._model:
            return None
        variance = max(residual / free, noise)
        width_variance = variance / float((1 / spread).sum())
        if common + WIDTH_SIGMAS * sqrt(width_variance) > MAX_WIDTH:
            return None
        if (widths - LENGTH_SIGMAS * np.sqrt(spread * variance)).max() > common + MAX_WIDTH_SURPLUS:
            return None
        own = fit.widths()
        if _longest(*own, LENGTH_SIGMAS * sqrt(variance)) > common + MAX_LENGTH_SURPLUS:
            return None
        if self._leaves_signal(fitter, fit, last):
            return None
        force, *shift = last[: 3 * n].reshape(3, n)
        if np.abs(shift).max() > MAX_LAST_SHIFT or (np.abs(force) > MAX_LAST_STRETCH * fit.force).any():
            return None
        errors = np.linalg.inv(normal[: 3 * n, : 3 * n]).diagonal().reshape(3, n).T * variance
        too_uncertain = (errors[:, 0] > (MAX_FORCE_ERROR * fit.force) ** 2).any()
        if too_uncertain or errors[:, 1:].max() > (MAX_PLACE_ERROR) ** 2:
            return None
        loads = PointLoads(
            places=fitter.within(fit.places + np.stack(shift, axis=1)),
            force=np.maximum(fit.force + force, 0),
            spread=np.asarray(np.sqrt(np.maximum(errors[:, 1:], MIN_PLACE_ERROR**2) + common)),
            variance=np.asarray(errors),
            width=width_variance,
            noise=noise / variance,
        )
        self.drawing(loads)
        may_be_pair = _widest(*own, sqrt(variance)) > PAIR_WIDTH
        return None if self._wary and may_be_pair and self._raw_is_near() else loads

    def _last_step(self, normal: Floats, right: Floats, common: float) -> Floats:
        """The last step of all unknowns, every width held near the common one."""
        n, firm = len(right) // 4, self._scene.noise**2 / max(MAX_WIDTH_SURPLUS, self._load_width) ** 2
        normal, right = normal.copy(), right.copy()
        normal.flat[3 * n * (4 * n + 1) :: 4 * n + 1] += firm
        right[3 * n :] += firm * common
        return np.asarray(np.linalg.solve(normal, right), float)

    def _raw_is_near(self) -> bool:
        """Whether the raw image may be nearer to the truth than the points just drawn, were one of them two."""
        y, image, k = self._frame, self.drawing.image, self._refine
        rows, columns = self._scene.blur.frame_shape
        square = float(np.vdot(image, image))
        both = float(np.einsum("ij,ikjl->", y.reshape(rows, columns), image.reshape(rows, k, columns, k)))
        missed = k**2 * float(y.dot(y)) - 2 * both + square
        return missed < (RAW_ERROR) ** 2 * square

    def _leaves_signal(self, fitter: Fitter, fit: Fit, last: Floats) -> bool:
        """Whether a fit leaves more than noise about one of its loads: all of a frame would hide that."""
        n = len(fit.force)
        moved = last * np.concatenate([np.ones(n), *[fit.force] * 3])
        moved = np.concatenate([moved, moved[3 * n :]]).astype(np.float32)  # a width is the same down and across
        np.subtract(fitter.residual, moved @ fitter.jacobian[: 5 * n], out=self._unexplained)
        unexplained = self._unexplained.reshape(fitter.shape)
        noise = self._scene.noise**2
        about = (_window(unexplained, each, 1) for each in fit.places)
        return any(
            float(np.vdot(each, each))
            > noise * (each.size + NEIGHBOURHOOD_SIGMAS * sqrt(2 * each.size)) + self._model
            for each in about
        )


def _neighbours(places: list[tuple[float, float]]) -> float:
    """How many others a peak has whose neighbourhood touches its own, in the mean."""
    at = np.array(places)
    touching = np.abs(at[:, None] - at).max(axis=-1) < TOUCHING
    return float(touching.sum() / len(at) - 1)


def _longest(own: Floats, covariance: Floats, sigmas: float) -> float:
    """Width (square pitches) that a load surely has along its longest axis; much of it, and it may be two.

    `sigmas`: how many deviations of a noise of 1 count as more than noise.
    """
    _, axes = np.linalg.eigh(own[[[0, 2], [2, 1]]].T)
    u, v = axes[..., -1].T
    along = np.stack([u * u, v * v, 2 * u * v])
    error = np.sqrt(np.maximum(np.einsum("in,injn,jn->n", along, covariance, along), 1e-30))
    return float(((own * along).sum(axis=0) - sigmas * error).max())


def _widest(own: Floats, covariance: Floats, noise: float) -> float:
    """Width (square pitches) that a load may have along an axis: what is estimated and a deviation of noise."""
    error = np.sqrt(np.maximum(np.einsum("ai,injn,aj->an", AXES, covariance, AXES), 1e-30))
    return float((AXES @ own + noise * error).max())


def _window(image: Image, middle: Floats, reach: int) -> Image:
    """Give the part of an image within `reach` cells of a place, as far as it lies inside."""
    i, j = (min(max(round(at), 0), n - 1) for at, n in zip(middle.tolist(), image.shape, strict=True))
    return image[max(i - reach, 0) : i + reach + 1, max(j - reach, 0) : j + reach + 1]
