"""A small learned network, unrolled: three times it redraws the image, then holds it to the frame again.

Trained by `python -m tests.bench train` on scenes and arrays that no claim is made on, some with faults. It draws
the logarithm of its image's deviation, too.
"""

from functools import cache, lru_cache
from math import log, sqrt
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from tactiled.arrays import Floats, Floats32
from tactiled.core import network
from tactiled.restore.blur import THICKNESS_ERROR, Blur
from tactiled.restore.deviation import deviation, slope_in_thickness
from tactiled.restore.prior import Kept
from tactiled.restore.scene import Scene
from tactiled.restore.wiener import Wiener

WEIGHTS = Path(__file__).with_name("learned.npz")
KERNEL = 3  # cells along each side of a filter's kernel
IMAGES = 3  # that a stage redraws from: held to the frame, as last redrawn, linear
INPUTS = IMAGES + 2  # and what never changes of the array, see cell_maps
GAINS = np.array([2, 4, 8, 12, 16, 22, 28]) / 32  # of an axis' modes: where the cover's gain is looked at
MIN_GAIN = 1e-4  # at those: less is not told apart
SLACK = 0.002  # by which their roots may be outside those in training
MAX_DOUBT = 2.0  # logarithm of a deviation over the image's scale
OF_FRAME = 6  # conditions of the frame; those of the cover follow
FIRMNESS = 5.0, 3.0  # a firmness is the noise's variance times exp(5 tuned + 3)
LIMIT = 2.0  # of the linear image's deviations, above it: where cells are finer than taxels, no cell has more
MIN_SIDE = 6  # taxels, with those beyond the border


class Weights(NamedTuple):
    """What was trained, float32; S stages of F filters, conditions c of Learned."""

    redraw: Floats32  # (S, F, 9 INPUTS): kernels of the filters
    draw: Floats32  # (S, 9, F): kernels that their outputs are drawn with
    doubt: Floats32  # (9, F): the same for the logarithm of the last image's deviation
    hidden: Floats32  # (c + 1, m): of the conditions, and a constant
    tune: Floats32  # (m + 1, S (2 F + 1) + 1): each stage's scales, offsets and firmness; the doubt's
    lowest: Floats32  # (c,) of the conditions in training
    highest: Floats32  # (c,)


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


def cell_maps(scene: Scene) -> Floats32:
    """Give (2, R, C): what taxels feel of each cell's pressure, over the most; 1 where it is the array's."""
    wide, shape = scene.array.wide, scene.blur.surface_shape
    felt = scene.cell_reach if wide is None or wide.felt is None else wide.felt.sum(axis=0).reshape(shape)
    covered = np.zeros(shape)
    covered[wide.own if wide else ...] = scene.array.taxel >= 0
    return np.array([felt / felt.max(), covered], np.float32)


class Conditions:
    """What the network is told besides the frame's image: noise, spectrum, cells a taxel and cover, (c,)."""

    def __init__(self, scene: Scene) -> None:
        self.values = np.concatenate([np.ones(OF_FRAME, np.float32), cover_gains(scene.blur)])
        self._scene, self._cells = scene, scene.cell_reach.size
        self.values[5] = log(float(cell_maps(scene)[1].sum()) / scene.size)

    def __call__(self, linear: Wiener) -> float:
        """Take the scene's frame, by its linear image; gives the largest value of that (kPa), or the noise."""
        spectrum = self._scene.spectrum
        total, squares, _, highest = linear.sums
        scale = max(highest, self._scene.noise)
        share = total**2 / (squares * self._cells) if squares else 1.0
        self.values[0] = log(self._scene.noise / scale) / 3 + 1.5
        self.values[1] = log(spectrum.level) / 5 - 1
        self.values[2] = log(spectrum.corner) / 2 + 1
        self.values[3] = log(linear.noise_gain) / 2
        self.values[4] = log(share) / 2 + 1
        return scale


