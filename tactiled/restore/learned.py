"""A small learned network, unrolled: three times it redraws the image, then holds it to the frame again.

Trained by `python -m tests.study train` on scenes that no claim is made on. Where its image does not explain the
frame, the model of the skin is wrong: the image is made again by weights that were trained on frames with faults.
"""

from functools import cache
from math import exp, log
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import as_strided
from numpy.typing import NDArray

from tactiled.restore.blur import Blur
from tactiled.restore.modes import Image
from tactiled.restore.scene import Scene
from tactiled.restore.wiener import Wiener

WEIGHTS = Path(__file__).with_name("learned.npz")
WARY_WEIGHTS = Path(__file__).with_name("learned_wary.npz")  # of a skin that is not quite as its model
# Chosen on scenes of the first family and on those of training, with frames that have faults and with others.
IMAGE_ERROR = 0.25  # of the root mean square of an image: by so much each of its modes may be wrong
MISFIT = 1.5  # times what this and the noise leave of a frame's modes, squared: more shows that the model is wrong
KERNEL = 3  # cells along each side of a filter's kernel
INPUTS = 3  # images that a stage redraws from: held to the frame, as last redrawn, linear
GAINS = np.array([2, 4, 8, 12, 16, 22, 28]) / 32  # of an axis' modes: where the cover's gain is looked at
MIN_GAIN = 1e-4  # at those: less is not told apart
SLACK = 0.02  # by which their roots may be outside those in training
OF_FRAME = 5  # conditions of the frame; those of the cover follow
FIRMNESS = 5.0, 3.0  # a firmness is the noise's variance times exp(5 tuned + 3)
MIN_SIDE = 6  # taxels, with those beyond the border


class Weights(NamedTuple):
    """What was trained, float32; S stages of F filters, conditions c of Learned."""

    redraw: Image  # (S, F, 9 INPUTS): kernels of the filters
    draw: Image  # (S, 9, F): kernels that their outputs are drawn with
    hidden: Image  # (c + 1, m): of the conditions, and a constant
    tune: Image  # (m + 1, S (2 F + 1)): of the hidden: each filter's scale and offset, then the stage's firmness
    lowest: Image  # (c,) of the conditions in training
    highest: Image  # (c,)


@cache
def weights(path: Path = WEIGHTS) -> Weights:
    """Load those in the package."""
    with np.load(path) as stored:
        return Weights(*(stored[name] for name in Weights._fields))


def fits(blur: Blur) -> bool:
    """Whether the network was trained for such a blur: a grid, a cell a taxel, a cover like those seen."""
    if len(blur.surface_shape) != 2 or blur.surface_shape != blur.frame_shape or min(blur.frame_shape) < MIN_SIDE:
        return False
    seen, gains = weights(), cover_gains(blur)
    lowest, highest = (each[-len(gains) :] for each in (seen.lowest, seen.highest))
    return bool(((gains > lowest - SLACK) & (gains < highest + SLACK)).all())


def cover_gains(blur: Blur) -> NDArray[np.float32]:
    """Give the roots of what modes at GAINS of either axis keep under a cover: the network knows it by them."""
    gain = blur.modes.gain
    at = (np.minimum((GAINS * n).astype(int), n - 1) for n in gain.shape)
    return np.asarray(np.sqrt(np.maximum(gain[tuple(at)], MIN_GAIN)), np.float32)


