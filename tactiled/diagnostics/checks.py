"""Checks of a frame and its image against themselves: faults that show without knowing the true pressure.

Pressure never pulls and a cover only smooths, whatever is pressed. So no part of a frame lies further below zero
than its noise explains, and the modes that the cover weakens most hold no less than the noise.
"""

from collections.abc import Callable
from math import hypot, sqrt
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammainccinv, ndtri

from tactiled.arrays import Flags, Floats, Floats32, Ints, Mask
from tactiled.core import readings
from tactiled.diagnostics.warning_codes import WarningCode, warning
from tactiled.frames import FrameWarning
from tactiled.restore.blur import Blur

# `tactiled bench stability` counts how often these bounds raise a warning on sound frames.
CHECK_EVERY_FRAMES = 16
CHECKS_IN_A_ROW = 3  # that must agree before a warning is raised
FALSE_ALARM = 1e-4  # chance that white noise, as configured, raises one of the warnings about noise
NOISE_RATIO = 2.0  # of true to configured noise, or the inverse, that is worth a warning
PARTS_PER_AXIS = 4  # of a frame
WEAK_MODES = 24  # of them hold less than a quarter of the noise's power with no more than that chance
WEAK_MODES_PER = 8  # modes one counts among those that the cover weakens most, if that is more
MIN_OFFSET = 0.02  # of the highest pressure: a lower offset does not matter
EVEN_RATIO = 1.25  # of a quarter of the parts to the least pressed part, at most, if all have the same offset
MODEL_ERROR = 0.01  # of the frame's peak: what a true model misses, as scenes do not lie on its grid
MAX_RESIDUAL_RMS = 3.5  # times the expected one
MAX_RESIDUAL = 16.0  # of one taxel, times the expected one
MAX_OUTLIERS = 9  # taxels, a dead one and its neighbours; with more of them the cover's model is wrong
BELOW_ZERO = 7.0  # times the noise
PRESSED = 10.0  # times the noise: a lower peak is no contact
PLATEAU_TAXELS = 3  # that share the highest value
EXCESS_SIGMAS = 4.0  # by which an image is stronger than its frame if its force is from elsewhere
EXCESS_RATIO = 0.02  # of its strength: one of these sigmas, however faint the noise
EDGE_RATIO = 1.5  # of the highest pressure at the rim to the highest inside

Predict = Callable[[], Floats32]
Scalar = TypeVar("Scalar", bound=np.generic)


