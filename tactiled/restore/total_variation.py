"""Non-negative least squares that prefers flat parts with sharp edges: total variation, isotropic, of a grid."""

import numpy as np

from tactiled.restore.modes import Image
from tactiled.restore.nonnegative import Nonnegative
from tactiled.restore.scene import Scene

# Weight, corner and tolerance were chosen on the scenes of `python -m tests.study judge --family first`.
VARIATION_WEIGHT = 0.04  # times the geometric mean of noise and contrast
FLAT_CORNER = 0.2  # cycles a cell: a scene whose spectrum reaches further has few flat parts to look for
PENALTY, RELAXATION = 0.3, 1.0  # of the splitting: the edges' pull takes one step an iteration, too
MAX_ITERATIONS = 30
SETTLED = 0.0  # the edges settle after the share of pressed cells
MIN_WEIGHT = 1e-6  # noise standard deviations: a weight of 0 would be divided by 0
DUAL_STEP = 0.125  # of the edges' pull: 1 over the largest eigenvalue of a grid's differences


class Edges:
    """An image's edges pull at it: p, along rows and down columns, follows the differences of x in every cell.

    Rows follow one another in memory, so a neighbour is a shift: `x` and p have room past their ends.
    """

    def __init__(self, shape: tuple[int, int]) -> None:
        rows, columns = shape
        cells = rows * columns
        x = np.zeros(cells + columns, np.float32)
        self.x, self._right, self._under = x[:cells], x[1 : cells + 1], x[columns:]
        p = np.zeros(1 + cells, np.float32), np.zeros(columns + cells, np.float32)
        (self._across, self._down), (self._before, self._above) = (
            [p[0][1:], p[1][columns:]],
            [q[:cells] for q in p],
        )
        self._row_ends, self._column_ends = self._across.reshape(shape)[:, -1], self._down[cells - columns :]
        self._in_row, self._in_column = np.ones((2, cells), np.float32)  # 1 where there is a neighbour
        self._in_row[columns - 1 :: columns] = self._in_column[cells - columns :] = 0
        self._length, self._square = np.empty_like(self.x), np.empty_like(self.x)
        self._step, self._zero = np.full_like(self.x, DUAL_STEP), np.zeros_like(self.x)
        self._limit = np.ones_like(self.x)

    def reset(self) -> None:
        """Pull no more."""
        self._across[...] = self._down[...] = 0

    def limit(self, weight: float) -> None:
        """Let no pull be longer than `weight` from now on."""
        self._limit[...] = weight / DUAL_STEP

    def sum_of_differences(self) -> float:
        """Sum of the differences' magnitudes, along rows and down columns."""
        total = 0.0
        for neighbour, inside in ((self._right, self._in_row), (self._under, self._in_column)):
            np.subtract(neighbour, self.x, out=self._length)
            np.abs(self._length, out=self._length)
            total += float(self._length.dot(inside))
        return total

    def fill(self, z: Image) -> None:
        """Make x what is left of z (R C,) under the pull, 0 where that is negative."""
        x = self.x
        np.subtract(self._across, self._before, out=x)
        np.add(x, self._down, out=x)
        np.subtract(x, self._above, out=x)
        np.multiply(x, self._step, out=x)
        np.add(x, z, out=x)
        np.maximum(x, self._zero, out=x)

    def follow(self) -> None:
        """Move the pull on by the differences of x, then cut it to its limit."""
        across, down, length = self._across, self._down, self._length
        np.add(across, self._right, out=across)
        np.subtract(across, self.x, out=across)
        np.add(down, self._under, out=down)
        np.subtract(down, self.x, out=down)
        self._row_ends[...] = self._column_ends[...] = 0
        np.multiply(across, across, out=length)
        np.multiply(down, down, out=self._square)
        np.add(length, self._square, out=length)
        np.sqrt(length, out=length)
        np.maximum(length, self._limit, out=length)
        np.divide(self._limit, length, out=length)
        np.multiply(across, length, out=across)
        np.multiply(down, length, out=down)


class TotalVariation(Nonnegative):
    """The same iteration, the weighted variation of the image added: its edges' pull is found along the way.

    max(z, 0) becomes max(z - D'p, 0), where p follows D x, in no cell longer than the weight over P. The weight is
    VARIATION_WEIGHT sqrt(sigma B) / (1 + (q0 / FLAT_CORNER)^2), B = sum x^2 / sum |D x|: between the noise and
    what the image has to lose, and less the further the scene's spectrum reaches.
    """

    _relaxation, _max_iterations, _settled = RELAXATION, MAX_ITERATIONS, SETTLED

    def __init__(self, scene: Scene) -> None:
        super().__init__(scene)
        rows, columns = scene.blur.surface_shape
        self._edges = Edges((rows, columns))
        self._x = self._edges.x.reshape(rows, columns)

    def _start(self, linear: Image) -> None:
        super()._start(linear)
        np.maximum(linear, self._zeros, out=self._x)
        self._edges.reset()

    def _show(self) -> None:
        self.image[...] = self._x

    def _penalty_for(self, curvature: Image) -> float:
        del curvature
        return PENALTY

    def _mirror(self) -> Image:
        self._edges.fill(self._z.reshape(-1))
        self._edges.follow()
        mirrored = np.add(self._x, self._x, out=self._mirrored)
        return np.subtract(mirrored, self._z, out=mirrored)

    def _load(self, share: float) -> None:
        super()._load(share)
        scene, x = self._scene, self._edges.x
        differences = self._edges.sum_of_differences()
        contrast = float(x.dot(x)) / differences if differences else 0.0
        flat = 1 / (1 + (scene.spectrum.corner / FLAT_CORNER) ** 2)
        weight = VARIATION_WEIGHT * flat * (scene.noise * contrast) ** 0.5
        self._edges.limit(max(weight, MIN_WEIGHT * scene.noise) / self._penalty)