class Convolution:
    """Redraws images (INPUTS, R, C) to one: F filters, each cut off below zero, and F kernels that add up.

    A row of an image is followed by a zero, so that every shift of a kernel is a shift in memory.
    """

    def __init__(self, shape: tuple[int, int], filters: int) -> None:
        rows, columns = shape
        line, size = columns + 1, np.dtype(np.float32).itemsize
        margin = line + 1
        length = rows * line + 2 * margin
        padded = np.zeros((INPUTS, length), np.float32)
        self._shifted = np.zeros((KERNEL**2 * INPUTS + 1, length), np.float32)
        self._filtered = np.zeros((filters, length), np.float32)
        self._maps = np.zeros((KERNEL**2, length), np.float32)
        self._zeros = np.zeros_like(self._filtered)  # to compare with an array takes a quarter of the time
        within = slice(margin, -margin)
        self._shifted[-1, within] = 1  # what the offset of a filter is multiplied by
        self.images = padded[:, within].reshape(-1, rows, line)[:, :, :columns]
        every = (KERNEL, KERNEL, INPUTS, rows * line)
        down, across = line * size, size
        self._around = as_strided(padded, every, (down, across, length * size, across))
        self._into = self._shifted[:-1, within].reshape(every)
        self._after_rows = self._filtered[:, within].reshape(-1, rows, line)[:, :, columns]
        self._summands = as_strided(
            self._maps,
            (KERNEL, KERNEL, rows, columns),
            (KERNEL * length * size + down, length * size + across, down, across),
        )

    def __call__(self, kernels: Image, draw: Image, out: Image) -> None:
        """Fill `out` (R, C) from `images`; `kernels` (F, 9 INPUTS + 1): of every filter, and its offset."""
        np.copyto(self._into, self._around)
        kernels.dot(self._shifted, self._filtered)
        np.maximum(self._filtered, self._zeros, out=self._filtered)
        self._after_rows.fill(0)
        draw.dot(self._filtered, self._maps)
        np.add.reduce(self._summands, axis=(0, 1), out=out)


class Conditions:
    """What the network is told of a frame besides its image: noise, spectrum and cover, (c,)."""

    def __init__(self, scene: Scene) -> None:
        self.values = np.concatenate([np.ones(OF_FRAME, np.float32), cover_gains(scene.blur)])
        self._scene = scene
        self._ones, self._pressed = (np.ones(scene.blur.surface_shape, np.float32) for _ in range(2))
        self._zeros = np.zeros_like(self._ones)

    def __call__(self, linear: Image, noise_gain: float, scale: float) -> NDArray[np.float32]:
        """Give those of the scene's frame, by its linear image, whose largest value is `scale` (kPa)."""
        spectrum, pressed = self._scene.spectrum, self._pressed.reshape(-1)
        np.maximum(linear, self._zeros, out=self._pressed)
        total, squares = float(pressed.dot(self._ones.reshape(-1))), float(pressed.dot(pressed))
        share = total**2 / (squares * pressed.size) if squares else 1.0
        self.values[0] = log(self._scene.noise / scale) / 3 + 1.5
        self.values[1] = log(spectrum.level) / 5 - 1
        self.values[2] = log(spectrum.corner) / 2 + 1
        self.values[3] = log(noise_gain) / 2
        self.values[4] = log(share) / 2 + 1
        return self.values


