"""A small learned network, unrolled: three times it redraws the image, then holds it to the frame again.

Trained by `python -m tests.study train` on scenes that no claim is made on. Where its image does not explain the
frame, the model of the skin is wrong: the image is made again by weights that were trained on frames with faults.
"""

from functools import cache
from math import exp, log
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactiled.core import coefficients, network
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


class Conditions:
    """What the network is told of a frame besides its image: noise, spectrum and cover, (c,)."""

    def __init__(self, scene: Scene) -> None:
        self.values = np.concatenate([np.ones(OF_FRAME, np.float32), cover_gains(scene.blur)])
        self._scene = scene

    def __call__(self, linear: Image, noise_gain: float, scale: float) -> NDArray[np.float32]:
        """Give those of the scene's frame, by its linear image, whose largest value is `scale` (kPa)."""
        spectrum = self._scene.spectrum
        total, squares, _ = coefficients.signed_sums(linear)
        share = total**2 / (squares * linear.size) if squares else 1.0
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
        self._exact, self._wary = (Stages(weights(path)) for path in (WEIGHTS, WARY_WEIGHTS))
        rows, columns = scene.blur.surface_shape
        self._conditions = Conditions(scene)
        self._fixed = np.zeros((self._exact.filters, rows, columns + 1), np.float32)
        self._images = np.empty((INPUTS, rows, columns), np.float32)
        self._gain = np.asarray(scene.modes.gain, np.float32)
        bases = zip(scene.modes.surface, self._gain.shape, strict=True)
        self._down, self._across = (np.ascontiguousarray(V[:, :n], np.float32) for V, n in bases)
        self._back = np.ascontiguousarray(self._across.T)
        self._c = np.empty_like(scene.c)
        self._drawn, self.image = (np.zeros((rows, columns), np.float32) for _ in range(2))
        self._scale = 1.0  # kPa

    def prepare(self) -> None:
        """Nothing is needed beforehand."""

    def __call__(self, linear: Image) -> int:
        """Restore from the linear image; gives the stages run."""
        scene = self._scene
        self._scale = max(linear.item(linear.argmax()), scene.noise)
        start, self._c[...] = linear / np.float32(self._scale), scene.c / np.float32(self._scale)
        self._conditions(linear, self._wiener.noise_gain, self._scale)
        done = self._run(self._exact, start)
        if not scene.cut_short and self._misfit() > MISFIT:
            done += self._run(self._wary, start)
        self.image *= np.float32(self._scale)
        scene.keep_force(self.image.reshape(-1))
        return done

    def _run(self, stages: "Stages", start: Image) -> int:
        """Make the image, over its scale, by all stages that there is time for; gives their number."""
        noise, done, (span, middle) = self._scene.noise / self._scale, 0, FIRMNESS
        self._images[1:] = start
        consistent, image = self._images[0], self._images[1]
        np.maximum(start, 0, out=consistent)
        tuned = stages.tune(self._conditions.values)
        while done < len(tuned) and not self._scene.cut():
            if done:
                self._hold(image, noise**2 * exp(span * tuned.item(done - 1, -1) + middle), consistent)
            scales, offsets = tuned[done, : stages.filters], tuned[done, stages.filters : -1]
            kernels, draw = stages.kernels[done], stages.draw[done]
            network.redraw(self._images, self._fixed, kernels, scales, offsets, draw, self._drawn)
            np.add(consistent, self._drawn, out=image)
            done += 1
        np.maximum(image if done else consistent, 0, out=self.image)
        return done

    def _misfit(self) -> float:
        """Mean square of what the image leaves of the frame's modes, each over what a right model leaves of it.

        What a scene does within a cell comes through the cover, as does the image's error: in modes that the cover
        takes, only a wrong model leaves more than noise.
        """
        bases, noise = (self._down, self._across), self._scene.noise / self._scale
        return network.misfit(self.image, *bases, self._gain, self._c, IMAGE_ERROR, noise)

    def _hold(self, image: Image, firmness: float, out: Image) -> None:
        """Add to the image what the frame tells of it."""
        network.hold(image, self._down, self._across, self._back, self._gain, self._c, firmness, out)


class Stages:
    """What was trained, in the order of memory that redraws fast."""

    def __init__(self, trained: Weights) -> None:
        self._trained = trained
        stages, self.filters = trained.redraw.shape[:2]
        taps = trained.redraw.reshape(stages, self.filters, KERNEL, KERNEL, INPUTS)
        self.kernels = np.ascontiguousarray(np.moveaxis(taps, -1, 2))
        self.draw = trained.draw.reshape(stages, KERNEL, KERNEL, self.filters)

    def tune(self, conditions: NDArray[np.float32]) -> Image:
        """Fit the stages (S, 2 F + 1) to a frame's conditions: a layer of units that are cut off below zero."""
        trained, tuned = self._trained, np.empty(self._trained.tune.shape[1], np.float32)
        network.tune(conditions, trained.lowest, trained.highest, trained.hidden, trained.tune, tuned)
        return tuned.reshape(len(self.kernels), -1)
