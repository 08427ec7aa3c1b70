"""Non-negative least squares in the blur's own modes: pressure pushes, it never pulls."""

from math import pi, prod

import numpy as np

from tactiled.restore.modes import Image
from tactiled.restore.prior import Spectrum
from tactiled.restore.scene import Scene
from tactiled.restore.wiener import Wiener

# All chosen on the scenes of `python -m tests.study restore`.
PENALTY = 0.3  # ADMM's: against a blur whose largest gain is 1
SPARSE_WEIGHT = 0.25  # of the sum of pressures, in noise standard deviations, on an image pressed all over
MIN_SHARE = 0.002  # of the cells pressed: smaller shares count as this one
SPARSE_SHARE = 0.025  # of the cells pressed: a mean over all modes then says little about the pressed ones
SPARSE_GAUSSIAN = 0.3  # of the Gaussian's weight remains there
MAX_ITERATIONS = 30
COLD_TOLERANCE = 0.05  # noise standard deviations: an iteration that changes less is the last
WARM_TOLERANCE = 0.6  # the same from the image before: it has been through many iterations already
SHARE_EVERY = 4  # iterations after which the share of pressed cells is counted again


class Step:
    """The constants of the iteration for one spectrum, its Gaussian weighed by `slack`."""

    def __init__(self, scene: Scene, slack: float, ones: Image) -> None:
        S = scene.spectrum.ratio
        weight = 1 / (1 + scene.gain_variance * S[scene.modes.head])
        square = np.zeros_like(S)
        square[scene.modes.head] = weight * scene.modes.gain**2
        inverse = 1 / (square + slack / S + PENALTY)
        self.again = np.asarray(PENALTY * inverse, np.float32)
        self.data = np.asarray(weight * scene.modes.gain * inverse[scene.modes.head], np.float32)
        self.sparse = np.asarray(-SPARSE_WEIGHT * scene.noise * inverse * ones, np.float32)


