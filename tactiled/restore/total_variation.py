"""Non-negative least squares that prefers flat parts with sharp edges: total variation, isotropic, of a grid."""

from math import sqrt

import numpy as np

from tactiled.arrays import Floats32
from tactiled.restore.nonnegative import Nonnegative
from tactiled.restore.prior import Spectrum
from tactiled.restore.scene import Scene

# All chosen on random scenes of 14 kinds that no claim is made on.
VARIATION_WEIGHT = 0.22  # times sqrt(sigma rms) / v^VARIANCE_POWER
VARIANCE_POWER = 2 / 3
PENALTY = 2.0  # over v: P of the splitting
ITERATIONS = 5  # 20 spare another 2 % of error
CUT_EVERY = 2  # iterations after which the time is looked at again
DUAL_STEP = 0.24  # of the edges' pull: below 2 over the largest eigenvalue of a grid's differences, 8
MODES_MISS = 0.02  # of a frame's norm, about twice what the blur's modes miss: less noise does not hide that
MIN_WEIGHT = 1e-6  # noise standard deviations: a weight of 0 would be divided by 0


class Edges:
    """An image's edges pull at it: p, along rows and down columns, follows the differences of x in every cell.

    Either part of p has zeros before it, and rows follow one another in memory, so a neighbour is a shift.
    """

    def __init__(self, shape: tuple[int, int]) -> None:
        rows, columns = shape
        cells = rows * columns
        part = cells + columns
        self.x = np.zeros(cells, np.float32)
        p, changes, squares = (np.zeros(1 + 2 * part, np.float32) for _ in range(3))
        self._p, self._changes, self._squares = p[1:], changes[1:], squares[1:]
        self._both = self._p.reshape(2, part)[:, :cells]
        self._across, self._down = self._both
        self._before, self._above = p[:cells], p[1 + cells :][:cells]
        self._length, self._square_down = self._squares.reshape(2, part)[:, :cells]
        self._inner, self._right = self.x[:-1], self.x[1:]
        self._upper, self._lower = self.x[:-columns], self.x[columns:]
        self._rightward, self._downward = self._changes[: cells - 1], self._changes[part:][: cells - columns]
        self._row_ends = self._changes[:cells].reshape(shape)[:, -1]
        self._step, self._limit = (np.asarray(each, np.float32) for each in (DUAL_STEP, 1))
        self._zeros = np.zeros_like(self.x)

    def reset(self, weight: float) -> None:
        """Pull no more; let no pull be longer than `weight` from now on."""
        self._p[...] = 0
        self._limit[()] = weight / DUAL_STEP

    def fill(self, z: Floats32) -> None:
        """Make x what is left of z (R C,) under the pull, 0 where that is negative."""
        x = self.x
        np.subtract(self._across, self._before, out=x)
        np.add(x, self._down, out=x)
        np.subtract(x, self._above, out=x)
        np.multiply(x, self._step, out=x)
        np.add(x, z, out=x)
        np.maximum(x, self._zeros, out=x)

    def follow(self) -> None:
        """Move the pull on by the differences of x, then cut it to its limit."""
        length = self._length
        np.subtract(self._right, self._inner, out=self._rightward)
        self._row_ends.fill(0)
        np.subtract(self._lower, self._upper, out=self._downward)
        np.add(self._p, self._changes, out=self._p)
        np.multiply(self._p, self._p, out=self._squares)
        np.add(length, self._square_down, out=length)
        np.sqrt(length, out=length)
        np.maximum(length, self._limit, out=length)
        np.divide(self._limit, length, out=length)
        np.multiply(self._both, length, out=self._both)


