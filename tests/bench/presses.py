"""Single presses at random places, blurred exactly: every scene of a family under every cover and noise."""

from collections.abc import Iterator
from copy import copy
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from tactiled.bench.scenes import TEST_SCENES
from tactiled.bench.skin import draw, rubber, sense
from tactiled.restore.blur import Blur
from tests.bench.held_out_scenes import FINER, HELD_OUT_SCENES, held_out

Floats = NDArray[np.float64]
FAMILIES = {"first": tuple(TEST_SCENES), "second": tuple(HELD_OUT_SCENES)}
PAPER = {"young": 98.0, "poisson": 0.3}  # of the cover in the paper that the package reproduces
SECOND = 2  # seeds of the second family


@dataclass(frozen=True, slots=True, eq=False)
class Press:
    """One frame and the truth under it, in kPa; the operators are those that restore, not those that blurred."""

    scene: str
    thickness: float  # pitches
    noise: float  # of the frame's peak
    sigma: float  # kPa, a taxel's standard deviation
    frame: NDArray[np.float32]
    truth: Floats  # means over cells of the pitch
    blur: Blur
    psf: Floats  # odd


def presses(
    size: int, thicknesses: tuple[float, ...], noises: tuple[float, ...], repeats: int = 1, seed: int = 1,
    scenes: tuple[str, ...] = FAMILIES["first"], beyond: bool = True,
) -> Iterator[Press]:  # fmt: skip
    """Every scene at every thickness (t/pitch) and noise on an array of size x size.

    The first family is under rubber; of the second, every other repeat is under the paper's cover. All pressure
    ends at the border: the blur that restores has none beyond, either, unless its surface goes on `beyond` it.
    """
    for thickness, scene, noise, repeat in product(thicknesses, scenes, noises, range(repeats)):
        seeds = [seed, repeat, int(1e4 * noise)]
        if scene in TEST_SCENES:
            skin, random = rubber(thickness, size), np.random.default_rng(seeds)
            fine = draw(skin, scene, random)
        else:
            skin = rubber(thickness, size, FINER, **PAPER if repeat % 2 else {})
            random = np.random.default_rng([*seeds, SECOND])
            fine = held_out(scene, skin, random)
        clean, truth = sense(skin, fine)
        sigma = noise * float(clean.max())
        frame = (clean + random.normal(0, sigma, clean.shape)).astype(np.float32)
        blur = skin.blur
        if not beyond:
            blur = copy(blur)
            blur.wide = None
        yield Press(scene, thickness, noise, sigma, frame, truth, blur, skin.psf)
