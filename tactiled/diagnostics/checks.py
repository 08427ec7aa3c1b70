"""What a frame and its image show against themselves: faults that need no truth to be seen.

Pressure never pulls and a cover only smooths, whatever is pressed. So no part of a frame lies further below zero
than its noise goes, and the modes that the cover weakens most hold no less than the noise.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammainccinv, ndtri

from tactiled.restore.blur import Blur

EVERY = 16  # frames between two looks
IN_A_ROW = 3  # looks that must agree before anything is said
CHANCE = 1e-4  # that noise alone, white and as told, raises one of the doubts that are about it
TWICE = 2.0  # times the noise told, or half of it: what is worth a warning
PARTS = 4  # of a frame along each axis
FINEST = 24  # modes that hold less than a quarter of the noise's power with no more than that chance
SMOOTH = 8  # of so many modes one counts among those that the cover weakens most, if that is more
FAINT = 0.02  # of the highest pressure: less is no offset that anyone would mind
EVEN = 1.25  # times the least pressed part that a quarter of the parts may reach to pass for an offset
MODEL = 0.01  # of the frame's peak: what a true model misses, as scenes do not lie on its grid
FAR = 3.5  # times what is expected of the residual's root mean square
OUT = 16.0  # times what is expected of one taxel's residual
FEW = 9  # taxels, a dead one and its neighbours, that may be out before it is the model that is
BELOW = 7.0  # times the noise
CLEAR = 10.0  # noise standard deviations from which the frame is pressed at all
LEVEL = 3  # taxels that share the highest value
MOVED = 4.0  # standard deviations by which an image is stronger than its frame if its force is from elsewhere
STRONGER = 0.02  # of its strength: one of them, however faint the noise
RIM = 1.5  # times the highest pressure inside that stands at the rim

RESIDUAL = "the restored image does not match the data: check the cover settings and look for faulty taxels"
OUTLIER = "single taxels disagree with all around them: dead or damaged? name them in calibration.dead"
NEGATIVE = "readings are negative: unload and tare, or check noise_kpa"
LIFTED = "no part of the array is free of pressure: if nothing lies on all of it, tare"
UNLIKE = "the finest patterns hold less than half the noise told: is it shared by taxels, or less than told?"
PLATEAU = "several taxels share the highest value: saturated? set calibration.saturation"
EDGE = "a contact reaches over the edge: what presses outside the array is felt inside"

Frames = NDArray[np.float32]


class Doubt:
    """Looks at every EVERY-th frame of one array and says what it has seen IN_A_ROW times running."""

    def __init__(self, blur: Blur, floor: float = 0.0) -> None:
        """`floor` (kPa) is what rounding to counts alone makes of the noise."""
        self._blur, self._floor = blur, floor
        self._grid = len(blur.surface_shape) == 2 and min(blur.surface_shape) > 2
        self._rim = np.ones(blur.surface_shape, bool)
        if self._grid:
            self._rim[1:-1, 1:-1] = False
        self._parts = _Parts(blur.frame_shape)
        self._cells = _Parts(blur.surface_shape)
        self._most_below = _most_below(int(np.prod(blur.frame_shape)))
        self._there = blur.modes.to_taxel_modes()
        self._weak = _weakest(blur.modes.gain)
        self._frames = 0
        self._seen: dict[str, int] = {}
        self._said: tuple[str, ...] = ()

    def __call__(
        self, raw: Frames, flags: NDArray[np.uint8], image: Frames, noise: float, method: str = ""
    ) -> tuple[str, ...]:
        """What is to be said of this frame: `raw` and `image` in kPa, `noise` a taxel's (kPa)."""
        self._frames += 1
        if self._frames % EVERY == 1:
            found = self.look(raw, flags, image, noise, method)
            self._seen = {text: self._seen.get(text, 0) + 1 for text in found}
            self._said = tuple(text for text, times in self._seen.items() if times >= IN_A_ROW)
        return self._said

    def look(
        self, raw: Frames, flags: NDArray[np.uint8], image: Frames, noise: float, method: str = ""
    ) -> tuple[str, ...]:
        """What one frame shows; `method` is what restored it."""
        sound = flags == 0
        if not sound.any():
            return ()
        predicted = self._blur.forward(image)
        whole = np.where(sound, raw, predicted)
        tests = {
            NEGATIVE: self._negative(raw[sound], np.where(sound, raw, np.float32(0)), sound, noise),
            LIFTED: self._lifted(image, noise),
            UNLIKE: self._unlike(whole, noise * float(np.sqrt(sound.mean()))),
        }
        found = [text for text, there in tests.items() if there]
        pressure = raw[sound]
        peak = float(pressure.max())
        if peak < CLEAR * noise:
            return tuple(found)
        expected = float(np.hypot(noise, MODEL * np.abs(pressure).max()))
        if np.count_nonzero(pressure == peak) >= LEVEL and peak > CLEAR * expected:
            found.append(PLATEAU)
        # The image of points shows cells, and their fit, which stood, was of what lies between them. A raw one has
        # the cover's blur in it, and explains no frame.
        if method not in ("points", "raw"):
            found += _unexplained(np.abs(predicted[sound] - pressure) / expected)
            if LIFTED not in found and self._moved(whole, predicted, noise):
                found.append(LIFTED)
        if self._grid and self._over_the_edge(image):
            found.append(EDGE)
        return tuple(found)

    def _negative(self, pressure: Frames, zeroed: Frames, sound: NDArray[np.bool_], noise: float) -> bool:
        """Whether one taxel, a part of the array or all together lie further below zero than noise does."""
        if float(pressure.min()) < -BELOW * float(np.hypot(noise, MODEL * np.abs(pressure).max())):
            return True
        count = self._parts.sums(sound)
        lowest = float((self._parts.sums(zeroed) / np.sqrt(np.maximum(count, 1))).min())
        if lowest < noise * _surely(count.size):
            return True
        below = np.minimum(pressure, 0)
        return float(np.dot(below, below)) > self._most_below * noise**2

    def _lifted(self, image: Frames, noise: float) -> bool:
        """Whether every part of the image is pressed, and a quarter of the parts alike."""
        means = np.sort(self._cells.sums(image) / self._cells.counts, axis=None)
        least, quarter = float(means[0]), float(means[(means.size - 1) // 4])
        surely = -_surely(1) * noise / float(np.sqrt(self._parts.counts.min()))
        return least > max(surely, FAINT * float(image.max())) and quarter < EVEN * least

    def _moved(self, whole: Frames, predicted: Frames, noise: float) -> bool:
        """Whether the image is stronger than its frame, and no quarter of the frame's parts is free.

        Total force is kept: an offset too faint beside the noise to pass for pressure, cell by cell, is moved onto
        the contacts. Its parts put together, the frame still tells of it.
        """
        strength = float(np.vdot(predicted, predicted))
        more = strength - float(np.vdot(predicted, whole))
        if more <= MOVED * float(np.hypot(noise * np.sqrt(strength), STRONGER * strength)):
            return False
        least = np.sort(self._parts.sums(whole) / self._parts.counts, axis=None)
        quarter = least[: max(1, least.size // 4)]
        surely = -_surely(1) * noise / float(np.sqrt(self._parts.counts.mean() * quarter.size))
        return float(quarter.mean()) > surely

    def _unlike(self, whole: Frames, noise: float) -> bool:
        """Whether the weakest modes hold less than half the noise; not where the noise is but rounding."""
        if self._weak is None or noise <= TWICE * self._floor:
            return False
        weakest = self._there(whole, self._there.empty()).reshape(-1)[self._weak]
        return float(np.dot(weakest, weakest)) < (noise / TWICE) ** 2 * weakest.size

    def _over_the_edge(self, image: Frames) -> bool:
        return float(image[self._rim].max()) > RIM * float(image[~self._rim].max())


class _Parts:
    """The parts of an array that are summed each for itself: PARTS along both axes, or as many of a layout."""

    def __init__(self, shape: tuple[int, ...]) -> None:
        most = PARTS if len(shape) == 2 else PARTS**2
        self._first = [np.linspace(0, n, min(n, most), endpoint=False).astype(int) for n in shape]
        self.counts = self.sums(np.ones(shape, np.float32))

    def sums(self, values: NDArray[Any]) -> NDArray[np.float64]:
        """Sum over each part."""
        summed = np.asarray(values, float)
        for axis, first in enumerate(self._first):
            summed = np.add.reduceat(summed, first, axis=axis)
        return summed


def _surely(parts: int) -> float:
    """Standard deviations below zero that the lowest of `parts` hardly ever lies."""
    return float(ndtri(CHANCE / parts))


def _most_below(size: int) -> float:
    """What the squares below zero of `size` unpressed taxels hardly ever add up to, over the noise's variance.

    Their sum has the mean n / 2 and the variance 5 n / 4 of a gamma distribution of shape n / 5 and scale 5 / 2;
    noise of TWICE the strength on half of the taxels reaches n.
    """
    return max(2.5 * float(gammainccinv(size / 5, CHANCE)), size * TWICE**2 / 4)


def _weakest(gain: NDArray[np.float64]) -> NDArray[np.intp] | None:
    """Which modes the cover weakens most; None where they are too few to tell half the noise from all of it."""
    count = max(FINEST, gain.size // SMOOTH)
    return np.argsort(gain, axis=None)[:count] if count <= gain.size // 2 else None


def _unexplained(rest: Frames) -> list[str]:
    """What a residual, over what is expected of it, says."""
    out = int(np.count_nonzero(rest > OUT))
    if out > FEW or float(np.sqrt(np.mean(np.square(rest)))) > FAR:
        return [RESIDUAL]
    return [OUTLIER] if out else []
