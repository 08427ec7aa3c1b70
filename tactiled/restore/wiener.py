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


class Filter:
    """One spectrum's filter, and the noise that it leaves."""

    def __init__(self, scene: Scene, band: NarrowBand) -> None:
        modes, weight = scene.modes, wiener_weight(scene)
        expected = modes.gain**2 * scene.spectrum.ratio[modes.head]
        self.of_spectrum = np.array([band.limit(expected), weight], np.float32)
        self.noise_gain = sqrt(float((weight**2).sum()) / prod(scene.blur.surface_shape))
        self._changed = np.asarray(weight * (1 - modes.gain), np.float32).ravel()

    def correction(self, c: Floats32) -> float:
        """How much the cover took from a frame of coefficients (n,): kPa^2, summed over taxels."""
        change = self._changed * c
        return float(change.dot(change))


class Wiener:
    """Restores the frame that its scene last looked at; `noise_gain` is the image's, noise over the frame's."""

    def __init__(self, scene: Scene) -> None:
        modes = scene.modes
        self._scene = scene
        arrays = modes.gain, modes.frequency, scene.gain_variance
        self._filters: Kept[Filter] = kept("filter", *arrays, np.array(scene.blur.surface_shape))
        self._band = NarrowBand(modes, scene.gain_variance)
        synthesise = modes.head_to_surface()
        self._image = synthesise.empty()
        self._fixed = self._band.of_modes, self._band.shared, scene.reach, synthesise.left, synthesise.right
        self._weight = np.empty_like(scene.c)  # of each mode in the image, in units of the noise
        self.noise_gain = 0.0
        # Of the image: sum and sum of squares of what is above 0, sum of squares of what is below, the highest.
        self.sums: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)

    def filter(self) -> Filter:
        """Give the filter of the scene's spectrum, made when that spectrum is first met."""
        return self._filters(self._scene.spectrum, lambda: Filter(self._scene, self._band))

    def __call__(self) -> Floats32:
        """Give the surface pressure, total force kept; may be negative."""
        scene, image, of_spectrum = self._scene, self._image, self.filter().of_spectrum
        squares, force, *sums = coefficients.filtered(
            scene.c, scene.noise**2, of_spectrum, *self._fixed, self._weight, image
        )
        self.noise_gain = sqrt(squares / image.size)
        scale = scene.force_scale(scene.force - force)
        if scale != 1.0:
            np.multiply(image, np.float32(scale), out=image)
            sums = [value * factor for value, factor in zip(sums, (scale, scale**2, scale**2, scale), strict=True)]
        self.sums = (*sums,)
        return image
