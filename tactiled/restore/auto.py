"""What does this scene need? Nothing, the raw image, a linear filter, a network, or a few loads fitted to it.

These are the candidates in the order of their cost. Each says what the next one would certainly put right, as a
share of the image's norm; the next one runs where that is at least WORTH, after the raw image RAW_WORTH. All
numbers are of this frame alone.
"""

from math import sqrt

import numpy as np

from tactiled.arrays import Floats, Floats32
from tactiled.restore import learned
from tactiled.restore.deviation import deviation, raw_deviation
from tactiled.restore.noise import detection_threshold
from tactiled.restore.points import LEARNED_SPREAD_CELLS, TOO_THIN, Points
from tactiled.restore.scene import Restored, Scene, pressed_noise_gain
from tactiled.restore.total_variation import TotalVariation
from tactiled.restore.wiener import Filter, Wiener

# Of the norm, chosen on 168 random scenes of 14 kinds that no claim is made on.
WORTH = 0.005  # 0.02 spares 4 % of the time, and in 0.2 % noise costs a sixth more error
RAW_WORTH = 0.02  # the same for the raw image: below that no model of a thin cover is right often enough
SUM_SIGMAS = 4.0  # standard deviations of a sum over taxels that count as more than noise
MIN_MARGIN = 1.0  # pitches from loads to the outermost taxels: nearer, a wide contact beyond them fits as well
FIRST_SIGMAS = 1e4  # standard deviations of a load that is restored before any frame

IDLE = "no contact above the noise"
RAW = "what the cover took and the noise added is {:.1%} of the frame"
SPOTS = "small spots under a thin cover: the frame does not tell where on their taxels they are"
WIENER = "smooth contact: {:.1%} of the Wiener-filtered image is below zero"
SHARP = "sharp contact: {:.1%} of the Wiener-filtered image is below zero"
LOADS = "isolated indenters: {} explain the frame down to its noise"


class Auto:
    """Restores each frame by the least that it needs."""

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._wiener = Wiener(scene)
        self._sharp = _sharp(scene, self._wiener)
        is_learned = isinstance(self._sharp, learned.Learned)
        self.loads = Points(scene, LEARNED_SPREAD_CELLS) if is_learned else Points(scene)
        size = scene.size
        self._taxel_ones = np.ones(size, np.float32)
        self._peak = detection_threshold(scene.noise, size)
        self._sum = SUM_SIGMAS * scene.noise * sqrt(size)
        self._unrefined = scene.array.frame_shape == scene.array.surface_shape
        self._too_thin = self._unrefined and self.loads.unavailable == TOO_THIN
        zeros = np.zeros(scene.blur.surface_shape, np.float32)
        zeros.setflags(write=False)
        self._idle = Restored(zeros, "idle", IDLE, 0, 0.0, scene.widest_mm)
        self._last = self._idle  # the last image

    def prepare(self) -> None:
        """Make now what any frame may need."""
        self._scene.prepare(self._wiener.filter, self._scene.resolution, self._sharp.prepare)
        load = np.zeros(self._scene.array.surface_shape, np.float32)
        load[tuple(n // 2 for n in load.shape)] = FIRST_SIGMAS * self._scene.noise
        y = np.ascontiguousarray(self._scene.array.forward(load))
        self._scene.measure_range(y)
        self(y)  # memory costs most when it is first written to
        self._scene.look_at_nothing()
        self._last = self._idle

    def deviation(self) -> Floats:
        """Standard deviation (kPa) of every cell of the image last restored: of loads the fit's."""
        if self._last.method == "points":
            return self.loads.drawing.deviation()
        if self._last.method == "raw":
            return raw_deviation(self._scene, self._wiener)
        if self._last.method == learned.Learned.name and isinstance(self._sharp, learned.Learned):
            return self._sharp.deviation()
        return deviation(self._scene, None if self._last is self._idle else self._last.image)

    def is_idle(self, y: Floats32) -> bool:
        """Whether a frame is noise and nothing else: peak, trough and sum stay within what noise does."""
        if self._scene.high > self._peak or self._scene.low < -self._peak:
            return False
        return abs(float(self._taxel_ones.dot(y.reshape(-1)))) < self._sum

    def __call__(self, y: Floats32) -> Restored:
        """Restore a frame without gaps."""
        if self.is_idle(y):
            self._scene.look_at_nothing()
            self._last = self._idle
        else:
            self._scene.look(y)
            self._last = self._restored(y)
        return self._last

    def _restored(self, y: Floats32) -> Restored:
        filter_, resolution = self._wiener.filter(), self._scene.resolution()
        spared = self._spared(filter_) if self._unrefined else 1.0
        if spared < RAW_WORTH:
            return Restored(self._scene.raw(), "raw", RAW.format(spared), 0, 1.0, resolution)
        if self._too_thin and self._scene.spotted:
            return Restored(self._scene.raw(), "raw", SPOTS, 0, 1.0, resolution)
        linear = self._wiener()
        negative = self._negative()
        if negative < WORTH:
            return Restored(linear, "wiener", WIENER.format(negative), 0, self._wiener.noise_gain, resolution)
        sharp = self._sharp
        done = sharp(linear)
        steps = self.loads(y, self._scene.inside(sharp.image))
        found = self.loads.loads if steps else None
        if found and found.margin(self._scene.array.frame_shape) >= MIN_MARGIN:
            drawing, why = self.loads.drawing, LOADS.format(len(found.force))
            return Restored(drawing.image, "points", why, done + steps, drawing.noise_gain, resolution)
        gain = pressed_noise_gain(self._scene.inside(sharp.image), self._wiener.noise_gain)
        return Restored(sharp.image, sharp.name, SHARP.format(negative), done, gain, resolution)

    def _spared(self, filter_: Filter) -> float:
        """What the cover took and the noise added that a filter takes back, as a share of the frame's norm."""
        scene = self._scene
        noise = max(1 - filter_.noise_gain**2, 0.0) * scene.noise**2 * scene.size
        return sqrt((filter_.correction(scene.flat) + noise) / max(scene.square, 1e-30))

    def _negative(self) -> float:
        """Norm of the linear image's negative part over its norm: no pressure is below zero, so that is wrong."""
        _, above, below, _ = self._wiener.sums
        return sqrt(below / max(above + below, 1e-30))


def _sharp(scene: Scene, wiener: Wiener) -> learned.Learned | TotalVariation:
    """Give what restores sharp contacts: the network where it was trained for, else what needs no training."""
    if learned.fits(scene.blur):
        return learned.Learned(scene, wiener)
    return TotalVariation(scene)