class Nonnegative:
    """Restores the frame that its scene last looked at, starting from the image before.

    ADMM on min |H x - y|^2 / 2 + sigma^2 x' S^-1 x / 2 + s sigma sum(x), x >= 0: with t = x + u - s sigma / P,
    the image is max(t, 0); the next x depends on |t| and min(t, 0). The fewer cells are pressed, the surer
    is each that it is not: s = SPARSE_WEIGHT / sqrt(share), the share being (sum x)^2 / (M sum x^2) of the image
    so far, but no smaller than what the noise lets a frame resolve: pressure on less would be made up.
    """

    _warm_tolerance = WARM_TOLERANCE

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        scene.follows = True
        self._steps: dict[tuple[Spectrum, float], Step] = {}
        self._min_shares: dict[Spectrum, float] = {}
        self._analyse, self._synthesise = scene.modes.to_surface_modes(), scene.modes.to_surface()
        self._modes, self._data = self._analyse.empty(), self._analyse.empty()
        ones = np.ones(scene.blur.surface_shape, np.float32)
        self._ones, self._flat_ones = self._analyse(ones, self._analyse.empty()), ones.reshape(-1)
        self._head, self._product = self._data[scene.modes.head], np.empty_like(scene.c)
        self._t, self._abs, self._pull = (self._synthesise.empty() for _ in range(3))
        self.image = self._synthesise.empty()
        self._flat = self.image.reshape(-1)
        # Ready-made: to turn a number into an array costs as much as the sum.
        self._zeros, self._factor = np.zeros_like(self.image), np.zeros((), np.float32)
        self._reach = scene.blur.reach.reshape(-1)
        self._change = np.empty_like(self._pull)
        self._pressed = np.empty(self._pull.shape, bool)
        self._warm = False

    def reset(self) -> None:
        """Forget the image before."""
        self._warm = False

    def prepare(self) -> None:
        """Make what the spectrum picked for the scene needs."""
        self._step(1.0)
        self._step(SPARSE_GAUSSIAN)

    def noise_gain(self, linear: float) -> float:
        """Give the image's noise over the frame's: `linear`, the filter's, where pressed, and none elsewhere."""
        np.greater(self.image, self._zeros, out=self._pressed)
        return linear * (np.count_nonzero(self._pressed) / self._pressed.size) ** 0.5

    def __call__(self, wiener: Wiener) -> int:
        """Iterate until an iteration changes hardly anything; gives how many were made."""
        scene = self._scene
        self._warm = self._warm and not scene.unrelated
        tolerance = (self._warm_tolerance if self._warm else COLD_TOLERANCE) * scene.noise
        if not self._warm:
            self._start(wiener())
            self._warm = True
        elif scene.moved:
            self._shift(wiener.of(scene.step))
        limit = tolerance**2 * self._t.size
        done = 0
        while done < MAX_ITERATIONS:
            if done % SHARE_EVERY == 0:
                step = self._load()
            done += 1
            if self._iterate(step) <= limit:
                break
        self._show()
        scale = scene.force_scale(scene.force - float(self._reach.dot(self._flat)))
        if scale != 1.0:
            self._factor[()] = scale
            np.multiply(self.image, self._factor, out=self.image)
        return done

    def _start(self, guess: Image) -> None:
        """Start from an image that may be negative."""
        np.maximum(guess, self._zeros, out=self._t)
        self._pull[...] = self._zeros

    def _shift(self, change: Image) -> None:
        """Start from the image before, plus the linear answer to what changed since the last such start."""
        np.add(self._t, change, out=self._t)
        np.minimum(self._t, self._zeros, out=self._pull)

    def _show(self) -> None:
        """Put the image so far in place."""
        np.maximum(self._t, self._zeros, out=self.image)

    def _slack(self, share: float) -> float:
        """How much of the Gaussian's weight remains."""
        return SPARSE_GAUSSIAN if share < SPARSE_SHARE else 1.0

    def _reflect(self) -> Image:
        """Give the image less its multiplier."""
        return np.abs(self._t, out=self._abs)

    def _split(self) -> None:
        """Take from t, as `_change`, the multiplier: what of it is no image."""
        np.minimum(self._t, self._zeros, out=self._change)

    def _step(self, slack: float) -> Step:
        key = self._scene.spectrum, slack
        if key not in self._steps:
            self._steps[key] = Step(self._scene, slack, self._ones)
        return self._steps[key]

    def _load(self) -> Step:
        """Put in place what the modes owe to the data and to the share of pressed cells; gives the next step."""
        self._show()
        flat = self._flat
        total, squares = float(flat.dot(self._flat_ones)), float(flat.dot(flat))
        share = total**2 / (flat.size * squares) if squares else 1.0
        share = min(max(share, self._min_share()), 1.0)
        step = self._step(self._slack(share))
        self._factor[()] = share**-0.5
        np.multiply(step.sparse, self._factor, out=self._data)
        np.multiply(self._scene.c, step.data, out=self._product)
        np.add(self._head, self._product, out=self._head)
        return step

    def _min_share(self) -> float:
        """Share of the cells on a disc of the resolution's radius: fewer pressed are only made up."""
        scene = self._scene
        if scene.spectrum not in self._min_shares:
            radius, shape = scene.resolution() / scene.blur.cell_mm, self._t.shape
            cells = pi * radius**2
            if len(shape) == 2:
                cells = min(cells, prod(min(2 * radius, n) for n in shape))
            self._min_shares[scene.spectrum] = max(cells / self._t.size, MIN_SHARE)
        return self._min_shares[scene.spectrum]

    def _iterate(self, step: Step) -> float:
        """Move t one iteration on; gives the squared change of the multiplier."""
        self._analyse(self._reflect(), self._modes)
        np.multiply(self._modes, step.again, out=self._modes)
        np.add(self._modes, self._data, out=self._modes)
        self._synthesise(self._modes, self._t)
        np.add(self._t, self._pull, out=self._t)
        self._split()
        self._pull, self._change = self._change, self._pull
        np.subtract(self._change, self._pull, out=self._change)
        flat = self._change.reshape(-1)
        return float(flat.dot(flat))
