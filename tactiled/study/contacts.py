"""How well contacts are found in the raw and in the restored image: where, how strong, and how near to each other.

Indenters are flat discs off the taxels' grid, drawn four times finer than it and blurred exactly; restoration has
the finite-element kernel and is told the noise.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache, partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactiled.contacts.detection import Contact, Finder
from tactiled.cover.operator import cached as cached_table
from tactiled.cover.operator import stencil
from tactiled.geometry import Array, grid, tiling
from tactiled.restore.blur import GridBlur
from tactiled.restore.methods import make
from tactiled.simulate.array import FINER, Surface
from tactiled.study.truth import APERTURE, PEAK, kernel

Floats = NDArray[np.float64]

SIDE = 24  # taxels along each side
RADIUS = (1.0, 2.5)  # pitches, of single discs
PAIR_RADIUS = 1.0
GAPS = tuple(np.arange(0, 6.01, 0.25).tolist())  # pitches between the edges of two discs
SURE = 0.9  # of the pairs that must be told apart, at a gap and at all wider ones


class Disc(NamedTuple):
    """An indenter: its centre from the array's and its radius, pitches."""

    x: float
    y: float
    radius: float


@dataclass(frozen=True, slots=True)
class Found:
    """One kind of image at one cover and noise; lengths in mm at a pitch of 1 mm."""

    image: str  # raw, restored
    thickness: float  # pitches
    noise: float  # of the frame's peak
    one: float  # share of single discs that are found as one contact
    off_mm: float  # from the true centre of pressure, median of those
    far_mm: float  # the same, 95th percentile
    force: float  # median error of theirs, of the true force
    gap_mm: float  # smallest between two discs that are told apart; infinite if none of GAPS is


class Press(NamedTuple):
    """What was pressed, and the contacts found in each kind of image."""

    centre: Floats  # (2,) mm, of pressure, in the array's coordinates
    force_n: float
    raw: list[Contact]
    restored: list[Contact]


class Bench:
    """An array under a cover, `thickness` pitches of rubber."""

    def __init__(self, thickness: float) -> None:
        array = _array()
        cover = kernel(thickness, "fem")
        self._surface = Surface(kernel(thickness, "layered"), array)
        finer = partial(cached_table, stencil, cover, array)
        self._blur = GridBlur(finer, (SIDE, SIDE))
        self._find = Finder(array, tiling(array))

    def press(self, discs: tuple[Disc, ...], noise: float, random: np.random.Generator) -> Press:
        """Press the array and look for contacts; `noise` is of the frame's peak."""
        x, y = self._surface.x, self._surface.y
        fine = sum(PEAK * np.clip(FINER * (d.radius - np.hypot(x - d.x, y - d.y)) + 0.5, 0, 1) for d in discs)
        pressure = np.asarray(fine, float)
        clean = self._surface.sense(pressure).reshape(SIDE, SIDE)
        sigma = noise * float(clean.max())
        frame = (clean + random.normal(0, sigma, clean.shape)).astype(np.float32)
        done = make("auto", self._blur, sigma)(frame)
        total = pressure.sum()
        centre = np.array([(pressure * x).sum(), (pressure * y).sum()]) / total + (SIDE - 1) / 2
        restored = self._find(done.image, sigma * max(done.noise_gain, 1.0))
        return Press(centre, total * self._surface.grain**2 * 1e-3, self._find(frame, sigma), restored)


@cache
def _array() -> Array:
    return grid(SIDE, SIDE, 1.0, APERTURE)


def _singles(repeats: int, seed: int) -> Iterator[tuple[tuple[Disc, ...], np.random.Generator]]:
    for number in range(repeats):
        random = np.random.default_rng([seed, number])
        x, y = random.uniform(-SIDE / 4, SIDE / 4, 2)
        yield (Disc(x, y, random.uniform(*RADIUS)),), random


def _pairs(gap: float, repeats: int, seed: int) -> Iterator[tuple[tuple[Disc, ...], np.random.Generator]]:
    for number in range(repeats):
        random = np.random.default_rng([seed, number, 1])
        (x, y), angle = random.uniform(-1, 1, 2), random.uniform(0, np.pi)
        half = PAIR_RADIUS + gap / 2
        a, b = half * np.cos(angle), half * np.sin(angle)
        yield (Disc(x + a, y + b, PAIR_RADIUS), Disc(x - a, y - b, PAIR_RADIUS)), random


def measure(thickness: float, noise: float, repeats: int, seed: int = 1) -> tuple[Found, Found]:
    """The raw and the restored image at one cover (pitches) and noise (of the frame's peak)."""
    bench = Bench(thickness)
    singles = [bench.press(discs, noise, random) for discs, random in _singles(repeats, seed)]
    apart: dict[str, list[float]] = {"raw": [], "restored": []}  # shares of the pairs told apart, gap by gap
    for gap in GAPS:
        pairs = [bench.press(discs, noise, random) for discs, random in _pairs(gap, max(repeats // 2, 2), seed)]
        for image, shares in apart.items():
            shares.append(float(np.mean([len(getattr(each, image)) == 2 for each in pairs])))
    raw, restored = (_summed(image, thickness, noise, singles, shares) for image, shares in apart.items())
    return raw, restored


def _summed(image: str, thickness: float, noise: float, singles: list[Press], shares: list[float]) -> Found:
    found = [(each, getattr(each, image)[0]) for each in singles if len(getattr(each, image)) == 1]
    off = [float(np.hypot(*(each.centre - (got.x_mm, got.y_mm)))) for each, got in found] or [np.nan]
    force = [abs(got.force_n / each.force_n - 1) for each, got in found] or [np.nan]
    blurred = [gap for gap, share in zip(GAPS, shares, strict=True) if share < SURE]  # the widest is what counts
    after = [gap for gap in GAPS if not blurred or gap > blurred[-1]]
    return Found(
        image=image,
        thickness=thickness,
        noise=noise,
        one=len(found) / len(singles),
        off_mm=float(np.median(off)),
        far_mm=float(np.percentile(off, 95)),
        force=float(np.median(force)),
        gap_mm=after[0] if after else np.inf,
    )
