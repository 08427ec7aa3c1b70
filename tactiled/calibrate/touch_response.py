"""What taxels sense of a tip or of a straight edge under a cover whose gain is being fitted, at any offset.

Both are linear in the gain on the nodes of a quadrature over q, so that tables for a new gain are one product of
matrices. A tip's response is a sum of Hankel transforms: a square aperture's transform has the harmonics
cos(4 m phi), and each of them becomes one of order 4 m. An edge's is the integral of the line response, whose
transform is the slice of gain and aperture across the edge.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.special import j1, jv

from tactiled.cover.family import CoverFamily
from tactiled.cover.operator import aperture_mean
from tactiled.geometry import Array

Floats = NDArray[np.float64]

# With these the tables agree with `cover.operator` to 1e-4 of the peak: tests/calibrate/test_touch_response.py.
HARMONICS = 4  # of a square aperture: 0, 4, 8, 12
GAIN_END = 1e-6  # a gain that ends the quadrature
RESPONSE_END = 2e-4  # of the point response's peak, that ends the table
NODES_PER_PANEL = 24
PANEL_RADIANS = 20.0  # of the fastest wave in a panel of the quadrature
STEPS_PER_DEPTH = 12  # of the table, in the thinnest cover
ANGLES = 256  # over which a harmonic of the aperture is a mean


@dataclass(frozen=True, eq=False)
class Quadrature:
    """Nodes (n,) in cycles/mm and weights, and how far (mm) responses are tabulated, in which steps."""

    q: Floats
    weights: Floats
    reach: float
    step: float
    factor: float = 1.0  # of the cover, in the middle of those that the nodes are for

    @cached_property
    def distance(self) -> Floats:
        """Distances (mm) of a table, from 0."""
        return np.asarray(np.arange(int(self.reach / self.step) + 6) * self.step)


def quadrature(family: CoverFamily, factors: tuple[float, float], extra_mm: float) -> Quadrature:
    """Nodes that resolve the response under covers of `factors` (low, high) out to its end and `extra_mm`."""
    thin, thick = family.kernel(factors[0]), family.kernel(factors[1])
    end = float(thin.q[np.flatnonzero(np.abs(thin.gain) >= GAIN_END)[-1]])
    reach = float(thick.r[np.flatnonzero(np.abs(thick.g) >= RESPONSE_END * thick.g[0])[-1]]) + extra_mm
    panels = int(2 * np.pi * end * reach / PANEL_RADIANS) + 1
    node, weight = np.polynomial.legendre.leggauss(NODES_PER_PANEL)
    width = end / panels
    q = (np.arange(panels)[:, None] * width + (node + 1) / 2 * width).ravel()
    step = family.configured.depth * factors[0] / STEPS_PER_DEPTH
    return Quadrature(q, np.tile(weight * width / 2, panels), reach, step, float(np.sqrt(np.prod(factors))))


def tip_transform(q: Floats, radius_mm: float, sphere: bool = False) -> Floats:
    """Transform, 1 at q = 0, of even pressure on a disc, or of Hertz's under a sphere, of contact radius (mm)."""
    x = np.maximum(2 * np.pi * q * radius_mm, 1e-3)
    if sphere:
        return np.asarray(3 * (np.sin(x) - x * np.cos(x)) / x**3)
    return np.asarray(2 * j1(x) / x)


class TipResponse:
    """The mean pressure on a taxel under a tip of force 1 (kPa mm^2), by its offset from the tip."""

    def __init__(self, array: Array, nodes: Quadrature, harmonics: int = HARMONICS) -> None:
        self.nodes = nodes
        self._matrices = []
        angle = np.arange(ANGLES) * 2 * np.pi / ANGLES
        aperture = aperture_mean(array, np.outer(nodes.q, np.cos(angle)), np.outer(nodes.q, np.sin(angle)))
        phase = 2 * np.pi * np.outer(nodes.distance, nodes.q)
        for order in range(0, 4 * harmonics, 4) if array.aperture == "square" else (0,):
            harmonic = (aperture * np.cos(order * angle)).mean(axis=1) * (2 if order else 1)
            self._matrices.append(2 * np.pi * jv(order, phase) * (nodes.weights * nodes.q * harmonic))

    def radial(self, spectrum: Floats) -> Floats:
        """Response at the nodes' distances, as if apertures were round."""
        return np.asarray(self._matrices[0] @ spectrum)

    def __call__(self, spectra: Floats, offsets: Floats) -> tuple[Floats, Floats]:
        """Responses (M, S) to tips of `spectra` (n, S), the gradient (M, 2) of the first; offsets (M, 2) mm."""
        x, y = offsets.T
        r = np.hypot(x, y)
        angle, inside = np.arctan2(y, x), (r < self.nodes.reach)[:, None]
        radial, turning = np.zeros(len(r)), np.zeros(len(r))
        response = np.zeros((len(r), spectra.shape[1]))
        for at, matrix in enumerate(self._matrices):
            table = CubicSpline(self.nodes.distance, matrix @ spectra)
            near = np.minimum(r, self.nodes.reach)
            value, slope = table(near), table(near, 1)[:, 0]
            response += np.cos(4 * at * angle)[:, None] * value
            radial += np.cos(4 * at * angle) * slope
            turning -= 4 * at * np.sin(4 * at * angle) * value[:, 0]
        turning /= np.maximum(r, self.nodes.step)
        gradient = (
            np.column_stack([radial * x - turning * y, radial * y + turning * x]) / np.maximum(r, 1e-9)[:, None]
        )
        return response * inside, gradient * inside


class EdgeResponse:
    """The mean pressure on a taxel under a straight edge of pressure 1 kPa, by the distance to the edge."""

    def __init__(self, array: Array, nodes: Quadrature) -> None:
        self.array, self.nodes = array, nodes
        phase = 2 * np.pi * np.outer(nodes.distance, nodes.q)
        self._matrix = np.sin(phase) * nodes.weights / (np.pi * nodes.q)

    def __call__(
        self, spectra: Floats, angle: float, distance: Floats, width: float = np.inf
    ) -> tuple[Floats, ...]:
        """Responses (M, S) of `spectra` (n, S) to a strip of `width` that starts at the edge, at (M,) mm from it.

        Behind them the slope (M,) of the first by distance and its integral (M,) from far outside. `angle` (rad)
        is that of the edge's normal, which points into the load. The strip is centred if its width is finite.
        """
        aperture = aperture_mean(self.array, self.nodes.q * np.cos(angle), self.nodes.q * np.sin(angle))
        table = CubicSpline(self.nodes.distance, self._matrix @ (spectra * aperture[:, None]))
        if np.isinf(width):
            return self._step(table, distance)
        ends = [self._step(table, distance + side * width / 2) for side in (1, -1)]
        return tuple(first - second for first, second in zip(*ends, strict=True))

    def _step(self, table: CubicSpline, distance: Floats) -> tuple[Floats, ...]:
        """Response, slope and integral of a load from 0 on."""
        end = self.nodes.distance[-1]
        near, side = np.minimum(np.abs(distance), end), np.sign(distance)
        rises = side[:, None] * table(near)
        rises[:, 0] += 0.5
        tail = (end - near) / 2 - (table.antiderivative()(end) - table.antiderivative()(near))[:, 0]
        return rises, table(near, 1)[:, 0], np.maximum(distance, 0) + tail
