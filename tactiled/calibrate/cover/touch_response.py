"""What taxels sense of a tip or of a straight edge under a cover whose gain is being fitted, at any offset.

Both are linear in the gain on the nodes of a quadrature over q, so that tables for a new gain are one product of
matrices; for several scales of the aperture a spectrum has a block each. A tip's response is a sum of Hankel
transforms: a square aperture's has the harmonics cos(4 m phi), and each becomes one of order 4 m. An edge's is the
integral of the line response, whose transform is the slice of gain and aperture across the edge.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.special import gamma, j0, j1, jv

from tactiled.arrays import Floats
from tactiled.cover.family import CoverFamily
from tactiled.cover.operator import aperture_mean
from tactiled.geometry import Array

# With these the tables fit `cover.operator` to 1e-4 of the peak: tests/calibrate/cover/test_touch_response.py
HARMONICS = 4  # of a square aperture: 0, 4, 8, 12
GAIN_END = 1e-6  # a gain that ends the quadrature
RESPONSE_END = 2e-4  # of the point response's peak, that ends the table
NODES_PER_PANEL = 24
PANEL_RADIANS = 20.0  # of the fastest wave in a panel of the quadrature
STEPS_PER_DEPTH = 12  # of the table, in the thinnest cover
ANGLES = 256  # over which a harmonic of the aperture is a mean
PROFILES = -0.9, 6.0  # exponents of a load's profile
ONE = (1.0,)  # scale of the aperture: as configured


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


def tip_transform(q: Floats, radius_mm: float, profile: float = 0.0) -> Floats:
    """Transform, 1 at q = 0, of pressure (1 - (r/a)^2)^profile on a disc of radius a (mm).

    0 is even pressure, 1/2 that under a sphere on a thick cover (Hertz), -1/2 that under a rigid flat punch on it.
    """
    return _bessel(2 * np.pi * q * radius_mm, profile + 1)


def ridge_transform(q: Floats, width_mm: float, profile: float = 0.0) -> Floats:
    """Transform, 1 at q = 0, of pressure (1 - (x/b)^2)^profile on a strip of width 2 b (mm)."""
    return _bessel(np.pi * q * width_mm, profile + 0.5)


def _bessel(x: Floats, order: float) -> Floats:
    """Sonine's integral, 1 at 0: Gamma(n + 1) J_n(x) (2 / x)^n."""
    x = np.maximum(x, 1e-3)
    return np.asarray(gamma(order + 1) * jv(order, x) * (2 / x) ** order)


def _every_fourth_bessel(x: Floats, harmonics: int) -> list[Floats]:
    """J_0, J_4, J_8, ... at x, 0 and above: by recurrence where that is stable, in a fifth of the time of `jv`."""
    order = 4 * (harmonics - 1)
    values, low, high = [j0(x), j1(x)], x < order, np.maximum(x, order)
    for n in range(1, order):
        values.append(2 * n / high * values[n] - values[n - 1])
    for n in range(4, order + 1, 4):
        values[n][low] = jv(n, x[low])
    return values[: order + 1 : 4]


def edge_transform(q: Floats, square_mm: float) -> Floats:
    """Transform of the rise across a blurred edge, 1 at q = 0; `square_mm` is the rise's variance (mm^2).

    Below 0 the load is highest at its rim, as under a hard plate.
    """
    x = 2 * np.pi**2 * q**2 * square_mm
    return np.asarray(np.exp(-x) if square_mm > 0 else 1 - x)


class TipResponse:
    """The mean pressure on a taxel under a tip of force 1 (kPa mm^2), by its offset from the tip."""

    def __init__(
        self, array: Array, nodes: Quadrature, harmonics: int = HARMONICS, scales: tuple[float, ...] = ONE
    ) -> None:
        self.nodes = nodes
        self._matrices = []
        angle = np.arange(ANGLES) * 2 * np.pi / ANGLES
        u, v = np.outer(nodes.q, np.cos(angle)), np.outer(nodes.q, np.sin(angle))
        apertures = [aperture_mean(array, scale * u, scale * v) for scale in scales]
        phase = 2 * np.pi * np.outer(nodes.distance, nodes.q)
        bessel = _every_fourth_bessel(phase, harmonics if array.aperture == "square" else 1)
        for harmonic, values in enumerate(bessel):
            waves = 2 * np.pi * values * (nodes.weights * nodes.q)
            turned = np.cos(4 * harmonic * angle) * (2 if harmonic else 1)
            self._matrices.append(np.hstack([waves * (each * turned).mean(axis=1) for each in apertures]))

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
    """The mean pressure on a taxel under an edge, or a `ridge`, of pressure 1 kPa, by the distance to it."""

    def __init__(
        self, array: Array, nodes: Quadrature, ridge: bool = False, scales: tuple[float, ...] = ONE
    ) -> None:
        self.array, self.nodes, self.ridge, self.scales = array, nodes, ridge, scales
        phase = 2 * np.pi * np.outer(nodes.distance, nodes.q)
        self._matrix = (
            2 * np.cos(phase) * nodes.weights if ridge else np.sin(phase) * nodes.weights / (np.pi * nodes.q)
        )

    def __call__(self, spectra: Floats, angle: float, distance: Floats) -> tuple[Floats, Floats, Floats]:
        """Responses (M, S) of `spectra` (n, S), at (M,) mm into the load, or from the ridge's middle.

        Behind them the slope (M,) of the first by distance and its integral (M,) from far outside, 0 of a ridge.
        `angle` (rad) is that of the edge's normal, which points into the load.
        """
        u, v = self.nodes.q * np.cos(angle), self.nodes.q * np.sin(angle)
        passed = sum(
            part * aperture_mean(self.array, scale * u, scale * v)[:, None]
            for part, scale in zip(np.split(spectra, len(self.scales)), self.scales, strict=True)
        )
        table = CubicSpline(self.nodes.distance, self._matrix @ passed)
        end = self.nodes.distance[-1]
        near, side = np.minimum(np.abs(distance), end), np.sign(distance)
        values, slope = table(near), table(near, 1)[:, 0]
        if self.ridge:
            return values, side * slope, np.zeros_like(slope)
        rises = side[:, None] * values
        rises[:, 0] += 0.5
        tail = (end - near) / 2 - (table.antiderivative()(end) - table.antiderivative()(near))[:, 0]
        return rises, slope, np.maximum(distance, 0) + tail
