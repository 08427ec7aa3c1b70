"""A few isolated indenters: where each of them is, below the pitch, and how hard it presses.

Their places are read off the non-negative image and refined, with the forces, by Gauss-Newton on the responses of
loads anywhere between the taxels. The answer stands only if it leaves nothing but noise behind.
"""

from math import sqrt
from typing import NamedTuple

import numpy as np

from tactiled.restore.drawing import MODEL, NEAREST, Drawing, Told
from tactiled.restore.loads import Loads
from tactiled.restore.modes import Floats, Image
from tactiled.restore.scene import Scene

MOST = 8  # points
STEPS = 12  # for one number of points, at most
GIVEN = 3  # steps, after which one that takes off less than
PROMISE = 0.2  # of the residual's square, while that is
FAR_OFF = 4.0  # times what noise leaves, is the last
SPLITS = 1  # times that a point which leaves too much behind is taken for two
DAMPING = 0.03  # of a point's response, per square pitch, at first
EASE = 0.3  # times the damping after a step that helped
EARNED = 2.0  # of the noise's variance: a step that takes less off the residual's square is the last
SETTLED = 0.01  # pitches: a step that moves no point further is the last
LEAP = 0.5  # pitches that one step may move a point
STANDS = 4.0  # standard deviations that a point's force must stand out by
SURE = 3.0  # standard deviations of the residual's square that noise may stray by
NEAR = 4.0  # the same about any one load: few taxels stray further
TELLING = 3.0  # times that must be what a quarter of a pitch changes of a load's frame, or no place is known
LEFT = 0.15  # of the image's pressure that may lie outside the neighbourhoods of its peaks
FEWEST = 3  # taxels a side that tell a place on it
SMALL = 0.05  # of the image's pressure: no more peaks are looked for once less is left
FLAT = 5.7  # cells that a point's pressure is spread over in an image of them, at most
WIDTH = 0.05  # square pitches of a load's variance along an axis: a disc of 0.45 pitch has it, and is no point
DOUBT = 3.0  # standard deviations that the width found must stay below that by
SURPLUS = 0.03  # square pitches of width by which points may differ
LENGTH = 0.02  # square pitches of width that a point may have along one axis above that: a longer one may be two
PAIR = 0.0625  # square pitches of width, at most, that two loads half a pitch apart have
MISSED = 0.6  # of the points' image, that the raw one misses: if more, points hardly do worse, though one were two
SEEN = 2.0  # standard deviations beyond these: one so wide is two
FIRM = 0.25  # pitches that the last step may move a point: it is linear, and holds no further
STRETCH = 0.5  # of a force that it may change
UNSURE = 0.2  # of a force: one less certain is not told
RIDGE = 1e-6  # on every square, so that what no frame can tell apart is only very uncertain
FAR = 0.5  # pitches: a place less certain is not told
STAY = 1.5  # times further that these bounds reach for points that go on from those of the frame before
AXES = np.array([[1, 0, 0], [0, 1, 0], [0.5, 0.5, 1], [0.5, 0.5, -1]])  # of a width: down, across, between these
NO_GRID = "points need a grid of three taxels a side at least: non-negative instead"
TOO_THIN = "under so thin a cover a frame hardly tells where on a taxel a load is: non-negative instead"


class Point(NamedTuple):
    """One load: place (mm, x along a row and y down a column, from the first taxel's centre) and force (N)."""

    x_mm: float
    y_mm: float
    force_n: float


