"""Presses with a small tip; each one's force and place are solved for."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tactiled.arrays import Floats, Mask
from tactiled.calibrate.cover.likelihood import Likelihood, Model, Prior, Readings, Solution, Spectrum
from tactiled.calibrate.cover.presses import Press, usable_presses
from tactiled.calibrate.cover.search import Touch, differences
from tactiled.calibrate.cover.touch_response import HARMONICS, PROFILES, Quadrature, TipResponse, tip_transform
from tactiled.calibrate.cover.unknowns import CALIPER_ERROR_MM, PROFILE, SHARED, SIZE, USUAL, Unknowns
from tactiled.cover.family import CoverFamily
from tactiled.cover.stack import Stack
from tactiled.errors import ConfigError
from tactiled.geometry import Array

SPHERE = 0.5  # exponent of its pressure's profile on a thick cover
UNKNOWN_TIP_DEVIATION = 1.0  # of the logarithm of an unknown tip's radius, about half a pitch
PLACE_ERROR_PITCHES = 0.1  # standard deviation of a place that is given
MIN_PRESSES = 3


@dataclass(frozen=True, slots=True)
class Tip:
    """What presses: a flat tip, or a sphere, of a contact diameter (mm), None: unknown."""

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
        spectra = differences(self.spectrum, shared, self.free)
        response, gradient = self.response(spectra, self.positions - place)
        own = np.hstack([response[:, :1], -force * gradient])
        return self.bent(shared, force[:, 0] * response[:, 0], force * response[:, 1:], own)


@dataclass(frozen=True, eq=False)
class TipTouch(Touch):
    """Presses with one tip; they share the logarithm of its radius (mm), too."""

    tip: Tip

    def transform(self, q: Floats, size: float, profile: float) -> Floats:
        """Transform of the tip (n,)."""
        return tip_transform(q, float(np.exp(size)), float(np.clip(profile, *PROFILES)))

    def model(self, nodes: Quadrature, spectrum: Spectrum, readings: Readings, coarse: bool = False) -> TipModel:
        """The model of `readings`; a coarse one takes apertures for round."""
        response = TipResponse(self.array, nodes, 1 if coarse else HARMONICS, self.scales)
        positions, highest = self.array.positions[readings.taxel], float(readings.value.max())
        return TipModel(positions, readings.press, spectrum, response, self.free, highest)

    def near(self, reach: float, depth: float) -> Mask:
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
    unknowns: Unknowns = USUAL,
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
    shared = np.zeros(SHARED)
    shared[SIZE], shared[PROFILE] = radius, SPHERE if tip.sphere else 0.0
    prior = Prior(shared, unknowns.deviations(array, uncertainty, unknowns.profile), own, deviation)
    gain = np.broadcast_to(np.asarray(gain_error, float), (array.size,))
    return TipTouch(array, CoverFamily(configured), tuple(presses[at] for at in usable), gain, prior, tip)
