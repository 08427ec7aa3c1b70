"""A straight edge laid across the taxels at a slant: it crosses them at many phases, finer than their pitch.

That is the slanted-edge method of ISO 12233, fitted to the taxels themselves rather than differentiated. Angle and
place of each edge, and the pressure beside it up to linear terms, are solved for.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import ConvexHull

from tactiled.arrays import Floats, Ints, Mask
from tactiled.calibrate.cover.likelihood import Likelihood, Model, Prior, Readings, Solution, Spectrum
from tactiled.calibrate.cover.presses import Press, usable_presses
from tactiled.calibrate.cover.search import Touch, differences
from tactiled.calibrate.cover.touch_response import (
    PROFILES,
    EdgeResponse,
    Quadrature,
    TipResponse,
    edge_transform,
    quadrature,
    ridge_transform,
)
from tactiled.calibrate.cover.unknowns import (
    CALIPER_ERROR_MM,
    EDGE_BLUR_MM,
    PROFILE,
    SHARED,
    SIZE,
    USUAL,
    Unknowns,
)
from tactiled.cover.family import CoverFamily
from tactiled.cover.stack import Stack
from tactiled.errors import ConfigError
from tactiled.geometry import Array

ANGLES = np.radians(np.arange(0, 360, 5))  # of the first look
FINER_ANGLES = np.radians(np.linspace(-4, 4, 9))
MIN_EDGES = 2
# How much of the load is missing beyond the array's border is solved for, too; the response to all of it is as of
# the first look. Readings within BORDER_DEPTHS depths of the cover from the border are not used, but those in the
# inner MIN_INSIDE of the way from border to middle always are.
BORDER_DEPTHS, MIN_INSIDE = 1.0, 0.5
CELL_PITCHES, CELL_STEPS = 0.5, 6.0  # side of a cell beyond the border: pitches, or steps of the table if larger


@dataclass(frozen=True, eq=False)
class EdgeModel(Model):
    """Readings under edges or ridges; positions are from the array's centre.

    An edge's own parameters: pressure (kPa), its growth along the edge (kPa/mm) and across it (kPa/mm; of a ridge
    that along it squared, kPa/mm^2), pressure that is missing beyond the array's border (kPa), angle (rad) of the
    normal into the load, and offset (mm) along that normal.
    """

    response: EdgeResponse
    outside: Floats  # (M,) response to a load of 1 beyond the array's border

    def of(self, keep: Mask, press: Ints) -> "EdgeModel":
        """The model of some readings, of presses numbered anew."""
        return replace(self, positions=self.positions[keep], press=press, outside=self.outside[keep])

    def __call__(self, shared: Floats, own: Floats) -> tuple[Floats, Floats, Floats]:
        """The model (M,), its slopes in what is shared (M, S) and in the edges' own (M, 6)."""
        spectra = differences(self.spectrum, shared, self.free)
        model, by_shared = np.zeros(len(self.press)), np.zeros((len(self.press), len(shared)))
        by_own = np.zeros((len(self.press), own.shape[1]))
        for press, parameters in enumerate(own):
            at = self.press == press
            model[at], by_shared[at], by_own[at] = self._edge(spectra, at, parameters)
        return self.bent(shared, model, by_shared, by_own)

    def _edge(self, spectra: Floats, at: Mask, own: Floats) -> tuple[Floats, Floats, Floats]:
        level, along, third, missing, angle, offset = own
        across, v = distances(self.positions[at], angle, offset)
        rises, slope, ramp = self.response(spectra, angle, across)
        rise, ridge = rises[:, 0], self.response.ridge
        last = v**2 * rise if ridge else ramp
        pressure = level + along * v + (third * v**2 if ridge else 0)
        by_across = pressure * slope + (0 if ridge else third * rise)
        by_v = (along + (2 * third * v if ridge else 0)) * rise
        by_angle = by_across * v - by_v * (across + offset)
        by_shared = pressure[:, None] * rises[:, 1:]  # that of the ramp is of second order
        model = (level + along * v) * rise + third * last - missing * self.outside[at]
        return model, by_shared, np.column_stack([rise, v * rise, last, -self.outside[at], by_angle, -by_across])