class Points:
    """Fits the frame that its scene last looked at; `found` holds the points of the fit that stood.

    If `wary`, one load that may be two half a pitch apart is told only where the raw image is much worse anyway.
    """

    def __init__(self, scene: Scene, wary: bool = False) -> None:
        self._scene, self._wary = scene, wary
        self._frame: Image  # flat, the last
        self._loads: Loads | None = scene.blur.loads if min(scene.blur.frame_shape) >= FEWEST else None
        self.never = NO_GRID if self._loads is None else ""  # why none is ever told
        if self._loads and self._loads.stir() < TELLING * MODEL:
            self._loads, self.never = None, TOO_THIN
        size = scene.flat.size
        self._jacobian = np.empty((6 * MOST, size), np.float32)
        self._residual, self._behind = np.empty((2, size), np.float32)
        self._peeled = np.empty(scene.blur.surface_shape, np.float32)
        self._ones = np.ones(self._peeled.size, np.float32)
        self._refine = scene.blur.surface_shape[0] // scene.blur.frame_shape[0]
        self.drawing = Drawing(scene.blur.surface_shape, self._refine, scene.noise)
        self._play = self._loads.side**2 / 6 if self._loads else 0.0  # of a load's width: it is no point itself
        self._model = 0.0  # kPa^2, summed over taxels: what the model may miss this frame by
        self._last: Floats | None = None  # places
        self.found: tuple[Point, ...] = ()

    def __call__(self, y: Image, image: Image) -> int:
        """Fit points to a frame, starting from an image without negative values; gives the steps made, or 0.

        A fit that leaves more than noise, or points whose place, force or smallness is uncertain, is none.
        """
        self.found = ()
        if self._loads is None:
            return 0
        y = self._frame = y.reshape(-1)
        self._model = MODEL**2 * float(y.dot(y))
        done, told = 0, None
        if self._last is not None:
            done, fit = self._refined(y, self._last)
            told = self._told(fit, STAY)
        places = None if told else self._peaks(image)
        if places:
            more, told = self._anew(y, np.array(places), image)
            done += more
        self._last = told.places if told else None
        if told is None:
            return 0
        pitch = self._scene.blur.cell_mm * self._refine
        self.found = tuple(
            Point(column * pitch, row * pitch, 1e-3 * force * pitch**2)
            for (row, column), force in zip(told.places.tolist(), told.force.tolist(), strict=True)
        )
        return done

    def _anew(self, y: Image, places: Floats, image: Image) -> tuple[int, Told | None]:
        """Fit as many points as an image has peaks, or one more; gives the steps made and what is told."""
        done, fit = self._refined(y, places)
        told = self._told(fit)
        for _ in range(SPLITS):
            if told or fit is None or len(fit.force) == MOST:
                break
            more, fit = self._refined(y, self._split(fit, image))
            told = self._told(fit)
            done += more
        return done, told

    def reset(self) -> None:
        """Forget the points of the frame before."""
        self._last, self.found = None, ()

    def _peaks(self, image: Image) -> list[tuple[float, float]]:
        """Places (row, column, in pitches) of an image's peaks; empty if they are too many or too wide."""
        k, flat = self._refine, image.reshape(-1)
        total, squares = float(flat.dot(self._ones)), float(flat.dot(flat))
        if total**2 > FLAT * MOST * k**2 * squares or not squares:
            return []
        self._peeled[...] = image
        places: list[tuple[float, float]] = []
        left = total
        while left > SMALL * total and len(places) < MOST:
            i, j = divmod(int(self._peeled.argmax()), image.shape[1])
            top, start = max(i - k, 0), max(j - k, 0)
            near = self._peeled[top : i + k + 1, start : j + k + 1]
            weight = float(near.sum())
            rows, columns = np.arange(near.shape[0]), np.arange(near.shape[1])
            row = top + float(near.sum(axis=1) @ rows) / weight
            column = start + float(near.sum(axis=0) @ columns) / weight
            near[...] = 0
            left -= weight
            places.append(((row + 0.5) / k - 0.5, (column + 0.5) / k - 0.5))
        return places if left <= LEFT * total and total**2 <= FLAT * len(places) * k**2 * squares else []

    def _refined(self, y: Image, places: Floats) -> tuple[int, "_Fit | None"]:
        """Give the steps made and the fit that they led to, by Levenberg's damped Gauss-Newton.

        Responses and residual are left as they are at that fit.
        """
        noise = self._scene.noise
        damping, fit = DAMPING, None
        done = 0
        while done < STEPS:
            done += 1
            A = self._responses(places)
            gram = np.asarray(A[0] @ A[0].T, float)
            force = _solve(gram, np.asarray(A[0] @ y, float))
            standing = force > STANDS * noise / np.sqrt(gram.diagonal())
            if not standing.all():
                fit, places = None, places[standing]
                if not len(places):
                    break
                continue
            left = self._leave(y, force)
            if fit is None or left <= fit.left:
                J, scale = A.reshape(6 * len(force), -1), np.concatenate([np.ones_like(force), *[force] * 5])
                normal, right = scale[:, None] * scale * (J @ J.T), scale * (J @ self._residual)
                gained = fit.left - left if fit else np.inf
                fit = _Fit(places, force, left, normal, right)
                damping *= EASE
                if gained < EARNED * (noise**2 + self._model / y.size):
                    break
                if (
                    done >= GIVEN
                    and gained < PROMISE * left
                    and left > FAR_OFF * (noise**2 * y.size + self._model)
                ):
                    return done, fit
            else:
                damping /= EASE**2
            step = fit.step(damping)
            if np.abs(step).max() < SETTLED:
                break
            places = self._within(fit.places + np.clip(step, -LEAP, LEAP))
        if fit is not None and left > fit.left:
            self._responses(fit.places)
            self._leave(y, fit.force)
        return done, fit

    def _leave(self, y: Image, force: Floats) -> float:
        """Put in place what is left of a frame, the loads' last responses taken off; gives its square."""
        size = y.size
        responses = self._jacobian[: len(force)].reshape(-1, size)
        np.subtract(y, force.astype(np.float32) @ responses, out=self._residual)
        return float(self._residual.dot(self._residual))

    def _split(self, fit: "_Fit", image: Image) -> Floats:
        """Give the places, the one that leaves most behind split in two along the image's longer axis there."""
        k = self._refine
        energy = self._residual.reshape(self._scene.blur.frame_shape) ** 2
        worst = int(np.argmax([_window(energy, each, 1).sum() for each in fit.places]))
        window = _window(image, (fit.places[worst] + 0.5) * k - 0.5, k)
        y, x = (each.astype(float) / k for each in np.mgrid[: window.shape[0], : window.shape[1]])
        weight = window / max(float(window.sum()), 1e-30)
        y -= (y * weight).sum()
        x -= (x * weight).sum()
        mixed = (x * y * weight).sum()
        _, axes = np.linalg.eigh([[(y * y * weight).sum(), mixed], [mixed, (x * x * weight).sum()]])
        pair = fit.places[worst] + 0.5 * np.array([axes[:, -1], -axes[:, -1]])
        return self._within(np.concatenate([np.delete(fit.places, worst, axis=0), pair]))

    def _responses(self, places: Floats) -> Image:
        assert self._loads is not None
        n = len(places)
        A = self._jacobian[: 6 * n].reshape(6, n, -1)
        self._loads.jacobian(places, A)
        return A

    def _within(self, places: Floats) -> Floats:
        rows, columns = self._scene.blur.frame_shape
        return np.clip(places, -0.5, (rows - 0.5, columns - 0.5))

    def _told(self, fit: "_Fit | None", reach: float = 1.0) -> Told | None:
        """Draw and give what stands, each load allowed a width of its own; None where anything is unsure."""
        if fit is None:
            return None
        n = len(fit.force)
        normal, right = fit.round()
        inverse = np.linalg.inv(normal)
        noise, free = self._scene.noise**2, max(self._residual.size - 4 * n, 1)
        width = inverse[3 * n :] @ right
        spread = np.maximum(inverse.diagonal()[3 * n :], 1e-30)
        common = max(float(width @ (1 / spread) / (1 / spread).sum()), 0.0)
        last = self._held(normal, right, common)
        left = fit.left + float(last @ (normal @ last - 2 * right))
        if left > noise * (free + reach * SURE * sqrt(2 * free)) + self._model:
            return None
        variance = max(left / free, noise)
        unsure = np.sqrt(spread * variance)
        doubt = variance / float((1 / spread).sum())
        if common + DOUBT * sqrt(doubt) > reach * WIDTH:
            return None
        if (width - SEEN * unsure).max() > common + reach * SURPLUS:
            return None
        widths = _widths(fit)
        if _longest(*widths, reach * SEEN * sqrt(variance)) > common + reach * LENGTH:
            return None
        if self._leaves(fit, last, reach):
            return None
        force, *shift = last[: 3 * n].reshape(3, n)
        if np.abs(shift).max() > reach * FIRM or (np.abs(force) > reach * STRETCH * fit.force).any():
            return None
        known = np.linalg.inv(normal[: 3 * n, : 3 * n]).diagonal().reshape(3, n).T * variance
        if (known[:, 0] > (reach * UNSURE * fit.force) ** 2).any() or known[:, 1:].max() > (reach * FAR) ** 2:
            return None
        places = self._within(fit.places + np.stack(shift, axis=1))
        spread = np.sqrt(np.maximum(known[:, 1:], NEAREST**2) + common)
        force = np.maximum(fit.force + force, 0)
        told = Told(places, force, np.asarray(spread), np.asarray(known), doubt, noise / variance)
        self.drawing(told)
        harmful = self._wary and self._raw_is_near(reach) and _widest(*widths, sqrt(variance)) > reach * PAIR
        return None if harmful else told

    def _raw_is_near(self, reach: float) -> bool:
        """Whether the raw image may be nearer to the truth than the points just drawn, were one of them two."""
        y, image, k = self._frame, self.drawing.image, self._refine
        rows, columns = self._scene.blur.frame_shape
        square = float(np.vdot(image, image))
        both = float(np.einsum("ij,ikjl->", y.reshape(rows, columns), image.reshape(rows, k, columns, k)))
        missed = k**2 * float(y.dot(y)) - 2 * both + square
        return missed < (MISSED / reach) ** 2 * square

    def _leaves(self, fit: "_Fit", last: Floats, reach: float) -> bool:
        """Whether a fit leaves more than noise about one of its loads: all of a frame would hide that."""
        n = len(fit.force)
        moved = last * np.concatenate([np.ones(n), *[fit.force] * 3])
        moved = np.concatenate([moved, moved[3 * n :]]).astype(np.float32)  # a width is the same down and across
        np.subtract(self._residual, moved @ self._jacobian[: 5 * n], out=self._behind)
        behind = self._behind.reshape(self._scene.blur.frame_shape)
        noise = self._scene.noise**2
        about = (_window(behind, each, 1) for each in fit.places)
        return any(
            float(np.vdot(each, each)) > noise * (each.size + reach * NEAR * sqrt(2 * each.size)) + self._model
            for each in about
        )

    def _held(self, normal: Floats, right: Floats, common: float) -> Floats:
        """The last step of all unknowns, every width held near the common one."""
        n, firm = len(right) // 4, self._scene.noise**2 / max(SURPLUS, self._play) ** 2
        held, drawn = normal.copy(), right.copy()
        held.flat[3 * n * (4 * n + 1) :: 4 * n + 1] += firm
        drawn[3 * n :] += firm * common
        return np.asarray(np.linalg.solve(held, drawn), float)


