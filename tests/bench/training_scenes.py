"""Scenes that the learned restoration is trained on: shapes, dots, strokes and textures, all drawn at random.

None of the kinds in `tactiled.bench.scenes` or `held_out_scenes` is among them. Lengths are in pitches of an array
of SIDE x SIDE taxels whose middle is the origin.
"""

from itertools import pairwise

import numpy as np
from scipy.ndimage import gaussian_filter

from tests.bench.held_out_scenes import FINER, inside, laid

SIDE = 32  # taxels along each side
REACH = 12.0  # of a shape's middle from the array's, along either axis
MIN_PEAK = 0.05  # of a scene worth a frame


def training_scene(x, y, random):
    """Draw one on fine cells at x, y (pitches): pressure of 1 at its peak."""
    while True:
        scene = random.choice(KINDS, p=SHARES)(x, y, random)
        change = random.random()
        if change < 0.1:
            scene = np.maximum(scene, random.uniform(0.2, 1) * random.choice(KINDS, p=SHARES)(x, y, random))
        elif change < 0.25:
            scene = gaussian_filter(scene, FINER * random.uniform(0.1, 1.2))
        elif change < 0.35:
            scene = scene ** random.uniform(0.5, 2)
        if scene.max() > MIN_PEAK:
            return scene / scene.max()


def _size(random, lowest, highest):
    return np.exp(random.uniform(np.log(lowest), np.log(highest)))


def _dome(distance, radius):
    """A sphere's pressure, by the distance within its outline."""
    depth = np.clip(distance / radius, 0, 1)
    return np.sqrt(depth * (2 - depth))


def _laid(x, y, random, off):
    """Coordinates of what lies anywhere, turned by any angle, and stretched as often as not."""
    u, v = laid(x, y, random, off)
    stretch = np.exp(random.normal(0, 0.25)) if random.random() < 0.5 else 1.0
    return u * stretch, v / stretch


def _distance(u, v, size, random):
    """Distance within the outline of a disc, box, polygon, ring, rod or star; negative without."""
    match random.integers(6):
        case 0:
            return size - np.hypot(u, v)
        case 1:
            return np.minimum(size - np.abs(u), random.uniform(0.2, 1) * size - np.abs(v))
        case 2:
            corners = int(random.integers(3, 8))
            angles = 2 * np.pi * np.arange(corners) / corners
            if random.random() < 0.5:
                angles = random.uniform(0, 2 * np.pi, corners)
            sides = [(u * np.cos(each) + v * np.sin(each)) * random.uniform(0.8, 1.2) for each in angles]
            return size - np.max(sides, axis=0)
        case 3:
            return max(random.uniform(0.08, 0.5) * size, 0.3) - np.abs(np.hypot(u, v) - size)
        case 4:
            half = max(random.uniform(0.05, 0.3) * size, random.uniform(0.25, 0.8))
            return half - np.hypot(u - np.clip(u, -size, size), v)
    waves = np.cos(random.integers(2, 7) * np.arctan2(v, u) + random.uniform(0, 2 * np.pi))
    return size * (1 + random.uniform(0.05, 0.4) * waves) - np.hypot(u, v)


def _shape(u, v, size, random):
    """A shape's pressure: flat, domed, tilted, or rising from its edge; and its outline's inside."""
    distance = _distance(u, v, size, random)
    within = inside(distance)
    match random.integers(6):
        case 0:
            return _dome(distance, size), within
        case 1:
            return within * np.clip(random.uniform(0.3, 1) + random.uniform(-0.7, 0.7) * u / size, 0, None), within
        case 2:
            return np.clip(distance / random.uniform(0.2, 2), 0, 1), within
        case 3:
            return np.clip(distance / size, 0, 1) ** random.uniform(0.5, 2), within
    return within, within


def _waves(phase, random):
    """Ridges or ripples of a phase."""
    return 0.5 + 0.5 * np.clip(random.uniform(0.8, 6) * (np.sin(phase) - random.uniform(-0.6, 0.6)), -1, 1)


def _texture(x, y, random):
    """A share of 0 to 1 for every cell: ridges, rings, a checker, or a random field."""
    u, v = _laid(x, y, random, 3)
    match random.integers(5):
        case 0:
            return _waves(2 * np.pi * u / _size(random, 1.4, 8), random)
        case 1:
            product = np.sin(2 * np.pi * u / _size(random, 1.6, 8)) * np.sin(2 * np.pi * v / _size(random, 1.6, 8))
            return _waves(np.arcsin(np.clip(product, -1, 1)), random)
        case 2:
            return _waves(2 * np.pi * np.hypot(u - 5, v) / _size(random, 1.5, 7), random)
        case 3:
            width = FINER * _size(random, 0.3, 3)
            field = gaussian_filter(random.normal(size=x.shape), (width, width * random.uniform(0.5, 2)))
            return np.clip(0.5 + random.uniform(0.2, 3) * (field / field.std() - random.uniform(-0.5, 1)), 0, 1)
    octaves = [gaussian_filter(random.normal(size=x.shape), 0.4 * FINER * scale) for scale in (1, 2, 4)]
    rough = random.uniform(0.3, 1.2)
    field = sum(scale**rough * each / each.std() for scale, each in zip((1, 2, 4), octaves, strict=True))
    return np.clip(0.5 + random.uniform(0.1, 0.6) * field, 0, None)