class TotalVariation:
    """Restores the frame that its scene last looked at, from the non-negative image: no frame before matters.

    Douglas-Rachford splitting of min |H x - y|^2 / 2 + weight TV(x), x >= 0, the edges' pull p found along the
    way: x = max(z - D'p, 0), where p follows D x, in no cell longer than the weight over P; then z moves by w - x,
    where w minimises |H w - y|^2 / 2 + P |w - (2 x - z)|^2 / 2. The less a frame tells of a cell, the smaller are
    both: with v = mean S / (1 + h^2 S), a cell's variance given the frame over the noise's, the weight is
    VARIATION_WEIGHT sqrt(sigma rms(y)) / v^VARIANCE_POWER, and P is PENALTY / v.

    H is diagonal in its modes but for about a hundredth of its norm. Where the noise is too low to hide that, y is
    first corrected by what the modes miss of the image that the iterations start from.
    """

    name = "tv"

    def __init__(self, scene: Scene) -> None:
        rows, columns = scene.blur.surface_shape
        self._scene, self._nonnegative = scene, Nonnegative(scene)
        self._square, self._gain = self._nonnegative.square, self._nonnegative.gain
        self._variance: dict[Spectrum, float] = {}  # v
        self._analyse, self._synthesise = scene.modes.to_surface_modes(), scene.modes.to_surface()
        self._modes, self._data, self._inverse, self._again = (np.zeros_like(self._square) for _ in range(4))
        self._head, self._product = self._data[scene.modes.head], np.empty_like(scene.c)
        self._exact, self._c = scene.blur.forward_in_modes(), np.empty_like(scene.c)
        # Norm of a frame up to which noise hides what the modes miss of it.
        self._hidden = scene.noise * sqrt(scene.flat.size) / MODES_MISS
        # The rest is z - x.
        self._rest, self._z, self._mirrored = (np.zeros((rows, columns), np.float32) for _ in range(3))
        self._edges = Edges((rows, columns))
        self._flat = self._edges.x
        self.image = self._flat.reshape(rows, columns)
        self._factor = np.zeros((), np.float32)

    def prepare(self) -> None:
        """Make what the spectrum picked for the scene needs."""
        self._nonnegative.prepare()
        self._cell_variance()

    def __call__(self, linear: Floats32) -> int:
        """Restore from the linear image; gives how often was iterated."""
        done = self._nonnegative(linear)
        return done + self.flatten(self._nonnegative.image)

    def flatten(self, image: Floats32) -> int:
        """Restore from a non-negative image; gives how often was iterated."""
        scene, edges, done = self._scene, self._edges, 0
        np.copyto(self.image, image)
        self._take_data()
        self._load()
        self._rest[...] = 0
        while done < ITERATIONS and not (done % CUT_EVERY == 0 and scene.cut()):
            edges.follow()
            self._iterate()
            done += 1
        scene.keep_force(self._flat)
        return done

    def _cell_variance(self) -> float:
        spectrum = self._scene.spectrum
        if spectrum not in self._variance:
            S = spectrum.ratio
            self._variance[spectrum] = float((S / (1 + self._square * S)).mean())
        return self._variance[spectrum]

    def _take_data(self) -> None:
        """Put in place the frame's coefficients c, less what the modes miss of the image: (U'H - h V') x."""
        scene, c = self._scene, self._c
        np.copyto(c, scene.c)
        if self._exact is None or scene.square < self._hidden**2:
            return
        self._analyse(self.image, self._modes)
        np.multiply(self._modes[scene.modes.head], self._gain, out=self._product)
        np.add(c, self._product, out=c)
        np.subtract(c, self._exact(self.image, self._product), out=c)

    def _load(self) -> None:
        """Put in place what the iterations owe to the frame."""
        scene, factor, v = self._scene, self._factor, self._cell_variance()
        penalty = PENALTY / v
        rms = sqrt(scene.square / scene.flat.size)
        weight = VARIATION_WEIGHT * sqrt(scene.noise * rms) / v**VARIANCE_POWER
        self._edges.reset(max(weight, MIN_WEIGHT * scene.noise) / penalty)
        factor[()] = penalty
        np.add(self._square, factor, out=self._inverse)
        np.divide(factor, self._inverse, out=self._again)
        np.multiply(self._c, self._gain, out=self._product)
        np.divide(self._product, self._inverse[scene.modes.head], out=self._head)

    def _iterate(self) -> None:
        """Move z one iteration on, and x after it."""
        x, rest, z, modes = self.image, self._rest, self._z, self._modes
        np.subtract(x, rest, out=self._mirrored)
        self._analyse(self._mirrored, modes)
        np.multiply(modes, self._again, out=modes)
        np.add(modes, self._data, out=modes)
        self._synthesise(modes, z)
        np.add(z, rest, out=z)
        self._edges.fill(z.reshape(-1))
        np.subtract(z, x, out=rest)