class _Fit(NamedTuple):
    places: Floats  # (n, 2), pitches
    force: Floats
    left: float  # of the frame, squared
    normal: Floats  # of n times force, row and column, then n times width down, across and both
    right: Floats

    def round(self) -> tuple[Floats, Floats]:
        """Give normal and right of n times force, row, column and a width that is the same down and across."""
        n = len(self.force)
        alike = np.eye(6 * n)[:, : 4 * n]
        alike[4 * n : 5 * n, 3 * n :] = np.eye(n)
        return _ridged(alike.T @ self.normal @ alike), self.right @ alike

    def step(self, damping: float) -> Floats:
        """Give the move (n, 2) of the points; the damping also holds those whose response is flat about them."""
        n = len(self.force)
        damped = self.normal[: 3 * n, : 3 * n].copy()
        stiff = np.tile(damped.diagonal()[:n], 3)
        stiff[:n] *= RIDGE
        stiff[n:] *= damping * np.tile(self.force**2, 2)
        damped.flat[:: 3 * n + 1] += stiff
        return np.asarray(np.linalg.solve(damped, self.right[: 3 * n])[n:].reshape(2, n).T, float)


def _widths(fit: _Fit) -> tuple[Floats, Floats]:
    """Give each load's own widths (3, n), down, across and both, and their covariance for a noise of 1."""
    n = len(fit.force)
    inverse = np.linalg.inv(_ridged(fit.normal))[3 * n :]
    covariance = np.asarray(inverse[:, 3 * n :], float)
    return np.asarray(inverse @ fit.right).reshape(3, n), covariance.reshape(3, n, 3, n)


