"""The second family of test scenes: none of its kinds, sizes or seeds shaped a constant; claims are made on it.

Constants are chosen on the first family (tactiled.bench.scenes) or on a third. Lengths are in pitches.
"""

from itertools import pairwise

import numpy as np

from tactiled.bench.scenes import PEAK_KPA

FINER = 8  # cells along each side of a taxel: an edge is one of them wide
STEP = 0.13  # that a scene moves in a frame
STICK_FRAMES, SLIP = 4, 0.9  # frames that a contact sticks, and how far it then slips
APPEARS = 3  # frame in which a scene that appears at once is there
STROKES = {  # from x y to x y, on a field of 4 x 4
    "A": "04 20 44/13 33", "E": "40 00 04 44/02 32", "H": "00 04/40 44/02 42", "K": "00 04/40 02 44",
    "M": "04 00 22 40 44", "R": "04 00 30 41 32 02/22 44", "S": "41 30 10 01 12 32 43 34 14 03",
    "Z": "00 40 04 44",
}  # fmt: skip


def inside(distance):
    """1 within an outline, 0 without; `distance` to it is positive within."""
    return np.clip(FINER * distance + 0.5, 0, 1)


def hertz(distance, radius):
    """A sphere's pressure over its peak, sqrt(1 - d^2/a^2)."""
    return np.sqrt(np.clip(1 - (distance / radius) ** 2, 0, None))


def laid(x, y, random, off):
    """Coordinates of what lies turned by any angle, up to `off` away from the middle along either axis."""
    (a, b), angle = random.uniform(-off, off, 2), random.uniform(0, 2 * np.pi)
    return (x - a) * np.cos(angle) + (y - b) * np.sin(angle), (y - b) * np.cos(angle) - (x - a) * np.sin(angle)


def _from_line(x, y, points):
    """Distance from a line through `points`."""
    distance = np.full_like(x, np.inf)
    for (a, b), (c, d) in pairwise(points):
        along = np.clip(((x - a) * (c - a) + (y - b) * (d - b)) / ((c - a) ** 2 + (d - b) ** 2), 0, 1)
        distance = np.minimum(distance, np.hypot(x - a - along * (c - a), y - b - along * (d - b)))
    return distance


def _letters(x, y, half, random):
    u, v = laid(x, y, random, 0.15 * half)
    word = random.choice(list(STROKES), random.integers(1, 4))
    side, wide = random.uniform(0.35, 0.5) * half, random.uniform(0.3, 0.8)
    distance = np.full_like(x, np.inf)
    for n, letter in enumerate(word):
        start = (1.4 * (n - len(word) / 2) + 0.2) * side
        for stroke in STROKES[letter].split("/"):
            points = [(start + int(a) * side / 4, (int(b) / 4 - 0.5) * side) for a, b in stroke.split()]
            distance = np.minimum(distance, _from_line(u, v, points))
    return inside(wide - distance)


def _screws(x, y, half, random):
    total = np.zeros_like(x)
    for _ in range(random.integers(1, 4)):
        u, v = laid(x, y, random, 0.6 * half)
        radius, wide = random.uniform(0.15, 0.35) * half, random.uniform(0.3, 0.7)
        recess = wide - np.abs(u)
        if random.random() < 0.5:
            recess = np.minimum(np.maximum(recess, wide - np.abs(v)), 0.65 * radius - np.hypot(u, v))
        dome = 1 - 0.3 * (np.hypot(u, v) / radius) ** 2
        total = np.maximum(total, inside(radius - np.hypot(u, v)) * (1 - inside(recess)) * dome)
    return total


def _cables(x, y, half, random):
    total = np.zeros_like(x)
    for _ in range(random.integers(1, 4)):
        u, v = laid(x, y, random, 0.5 * half)
        radius, bend = random.uniform(0.5, 1.3), random.uniform(-0.4, 0.4) * half
        s = np.linspace(-1, 1, 13)
        line = list(zip(1.6 * half * s, bend * np.sin(2.5 * s + random.uniform(0, 3)), strict=True))
        total = np.maximum(total, random.uniform(0.5, 1) * hertz(_from_line(u, v, line), radius))
    return total


def _textures(x, y, half, random):
    u, v = laid(x, y, random, 0.3 * half)
    rough = np.zeros_like(x)
    for period, angle in zip(random.uniform(1.6, 6, 16), random.uniform(0, np.pi, 16), strict=True):
        wave = (u * np.cos(angle) + v * np.sin(angle)) / period + random.random()
        rough += np.cos(2 * np.pi * wave) / 4
    return np.clip(0.4 + 0.5 * rough, 0, None) * hertz(np.hypot(u, v), random.uniform(0.5, 0.8) * half)


