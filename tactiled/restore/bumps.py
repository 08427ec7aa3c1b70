"""A few small indenters of any width: where each is, how hard it presses, and how wide it is.

Points are fitted first. Where they do not stand, bumps are: Gaussian loads about one common width, of a table the
nearest to what the frame shows, from which each load's own width differs a little.
"""

from math import sqrt
from typing import NamedTuple

import numpy as np

from tactiled.restore.modes import Floats, Image
from tactiled.restore.point_fit import MAX_POINTS, Fit, Fitter
from tactiled.restore.point_image import MIN_PLACE_ERROR, PointLoads
from tactiled.restore.points import (
    MAX_LAST_SHIFT,
    MAX_LAST_STRETCH,
    MAX_NEIGHBOURS,
    MAX_PLACE_ERROR,
    RESIDUAL_SIGMAS,
    Points,
)
from tactiled.restore.scene import Scene

# All chosen on random points, bumps, caps, lines and balls with stones, and on the scenes of
# `python -m tests.study judge --family first`.
WIDTHS = (0.0, 0.12, 0.25, 0.4, 0.6)  # square pitches: a load's variance along an axis
MAX_HOPS = 2  # from one of these to another
MAX_PREDICTED = 6.0  # times what noise leaves: a fit that predicts more is the last; one of 129 would have stood
FAR, MIDDLE = 2.0, 0.25  # times what noise leaves: so far from points, the width tried next (square pitches)
OWN_WIDTH, OWN_SHARE = 0.03, 0.4  # square pitches and share of the common width: deviation of the loads' own
MAX_WIDTH_ERROR = 0.1  # square pitches of the common width: of one less certain the shape is made up
MAX_FORCE_ERROR = 0.4  # of a force
WIDE = 0.08  # square pitches: loads so wide show their shape in the non-negative image,
MAX_DIFFERENCE = 0.45  # of their own norm that it may then differ by
MIN_SENSITIVITY = 0.1  # that a quarter of a pitch changes of a load's frame: less, and loads less wide are unsure
REACH = 4.0  # standard deviations of two loads together: nearer ones are neighbours


class Estimate(NamedTuple):
    """The last step of a fit's unknowns, with what is left and how certain it is."""

    step: Floats  # (4 n,) of n times force, row, column and width
    force: Floats
    shift: Floats  # (n, 2) pitches
    width: Floats  # (n,) square pitches, each load's own
    common: float  # their common width
    residual: float  # of the frame, squared
    variance: Floats  # (n, 3) of force and place for a noise of 1
    common_variance: float  # the same of the common width


