"""What does this scene need? Nothing, the raw image, a linear filter, or non-negativity: no more than it earns.

Every test is against the noise, on numbers that are there anyway. A test that was passed last frame is passed
again up to `STAY` times further, so that a scene on the border does not flicker.
"""

from math import sqrt

import numpy as np

from tactiled.restore.drawing import MODEL
from tactiled.restore.modes import Floats, Image
from tactiled.restore.noise import outstanding
from tactiled.restore.nonnegative import Nonneg
from tactiled.restore.points import Points
from tactiled.restore.scene import Restored, Scene
from tactiled.restore.wiener import Filter, Wiener, deviation, untouched

STAY = 1.5  # how much further a test reaches for the method of the frame before
REVIEW = 8  # frames after which one that needed iterations is asked again whether linear would do
SELDOM = 256  # the same at most: twice as many every time that linear did not do for as long
SURE = 4.0  # standard deviations that count as more than noise
SEEN = 2.0  # noise standard deviations, all of the correction put together, that no one would miss
CLEAN = 20.0  # times the noise: a frame of less gains from a filter even where the cover does nothing
PAUSE = 32  # frames that points are left alone for after a fit that did not stand: twice as many every time
LONGEST = 2048  # of those
ITERATED = ("nnls", "points")
WORTH = 1.5  # times what the model of a cover may miss of a frame: less is not worth restoring for
UNTOLD = 0.14  # of its square: what points mislead by if nothing tells where on their taxels they are
NEGATIVE = 0.02  # of the image's norm: a negative part below this is not worth iterating for

IDLE = "no contact above the noise"
RAW = "the cover hardly matters here: all it changes is under a faint noise, or under what its model may miss"
WIENER = "smooth contact: a linear filter is enough"
POINTS = "isolated indenters: a few points explain the frame down to its noise"
MIXED = "contacts smaller than a taxel; NNLS mixed with the raw image"
LEFT = "contacts smaller than a taxel; raw image shown"
NNLS = "sharp contact: NNLS avoids ringing"


class Idle:
    """Tests whether a frame is noise and nothing else."""

    def __init__(self, scene: Scene) -> None:
        size = scene.flat.size
        self._ones = np.ones(size, np.float32)
        self._scene = scene
        self._peak = outstanding(scene.noise, size)
        self._sum = SURE * scene.noise * sqrt(size)

    def __call__(self, y: Image, reach: float) -> bool:
        """Whether peak, trough and sum stay within `reach` times what noise does."""
        peak = reach * self._peak
        if self._scene.high > peak or self._scene.low < -peak:
            return False
        return abs(float(self._ones.dot(y.reshape(-1)))) < reach * self._sum


