"""Tips and edges on covered taxels, made by another way than the fits' own: pieces of load at exact places."""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import map_coordinates, spline_filter

from tactiled.calibrate.cover.presses import Press
from tactiled.cover.kernel import solve
from tactiled.cover.operator import _response
from tactiled.cover.stack import Layer, Stack

PEAK_KPA = 100.0


def rubber(thickness, young=0.6, poisson=0.49):
    """Rubber on a board of glass fibre."""
    return Stack((Layer(thickness, young, poisson), Layer(1.6, 20e3, 0.2)))


def disc(radius, sphere=False):
    """Places (n, 2) and weights (n,) of even pressure on a disc, or of Hertz's: Gauss in r, even in the angle."""
    node, weight = (each / 2 for each in np.polynomial.legendre.leggauss(8))
    node = node + 0.5
    r = radius * (np.sqrt(1 - node**2) if sphere else np.sqrt(node))
    weight = weight * (3 * node**2 if sphere else 1)
    angle = np.arange(24) * 2 * np.pi / 24
    places = np.stack([np.outer(r, np.cos(angle)), np.outer(r, np.sin(angle))], axis=-1).reshape(-1, 2)
    return places, np.repeat(weight / 24, 24)


class World:
    """What taxels sense of loads under a cover."""

    def __init__(self, array, stack, model="layered"):
        self.array = array
        piece = 0.02 * array.pitch
        reach = float(np.ptp(array.positions, axis=0).max()) + 3 * array.pitch
        self._step = min(0.08 * stack.depth, 0.1 * array.pitch)
        at = np.arange(0, reach, self._step)
        table = _response(solve(stack, model), array, piece, at, at) / piece**2
        self._table, self._reach = spline_filter(table, mode="mirror"), at[-1]
        self._near, self._panel = min(10 * stack.depth + 2 * array.pitch, self._reach), stack.depth

    def _at(self, down, across):
        """Response (n,) of a taxel to a force so far away from it, mm: it is even in both."""
        at = np.abs([down, across]) / self._step
        return map_coordinates(self._table, at, mode="mirror", prefilter=False)

    def sensed(self, places, forces):
        """Pressures (N,) under forces (n,) in kPa mm^2 at places (n, 2)."""
        offsets = np.abs(self.array.positions[:, None] - places[None])
        values = self._at(*np.minimum(offsets, self._reach)[..., ::-1].reshape(-1, 2).T)
        return values.reshape(offsets.shape[:2]) @ forces

    def tip(self, radius, place, sphere=False):
        """Pressures (N,) under a tip, PEAK_KPA at most."""
        pieces, weights = disc(radius, sphere)
        value = self.sensed(pieces + place, weights)
        return PEAK_KPA * value / value.max()

    def edge(self, angle, offset, width=np.inf, beyond=True, growth=0.0):
        """Pressures (N,) under PEAK_KPA on one side of an edge, or on a ridge; along it, it grows by `growth` /mm.

        The load goes on `beyond` the array's border, or ends there.
        """
        positions = (
            self.array.positions - (self.array.positions.min(axis=0) + self.array.positions.max(axis=0)) / 2
        )
        half = np.abs(positions).max(axis=0) + self.array.pitch / 2
        end, node, weight = float(np.hypot(*half)) + self._near, *np.polynomial.legendre.leggauss(6)
        begin, end = (0.0, end + abs(offset)) if np.isinf(width) else (-width / 2, width / 2)
        panels = int((end - begin) / self._panel) + 1
        step = (end - begin) / panels
        across = (begin + (np.arange(panels)[:, None] + (node + 1) / 2) * step).ravel()
        along = np.arange(-2 * half.max() - self._near, 2 * half.max() + self._near, self._panel / 4)
        n, v = np.meshgrid(across, along)
        force = np.tile(weight * step / 2, panels) * self._panel / 4 * (1 + growth * v)
        x = (n + offset) * np.cos(angle) - v * np.sin(angle)
        y = (n + offset) * np.sin(angle) + v * np.cos(angle)
        if not beyond:
            force = force * (np.abs(x) < half[0]) * (np.abs(y) < half[1])
        pressure = np.zeros(self.array.size)
        for taxel, (right, down) in enumerate(positions):
            near = (np.abs(x - right) < self._near) & (np.abs(y - down) < self._near) & (force != 0)
            pressure[taxel] = self._at(y[near] - down, x[near] - right) @ force[near]
        return PEAK_KPA * pressure

    def places(self, count, random, inside=1.5):
        """Places (count, 2), `inside` mm from the border at least."""
        low, high = self.array.positions.min(axis=0) + inside, self.array.positions.max(axis=0) - inside
        return random.uniform(low, high, (count, 2))


@dataclass
class Skin:
    """Taxels with errors: their gains, and dead ones; frames averaged to a noise of a press's mean."""

    size: int
    random: np.random.Generator
    gain_error: float = 0.01
    dead: float = 0.02
    noise: float = 0.003 * PEAK_KPA

    def __post_init__(self):
        self.gain = 1 + self.gain_error * self.random.normal(size=self.size)
        self.gain[self.random.random(self.size) < self.dead] = np.nan

    def press(self, pressure, array):
        """A press's mean, as out of a recording."""
        mean = pressure * self.gain + self.random.normal(0, self.noise, self.size)
        above = np.nan_to_num(np.maximum(mean - np.nanmax(mean) / 3, 0))
        x, y = above @ array.positions / above.sum()
        return Press(0, 10, mean, np.full(self.size, self.noise), np.nansum(mean) * array.pitch**2 / 1e3, (x, y))


def recorded(pressures, random, noise=1.0, frames=30):
    """Frames (T, N): each of the pressures (K, N) for `frames`, up and down in a few, with pauses as long."""
    pause = np.zeros(frames)
    load = np.concatenate([pause, np.linspace(0, 1, 5), np.ones(frames), np.linspace(1, 0, 5)])
    clean = np.concatenate([load[:, None] * each for each in pressures] + [pause[:, None] * pressures[0]])
    return (clean + random.normal(0, noise, clean.shape)).astype(np.float32)