def _longest(own: Floats, known: Floats, seen: float) -> float:
    """Width (square pitches) that a load surely has along its longest axis; much of it, and it may be two.

    `seen`: how many deviations of a noise of 1 count as more than noise.
    """
    _, axes = np.linalg.eigh(own[[[0, 2], [2, 1]]].T)
    u, v = axes[..., -1].T
    along = np.stack([u * u, v * v, 2 * u * v])
    doubt = np.sqrt(np.maximum(np.einsum("in,injn,jn->n", along, known, along), 1e-30))
    return float(((own * along).sum(axis=0) - seen * doubt).max())


def _widest(own: Floats, known: Floats, noise: float) -> float:
    """Width (square pitches) that a load may have along an axis: what is found and a deviation of noise."""
    doubt = np.sqrt(np.maximum(np.einsum("ai,injn,aj->an", AXES, known, AXES), 1e-30))
    return float((AXES @ own + noise * doubt).max())


def _window(image: Image, middle: Floats, reach: int) -> Image:
    """Give the part of an image within `reach` cells of a place, as far as it lies inside."""
    i, j = (min(max(round(at), 0), n - 1) for at, n in zip(middle.tolist(), image.shape, strict=True))
    return image[max(i - reach, 0) : i + reach + 1, max(j - reach, 0) : j + reach + 1]


def _solve(gram: Floats, right: Floats) -> Floats:
    """Least squares for the forces."""
    return np.asarray(np.linalg.solve(_ridged(gram), right), float)


def _ridged(normal: Floats) -> Floats:
    """Normal equations that can be solved, whatever the frame tells apart."""
    held = normal.copy()
    held.flat[:: len(normal) + 1] *= 1 + RIDGE
    return held