class Auto:
    """Restores each frame by the least that it needs."""

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._idle, self._wiener, self._nonneg = Idle(scene), Wiener(scene), Nonneg(scene)
        self.points = Points(scene, wary=True)
        self._square = scene.blur.frame_shape == scene.blur.surface_shape
        self._below = np.empty(scene.blur.surface_shape, np.float32)
        self._method, self._age, self._review, self._stay = "", 0, REVIEW, False
        self._wait, self._pause = 0, PAUSE
        zeros = np.zeros(scene.blur.surface_shape, np.float32)
        zeros.setflags(write=False)
        self._nothing = Restored(zeros, "idle", IDLE, 0, 0.0, scene.widest_mm)
        self._image: Image | None = None  # the last, unless there was nothing: the scene has not looked at that

    def prepare(self) -> None:
        """Make now what any frame may need."""
        self._scene.ahead(self._wiener.prepare, self._nonneg.prepare)

    def reset(self) -> None:
        """Forget the frames so far."""
        self._method, self._review = "", REVIEW
        self._wait, self._pause = 0, PAUSE
        self._nonneg.reset()
        self.points.reset()

    def follow(self, other: "Auto") -> None:
        """Go on from where another was, but from no image."""
        self._nonneg.reset()
        self.points.reset()
        self._method, self._age, self._review = other._method, other._age, other._review
        self._wait, self._pause = other._wait, other._pause
        self._stay = True

    def stay(self) -> None:
        """Do not ask this time whether linear would do, however much has changed."""
        self._age, self._stay = min(self._age, 1), True

    def _reach(self, method: str) -> float:
        return STAY if self._method == method else 1.0

    def deviation(self) -> Floats:
        """Standard deviation (kPa) of every cell of the image last restored: of points the fit's."""
        if self.points.found:
            return self.points.drawing.deviation()
        if self._method == "raw":
            return untouched(self._scene, self._wiener)
        return deviation(self._scene, self._image)

    def rests(self, y: Image) -> bool:
        """Whether there is nothing in a frame."""
        return self._idle(y, self._reach("idle"))

    def __call__(self, y: Image) -> Restored:
        """Restore a frame without gaps."""
        self.points.found = ()
        if self.rests(y):
            self._method, self._review = "idle", REVIEW
            self._wait, self._pause = 0, PAUSE
            self._scene.empty()
            self._image = None
            return self._nothing
        done = self._some(y)
        self._method, self._image = done.method, done.image
        return done

    def _some(self, y: Image) -> Restored:
        scene = self._scene
        scene.look(y)
        if scene.anew:
            method = self._method if self._stay else ""
            self.reset()
            self._method = method
        self._stay = False
        if self._method in ITERATED and self._age < self._review:
            self._age += 1
            return self._iterated(y)
        filter_ = self._wiener.filter
        left = self._untouched(filter_) if self._square else ""
        if left:
            return Restored(y, "raw", left, 0, 1.0, scene.resolution())
        image = self._wiener()
        if self._linear(image):
            self._age = self._age + 1 if self._method == "wiener" else 1
            return Restored(image, "wiener", WIENER, 0, filter_.noise_gain, scene.resolution())
        if self._method == "wiener":
            self._review = min(2 * self._review, SELDOM) if self._age < SELDOM else REVIEW
        if self._method not in ITERATED:
            self._nonneg.reset()
        self._age = 1
        return self._iterated(y)

    def _untouched(self, chosen: Filter) -> str:
        """Why neither what the cover did nor the noise is worth taking out of this frame; empty if it is."""
        scene, reach = self._scene, self._reach("raw")
        square, faint = float(scene.flat.dot(scene.flat)), (CLEAN * scene.noise) ** 2 * scene.flat.size
        if square * reach**2 > faint and chosen.correction(scene.power) < (reach * SEEN * scene.noise) ** 2:
            return RAW
        if self._spared(chosen.noise_gain) < (reach * WORTH * MODEL) ** 2 * square:
            return RAW
        return LEFT if self.points.never and self._earned(chosen.noise_gain, reach) <= 0 else ""

    def _spared(self, gain: float) -> float:
        """Square error (kPa^2, summed over taxels) that restoring is to spare: the cover's, and the noise's."""
        scene = self._scene
        noise = max(1 - gain**2, 0.0) * scene.noise**2 * scene.flat.size
        return self._wiener.filter.correction(scene.power) + noise

    def _earned(self, gain: float, reach: float = 1.0) -> float:
        """Share, 1 at most, of what restoring changed that is more good than harm; 0 or less is none.

        Points that are not told mislead: what is spared must exceed that.
        """
        scene = self._scene
        if not self._square or not scene.spotted:
            return 1.0
        misled = reach**2 * UNTOLD * float(scene.flat.dot(scene.flat))
        spared = self._spared(gain)
        return 1 - misled / spared if spared else 0.0

    def _linear(self, image: Image) -> bool:
        """Whether hardly any of a linear image falls below zero."""
        np.minimum(image, self._nothing.image, out=self._below)
        flat, below = image.reshape(-1), self._below.reshape(-1)
        limit = (self._reach("wiener") * NEGATIVE) ** 2
        return float(below.dot(below)) <= limit * float(flat.dot(flat))

    def _iterated(self, y: Image) -> Restored:
        done = self._nonneg(self._wiener)
        steps = self._pointed(y)
        if steps:
            drawn, done = self.points.drawing, done + steps
            return Restored(drawn.image, "points", POINTS, done, drawn.noise_gain, self._scene.resolution())
        gain = self._nonneg.noise_gain(self._wiener.filter.noise_gain)
        earned, resolution = self._earned(gain), self._scene.resolution()
        if earned <= 0:
            return Restored(y, "raw", LEFT, done, 1.0, resolution)
        if earned < 1:
            return Restored(self._mixed(y, earned), "nnls", MIXED, done, 1 - earned * (1 - gain), resolution)
        return Restored(self._nonneg.image, "nnls", NNLS, done, gain, resolution)

    def _mixed(self, y: Image, earned: float) -> Image:
        """Give the raw image and what was earned of the change to it, without negative values."""
        mixed = np.subtract(self._nonneg.image, y, out=self._below)
        np.multiply(mixed, np.float32(earned), out=mixed)
        np.add(mixed, y, out=mixed)
        return np.maximum(mixed, self._nothing.image, out=mixed)

    def _pointed(self, y: Image) -> int:
        """Steps of a fit of points that stands; one that does not is not tried again before a while."""
        if self._wait and self._method != "points":
            self._wait -= 1
            return 0
        steps = self.points(y, self._nonneg.image)
        self._pause = PAUSE if steps else min(2 * self._pause, LONGEST)
        self._wait = 0 if steps else self._pause
        return steps
