"""Standard deviation (kPa) of every cell of an image: of the noise, of what a method leaves out, of the model."""

import numpy as np

from tactiled.arrays import Floats, Floats32
from tactiled.restore.scene import Scene
from tactiled.restore.wiener import Wiener, wiener_weight

MISPLACED = 0.5  # pitches that a small spot may be from where it is drawn, and the share of it


def deviation(scene: Scene, image: Floats32 | None = None) -> Floats:
    """Give it for an image of the scene, the linear one or any that knows more.

    Of the noise, of what the filter leaves out, and of the model: pressure finer than the grid, and a cover known
    to the blur's `thickness_error`. All are given the spectrum picked for the scene, which is the same everywhere,
    but for the thickness: that counts what it changes of `image`. The spectrum says too little of a few small
    spots: what may be elsewhere of `image` is added.
    """
    modes, spectrum = scene.modes, scene.spectrum
    variance = spectrum.ratio.copy()
    S, h = variance[modes.head], modes.gain
    model = modes.gain_variance(0.0 if image is not None else scene.thickness_error**2)
    if scene.blur.aliasing:
        model = model + scene.blur.aliasing.variance(spectrum.fall)
    weight = wiener_weight(scene)
    variance[modes.head] = S * (1 - h * weight) ** 2 + weight**2 * (1 + S * model)
    variance *= scene.noise**2
    squares = [basis**2 for basis in modes.surface]
    spread = np.sqrt(squares[0] @ variance @ squares[1].T)
    if image is None:
        return np.asarray(spread, float)
    spread = np.hypot(spread, scene.thickness_error * slope_in_thickness(scene, image))
    if scene.spotted:
        from scipy.ndimage import gaussian_filter  # which nothing else imports that starts a service

        about = gaussian_filter(np.abs(image), MISPLACED * scene.array.refine)
        spread = np.hypot(spread, MISPLACED * about)
    return np.asarray(spread, float)


def slope_in_thickness(scene: Scene, image: Floats32) -> Floats:
    """How much a filtered `image` changes with the logarithm of the thickness under which it was sensed."""
    modes = scene.modes
    analyse, synthesise = modes.to_surface_modes(), modes.head_to_surface()
    pressure = analyse(np.ascontiguousarray(image, np.float32), analyse.empty())[modes.head]
    change = wiener_weight(scene) * np.sqrt(modes.gain_variance(1.0)) * pressure
    return np.abs(synthesise(np.asarray(change, np.float32), synthesise.empty())).astype(float)


def raw_deviation(scene: Scene, wiener: Wiener) -> Floats:
    """Give it for the raw image of the array: the linear one's, and what `wiener` would change."""
    raw, linear = scene.raw(), wiener()
    return np.asarray(np.hypot(scene.inside(deviation(scene, linear)), raw - scene.inside(linear)), float)