class Bumps(Points):
    """Points, or else bumps: in the place of Points, with the same `loads` and `drawing`."""

    def __init__(self, scene: Scene, wary: bool = False) -> None:
        super().__init__(scene, wary)
        self._fitters = {} if self._fitter is None else {0.0: self._fitter}
        self._image: Image  # the non-negative one
        response = scene.blur.response
        self._sensitive = response is not None and response.sensitivity() >= MIN_SENSITIVITY

    def prepare(self) -> None:
        """Make now what loads of any width need."""
        for width in WIDTHS if self._fitters else ():
            self._fitter_of(width)

    def _fitter_of(self, width: float) -> Fitter:
        if width not in self._fitters:
            response, first = self._scene.blur.response, self._fitters[0.0]
            assert response is not None
            fitter = Fitter(response.widened(width), self._scene.noise, self._scene.cut)
            fitter.jacobian, fitter.residual = first.jacobian, first.residual  # none outlives the next fit
            self._fitters[width] = fitter
        return self._fitters[width]

    def _fit(self, places: Floats, width: float, image: Image) -> None:
        """Fit as many loads as there are places, or one more, of a width or the one that the frame shows."""
        self._image, fitter = image, self._fitter_of(width)
        fit = self._try(fitter, places, width)
        for _ in range(MAX_HOPS):
            if fit is None or (nearest := self._nearest(fit, width)) == width:
                break
            width, fitter = nearest, self._fitter_of(nearest)
            fit = self._try(fitter, fit.places, width)
        if fit is not None and len(fit.force) < MAX_POINTS:
            super()._try(fitter, self._split(fitter, fit, image), width)

    def _try(self, fitter: Fitter, places: Floats, width: float) -> Fit | None:
        """Fit loads of a width at places and keep them if they stand; gives a fit that another may improve on.

        From a width, though not from points, a fit predicts well what the next one leaves.
        """
        fit = super()._try(fitter, places, width)
        if fit is not None and width > 0 and fit.predicted() > MAX_PREDICTED * self._expected():
            return None
        return fit

    def _expected(self) -> float:
        """Square of what the noise and the model's error leave of the frame (kPa^2)."""
        return self._scene.noise**2 * self._unexplained.size + self._model

    def _nearest(self, fit: Fit, width: float) -> float:
        """Which of WIDTHS is nearest to the common width that a fit about `width` shows."""
        total = width + _common_width(fit)[2]
        if width == 0 and fit.residual > FAR * self._expected():
            total = MIDDLE
        return min(WIDTHS, key=lambda each: abs(each - total))

    def _accepted(self, fitter: Fitter, fit: Fit, width: float) -> PointLoads | None:
        """Draw and give what stands of a fit, as points or as bumps."""
        points = super()._accepted(fitter, fit, width) if width == 0 else None
        if points or self._nearest(fit, width) != width:
            return points
        return self._accepted_bumps(fitter, fit, width)

    def _accepted_bumps(self, fitter: Fitter, fit: Fit, base: float) -> PointLoads | None:
        """Draw and give what stands of a fit about a width; None where anything is uncertain."""
        noise, last = self._scene.noise**2, _estimate(fit, base, self._scene.noise**2)
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
        if last.common_variance * variance > MAX_WIDTH_ERROR**2:
            return None
        loads = PointLoads(
            places=fitter.within(fit.places + last.shift),
            force=np.maximum(fit.force + last.force, 0),
            spread=np.asarray(np.sqrt(np.maximum(errors[:, 1:], MIN_PLACE_ERROR**2) + last.width[:, None])),
            variance=errors,
            width=last.common_variance * variance,
            noise=noise / variance,
        )
        crowded = _neighbours(loads.places, (loads.spread**2).mean(axis=1)) > MAX_NEIGHBOURS
        if crowded or self._leaves_signal(fitter, fit, last.step):
            return None
        self.drawing(loads)
        return loads if self._shows(last.common) else None

    def _shows(self, width: float) -> bool:
        """Whether what was just drawn, of a common width, agrees with the non-negative image where that tells."""
        if width <= WIDE:
            return self._sensitive and not (self._wary and self._raw_is_near())
        image = self.drawing.image
        return float(np.linalg.norm(image - self._image)) <= MAX_DIFFERENCE * float(np.linalg.norm(image))


def _common_width(fit: Fit) -> tuple[Floats, Floats, float, float]:
    """Give a fit's isotropic normal and right, the loads' common width, and its variance for a noise of 1."""
    n = len(fit.force)
    normal, right = fit.isotropic()
    inverse = np.linalg.inv(normal)
    weight = 1 / np.maximum(inverse.diagonal()[3 * n :], 1e-30)
    total = float(weight.sum())
    return normal, right, float(inverse[3 * n :] @ right @ weight) / total, 1 / total


def _estimate(fit: Fit, base: float, noise: float) -> Estimate:
    """The last step of all unknowns of a fit about a width, each load's own held near the common one."""
    n = len(fit.force)
    normal, right, common, common_variance = _common_width(fit)
    common = max(common, -base)
    firm = noise / (OWN_WIDTH + OWN_SHARE * (base + common)) ** 2
    stiff, pull = normal.copy(), right.copy()
    stiff.flat[3 * n * (4 * n + 1) :: 4 * n + 1] += firm
    pull[3 * n :] += firm * common
    inverse = np.linalg.inv(stiff)
    last = inverse @ pull
    force, row, column, width = last.reshape(4, n)
    return Estimate(
        step=last,
        force=force,
        shift=np.stack([row, column], axis=1),
        width=np.maximum(base + width, 0),
        common=base + common,
        residual=fit.residual + float(last @ (normal @ last - 2 * right)),
        variance=np.asarray(inverse.diagonal()[: 3 * n].reshape(3, n).T),
        common_variance=common_variance,
    )


def _neighbours(places: Floats, width: Floats) -> float:
    """How many others a load has within its REACH, in the mean."""
    apart = ((places[:, None] - places) ** 2).sum(axis=-1)
    return float((apart <= REACH**2 * (width[:, None] + width)).sum() / len(width) - 1)