def _places(random):
    """Where dots are: anywhere, in a heap, on a lattice, or on a circle."""
    count, shift = random.integers(1, 13), random.uniform(-5, 5, 2)
    match random.integers(4):
        case 0:
            return random.uniform(-0.8 * SIDE / 2, 0.8 * SIDE / 2, (count, 2))
        case 1:
            return random.normal(0, random.uniform(1.5, 5), (count, 2)) + shift
        case 2:
            pitch, angle, reach = _size(random, 1.4, 7), random.uniform(0, np.pi), random.integers(1, 5)
            lattice = np.mgrid[-reach : reach + 1, -reach : reach + 1].reshape(2, -1).T * pitch
            if random.random() < 0.4:
                lattice[:, 0] += pitch / 2 * (np.arange(len(lattice)) % 2)
            some = lattice[random.random(len(lattice)) < random.uniform(0.3, 1)]
            turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
            return some @ turn + shift
    angles = 2 * np.pi * np.arange(count) / count + random.uniform(0, 2 * np.pi)
    return _size(random, 2, 10) * np.stack([np.cos(angles), np.sin(angles)], axis=1) + shift


def _dots(x, y, random):
    """Points, pins, domes or bumps, all alike or not."""
    total, size = np.zeros_like(x), _size(random, 0.15, 1.6)
    kind, alike = random.integers(3), random.random() < 0.5
    for a, b in _places(random):
        own = size if alike else size * np.exp(random.normal(0, 0.3))
        distance = np.hypot(x - a, y - b)
        dot = (inside(own - distance), _dome(own - distance, own), np.exp(-((distance / own) ** 2)))[kind]
        total = np.maximum(total, random.uniform(0.5, 1) * dot)
    return total


def _shapes(x, y, random):
    """Shapes beside, upon and over one another, and holes."""
    total, way = np.zeros_like(x), random.integers(3)
    for _ in range(random.integers(1, 10)):
        u, v = _laid(x, y, random, REACH)
        pressure, within = _shape(u, v, _size(random, 0.5, 8), random)
        pressure = pressure * random.uniform(0.15, 1)
        if random.random() < 0.25:
            pressure = pressure * _texture(x, y, random)
        if random.random() < 0.15:
            total = total * (1 - within)
        else:
            total = (np.maximum(total, pressure), total + pressure, total * (1 - within) + pressure)[way]
    return total


def _textured(x, y, random):
    """One larger shape with a texture, up to all of the array and over its edge."""
    u, v = _laid(x, y, random, 0.6 * REACH)
    pressure, _ = _shape(u, v, _size(random, 2, 20), random)
    return pressure * _texture(x, y, random) if random.random() < 0.6 else pressure


def _strokes(x, y, random):
    """A line through a few places, with gaps: a wire or a cord."""
    count = random.integers(2, 9)
    places = random.uniform(-11, 11, (count, 2))
    if random.random() < 0.5:
        places = np.cumsum(random.normal(0, _size(random, 1, 6), (count, 2)), axis=0) + random.uniform(-6, 6, 2)
    nearest, half = np.full_like(x, np.inf), random.uniform(0.25, 1.2)
    for (a, b), (c, d) in pairwise(places):
        if random.random() < 0.85:
            along = ((x - a) * (c - a) + (y - b) * (d - b)) / ((c - a) ** 2 + (d - b) ** 2 + 1e-9)
            along = np.clip(along, 0, 1)
            nearest = np.minimum(nearest, np.hypot(x - a - along * (c - a), y - b - along * (d - b)))
    return inside(half - nearest) if random.random() < 0.6 else _dome(half - nearest, half)


def _smooth(x, y, random):
    """Soft contacts."""
    total = np.zeros_like(x)
    for _ in range(random.integers(1, 7)):
        u, v = _laid(x, y, random, REACH)
        total += random.uniform(0.2, 1) * np.exp(-(u**2 + v**2) / (2 * _size(random, 0.8, 6) ** 2))
    return total


def _relief(x, y, random):
    """A broad contact with dots or strokes on it."""
    broad = random.uniform(0.1, 1) * _textured(x, y, random)
    if random.random() < 0.5:
        return np.maximum(broad, _dots(x, y, random))
    return broad + _strokes(x, y, random) * (broad > 0.01)


KINDS = (_dots, _shapes, _textured, _strokes, _smooth, _relief)
SHARES = np.array([2, 2, 2, 1, 1, 1]) / 9