class Learned:
    """Restores the frame that its scene last looked at, from the linear image: no frame before matters.

    Each stage adds to the image what its convolution draws, then takes from the frame what it tells:
    z + V' h (c - h V z) / (h^2 + k), the least of |H x - y|^2 + k |x - z|^2 in the blur's modes.
    """

    name = "learned"

    def __init__(self, scene: Scene, wiener: Wiener) -> None:
        self._scene, self._wiener = scene, wiener
        self._stages = Stages(cell_maps(scene))
        rows, columns = scene.blur.surface_shape
        self._conditions = Conditions(scene)
        self._images = np.empty((IMAGES, rows, columns), np.float32)
        self._gain = np.asarray(scene.modes.gain, np.float32)
        bases = zip(scene.modes.surface, self._gain.shape, strict=True)
        self._down, self._across = (np.ascontiguousarray(V[:, :n], np.float32) for V, n in bases)
        self.image = np.zeros((rows, columns), np.float32)
        self._is_fine, self._spreads = scene.array.refine > 1, Kept[Floats32]()
        self._scale = 1.0  # kPa

    def prepare(self) -> None:
        """Make what the scene's spectrum needs."""
        if self._is_fine:
            self._spread()

    def __call__(self, linear: Floats32) -> int:
        """Restore from the linear image; gives the stages run."""
        scene = self._scene
        self._scale = self._conditions(self._wiener)
        done = self._run(linear)
        if self._is_fine:
            most = np.maximum(linear, 0) + np.float32(LIMIT * scene.noise) * self._spread()
            np.minimum(self.image, most, out=self.image)
        scene.keep_force(self.image.reshape(-1))
        return done

    def deviation(self) -> Floats:
        """Standard deviation (kPa) of every cell of the image last restored.

        The network gives its own; a cover that is known less than in training adds what it changes. Of what is
        between 0 and a bound the deviation is half the bound at most (Popoviciu 1935).
        """
        scene, doubts = self._scene, np.minimum(self._stages.doubts(self._images), MAX_DOUBT)
        spread = np.minimum(self._scale * np.exp(doubts.astype(float)), 0.5 * scene.most(self.image))
        doubt = sqrt(max(scene.thickness_error**2 - THICKNESS_ERROR**2, 0.0))
        return np.asarray(np.hypot(spread, doubt * slope_in_thickness(scene, self.image)) if doubt else spread)

    def _spread(self) -> Floats32:
        """Standard deviation of the linear image's cells, over the noise."""
        scene = self._scene
        cells = scene.cell_reach.size
        return self._spreads(scene.spectrum, lambda: np.asarray(deviation(scene) / scene.noise, np.float32), cells)

    def _run(self, linear: Floats32) -> int:
        """Make the image from the linear one; gives the number of stages, 0 if time is over."""
        scene, stages, noise = self._scene, self._stages, self._scene.noise / self._scale
        stages.tune(self._conditions.values)
        if scene.cut():
            np.maximum(linear, 0, out=self.image)
            self._images[:] = self.image / np.float32(self._scale)
            self._images[2] = linear / np.float32(self._scale)
            return 0
        network.restore(
            linear, self._scale, stages.fixed, stages.kernels, stages.tuned, stages.draw,
            self._down, self._across, self._gain, scene.c, noise**2, FIRMNESS, scene.box[:4],
            self._images, self.image,
        )  # fmt: skip
        return len(stages.tuned)


@lru_cache(maxsize=16)  # of the arrays in use: alike ones share what is much larger than their images
def _drawn(shape: tuple[int, ...], maps: bytes) -> tuple[Floats32, Floats32]:
    """Give the kernels of the filters for a stage's images, and what they draw from the array's maps."""
    trained, (_, rows, columns) = weights(), shape
    stages, filters = trained.redraw.shape[:2]
    taps = np.moveaxis(trained.redraw.reshape(stages, filters, KERNEL, KERNEL, INPUTS), -1, 2)
    padded = np.pad(np.frombuffer(maps, np.float32).reshape(shape), ((0, 0), (1, 1), (1, 1)))
    around = sliding_window_view(padded, (KERNEL, KERNEL), (1, 2))
    fixed = np.zeros((stages, filters, rows, columns + 1), np.float32)
    fixed[..., :-1] = np.einsum("sfiab,ircab->sfrc", taps[:, :, IMAGES:], around)
    return np.ascontiguousarray(np.moveaxis(taps[:, :, :IMAGES], 1, -1)), fixed


class Stages:
    """What was trained, in the order of memory that redraws fast, for an array's `maps` (see cell_maps)."""

    def __init__(self, maps: Floats32) -> None:
        self._trained = trained = weights()
        stages, filters = trained.redraw.shape[:2]
        self.kernels, self.fixed = _drawn(maps.shape, maps.tobytes())
        self.draw = trained.draw.reshape(stages, KERNEL, KERNEL, filters)
        self._doubt = trained.doubt.reshape(KERNEL, KERNEL, filters)
        self._tuned = np.zeros(trained.tune.shape[1], np.float32)
        self.tuned = self._tuned[:-1].reshape(stages, -1)  # each stage's scales, offsets and firmness

    def tune(self, conditions: NDArray[np.float32]) -> None:
        """Fit the stages to a frame's conditions."""
        trained = self._trained
        network.tune(conditions, trained.lowest, trained.highest, trained.hidden, trained.tune, self._tuned)

    def doubts(self, images: Floats32) -> Floats32:
        """Give the logarithm of the deviation (R, C) of what the last stage made of its images."""
        filters, out = self.kernels.shape[-1], np.empty(images.shape[1:], np.float32)
        scales, offsets = self.tuned[-1, :filters], self.tuned[-1, filters:-1]
        network.redraw(images, self.fixed[-1], self.kernels[-1], scales, offsets, self._doubt, out)
        out += self._tuned[-1]
        return out
