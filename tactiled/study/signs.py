"""What a frame and its image show of a fault at run time, without the truth: what a warning could be made of."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tactiled.restore.blur import Blur
from tactiled.study.skin import Frames

MODEL = 0.005  # of the frame's peak: what a true model misses, as scenes do not lie on its grid
WEAK = 0.05  # of the modes, the weakest: they carry noise and hardly any scene
SIGNS = {
    "residual": "H x − y is larger than the noise",
    "outlier": "one taxel of H x − y is far out",
    "tail": "the weakest modes hold more, or less, than the noise",
    "below": "taxels are further below zero than noise goes",
    "plateau": "taxels share the highest value",
}


@dataclass(frozen=True, slots=True)
class Signs:
    """Each grows with the suspicion; NaN where it cannot be told."""

    residual: float = np.nan
    outlier: float = np.nan
    tail: float = np.nan
    below: float = np.nan
    plateau: float = np.nan


def signs(blur: Blur, frame: Frames, image: Frames, noise: float, flags: NDArray[np.uint8] | None) -> Signs:
    """Look at a frame (kPa), its image and the noise told; flagged taxels are left out."""
    sound = np.ones(frame.shape, bool) if flags is None else flags == 0
    if not sound.any():
        return Signs()
    expected = float(np.hypot(noise, MODEL * np.abs(frame).max()))
    rest = np.abs(blur.forward(np.asarray(image, np.float32)) - frame)[sound] / expected
    return Signs(
        residual=float(np.sqrt(np.mean(np.square(rest)))),
        outlier=float(rest.max()),
        tail=_tail(blur, frame, expected) if sound.all() else np.nan,
        below=float(-frame[sound].min() / expected),
        plateau=float(np.count_nonzero(frame[sound] == frame[sound].max())) if sound.all() else np.nan,
    )


def _tail(blur: Blur, frame: Frames, expected: float) -> float:
    """|log| of the weakest modes' root mean square over what is expected of them."""
    modes = blur.modes
    inner = modes.taxel[0].T @ frame
    c = inner if len(modes.taxel) == 1 else inner @ modes.taxel[1]
    weakest = np.argsort(modes.gain, axis=None)[: max(8, int(WEAK * c.size))]
    found = float(np.sqrt(np.mean(np.square(c.ravel()[weakest]))))
    return float(abs(np.log(max(found, 1e-12) / expected)))
