"""Pressure on the surface, in kPa, as functions of place (mm) and time (s); any point of the plane, no grid.

A scene is drawn in a field of `size` mm with `grain` mm as its finest detail: edges are smoothed over `grain`, so
that a moving edge does not jump from cell to cell.
"""

from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Floats: TypeAlias = NDArray[np.float64]
Scene: TypeAlias = Callable[[Floats, Floats, float, float, float], Floats]


def _inside(distance: Floats, grain: float) -> Floats:
    """1 within an outline, 0 without; `distance` (mm) to it is positive within."""
    return np.asarray(np.clip(distance / grain + 0.5, 0, 1))


def _square(x: Floats, y: Floats, side: float) -> Floats:
    """Distance (mm) within a centred square's nearest side."""
    return np.asarray(side / 2 - np.maximum(np.abs(x), np.abs(y)))


def _hertz(x: Floats, y: Floats, radius: float) -> Floats:
    """Pressure of a sphere over its peak: sqrt(1 - r^2/a^2), Hertz."""
    return np.asarray(np.sqrt(np.clip(1 - (x**2 + y**2) / radius**2, 0, None)))


def empty(x: Floats, y: Floats, t: float, size: float, grain: float) -> Floats:
    """Nothing."""
    del y, t, size, grain
    return np.zeros_like(x)


def uniform(x: Floats, y: Floats, t: float, size: float, grain: float) -> Floats:
    """The same pressure everywhere, rising and falling."""
    del y, size, grain
    return np.full_like(x, 30 * (1 + np.sin(t)))


def ring(x: Floats, y: Floats, t: float, size: float, grain: float) -> Floats:
    """The square ring of Shimojo, 1.0 mm without and 0.6 mm within in a field of 2 mm, scaled to the field."""
    turn, mm = 0.3 * t, size / 2
    u, v = x * np.cos(turn) + y * np.sin(turn), y * np.cos(turn) - x * np.sin(turn)
    return 80 * (_inside(_square(u, v, 1.0 * mm), grain) - _inside(_square(u, v, 0.6 * mm), grain))


def indenters(x: Floats, y: Floats, t: float, size: float, grain: float) -> Floats:
    """Two flat punches that part and meet."""
    radius, half = 0.05 * size, size * (0.11 + 0.05 * np.cos(0.8 * t))
    punches = (radius - np.hypot(x - side * half, y) for side in (-1, 1))
    return 120 * np.asarray(sum(_inside(each, grain) for each in punches))


def sphere(x: Floats, y: Floats, t: float, size: float, grain: float) -> Floats:
    """A sphere that rolls in a circle."""
    del grain
    return 100 * _hertz(x - 0.24 * size * np.cos(t), y - 0.24 * size * np.sin(t), 0.14 * size)


def edge(x: Floats, y: Floats, t: float, size: float, grain: float) -> Floats:
    """A straight edge that slides over the array, slanted."""
    along, across = x * np.cos(0.4) + y * np.sin(0.4), y * np.cos(0.4) - x * np.sin(0.4)
    beside = np.abs(along - 0.3 * size * np.sin(0.7 * t))
    return 90 * _inside(0.03 * size - beside, grain) * _inside(0.35 * size - np.abs(across), grain)


def fingertip(x: Floats, y: Floats, t: float, size: float, grain: float) -> Floats:
    """Two fingertips that walk: one down while the other swings."""
    del grain
    total = np.zeros_like(x)
    for side in (0, 1):
        phase = (0.4 * t + 0.5 * side) % 1.0
        load = np.sin(np.pi * min(phase / 0.6, 1.0))
        place = size * (0.25 - 0.5 * min(phase / 0.6, 1.0))
        lane = size * (0.13 - 0.26 * side)
        total += 70 * load * _hertz((x - lane) / 1.0, (y - place) / 1.35, 0.11 * size)
    return total


SCENES: dict[str, Scene] = {
    each.__name__: each for each in (ring, indenters, sphere, edge, fingertip, uniform, empty)
}
