"""Non-negative least squares in the blur's own modes: pressure pushes, it never pulls."""

from math import inf, pi, prod, sqrt

import numpy as np

from tactiled.arrays import Floats32
from tactiled.restore.prior import Spectrum
from tactiled.restore.scene import Scene

# All chosen on random scenes of 13 kinds that no claim is made on.
RELAXATION = 1.7  # a of the splitting: 2 is the limit of convergence
GAUSSIAN_SHARE = 1 / 3  # of the cells pressed: on a smaller one the Gaussian's weight falls in proportion
SPARSE_SHARE = 0.05  # of the cells pressed: on a larger one the weight of the sum falls in proportion
MIN_RADIUS = 2.0  # half-periods of the finest pattern resolved: pressure on a smaller disc would be made up
MAX_ITERATIONS = 15  # 30 are no better
SHARE_EVERY = 3  # iterations after which the share of pressed cells is counted again
SETTLED = 0.1  # of the share: once it changes by less, further iterations sharpen what is noise as often as not


class Smooth:
    """What one spectrum weighs, in the modes, and the smallest share of the cells that it resolves."""

    def __init__(self, scene: Scene) -> None:
        S = scene.spectrum.ratio
        self.prior = np.asarray(1 / S, np.float32)
        radius, shape = MIN_RADIUS * scene.resolution() / scene.blur.cell_mm, S.shape
        cells = min(pi * radius**2, prod(min(2 * radius, n) for n in shape) if len(shape) == 2 else inf)
        self.min_share = min(cells / S.size, 1.0)


class Nonnegative:
    """Restores the frame that its scene last looked at, always from its linear image: no frame before matters.

    Douglas-Rachford splitting (Eckstein and Bertsekas 1992) of
    min |H x - y|^2 / 2 + g sigma^2 x' S^-1 x / 2 + s sigma sum(x), x >= 0: from z, whose positive part is x, to
    z + a (w - x), where w minimises the smooth part + P |w - (2 x - z)|^2 / 2; P is the geometric mean of the
    smooth part's extreme curvatures (Ghadimi et al. 2015). S is a mean over all cells, but only the pressed
    ones have a variance, the larger the fewer they are: g = min(1, share / GAUSSIAN_SHARE). The surer is each
    other cell that it is not pressed: s = min(1, SPARSE_SHARE / share). The share is (sum x)^2 / (M sum x^2) of
    the image so far, no smaller than what the noise lets a frame resolve.
    """

    name = "nnls"

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._smooth: dict[Spectrum, Smooth] = {}
        square = np.zeros(scene.blur.surface_shape)
        square[scene.modes.head] = scene.modes.gain**2 + scene.gain_variance
        self.square, self.gain = np.asarray(square, np.float32), np.asarray(scene.modes.gain, np.float32)
        self._analyse, self._synthesise = scene.modes.to_surface_modes(), scene.modes.to_surface()
        self._modes, self._data, self._inverse, self._again = (self._analyse.empty() for _ in range(4))
        ones = np.ones(scene.blur.surface_shape, np.float32)
        self._ones, self._flat_ones = self._analyse(ones, self._analyse.empty()), ones.reshape(-1)
        self._head, self._product = self._data[scene.modes.head], np.empty_like(scene.c)
        self._z, self._next, self._mirrored = (self._synthesise.empty() for _ in range(3))
        self.image = self._synthesise.empty()
        self._flat = self.image.reshape(-1)
        # Ready-made: to turn a number into an array costs as much as the sum.
        self._zeros, self._factor = np.zeros_like(self.image), np.zeros((), np.float32)
        self._kept = np.asarray(1 - RELAXATION / 2, np.float32)
        self._penalty = 0.0  # P of the iteration so far; 0 before the first

    def prepare(self) -> None:
        """Make what the spectrum picked for the scene needs."""
        if self._scene.spectrum not in self._smooth:
            self._smooth[self._scene.spectrum] = Smooth(self._scene)

    def __call__(self, linear: Floats32) -> int:
        """Iterate from the linear image until the share of pressed cells has settled; gives how often."""
        scene = self._scene
        np.copyto(self._z, linear)
        self._penalty = 0.0
        self.prepare()
        done, share = 0, 0.0
        while done < MAX_ITERATIONS:
            if done % SHARE_EVERY == 0:
                before, share = share, self._share()
                if abs(share - before) < SETTLED * before:
                    break
                if scene.cut():
                    break
                self._load(share)
            self._iterate()
            done += 1
        np.maximum(self._z, self._zeros, out=self.image)
        scene.keep_force(self._flat)
        return done

    def _share(self) -> float:
        """Share of the cells pressed in the image so far."""
        np.maximum(self._z, self._zeros, out=self.image)
        flat = self._flat
        total, squares = float(flat.dot(self._flat_ones)), float(flat.dot(flat))
        share = total**2 / (flat.size * squares) if squares else 1.0
        return min(max(share, self._smooth[self._scene.spectrum].min_share), 1.0)

    def _load(self, share: float) -> None:
        """Put in place what the next iterations owe to the data and to the share of pressed cells."""
        scene, smooth = self._scene, self._smooth[self._scene.spectrum]
        inverse, factor = self._inverse, self._factor
        factor[()] = min(1.0, share / GAUSSIAN_SHARE)
        np.multiply(smooth.prior, factor, out=inverse)
        np.add(inverse, self.square, out=inverse)
        penalty = sqrt(inverse.item(inverse.argmin()) * inverse.item(inverse.argmax()))
        self._rescale(penalty)
        factor[()] = penalty
        np.add(inverse, factor, out=inverse)
        factor[()] = RELAXATION
        np.divide(factor, inverse, out=inverse)
        factor[()] = penalty
        np.multiply(inverse, factor, out=self._again)
        factor[()] = RELAXATION / 2
        np.subtract(self._again, factor, out=self._again)
        factor[()] = -min(1.0, SPARSE_SHARE / share) * scene.noise
        np.multiply(self._ones, factor, out=self._data)
        np.multiply(scene.c, self.gain, out=self._product)
        np.add(self._head, self._product, out=self._head)
        np.multiply(self._data, inverse, out=self._data)

    def _rescale(self, penalty: float) -> None:
        """Go on with another P: z - x, the multiplier over P, shrinks or grows with it."""
        if self._penalty:
            np.subtract(self._z, self.image, out=self._mirrored)
            self._factor[()] = self._penalty / penalty - 1
            np.multiply(self._mirrored, self._factor, out=self._mirrored)
            np.add(self._z, self._mirrored, out=self._z)
        self._penalty = penalty

    def _iterate(self) -> None:
        """Move z one iteration on: with r = 2 x - z, to (1 - a/2) z - (a/2) r + a w, the last two one product."""
        z, new, mirrored = self._z, self._next, np.abs(self._z, out=self._mirrored)
        self._analyse(mirrored, self._modes)
        np.multiply(self._modes, self._again, out=self._modes)
        np.add(self._modes, self._data, out=self._modes)
        self._synthesise(self._modes, new)
        np.multiply(z, self._kept, out=mirrored)
        np.add(new, mirrored, out=new)
        self._z, self._next = new, z