def distances(positions: Floats, angle: Floats | float, offset: Floats | float) -> tuple[Floats, Floats]:
    """Distance (M,) in mm into the load of an edge, and that along it."""
    x, y = positions.T
    return x * np.cos(angle) + y * np.sin(angle) - offset, y * np.cos(angle) - x * np.sin(angle)


@dataclass(frozen=True, eq=False)
class EdgeTouch(Touch):
    """Straight edges, or ridges of `width` (mm)."""

    width: float

    @property
    def centred(self) -> Floats:
        """Taxels' positions (N, 2) from the middle of the array."""
        positions = self.array.positions
        return np.asarray(positions - (positions.min(axis=0) + positions.max(axis=0)) / 2)

    def transform(self, q: Floats, size: float, profile: float) -> Floats:
        """Transform of a ridge's pressure (mm), or of the rise across an edge."""
        if np.isinf(self.width):
            return edge_transform(q, float(profile))
        width = float(np.exp(size))
        return width * ridge_transform(q, width, float(np.clip(profile, *PROFILES)))

    def freed_deviation(self, parameter: int) -> float:
        """Deviation of what is shared where presses refuse its prior."""
        if parameter == PROFILE and np.isinf(self.width):
            return self.array.pitch**2
        return super().freed_deviation(parameter)

    @property
    def extra_mm(self) -> float:
        """How far a response reaches beyond that of the cover."""
        return 3 * self.array.pitch + (0 if np.isinf(self.width) else self.width / 2)

    def model(self, nodes: Quadrature, spectrum: Spectrum, readings: Readings, coarse: bool = False) -> EdgeModel:
        """The model of `readings`."""
        response = EdgeResponse(self.array, nodes, np.isfinite(self.width), self.scales)
        outside = np.zeros(len(readings.press)) if coarse else self._outside(nodes)[readings.press, readings.taxel]
        positions, highest = self.centred[readings.taxel], float(readings.value.max())
        return EdgeModel(positions, readings.press, spectrum, response, self.free, highest, outside)

    def _outside(self, nodes: Quadrature) -> Floats:
        """Responses (K, N) to the part of each edge at the first look, 1 kPa, beyond the array's border."""
        half = np.abs(self.centred).max(axis=0) + self.array.pitch / 2
        side = max(CELL_PITCHES * self.array.pitch, CELL_STEPS * nodes.step)
        x, y = (np.arange(-end - nodes.reach + side / 2, end + nodes.reach, side) for end in half)
        cells = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        within = np.clip((half - np.abs(cells)) / side + 0.5, 0, 1).prod(axis=1)
        cells, share = cells[within < 1], (1 - within)[within < 1]
        table = TipResponse(self.array, nodes, 1).radial(self.family.gain(nodes.q, nodes.factor))
        apart = np.linalg.norm(self.centred[:, None] - cells, axis=-1)
        response = np.interp(apart.ravel(), nodes.distance, table, right=0).reshape(apart.shape) * side**2
        loads = []
        for *_, angle, offset in self.prior.own:
            across = distances(cells, angle, offset)[0]
            inside = across if np.isinf(self.width) else self.width / 2 - np.abs(across)
            loads.append(share * np.clip(inside / side + 0.5, 0, 1))
        return np.asarray(np.array(loads) @ response.T)

    def near(self, reach: float, depth: float) -> Mask:
        """Readings (K, N) within `reach` of an edge, and far enough from the array's border."""
        homogeneous = np.vstack([self.centred.T, np.ones(self.array.size)])
        border = -(ConvexHull(self.centred).equations @ homogeneous).max(axis=0)
        inside = border >= min(BORDER_DEPTHS * depth, (1 - MIN_INSIDE) * border.max()) - 1e-9
        across = [distances(self.centred, angle, offset)[0] for *_, angle, offset in self.prior.own]
        return np.asarray((np.abs(across) < reach) & inside)

    def on_line(self, likelihood: Likelihood, solution: Solution) -> tuple[Floats, Floats]:
        """Each reading's distance (M,) in mm into the load, and the load's pressure (kPa) at that place."""
        model, own = likelihood.model, solution.own[likelihood.readings.press].T
        across, along = distances(model.positions, *own[-2:])
        third = along**2 if np.isfinite(self.width) else np.maximum(across, 0)
        return across, own[0] + own[1] * along + own[2] * third