class Learned:
    """Restores the frame that its scene last looked at, from the linear image: no frame before matters.

    Each stage adds to the image what its convolution draws; all but the last then take from the frame what it
    tells: z + V' h (c - h V z) / (h^2 + k), the least of |H x - y|^2 + k |x - z|^2 in the blur's modes.
    """

    name = "learned"

    def __init__(self, scene: Scene, wiener: Wiener) -> None:
        self._scene, self._wiener = scene, wiener
        self._exact, self._wary = weights(), weights(WARY_WEIGHTS)
        rows, columns = scene.blur.surface_shape
        stages, filters = self._exact.redraw.shape[:2]
        self._convolve = Convolution((rows, columns), filters)
        self._conditions = Conditions(scene)
        self._input = np.ones(len(self._exact.hidden), np.float32)
        self._hidden = np.ones(len(self._exact.tune), np.float32)
        self._tuned = np.empty((stages, 2 * filters + 1), np.float32)
        self._scales, self._offsets = self._tuned[:, :filters, None], self._tuned[:, filters:-1]
        self._kernels = np.empty((stages, filters, KERNEL**2 * INPUTS + 1), np.float32)
        self._gain = np.asarray(scene.modes.gain, np.float32)
        self._square = self._gain**2
        self._analyse = scene.modes.to_surface_modes()
        self._synthesise = scene.modes.head_to_surface()
        self._modes = self._analyse.empty()
        self._seen = self._modes[scene.modes.head]
        self._c, self._change, self._divisor = (np.empty_like(scene.c) for _ in range(3))
        self._addend, self.image = (np.zeros((rows, columns), np.float32) for _ in range(2))
        self._zeros, self._factor = np.zeros_like(self.image), np.zeros((), np.float32)
        self._no_units = np.zeros(len(self._hidden) - 1, np.float32)
        self._scale = 1.0  # kPa

    def prepare(self) -> None:
        """Nothing is needed beforehand."""

    def __call__(self, linear: Image) -> int:
        """Restore from the linear image; gives the stages run."""
        scene, factor = self._scene, self._factor
        self._scale = max(linear.item(linear.argmax()), scene.noise)
        factor[()] = 1 / self._scale
        np.multiply(linear, factor, out=self._convolve.images[-1])
        np.multiply(scene.c, factor, out=self._c)
        self._conditions(linear, self._wiener.noise_gain, self._scale)
        done = self._run(self._exact)
        if not scene.cut_short and self._misfit() > MISFIT:
            done += self._run(self._wary)
        factor[()] = self._scale
        np.multiply(self.image, factor, out=self.image)
        scene.keep_force(self.image.reshape(-1))
        return done

    def _run(self, trained: Weights) -> int:
        """Make the image, over its scale, by all stages that there is time for; gives their number."""
        image, noise, done, (span, middle) = self.image, self._scene.noise / self._scale, 0, FIRMNESS
        consistent, redrawn, start = self._convolve.images
        self._tune(trained, self._conditions.values)
        np.copyto(redrawn, start)
        np.maximum(start, self._zeros, out=image)
        np.copyto(consistent, image)
        while done < len(self._tuned) and not self._scene.cut():
            if done:
                np.copyto(redrawn, image)
                change = self._correction(noise**2 * exp(span * self._tuned.item(done - 1, -1) + middle))
                np.add(image, change, out=consistent)
            self._convolve(self._kernels[done], trained.draw[done], self._addend)
            np.add(consistent, self._addend, out=image)
            done += 1
        np.maximum(image, self._zeros, out=image)
        return done

    def _tune(self, trained: Weights, conditions: NDArray[np.float32]) -> None:
        """Fit the stages to a frame's conditions: a layer of hidden units that are cut off below zero."""
        np.clip(conditions, trained.lowest, trained.highest, out=self._input[:-1])
        self._input.dot(trained.hidden, self._hidden[:-1])
        np.maximum(self._hidden[:-1], self._no_units, out=self._hidden[:-1])
        self._hidden.dot(trained.tune, self._tuned.reshape(-1))
        np.multiply(trained.redraw, self._scales, out=self._kernels[:, :, :-1])
        np.copyto(self._kernels[:, :, -1], self._offsets)

    def _misfit(self) -> float:
        """Mean square of what the image leaves of the frame's modes, each over what a right model leaves of it.

        What a scene does within a cell comes through the cover, as does the image's error: in modes that the cover
        takes, only a wrong model leaves more than noise.
        """
        missed, factor, flat = self._missed(), self._factor, self.image.reshape(-1)
        factor[()] = IMAGE_ERROR**2 * float(flat.dot(flat)) / flat.size
        np.multiply(self._square, factor, out=self._divisor)
        factor[()] = (self._scene.noise / self._scale) ** 2
        np.add(self._divisor, factor, out=self._divisor)
        np.multiply(missed, missed, out=missed)
        np.divide(missed, self._divisor, out=missed)
        return float(np.add.reduce(missed, axis=None)) / missed.size

    def _missed(self) -> Image:
        """What the image leaves of the frame's coefficients."""
        self._analyse(self.image, self._modes)
        np.multiply(self._seen, self._gain, out=self._change)
        return np.subtract(self._c, self._change, out=self._change)

    def _correction(self, firmness: float) -> Image:
        """What the frame tells of the image, to be added to it."""
        change, factor = self._missed(), self._factor
        np.multiply(change, self._gain, out=change)
        factor[()] = firmness
        np.add(self._square, factor, out=self._divisor)
        np.divide(change, self._divisor, out=change)
        return self._synthesise(change, self._addend)
