"""What does this scene need? Nothing, the raw image, a linear filter, or non-negativity: no more than it earns.

Every test is against the noise, on numbers of this frame alone.
"""

from math import sqrt

import numpy as np

from tactiled.restore.deviation import deviation, raw_deviation
from tactiled.restore.modes import Floats, Image
from tactiled.restore.noise import detection_threshold
from tactiled.restore.nonnegative import Nonnegative
from tactiled.restore.point_image import MODEL_ERROR
from tactiled.restore.points import Points
from tactiled.restore.scene import Restored, Scene
from tactiled.restore.wiener import Filter, Wiener

# All chosen on the scenes of `python -m tests.study restore`.
SUM_SIGMAS = 4.0  # standard deviations of a sum over taxels that count as more than noise
CORRECTION_SIGMAS = 2.0  # noise standard deviations: a smaller correction, over all taxels, is not worth making
CLEAN = 20.0  # times the noise: a frame of less gains from a filter even where the cover does nothing
WORTH_MODEL_ERRORS = 1.5  # times what the model may miss of a frame: less is not worth restoring for
MISPLACED = 0.14  # of a frame's square: what points mislead by if no fit tells where on their taxels they are
NEGATIVE = 0.02  # of the image's norm: a negative part below this is not worth iterating for

IDLE = "no contact above the noise"
RAW = "the cover hardly matters here: all it changes is under a faint noise, or under what its model may miss"
WIENER = "smooth contact: a linear filter is enough"
POINTS = "isolated indenters: a few points explain the frame down to its noise"
MIXED = "contacts smaller than a taxel; NNLS mixed with the raw image"
RAW_POINTS = "contacts smaller than a taxel; raw image shown"
NNLS = "sharp contact: NNLS avoids ringing"


class Auto:
    """Restores each frame by the least that it needs."""

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._wiener, self._nonnegative = Wiener(scene), Nonnegative(scene)
        self.points = Points(scene, wary=True)
        size = scene.flat.size
        self._taxel_ones = np.ones(size, np.float32)
        self._peak = detection_threshold(scene.noise, size)
        self._sum = SUM_SIGMAS * scene.noise * sqrt(size)
        self._unrefined = scene.blur.frame_shape == scene.blur.surface_shape
        self._below = np.empty(scene.blur.surface_shape, np.float32)
        zeros = np.zeros(scene.blur.surface_shape, np.float32)
        zeros.setflags(write=False)
        self._idle = Restored(zeros, "idle", IDLE, 0, 0.0, scene.widest_mm)
        self._method = ""  # of the last image
        self._image: Image | None = None  # that image, unless it was idle: the scene has not looked at that

    def prepare(self) -> None:
        """Make now what any frame may need."""
        self._scene.prepare(self._wiener.filter, self._nonnegative.prepare)

    def deviation(self) -> Floats:
        """Standard deviation (kPa) of every cell of the image last restored: of points the fit's."""
        if self.points.loads:
            return self.points.drawing.deviation()
        if self._method == "raw":
            return raw_deviation(self._scene, self._wiener)
        return deviation(self._scene, self._image)

    def is_idle(self, y: Image) -> bool:
        """Whether a frame is noise and nothing else: peak, trough and sum stay within what noise does."""
        if self._scene.high > self._peak or self._scene.low < -self._peak:
            return False
        return abs(float(self._taxel_ones.dot(y.reshape(-1)))) < self._sum

    def __call__(self, y: Image) -> Restored:
        """Restore a frame without gaps."""
        self.points.loads = None
        if self.is_idle(y):
            self._scene.look_at_nothing()
            self._method, self._image = "idle", None
            return self._idle
        done = self._restored(y)
        self._method, self._image = done.method, done.image
        return done

    def _restored(self, y: Image) -> Restored:
        scene = self._scene
        scene.look(y)
        filter_ = self._wiener.filter()
        raw_reason = self._raw_reason(filter_) if self._unrefined else ""
        if raw_reason:
            return Restored(y, "raw", raw_reason, 0, 1.0, scene.resolution())
        image = self._wiener()
        if self._linear(image):
            return Restored(image, "wiener", WIENER, 0, filter_.noise_gain, scene.resolution())
        return self._iterated(y, image)

    def _raw_reason(self, filter_: Filter) -> str:
        """Why neither what the cover did nor the noise is worth taking out of this frame; empty if it is."""
        scene = self._scene
        square, faint = scene.square, (CLEAN * scene.noise) ** 2 * scene.flat.size
        correction = filter_.correction(scene.power)
        if square > faint and correction < (CORRECTION_SIGMAS * scene.noise) ** 2:
            return RAW
        if self._spared(filter_.noise_gain) < (WORTH_MODEL_ERRORS * MODEL_ERROR) ** 2 * square:
            return RAW
        return RAW_POINTS if self.points.unavailable and self._earned(filter_.noise_gain) <= 0 else ""

    def _spared(self, gain: float) -> float:
        """Square error (kPa^2, summed over taxels) that restoring is to spare: the cover's, and the noise's."""
        scene = self._scene
        noise = max(1 - gain**2, 0.0) * scene.noise**2 * scene.flat.size
        return self._wiener.filter().correction(scene.power) + noise

    def _earned(self, gain: float) -> float:
        """Share, 1 at most, of what restoring changed that is more good than harm; none at 0 or less.

        Points that no fit places mislead: what is spared must exceed that.
        """
        scene = self._scene
        if not self._unrefined or not scene.spotted:
            return 1.0
        misled = MISPLACED * scene.square
        spared = self._spared(gain)
        return 1 - misled / spared if spared else 0.0

    def _linear(self, image: Image) -> bool:
        """Whether hardly any of a linear image falls below zero."""
        np.minimum(image, self._idle.image, out=self._below)
        flat, below = image.reshape(-1), self._below.reshape(-1)
        return float(below.dot(below)) <= NEGATIVE**2 * float(flat.dot(flat))

    def _iterated(self, y: Image, linear: Image) -> Restored:
        done = self._nonnegative(linear)
        steps, resolution = self.points(y, self._nonnegative.image), self._scene.resolution()
        if steps:
            drawing = self.points.drawing
            return Restored(drawing.image, "points", POINTS, done + steps, drawing.noise_gain, resolution)
        gain = self._nonnegative.noise_gain(self._wiener.filter().noise_gain)
        earned = self._earned(gain)
        if earned <= 0:
            return Restored(y, "raw", RAW_POINTS, done, 1.0, resolution)
        if earned < 1:
            return Restored(self._mixed(y, earned), "nnls", MIXED, done, 1 - earned * (1 - gain), resolution)
        return Restored(self._nonnegative.image, "nnls", NNLS, done, gain, resolution)

    def _mixed(self, y: Image, earned: float) -> Image:
        """Give the raw image and what was earned of the change to it, without negative values."""
        mixed = np.subtract(self._nonnegative.image, y, out=self._below)
        np.multiply(mixed, np.float32(earned), out=mixed)
        np.add(mixed, y, out=mixed)
        return np.maximum(mixed, self._idle.image, out=mixed)
