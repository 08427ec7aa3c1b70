"""The linear answer: Wiener's filter in the blur's own modes, for the spectrum that the frame itself shows.

The filter minimises E|x - W y|^2 for pressure x of spectrum S, white noise and a gain h whose model has the
variance m: W = h S / (h^2 S + sigma^2 + m S). On a grid, modes that stand out of the spectrum have their own S.
"""

from math import prod, sqrt

import numpy as np

from tactiled.arrays import Floats, Floats32
from tactiled.core import coefficients
from tactiled.restore.narrow_band import NarrowBand
from tactiled.restore.prior import Kept, kept
from tactiled.restore.scene import Scene


def wiener_weight(scene: Scene) -> Floats:
    """W of every taxel mode for the scene's spectrum, in units of the noise."""
    h, S = scene.modes.gain, scene.spectrum.ratio[scene.modes.head]
    return np.asarray(h * S / (h**2 * S + 1 + scene.gain_variance * S))


Sums = tuple[float, float, float, float]


class Filter:
    """One spectrum's filter, with the total force and the noise that it leaves."""

    def __init__(self, scene: Scene, band: NarrowBand | None) -> None:
        modes = scene.modes
        weight = wiener_weight(scene)
        self.weight = np.asarray(weight, np.float32)
        self.missed = np.asarray(scene.ones - scene.reach * weight.ravel(), np.float32)
        self._changed = np.asarray((weight * (1 - modes.gain)).ravel() ** 2, np.float32)
        self.noise_gain = sqrt(float((weight**2).sum()) / prod(scene.blur.surface_shape))
        expected = modes.gain**2 * scene.spectrum.ratio[modes.head]
        self.limit = band.limit(expected) if band else None  # of each mode's power, over that of the noise

    def correction(self, power: Floats32) -> float:
        """How much the cover took from the frame (kPa^2, summed over taxels), from the power of its modes."""
        return float(self._changed.dot(power))


class Wiener:
    """Restores the frame that its scene last looked at; `noise_gain` is the image's, noise over the frame's."""

    def __init__(self, scene: Scene) -> None:
        modes = scene.modes
        self._scene = scene
        arrays = scene.ones, scene.reach, modes.gain, modes.frequency, scene.gain_variance
        self._filters: Kept[Filter] = kept("filter", *arrays, np.array(scene.blur.surface_shape))
        self._band = NarrowBand(modes, scene.noise, scene.gain_variance) if modes.gain.ndim == 2 else None
        self._synthesise = modes.head_to_surface()
        self._modes, self._image = np.empty_like(scene.c), self._synthesise.empty()
        self.noise_gain = 0.0
        self._sums: Sums | None = None

    def filter(self) -> Filter:
        """Give the filter of the scene's spectrum, made when that spectrum is first met."""
        return self._filters(self._scene.spectrum, lambda: Filter(self._scene, self._band))

    def __call__(self) -> Floats32:
        """Give the surface pressure, total force kept; may be negative."""
        scene, filter_, band = self._scene, self.filter(), self._band
        if band and filter_.limit is not None and band(scene.squares, filter_.limit, filter_.weight):
            weight = band.weight.reshape(-1)
            np.multiply(scene.c, band.weight, out=self._modes)
            missed = scene.force - float(scene.reach.dot(self._modes.reshape(-1)))
            self.noise_gain = sqrt(float(weight.dot(weight)) / self._image.size)
        else:
            np.multiply(scene.c, filter_.weight, out=self._modes)
            missed, self.noise_gain = float(filter_.missed.dot(scene.flat)), filter_.noise_gain
        scale = scene.force_scale(missed)
        if scale != 1.0:
            np.multiply(self._modes, np.float32(scale), out=self._modes)
        self._sums = None
        return self._synthesise(self._modes, self._image)

    @property
    def sums(self) -> Sums:
        """Of the last image, as by `coefficients.signed_sums`."""
        if self._sums is None:
            self._sums = coefficients.signed_sums(self._image.reshape(len(self._image), -1))
        return self._sums
