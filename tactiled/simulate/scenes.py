"""Pressure on the surface, in kPa, as functions of place (mm) and time (s); any point of the plane, no grid.

A scene is drawn in a field of `size` mm with `grain` mm as its finest detail: edges are smoothed over `grain`, so
that a moving edge does not jump from cell to cell.
"""

from collections.abc import Callable
from typing import TypeAlias

import numpy as np

from tactiled.arrays import Floats

Scene: TypeAlias = Callable[[Floats, Floats, float, float, float], Floats]
# Over the root of x^3 = x + 1, and its square: numbers times these, modulo 1, fill a square evenly.
PLASTIC_STEPS = (0.7548776662466927, 0.5698402909980532)
TOUCH = (2345, 135, 136, 14, 125)  # the word in Braille: each letter's dots, down the left column, then the right


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


def touch(x: Floats, y: Floats, t: float, size: float, grain: float) -> Floats:
    """Two rings and the word TOUCH in Braille (dots 2.5 mm apart on 32 mm), pressed harder and softer."""
    mm = size / 32
    around = np.hypot(x, y - 5.5 * mm)
    outer, inner = (_inside(0.7 * mm - np.abs(around - radius * mm), grain) for radius in (7.5, 3.0))
    squares = np.full_like(x, np.inf)  # of the distances to the nearest dot
    for number, dots in enumerate(TOUCH):
        for dot in str(dots):
            column, row = divmod(int(dot) - 1, 3)
            right, down = (6.1 * (number - 2) + 2.5 * (column - 0.5)) * mm, (2.5 * row - 12.0) * mm
            np.minimum(squares, (x - right) ** 2 + (y - down) ** 2, out=squares)
    dotted = _inside(0.8 * mm - np.sqrt(squares), grain)
    return 100 * (0.8 + 0.2 * float(np.sin(t))) * (outer + inner + dotted)


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


def _press(t: float, period_s: float) -> tuple[int, float]:
    """Number of the press at `t` s, and its load from 0 to 1: up and down in 0.15 s each, then a pause."""
    number, phase = divmod(t, period_s)
    return int(number), float(np.clip(min(phase, 2 / 3 * period_s - phase) / 0.15, 0, 1))


def tip(x: Floats, y: Floats, t: float, size: float, grain: float) -> Floats:
    """A flat round tip of 2 mm that presses at ever other places, for the calibration of a cover."""
    number, load = _press(t, 1.2)
    right, down = (np.modf((number + 0.5) * step)[0] - 0.5 for step in PLASTIC_STEPS)
    return 250 * load * _inside(1.0 - np.hypot(x - 0.85 * size * right, y - 0.85 * size * down), grain)


def straightedge(x: Floats, y: Floats, t: float, size: float, grain: float) -> Floats:
    """A block with a straight edge, laid across the array at ever other slants, for the calibration of a cover."""
    number, load = _press(t, 2.4)
    slant, offset = (np.modf((number + 0.5) * step)[0] - 0.5 for step in PLASTIC_STEPS)
    angle = np.pi / 2 * (number % 4) + np.radians(8) + np.radians(24) * (slant + 0.5)
    return 60 * load * _inside(x * np.cos(angle) + y * np.sin(angle) - 0.3 * size * offset, grain)


def steps(x: Floats, y: Floats, t: float, size: float, grain: float) -> Floats:
    """The same pressure everywhere, 0, 20, 40, 60, 40 and 20 kPa for 8 s each, for the calibration of the gain."""
    del y, size, grain
    return np.full_like(x, (0.0, 20.0, 40.0, 60.0, 40.0, 20.0)[int(t / 8) % 6])


SCENES: dict[str, Scene] = {
    each.__name__: each
    for each in (ring, indenters, sphere, edge, fingertip, uniform, empty, touch, tip, straightedge, steps)
}
