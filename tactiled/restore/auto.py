"""What does this scene need? Nothing, the raw image, a linear filter, or non-negativity: no more than it earns.

Every test is against the noise, on numbers that are there anyway. A test that was passed last frame is passed
again up to HYSTERESIS times further, so that a scene on the border does not flicker.
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
HYSTERESIS = 1.5  # how much further a test reaches for the method of the frame before
REVIEW_FRAMES = 8  # after which a frame that needed iterations is asked again whether linear would do
MAX_REVIEW_FRAMES = 256  # twice as many every time that linear did not do for as long
SUM_SIGMAS = 4.0  # standard deviations of a sum over taxels that count as more than noise
CORRECTION_SIGMAS = 2.0  # noise standard deviations: a smaller correction, over all taxels, is not worth making
CLEAN = 20.0  # times the noise: a frame of less gains from a filter even where the cover does nothing
POINTS_PAUSE_FRAMES = 32  # without points after a fit that did not stand: twice as many every time
MAX_POINTS_PAUSE_FRAMES = 2048
ITERATED = ("nnls", "points")
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
        self._image: Image | None = None  # the last, unless it was idle: the scene has not looked at that
        self._keep = False  # the method this time, however much has changed
        self._age = 0
        self.reset()

    def prepare(self) -> None:
        """Make now what any frame may need."""
        self._scene.prepare(self._wiener.filter, self._nonnegative.prepare)

    def reset(self) -> None:
        """Forget the frames so far."""
        self._set_method("")
        self._nonnegative.reset()
        self.points.reset()

    def _set_method(self, method: str) -> None:
        self._method, self._review = method, REVIEW_FRAMES
        self._wait, self._pause = 0, POINTS_PAUSE_FRAMES

    def follow(self, other: "Auto") -> None:
        """Go on from where another was, but from no image."""
        self._nonnegative.reset()
        self.points.reset()
        self._method, self._age, self._review = other._method, other._age, other._review
        self._wait, self._pause = other._wait, other._pause
        self._keep = True

    def keep_method(self) -> None:
        """Do not ask this time whether linear would do, however much has changed."""
        self._age, self._keep = min(self._age, 1), True

    def _reach(self, method: str) -> float:
        return HYSTERESIS if self._method == method else 1.0

    def deviation(self) -> Floats:
        """Standard deviation (kPa) of every cell of the image last restored: of points the fit's."""
        if self.points.loads:
            return self.points.drawing.deviation()
        if self._method == "raw":
            return raw_deviation(self._scene, self._wiener)
        return deviation(self._scene, self._image)

    def is_idle(self, y: Image) -> bool:
        """Whether a frame is noise and nothing else: peak, trough and sum stay within what noise does."""
        reach = self._reach("idle")
        if self._scene.high > reach * self._peak or self._scene.low < -(reach * self._peak):
            return False
        return abs(float(self._taxel_ones.dot(y.reshape(-1)))) < reach * self._sum

    def __call__(self, y: Image) -> Restored:
        """Restore a frame without gaps."""
        self.points.loads = None
        if self.is_idle(y):
            self._set_method("idle")
            self._scene.look_at_nothing()
            self._image = None
            return self._idle
        done = self._restored(y)
        self._method, self._image = done.method, done.image
        return done

    def _restored(self, y: Image) -> Restored:
        scene = self._scene
        scene.look(y)
        if scene.unrelated:
            method = self._method if self._keep else ""
            self.reset()
            self._method = method
        self._keep = False
        if self._method in ITERATED and self._age < self._review:
            self._age += 1
            return self._iterated(y)
        filter_ = self._wiener.filter()
        raw_reason = self._raw_reason(filter_) if self._unrefined else ""
        if raw_reason:
            return Restored(y, "raw", raw_reason, 0, 1.0, scene.resolution())
        image = self._wiener()
        if self._linear(image):
            self._age = self._age + 1 if self._method == "wiener" else 1
            return Restored(image, "wiener", WIENER, 0, filter_.noise_gain, scene.resolution())
        if self._method == "wiener":
            patient = self._age < MAX_REVIEW_FRAMES
            self._review = min(2 * self._review, MAX_REVIEW_FRAMES) if patient else REVIEW_FRAMES
        if self._method not in ITERATED:
            self._nonnegative.reset()
        self._age = 1
        return self._iterated(y)

    def _raw_reason(self, filter_: Filter) -> str:
        """Why neither what the cover did nor the noise is worth taking out of this frame; empty if it is."""
        scene, reach = self._scene, self._reach("raw")
        square, faint = scene.square, (CLEAN * scene.noise) ** 2 * scene.flat.size
        correction = filter_.correction(scene.power)
        if square * reach**2 > faint and correction < (reach * CORRECTION_SIGMAS * scene.noise) ** 2:
            return RAW
        if self._spared(filter_.noise_gain) < (reach * WORTH_MODEL_ERRORS * MODEL_ERROR) ** 2 * square:
            return RAW
        return RAW_POINTS if self.points.unavailable and self._earned(filter_.noise_gain, reach) <= 0 else ""

    def _spared(self, gain: float) -> float:
        """Square error (kPa^2, summed over taxels) that restoring is to spare: the cover's, and the noise's."""
        scene = self._scene
        noise = max(1 - gain**2, 0.0) * scene.noise**2 * scene.flat.size
        return self._wiener.filter().correction(scene.power) + noise

    def _earned(self, gain: float, reach: float = 1.0) -> float:
        """Share, 1 at most, of what restoring changed that is more good than harm; none at 0 or less.

        Points that no fit places mislead: what is spared must exceed that.
        """
        scene = self._scene
        if not self._unrefined or not scene.spotted:
            return 1.0
        misled = reach**2 * MISPLACED * scene.square
        spared = self._spared(gain)
        return 1 - misled / spared if spared else 0.0

    def _linear(self, image: Image) -> bool:
        """Whether hardly any of a linear image falls below zero."""
        np.minimum(image, self._idle.image, out=self._below)
        flat, below = image.reshape(-1), self._below.reshape(-1)
        limit = (self._reach("wiener") * NEGATIVE) ** 2
        return float(below.dot(below)) <= limit * float(flat.dot(flat))

    def _iterated(self, y: Image) -> Restored:
        done = self._nonnegative(self._wiener)
        steps, resolution = self._point_steps(y), self._scene.resolution()
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

    def _point_steps(self, y: Image) -> int:
        """Steps of a fit of points that stands; one that does not is not tried again before a while."""
        if self._wait and self._method != "points":
            self._wait -= 1
            return 0
        steps = self.points(y, self._nonnegative.image)
        self._pause = POINTS_PAUSE_FRAMES if steps else min(2 * self._pause, MAX_POINTS_PAUSE_FRAMES)
        self._wait = 0 if steps else self._pause
        return steps
