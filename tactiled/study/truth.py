"""Known presses, drawn off the grid and blurred exactly: what restorations are held against."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tactiled.cover.kernel import Kernel, cached, solve
from tactiled.cover.operator import cached as cached_table
from tactiled.cover.operator import stencil
from tactiled.cover.stack import Layer, Stack
from tactiled.geometry import Array, grid
from tactiled.restore.blur import Blur, GridBlur
from tactiled.simulate.array import FINER, Surface

Floats = NDArray[np.float64]
Draw = Callable[[Floats, Floats, np.random.Generator], Floats]  # x, y in pitches from the middle -> kPa

PEAK = 100.0  # kPa
APERTURE = 0.8  # of the pitch


@dataclass(frozen=True, slots=True, eq=False)
class Press:
    """One frame and the truth under it, in kPa; the operators are the restoring side's, not what blurred it."""

    scene: str
    thickness: float  # pitches
    noise: float  # of the blurred frame's peak
    sigma: float  # kPa, a taxel's standard deviation
    frame: NDArray[np.float32]
    truth: Floats  # means over cells of the pitch
    blur: Blur
    psf: Floats  # odd


def stack(thickness: float) -> Stack:
    """A rubber cover over a stiff board, `thickness` mm."""
    return Stack((Layer(thickness, 0.6, 0.48), Layer(1.0, 980.0, 0.3)))


@cache
def kernel(thickness: float, model: str, folder: Path | None = None) -> Kernel:
    """Solve a cover by finite elements, from the cache if it is there, or exactly."""
    return solve(stack(thickness), "layered") if model == "layered" else cached(stack(thickness), folder=folder)


def psf_of(blur: Blur) -> Floats:
    """What one cell of pressure in the middle of a grid leaves: odd, and no larger than the array."""
    middle = [n // 2 for n in blur.frame_shape]
    cell = np.zeros(blur.surface_shape, np.float32)
    cell[tuple(middle)] = 1
    around = tuple(slice(max(2 * m - n + 1, 0), 2 * m + 1) for m, n in zip(middle, cell.shape, strict=True))
    return np.asarray(blur.forward(cell), float)[around]


@cache
def sides(size: int, thickness: float) -> tuple[Surface, Blur, Floats]:
    """Build what blurs presses, exactly, and what restores them: the operator and its point spread."""
    array = grid(size, size, 1.0, APERTURE)
    finer = partial(cached_table, stencil, kernel(thickness, "fem"), array)
    blur = GridBlur(finer, (size, size))
    return Surface(kernel(thickness, "layered"), array), blur, psf_of(blur)


def presses(
    size: int, thicknesses: tuple[float, ...], noises: tuple[float, ...], repeats: int = 1, seed: int = 1
) -> Iterator[Press]:
    """Every scene at every thickness (t/pitch) and noise on an array of size x size, at random places."""
    array = grid(size, size, 1.0, APERTURE)
    for thickness in thicknesses:
        surface, blur, psf = sides(size, thickness)
        for name, draw in DRAWN.items():
            for noise in noises:
                for repeat in range(repeats):
                    random = np.random.default_rng([seed, repeat, int(1e4 * noise)])
                    yield _press(name, draw, (thickness, noise), surface, array, (blur, psf), random)


def _press(
    name: str,
    draw: Draw,
    place: tuple[float, float],
    surface: Surface,
    array: Array,
    operators: tuple[Blur, Floats],
    random: np.random.Generator,
) -> Press:
    fine = draw(surface.x, surface.y, random)
    shape = array.frame_shape
    clean = surface.sense(fine).reshape(shape)
    sigma = place[1] * float(clean.max())
    frame = (clean + random.normal(0, sigma, shape)).astype(np.float32)
    truth = fine.reshape(shape[0], FINER, shape[1], FINER).mean(axis=(1, 3))
    return Press(name, *place, sigma, frame, truth, *operators)


def _spots(
    random: np.random.Generator, x: Floats, least: int, most: int, margin: float = 0.4
) -> Iterator[tuple[float, float]]:
    half = float(x.max()) * 2 * margin
    for _ in range(random.integers(least, most + 1)):
        yield tuple(random.uniform(-half, half, 2))


def _soft(distance: Floats) -> Floats:
    """1 within, 0 without, an edge of a quarter of a pitch between."""
    return np.asarray(np.clip(FINER * distance + 0.5, 0, 1))


def _turned(x: Floats, y: Floats, random: np.random.Generator) -> tuple[Floats, Floats]:
    angle = random.uniform(0, np.pi)
    return x * np.cos(angle) + y * np.sin(angle), y * np.cos(angle) - x * np.sin(angle)


def _blobs(x: Floats, y: Floats, random: np.random.Generator) -> Floats:
    total = np.zeros_like(x)
    for a, b in _spots(random, x, 2, 4):
        width = random.uniform(1.5, 4)
        total += random.uniform(0.4, 1) * np.exp(-((x - a) ** 2 + (y - b) ** 2) / (2 * width**2))
    return PEAK * total


def _punches(x: Floats, y: Floats, random: np.random.Generator) -> Floats:
    discs = (_soft(random.uniform(1.5, 3.5) - np.hypot(x - a, y - b)) for a, b in _spots(random, x, 1, 4))
    return np.asarray(PEAK * np.maximum.reduce(list(discs)))


def _rings(x: Floats, y: Floats, random: np.random.Generator) -> Floats:
    rings = []
    for a, b in _spots(random, x, 1, 2, 0.25):
        radius, half = random.uniform(2.5, 6), random.uniform(0.5, 1)
        rings.append(_soft(half - np.abs(np.hypot(x - a, y - b) - radius)))
    return np.asarray(PEAK * np.maximum.reduce(rings))


def _bars(x: Floats, y: Floats, random: np.random.Generator) -> Floats:
    u, v = _turned(x, y, random)
    period, half = random.uniform(4, 8), random.uniform(0.5, 1.5)
    across = np.abs((u + random.uniform(0, period)) % period - period / 2)
    return PEAK * _soft(half - across) * _soft(0.7 * x.max() - np.maximum(np.abs(u), np.abs(v)))


def _braille(x: Floats, y: Floats, random: np.random.Generator) -> Floats:
    u, v = _turned(x, y, random)
    total = np.zeros_like(x)
    for row in range(-3, 4):
        for column in range(-3, 4):
            if random.random() < 0.5:
                dot = np.hypot(u - 2.6 * column, v - 2.6 * row)
                total = np.maximum(total, np.sqrt(np.clip(1 - (dot / 0.8) ** 2, 0, None)))
    return PEAK * total


def _points(x: Floats, y: Floats, random: np.random.Generator) -> Floats:
    total = np.zeros_like(x)
    for a, b in _spots(random, x, 2, 6):
        total.flat[np.argmin((x - a) ** 2 + (y - b) ** 2)] += FINER**2 * random.uniform(0.5, 1)
    return PEAK * total


def _edges(x: Floats, y: Floats, random: np.random.Generator) -> Floats:
    u, _ = _turned(x, y, random)
    return PEAK * _soft(u - random.uniform(-0.3, 0.3) * x.max())


DRAWN: dict[str, Draw] = {
    "blobs": _blobs,
    "punches": _punches,
    "rings": _rings,
    "bars": _bars,
    "braille": _braille,
    "points": _points,
    "edges": _edges,
}
