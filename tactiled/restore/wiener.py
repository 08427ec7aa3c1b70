"""The linear answer: Wiener's filter in the blur's own modes, for the spectrum that the frame itself shows."""

from math import prod, sqrt

import numpy as np

from tactiled.restore.modes import Floats, Image
from tactiled.restore.scene import Scene

ASTRAY = 0.5  # pitches that a small spot may be from where it is drawn, and the share of it
COVER = 0.03  # of a cover's thickness: better is hardly known
TINY = 1e-12  # a gain is taken to be no less


class Filter:
    """One spectrum's filter h S / (h^2 S + sigma^2), with the total force and the noise that it leaves."""

    def __init__(self, scene: Scene) -> None:
        modes = scene.modes
        S = scene.prior.ratio(scene.number)[modes.head]
        weight = modes.gain * S / (modes.gain**2 * S + 1)
        self.weight = np.asarray(weight, np.float32)
        self.missed = np.asarray(scene.ones - scene.felt * weight.ravel(), np.float32)
        self._changed = np.asarray((weight * (1 - modes.gain)).ravel() ** 2, np.float32)
        cells = prod(scene.blur.surface_shape)
        self.resolution_mm = scene.resolution()
        self.noise_gain = sqrt(float((weight**2).sum()) / cells)

    def correction(self, power: Image) -> float:
        """How much the cover took from the frame (kPa^2, summed over taxels), from the power of its modes."""
        return float(self._changed.dot(power))


class Wiener:
    """Restores the frame that its scene last looked at."""

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._filters: dict[int, Filter] = {}
        self._back = scene.modes.to_surface(seen=True)
        self.chosen: Filter  # of the image last made
        self._modes, self.image = np.empty_like(scene.c), self._back.empty()

    @property
    def filter(self) -> Filter:
        """The filter of the scene's spectrum, made when that spectrum is first met."""
        self.prepare()
        return self._filters[self._scene.number]

    def prepare(self) -> None:
        """Make the filter of the scene's spectrum if there is none."""
        if self._scene.number not in self._filters:
            self._filters[self._scene.number] = Filter(self._scene)

    def __call__(self) -> Image:
        """Give the surface pressure, total force kept; may be negative."""
        self.chosen = chosen = self.filter
        scene = self._scene
        np.multiply(scene.c, chosen.weight, out=self._modes)
        scale = scene.force_scale(float(chosen.missed.dot(scene.flat)))
        if scale != 1.0:
            np.multiply(self._modes, np.float32(scale), out=self._modes)
        return self._back(self._modes, self.image)

    def of(self, c: Image) -> Image:
        """Give what the scene's filter makes of any modes `c`; the total force is not held to."""
        np.multiply(c, self.filter.weight, out=self._modes)
        return self._back(self._modes, self.image)


def deviation(scene: Scene, image: Image | None = None) -> Floats:
    """Standard deviation (kPa) of each cell of an image of the scene, the linear one or any that knows more.

    Of the noise, of what the filter leaves out, and of the model: a cover known to COVER of its thickness, whose
    gain falls by as many octaves for a wave, and pressure finer than the grid; all given the spectrum picked for
    the scene, which is the same everywhere. That says too little of a few small spots: what may be elsewhere of
    `image` is added.
    """
    modes = scene.modes
    variance = scene.prior.ratio(scene.number).copy()
    S, h = variance[modes.head], modes.gain
    model = (COVER * h * np.log(np.maximum(h, TINY))) ** 2
    if scene.blur.aliases:
        model = model + scene.blur.aliases.missed(lambda q: scene.prior.fall(scene.number, q))
    variance[modes.head] = S / (h**2 * S + 1) * (1 + h**2 * S / (h**2 * S + 1) * S * model)
    variance *= scene.noise**2
    squares = [basis**2 for basis in modes.surface]
    spread = np.sqrt(squares[0] @ variance if len(squares) == 1 else squares[0] @ variance @ squares[1].T)
    if image is not None and scene.spotted:
        from scipy.ndimage import gaussian_filter  # which nothing else imports that starts a service

        refine = image.shape[0] // scene.blur.frame_shape[0]
        about = gaussian_filter(np.abs(image), ASTRAY * refine) if image.ndim > 1 else np.abs(image)
        spread = np.hypot(spread, ASTRAY * about)
    return np.asarray(spread, float)


def untouched(scene: Scene, wiener: Wiener) -> Floats:
    """Standard deviation (kPa) of each cell of the raw image: the linear one's, and what `wiener` would change."""
    image = scene.modes.to_taxels()
    raw = image(scene.c, image.empty())
    for axis, cells in enumerate(scene.blur.surface_shape):
        raw = np.repeat(raw, cells // raw.shape[axis], axis)
    return np.asarray(np.hypot(deviation(scene, raw), raw - wiener()), float)