def edge_touch(
    presses: Sequence[Press],
    array: Array,
    configured: Stack,
    gain_error: Floats | float,
    width_mm: float | None = None,
    unknowns: Unknowns = USUAL,
) -> EdgeTouch:
    """Make the usable `presses` ready to be fitted as edges, or ridges of `width_mm`; ConfigError for too few."""
    advice = f"lay the edge at least {MIN_EDGES} times, better 5"
    usable = [presses[at] for at in usable_presses(presses, MIN_EDGES, advice)]
    if np.linalg.matrix_rank(array.positions - array.positions[0], tol=1e-6) < 2:
        raise ConfigError("array is one line of taxels: an edge needs two dimensions")
    span = float(np.hypot(*np.ptp(array.positions, axis=0)))
    if width_mm is not None and not 0 < width_mm < span:
        raise ConfigError(
            f"the ridge is {width_mm:g} mm wide: give more than 0 and less than the array's {span:.3g} mm"
        )
    family = CoverFamily(configured)
    gain = np.broadcast_to(np.asarray(gain_error, float), (array.size,))
    own, shared = np.zeros((len(usable), 6)), np.zeros(SHARED)
    if width_mm is None:
        deviations = unknowns.deviations(array, 0.0, (unknowns.size_mm or EDGE_BLUR_MM) ** 2)
    else:
        shared[SIZE] = np.log(width_mm)
        deviations = unknowns.deviations(
            array, (unknowns.size_mm or CALIPER_ERROR_MM) / width_mm, unknowns.profile
        )
    prior = Prior(shared, deviations, own, np.full(own.shape, np.inf))
    touch = EdgeTouch(array, family, tuple(usable), gain, prior, width_mm or np.inf)
    response = EdgeResponse(array, quadrature(family, (1.0, 1.0), touch.extra_mm), width_mm is not None)
    for press, each in zip(own, usable, strict=True):
        press[[0, 4, 5]] = _first_look(each, touch, response)
    return touch


def _first_look(press: Press, touch: EdgeTouch, response: EdgeResponse) -> tuple[float, float, float]:
    """Level (kPa), angle (rad) and offset (mm) of the even edge nearest to a press, on a grid, then finer."""
    pitch, span = touch.array.pitch, float(np.hypot(*np.ptp(touch.centred, axis=0))) / 2
    works = np.isfinite(press.mean)
    positions, values = touch.centred[works], press.mean[works]
    q = response.nodes.q
    spectrum = (touch.family.gain(q, 1.0) * touch.transform(q, *touch.prior.shared[[SIZE, PROFILE]]))[:, None]
    best, angles, offsets = (-np.inf, 0.0, 0.0, 0.0), ANGLES, np.arange(-span, span, pitch / 2)
    for _ in range(2):
        for angle in angles:
            across = distances(positions, angle, 0.0)[0][:, None] - offsets
            rise = response(spectrum, angle, across.ravel())[0][:, 0].reshape(across.shape)
            power = np.maximum((rise**2).sum(axis=0), 1e-9)
            score = np.maximum(values @ rise, 0) ** 2 / power
            at = int(score.argmax())
            level = float(values @ rise[:, at] / power[at])
            best = max(best, (float(score[at]), level, float(angle), float(offsets[at])))
        angles, offsets = best[2] + FINER_ANGLES, best[3] + np.linspace(-0.5, 0.5, 11) * pitch
    return best[1:]