class FrameChecks:
    """Checks every CHECK_EVERY_FRAMES-th frame of one array; warns of what CHECKS_IN_A_ROW checks show."""

    def __init__(self, blur: Blur, floor_kpa: float = 0.0) -> None:
        """`floor_kpa` is the part of the noise that rounding to counts makes."""
        self._blur, self._floor = blur, floor_kpa
        self._grid = len(blur.frame_shape) == 2 and min(blur.surface_shape) > 2
        self._parts = _Parts(np.ones(blur.frame_shape, bool))
        self._cells = _Parts(blur.taxel >= 0)
        self._fewest = float(self._parts.counts.min())
        self._max_below = _max_below(int(np.prod(blur.frame_shape)))
        self._to_modes = blur.modes.to_taxel_modes()
        self._weak = _weakest(blur.modes.gain)
        self._frames = 0
        self._counts: dict[WarningCode, int] = {}  # checks in a row that showed it
        self._warnings: tuple[FrameWarning, ...] = ()

    def __call__(
        self,
        raw: Floats32,
        flags: Flags,
        image: Floats32,
        noise: float,
        method: str = "",
        predict: Predict | None = None,
    ) -> tuple[FrameWarning, ...]:
        """Warnings of this frame; arguments as of `check`."""
        self._frames += 1
        if self._frames % CHECK_EVERY_FRAMES == 1:
            codes = self.check(raw, flags, image, noise, method, predict)
            self._counts = {code: self._counts.get(code, 0) + 1 for code in codes}
            self._warnings = tuple(warning(code) for code, n in self._counts.items() if n >= CHECKS_IN_A_ROW)
        return self._warnings

    def check(
        self,
        raw: Floats32,
        flags: Flags,
        image: Floats32,
        noise: float,
        method: str = "",
        predict: Predict | None = None,
    ) -> tuple[WarningCode, ...]:
        """What one frame shows: `raw` and `image` in kPa, `noise` of a taxel in kPa, `method` restored it.

        `predict` gives what the taxels feel (kPa) of the image, where something of it lies beyond the array.
        """
        predicted = predict() if predict else self._blur.forward(image)
        frames = _flat(raw), _flat(predicted), _flat(flags)
        seen = Comparison(*readings.compare(*frames, noise, MODEL_ERROR, MAX_RESIDUAL))
        if not seen.known:
            return ()
        sound = None if seen.known == flags.size else flags == 0
        completed, zeroed = raw, raw
        if sound is not None:
            completed, zeroed = np.where(sound, raw, predicted), np.where(sound, raw, np.float32(0))
        peak = readings.look(_flat(image))[1]
        offset = self._even_offset(image, peak, noise)
        tests: dict[WarningCode, bool] = {
            "negative": self._negative(seen, zeroed, sound, noise),
            "offset": offset,
            "noise_low": self._noise_low(completed, noise * sqrt(seen.known / flags.size)),
        }
        codes = [code for code, failed in tests.items() if failed]
        if seen.highest < PRESSED * noise:
            return tuple(codes)
        if seen.at_highest >= PLATEAU_TAXELS and seen.highest > PRESSED * seen.expected:
            codes.append("plateau")
        # An image of points shows whole cells, but their fit, which matched, was of positions between them. A raw
        # image still has the cover's blur in it, and explains no frame.
        if method not in ("points", "raw"):
            if seen.outliers > MAX_OUTLIERS or seen.square > MAX_RESIDUAL_RMS**2:
                codes.append("cover_mismatch")
            elif seen.outliers:
                codes.append("outliers")
            if not offset and self._moved_offset(seen, completed, noise):
                codes.append("offset")
        if self._grid and peak > EDGE_RATIO * float(image[1:-1, 1:-1].max()):
            codes.append("edge")
        return tuple(codes)

    def _negative(self, seen: "Comparison", zeroed: Floats32, sound: Mask | None, noise: float) -> bool:
        """Whether one taxel, a part of the array or all together lie further below zero than noise does."""
        if seen.lowest < -BELOW_ZERO * seen.expected or seen.below > self._max_below * noise**2:
            return True
        count = self._parts.counts if sound is None else self._parts.sums(sound)
        lowest = float((self._parts.sums(zeroed) / np.sqrt(np.maximum(count, 1))).min())
        return lowest < noise * _lowest_sigmas(count.size)

    def _even_offset(self, image: Floats32, peak: float, noise: float) -> bool:
        """Whether every part of the image is pressed, and a quarter of the parts alike."""
        counts = self._cells.counts
        means = sorted((self._cells.sums(image)[counts > 0] / counts[counts > 0]).tolist())
        lowest, quarter = means[0], means[(len(means) - 1) // 4]
        certain = -_lowest_sigmas(1) * noise / sqrt(self._fewest)
        return bool(lowest > max(certain, MIN_OFFSET * peak) and quarter < EVEN_RATIO * lowest)

    def _moved_offset(self, seen: "Comparison", completed: Floats32, noise: float) -> bool:
        """Whether the image is stronger than its frame, and no quarter of the frame's parts is free.

        Restoration keeps total force: it moves an offset that noise hides in each cell onto the contacts. The
        frame's parts together still show it.
        """
        excess, noise_of_it = seen.strength - seen.product, noise * sqrt(seen.strength)
        if excess <= EXCESS_SIGMAS * hypot(noise_of_it, EXCESS_RATIO * seen.strength):
            return False
        means = sorted((self._parts.sums(completed) / self._parts.counts).ravel().tolist())
        quarter = means[: max(1, len(means) // 4)]
        certain = -_lowest_sigmas(1) * noise / sqrt(float(self._parts.counts.mean()) * len(quarter))
        return sum(quarter) / len(quarter) > certain

    def _noise_low(self, completed: Floats32, noise: float) -> bool:
        """Whether the weakest modes hold less than half the noise; unknown where noise is only rounding."""
        if self._weak is None or noise <= NOISE_RATIO * self._floor:
            return False
        weakest = self._to_modes(completed, self._to_modes.empty()).reshape(-1)[self._weak]
        return float(np.dot(weakest, weakest)) < (noise / NOISE_RATIO) ** 2 * weakest.size


class Comparison(NamedTuple):
    """What `readings.compare` gives."""

    known: int  # taxels whose flags are 0; of these:
    lowest: float  # kPa
    highest: float  # kPa
    at_highest: int
    below: float  # kPa^2, sum of squares
    expected: float  # kPa, difference from what is felt of the image
    outliers: int
    square: float  # of all differences over the expected one, mean
    strength: float  # kPa^2, of what is felt of the image, all taxels
    product: float  # kPa^2, of that and the frame


def _flat(values: NDArray[Scalar]) -> NDArray[Scalar]:
    return np.ascontiguousarray(values).reshape(-1)


class _Parts:
    """The parts of an array that are summed each for itself: PARTS_PER_AXIS squared, also of a list of taxels."""

    def __init__(self, there: Mask) -> None:
        """`there` are the values that count."""
        parts = PARTS_PER_AXIS if there.ndim == 2 else PARTS_PER_AXIS**2
        first = [np.linspace(0, n, min(n, parts), endpoint=False).astype(int) for n in there.shape]
        self._rows, self._columns = first[0], first[1] if there.ndim == 2 else np.zeros(1, int)
        self._out = None if there.all() else ~there
        self.counts = self.sums(there)

    def sums(self, values: NDArray[Any]) -> Floats:
        """Sum over each part."""
        summed, values = np.empty((len(self._rows), len(self._columns))), np.ascontiguousarray(values, np.float32)
        if self._out is not None:
            values = np.where(self._out, np.float32(0), values)
        readings.part_sums(values.reshape(len(values), -1), self._rows, self._columns, summed)
        return summed


def _lowest_sigmas(parts: int) -> float:
    """Where the lowest of `parts` lies below, in standard deviations of noise, with the chance FALSE_ALARM."""
    return float(ndtri(FALSE_ALARM / parts))


def _max_below(size: int) -> float:
    """What the squares below zero of `size` unpressed taxels add up to, over the noise's variance, at most.

    Their sum has the mean n / 2 and the variance 5 n / 4 of a gamma distribution of shape n / 5 and scale 5 / 2;
    noise of NOISE_RATIO times the strength on half of the taxels reaches n.
    """
    return max(2.5 * float(gammainccinv(size / 5, FALSE_ALARM)), size * NOISE_RATIO**2 / 4)


def _weakest(gain: Floats) -> Ints | None:
    """Which modes the cover weakens most; None where they are too few to tell half the noise from all of it."""
    count = max(WEAK_MODES, gain.size // WEAK_MODES_PER)
    return np.argsort(gain, axis=None)[:count] if count <= gain.size // 2 else None