def _fingertip(x, y, half, random):
    u, v = laid(x, y, random, 0.2 * half)
    radius, ratio = random.uniform(0.4, 0.6) * half, random.uniform(1.1, 1.5)
    core = random.uniform(-0.3, 0.3, 2) * radius
    ridges = np.hypot(u - core[0], 0.8 * (v - core[1])) / random.uniform(1.5, 2.6)
    ridges += 0.4 * np.sin(np.arctan2(v - core[1], u - core[0]) + random.uniform(0, 6))
    return hertz(np.hypot(u, v / ratio), radius) * (0.55 + 0.45 * np.tanh(2 * np.cos(2 * np.pi * ridges)))


def _gear(x, y, half, random):
    u, v = laid(x, y, random, 0.4 * half)
    r, teeth = np.hypot(u, v), random.integers(9, 19)
    root, height = random.uniform(0.3, 0.5) * half, random.uniform(1, 2)
    tooth = np.clip(1.5 * np.cos(teeth * np.arctan2(v, u)) + 0.5, 0, 1)
    return inside(np.minimum(root + height * tooth - r, r - random.uniform(0.2, 0.8) * root))


def _mesh(x, y, half, random):
    u, v = laid(x, y, random, 0.2 * half)
    period, wire = random.uniform(2.2, 5), random.uniform(0.35, 0.8)
    across = [hertz((each + period / 2) % period - period / 2, wire) for each in (u, v)]
    over = [np.cos(np.pi * u / period), np.cos(np.pi * v / period)]  # a wire is up where it crosses over another
    woven = [across[0] * (0.6 + 0.4 * over[1]), across[1] * (0.6 - 0.4 * over[0])]
    return np.maximum(*woven) * inside(random.uniform(0.4, 0.8) * half - np.maximum(np.abs(u), np.abs(v)))


def _stone(x, y, half, random):
    u, v = laid(x, y, random, 0.3 * half)
    radius = random.uniform(0.4, 0.65) * half
    a, b = random.uniform(-0.5, 0.5, 2) * radius
    size, angle = random.uniform(0.7, 2), np.arctan2(v - b, u - a)
    outline = size * (1 + 0.25 * np.cos(3 * angle + random.uniform(0, 6)))
    return random.uniform(0.2, 0.5) * hertz(np.hypot(u, v), radius) + inside(outline - np.hypot(u - a, v - b))


def _bumps(x, y, half, random):
    total = np.zeros_like(x)
    for _ in range(random.integers(2, 8)):
        (a, b), width = random.uniform(-0.75, 0.75, 2) * half, random.uniform(0.4, 0.6)
        total += random.uniform(0.5, 1) * np.exp(-((x - a) ** 2 + (y - b) ** 2) / (2 * width**2))
    return total


def _caps(x, y, half, random):
    u, v = laid(x, y, random, 0.3 * half)
    apart, radius = random.uniform(2.3, 2.8), random.uniform(0.6, 1)
    total = np.zeros_like(x)
    for character in range(random.integers(1, 4)):
        for n in random.choice(6, random.integers(1, 6), replace=False):
            a, b = (n % 2 + 2.6 * character - 2) * apart, (n // 2 - 1) * apart
            total = np.maximum(total, np.clip(1 - ((u - a) ** 2 + (v - b) ** 2) / radius**2, 0, None))
    return total


# x, y from the array's middle, half of its side, where sizes come from -> pressure over its peak
ALL = _letters, _screws, _cables, _textures, _fingertip, _gear, _mesh, _stone, _bumps, _caps
HELD_OUT_SCENES = {draw.__name__.strip("_"): draw for draw in ALL}
MOTIONS = ("still", "moving", "rolling", "slipping", "appearing")


def held_out(scene, skin, seed, motion="still", frame=0):
    """The pressure (kPa) of a scene on a skin's fine cells, in a frame of its motion."""
    x, y = skin.surface.x / skin.array.pitch, skin.surface.y / skin.array.pitch
    half, window = skin.surface.size / skin.array.pitch / 2, 1.0
    match motion:
        case "moving":
            x = x - STEP * frame
        case "rolling":  # what has touched the surface stays where it is, as long as it touches
            window = hertz(np.hypot(x + 0.3 * half - STEP * frame, y), 0.8 * half)
        case "slipping":
            slips = frame // STICK_FRAMES
            x, y = x - SLIP * slips, y - 0.07 * slips * x
        case "appearing" if frame < APPEARS:
            window = 0.0
    return PEAK_KPA * window * HELD_OUT_SCENES[scene](x, y, half, np.random.default_rng(seed))
