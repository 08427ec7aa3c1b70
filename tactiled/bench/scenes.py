"""Test scenes with a known pressure, drawn off the taxels' grid."""

from collections.abc import Callable, Iterator

import numpy as np

from tactiled.arrays import Floats
from tactiled.simulate.array import FINER

Draw = Callable[[Floats, Floats, np.random.Generator], Floats]  # x, y in pitches from the middle -> kPa

PEAK_KPA = 100.0


def _places(
    random: np.random.Generator, x: Floats, fewest: int, highest: int, margin: float = 0.4
) -> Iterator[tuple[float, float]]:
    half = float(x.max()) * 2 * margin
    for _ in range(random.integers(fewest, highest + 1)):
        yield tuple(random.uniform(-half, half, 2))


def smooth_step(distance: Floats) -> Floats:
    """1 inside, 0 outside, an edge of a quarter of a pitch between."""
    return np.asarray(np.clip(FINER * distance + 0.5, 0, 1))


def _rotated(x: Floats, y: Floats, random: np.random.Generator) -> tuple[Floats, Floats]:
    angle = random.uniform(0, np.pi)
    return x * np.cos(angle) + y * np.sin(angle), y * np.cos(angle) - x * np.sin(angle)


def _blobs(x: Floats, y: Floats, random: np.random.Generator) -> Floats:
    total = np.zeros_like(x)
    for a, b in _places(random, x, 2, 4):
        width = random.uniform(1.5, 4)
        total += random.uniform(0.4, 1) * np.exp(-((x - a) ** 2 + (y - b) ** 2) / (2 * width**2))
    return PEAK_KPA * total


def _punches(x: Floats, y: Floats, random: np.random.Generator) -> Floats:
    discs = (smooth_step(random.uniform(1.5, 3.5) - np.hypot(x - a, y - b)) for a, b in _places(random, x, 1, 4))
    return np.asarray(PEAK_KPA * np.maximum.reduce(list(discs)))


def _rings(x: Floats, y: Floats, random: np.random.Generator) -> Floats:
    rings = []
    for a, b in _places(random, x, 1, 2, 0.25):
        radius, half = random.uniform(2.5, 6), random.uniform(0.5, 1)
        rings.append(smooth_step(half - np.abs(np.hypot(x - a, y - b) - radius)))
    return np.asarray(PEAK_KPA * np.maximum.reduce(rings))


def _bars(x: Floats, y: Floats, random: np.random.Generator) -> Floats:
    u, v = _rotated(x, y, random)
    period, half = random.uniform(4, 8), random.uniform(0.5, 1.5)
    across = np.abs((u + random.uniform(0, period)) % period - period / 2)
    return PEAK_KPA * smooth_step(half - across) * smooth_step(0.7 * x.max() - np.maximum(np.abs(u), np.abs(v)))


def _braille(x: Floats, y: Floats, random: np.random.Generator) -> Floats:
    u, v = _rotated(x, y, random)
    total = np.zeros_like(x)
    for row in range(-3, 4):
        for column in range(-3, 4):
            if random.random() < 0.5:
                dot = np.hypot(u - 2.6 * column, v - 2.6 * row)
                total = np.maximum(total, np.sqrt(np.clip(1 - (dot / 0.8) ** 2, 0, None)))
    return PEAK_KPA * total


def _points(x: Floats, y: Floats, random: np.random.Generator) -> Floats:
    total = np.zeros_like(x)
    for a, b in _places(random, x, 2, 6):
        total.flat[np.argmin((x - a) ** 2 + (y - b) ** 2)] += FINER**2 * random.uniform(0.5, 1)
    return PEAK_KPA * total


def _edges(x: Floats, y: Floats, random: np.random.Generator) -> Floats:
    u, _ = _rotated(x, y, random)
    return PEAK_KPA * smooth_step(u - random.uniform(-0.3, 0.3) * x.max())


ALL = (_blobs, _punches, _rings, _bars, _braille, _points, _edges)
TEST_SCENES: dict[str, Draw] = {draw.__name__.strip("_"): draw for draw in ALL}
