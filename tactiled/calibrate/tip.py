"""Presses with a small tip; each one's force and place are solved for."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tactiled.calibrate.cover_search import Touch, differences, search
from tactiled.calibrate.likelihood import Likelihood, Model, Prior, Readings, Solution, Spectrum, pooled
from tactiled.calibrate.presses import Press, usable_presses
from tactiled.calibrate.touch_response import HARMONICS, Quadrature, TipResponse, tip_transform
from tactiled.cover.family import CoverFamily
from tactiled.cover.stack import Stack
from tactiled.errors import ConfigError
from tactiled.geometry import Array

Floats = NDArray[np.float64]

UNKNOWN_TIP_DEVIATION = 1.0  # of the logarithm of an unknown tip's radius, about half a pitch
PLACE_ERROR_PITCHES = 0.1  # standard deviation of a place that is given
CALIPER_ERROR_MM = 0.02  # standard deviation of a measured diameter
SUSPECT_PULL = 2.0  # standard deviations that a fit is off the measured diameter, from which another is tried
SUSPECT_MISFIT = 1.2  # times noise and gain errors, the same
MAX_MISFIT = 1.5  # with another diameter: above it gains or layers are wrong, and the tip may be right
MAX_DIFFERENCE = 3.0  # standard deviations between the measured diameter and the presses'
MIN_PRESSES = 3


@dataclass(frozen=True, slots=True)
class Tip:
    """What presses: evenly on a disc, or as a sphere does (Hertz), of a contact diameter (mm), None: unknown."""

    diameter_mm: float | None = None
    error_mm: float = CALIPER_ERROR_MM  # standard deviation of the diameter
    sphere: bool = False

    def radius_prior(self, pitch: float) -> tuple[float, float]:
        """Mean and standard deviation of the logarithm of the radius (mm)."""
        if self.diameter_mm is None:
            return float(np.log(pitch / 2)), UNKNOWN_TIP_DEVIATION
        return float(np.log(self.diameter_mm / 2)), self.error_mm / self.diameter_mm


@dataclass(frozen=True, eq=False)
class TipModel(Model):
    """Readings under a tip of each press's own force (kPa mm^2) and place (mm)."""

    response: TipResponse

    def __call__(self, shared: Floats, own: Floats) -> tuple[Floats, Floats, Floats]:
        """The model (M,), its slopes in what is shared (M, S), and in force and place (M, 3)."""
        force, place = own[self.press, :1], own[self.press, 1:]
        response, gradient = self.response(differences(self.spectrum, shared), self.positions - place)
        return (
            force[:, 0] * response[:, 0],
            force * response[:, 1:],
            np.hstack([response[:, :1], -force * gradient]),
        )


@dataclass(frozen=True, eq=False)
class TipTouch(Touch):
    """Presses with one tip; they share the logarithm of its radius (mm), too."""

    tip: Tip

    def transform(self, q: Floats, shared: Floats) -> Floats:
        """Transform of the tip (n,)."""
        return tip_transform(q, float(np.exp(shared[1])), self.tip.sphere)

    def model(self, nodes: Quadrature, spectrum: Spectrum, readings: Readings, coarse: bool = False) -> TipModel:
        """The model of `readings`; a coarse one takes apertures for round."""
        response = TipResponse(self.array, nodes, 1 if coarse else HARMONICS)
        return TipModel(self.array.positions[readings.taxel], readings.press, spectrum, response)

    def size_note(self, solution: Solution, misfit: float) -> str:
        """Whether the presses are explained by another tip than the measured one, and not by that."""
        measured, deviation = float(self.prior.shared[1]), float(self.prior.shared_deviation[1])
        if self.tip.diameter_mm is None or deviation == 0:
            return ""
        pull = abs(float(solution.shared[1]) - measured) / deviation
        if pull <= SUSPECT_PULL and misfit <= SUSPECT_MISFIT:
            return ""
        radius, unknown = Tip().radius_prior(self.array.pitch)
        shared, free = np.array([0.0, radius]), np.array([np.inf, unknown])
        fitted = search(replace(self, prior=replace(self.prior, shared=shared, shared_deviation=free)))
        lowest = max(1.0, pooled(fitted.likelihood.misfits(fitted.solution)))
        own = lowest * float(np.sqrt(np.linalg.pinv(fitted.solution.information)[1, 1]))
        offset = abs(float(fitted.solution.shared[1]) - measured) / np.hypot(own, deviation)
        if lowest > MAX_MISFIT or max(pull / misfit, offset) <= MAX_DIFFERENCE:
            return ""
        factor, radius = np.exp(fitted.solution.shared)
        depth = factor * self.family.configured.depth
        other = f"a tip of {2 * radius:.2g} mm, not {self.tip.diameter_mm:g} mm, under a cover of {depth:.3g} mm"
        return f"the presses look like those of {other}: measure it again, or leave it out (--tip-mm 0)"

    def near(self, reach: float, depth: float) -> NDArray[np.bool_]:
        """Readings (K, N) within `reach` of a press's place."""
        del depth
        offsets = self.array.positions[None] - self.prior.own[:, None, 1:]
        return np.asarray(np.linalg.norm(offsets, axis=-1) < reach)

    def on_line(self, likelihood: Likelihood, solution: Solution) -> tuple[Floats, Floats]:
        """Each reading's distance (M,) in mm from the tip's middle, and the response there (kPa)."""
        press, places = likelihood.readings.press, solution.own[:, 1:]
        middle = replace(likelihood.model, positions=places, press=np.arange(len(places)))
        peaks = middle(solution.shared, solution.own)[0]
        return np.linalg.norm(likelihood.model.positions - places[press], axis=1), peaks[press]


def tip_touch(
    presses: Sequence[Press],
    array: Array,
    configured: Stack,
    tip: Tip,
    gain_error: Floats | float,
    places_mm: Floats | None = None,
) -> TipTouch:
    """Make the usable `presses` ready to be fitted; ConfigError for too few, or a tip wider than the array.

    `gain_error`: relative standard deviation of taxels' gains, (N,) or of all. `places_mm` (K, 2), of all presses,
    where they are known to a standard deviation of PLACE_ERROR_PITCHES.
    """
    usable = usable_presses(presses, MIN_PRESSES, f"press at least {MIN_PRESSES} times, better 20")
    width = float(np.ptp(array.positions, axis=0).min()) + array.pitch
    if tip.diameter_mm is not None and not 0 < tip.diameter_mm < width:
        raise ConfigError(
            f"the tip is {tip.diameter_mm:g} mm wide: give more than 0 and less than the array's {width:g} mm"
        )
    own = np.array([(1e3 * presses[at].force_n, *presses[at].place_mm) for at in usable])
    deviation = np.full(own.shape, np.inf)
    if places_mm is not None:
        if len(places_mm) != len(presses):
            raise ConfigError(f"{len(places_mm)} places are given, and there are {len(presses)} presses")
        own[:, 1:] = places_mm[usable]
        deviation[:, 1:] = PLACE_ERROR_PITCHES * array.pitch
    radius, uncertainty = tip.radius_prior(array.pitch)
    prior = Prior(np.array([0.0, radius]), np.array([np.inf, uncertainty]), own, deviation)
    gain = np.broadcast_to(np.asarray(gain_error, float), (array.size,))
    return TipTouch(array, CoverFamily(configured), tuple(presses[at] for at in usable), gain, prior, tip)
