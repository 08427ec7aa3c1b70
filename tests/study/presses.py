"""Single presses at random places, blurred exactly: every scene under every cover and noise."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from tactiled.restore.blur import Blur
from tactiled.study.scenes import TEST_SCENES
from tactiled.study.skin import draw, rubber, sense

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Press:
    """One frame and the truth under it, in kPa; the operators are those that restore, not those that blurred."""

    scene: str
    thickness: float  # pitches
    sigma: float  # kPa, a taxel's standard deviation
    frame: NDArray[np.float32]
    truth: Floats  # means over cells of the pitch
    blur: Blur
    psf: Floats  # odd


def presses(
    size: int, thicknesses: tuple[float, ...], noises: tuple[float, ...], repeats: int = 1, seed: int = 1
) -> Iterator[Press]:
    """Every scene at every thickness (t/pitch) and noise on an array of size x size."""
    for thickness, scene, noise, repeat in product(thicknesses, TEST_SCENES, noises, range(repeats)):
        skin, random = rubber(thickness, size), np.random.default_rng([seed, repeat, int(1e4 * noise)])
        clean, truth = sense(skin, draw(skin, scene, random))
        sigma = noise * float(clean.max())
        frame = (clean + random.normal(0, sigma, clean.shape)).astype(np.float32)
        yield Press(scene, thickness, sigma, frame, truth, skin.blur, skin.psf)
