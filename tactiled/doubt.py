"""What a frame and its image show against themselves: faults that need no truth to be seen."""

import numpy as np
from numpy.typing import NDArray

from tactiled.restore.blur import Blur

EVERY = 16  # frames between two looks
IN_A_ROW = 3  # looks that must agree before anything is said
MODEL = 0.01  # of the frame's peak: what a true model misses, as scenes do not lie on its grid
FAR = 3.0  # times what is expected of the residual's root mean square
OUT = 12.0  # times what is expected of one taxel's residual
FEW = 9  # taxels, a dead one and its neighbours, that may be out before it is the model that is
BELOW = 7.0  # times the noise
CLEAR = 10.0  # noise standard deviations from which the frame is pressed at all
LEVEL = 3  # taxels that share the highest value
RIM = 1.5  # times the highest pressure inside that stands at the rim

RESIDUAL = "the image does not explain the frame: is the cover as configured, and every taxel sound?"
OUTLIER = "single taxels disagree with all around them: dead or damaged? name them in calibration.dead"
NEGATIVE = "taxels are far below zero: tare, or the noise is larger than told"
PLATEAU = "several taxels share the highest value: saturated? set calibration.saturation"
EDGE = "a contact reaches over the edge: what presses outside the array is felt inside"

Frames = NDArray[np.float32]


class Doubt:
    """Looks at every EVERY-th frame of one array and says what it has seen IN_A_ROW times running."""

    def __init__(self, blur: Blur) -> None:
        self._blur = blur
        self._grid = len(blur.surface_shape) == 2 and min(blur.surface_shape) > 2
        self._rim = np.ones(blur.surface_shape, bool)
        if self._grid:
            self._rim[1:-1, 1:-1] = False
        self._frames = 0
        self._seen: dict[str, int] = {}
        self._said: tuple[str, ...] = ()

    def __call__(self, raw: Frames, flags: NDArray[np.uint8], image: Frames, noise: float) -> tuple[str, ...]:
        """What is to be said of this frame: `raw` and `image` in kPa, `noise` a taxel's (kPa)."""
        self._frames += 1
        if self._frames % EVERY == 1:
            found = self.look(raw, flags, image, noise)
            self._seen = {text: self._seen.get(text, 0) + 1 for text in found}
            self._said = tuple(text for text, times in self._seen.items() if times >= IN_A_ROW)
        return self._said

    def look(self, raw: Frames, flags: NDArray[np.uint8], image: Frames, noise: float) -> tuple[str, ...]:
        """What one frame shows."""
        sound = flags == 0
        if not sound.any():
            return ()
        pressure = raw[sound]
        peak = float(pressure.max())
        expected = float(np.hypot(noise, MODEL * np.abs(pressure).max()))
        found = [NEGATIVE] if float(pressure.min()) < -BELOW * expected else []
        if peak < CLEAR * noise:
            return tuple(found)
        if np.count_nonzero(pressure == peak) >= LEVEL and peak > CLEAR * expected:
            found.append(PLATEAU)
        rest = np.abs(self._blur.forward(image)[sound] - pressure) / expected
        out = int(np.count_nonzero(rest > OUT))
        if 0 < out <= FEW:
            found.append(OUTLIER)
        elif float(np.sqrt(np.mean(np.square(rest)))) > FAR:
            found.append(RESIDUAL)
        if self._grid and self._over_the_edge(image):
            found.append(EDGE)
        return tuple(found)

    def _over_the_edge(self, image: Frames) -> bool:
        return float(image[self._rim].max()) > RIM * float(image[~self._rim].max())
