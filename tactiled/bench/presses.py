"""Presses on a simulated skin whose cover, gains, zeros and faults are known: what a calibration is judged by.

What taxels feel is integrated from the exact solution of the true cover, off every grid and without cells; a
calibration fits with tables of its own.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import j1

from tactiled.arrays import Floats, Ints
from tactiled.cover.kernel import Kernel, solve
from tactiled.cover.operator import aperture_mean
from tactiled.cover.stack import Stack
from tactiled.frames import FrameSeries
from tactiled.geometry import Array
from tactiled.simulate.array import Surface
from tactiled.simulate.playback import SCENE_S, TOUR
from tactiled.simulate.scenes import SCENES

PERIOD_MM = 64.0  # after which the waves repeat: readings of 16 x 16 are those of twice as long to 1e-8
EDGE_WAVES = 16  # as many more for an edge, which is one-dimensional
RATE_HZ = 50.0
FREE_S, RAMP_S, PLATEAU_S = 0.3, 0.2, 0.5  # of one press: before it, rising and falling, and held
STEP_S = 2.0  # of uniform pressure
TOUR_RATE_HZ, TOUR_FINER = 50.0, 6  # frames a second of the tour, cells along a taxel's side
TOUR_START_S = 600.0  # within which a recording of the tour begins: its scenes move, and none repeats exactly
FULL_SCALE = 65535  # counts
NO_LOAD, KPA_PER_COUNT = 2000.0, 0.01  # of a taxel before its own spread


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedSkin:
    """An array under a true cover, with taxels that differ."""

    array: Array
    cover: Kernel  # the true one
    kpa_per_count: Floats  # (N,)
    no_load: Floats  # (N,) counts
    dead: Ints  # taxels
    noise_kpa: float  # standard deviation of one taxel
    drift_kpa_s: Floats  # (N,) kPa a second

    def series(self, pressure: Floats, times: Floats, random: np.random.Generator) -> FrameSeries:
        """The counts, rounded, of what taxels feel (T, N) in kPa at `times` (T,) s."""
        felt = pressure + self.drift_kpa_s * times[:, None] + random.normal(0, self.noise_kpa, pressure.shape)
        counts = np.clip(np.round(felt / self.kpa_per_count + self.no_load), 0, FULL_SCALE)
        counts[:, self.dead] = np.round(self.no_load[self.dead])
        return FrameSeries(np.asarray(times, float), counts.astype(np.float32))


def simulated_skin(
    true: Stack, array: Array, random: np.random.Generator, noise_kpa: float, spread: float = 0.2, dead: int = 0
) -> SimulatedSkin:
    """Taxels with a relative `spread` of gains and zeros, and `dead` of them that do not work."""
    gains = KPA_PER_COUNT * np.exp(random.normal(0, np.log1p(spread), array.size))
    return SimulatedSkin(
        array=array,
        cover=solve(true, "layered"),
        kpa_per_count=gains,
        no_load=NO_LOAD * (1 + spread * random.uniform(-1, 1, array.size)),
        dead=random.choice(array.size, dead, replace=False),
        noise_kpa=noise_kpa,
        drift_kpa_s=np.zeros(array.size),
    )


@dataclass(frozen=True, slots=True)
class Disc:
    """A flat round tip, its place in mm from the array's middle."""

    x_mm: float
    y_mm: float
    radius_mm: float

    def readings(self, array: Array, cover: Kernel) -> Floats:
        """What taxels (N,) feel of unit pressure: the integral over the plane's waves, axis after axis."""
        x, y = (array.positions - middle(array) - (self.x_mm, self.y_mm)).T
        waves = np.arange(-cover.q[-1], cover.q[-1], 1 / PERIOD_MM)
        u, v = waves, waves[:, None]
        q = np.hypot(u, v)
        bessel = 2 * np.pi * self.radius_mm * np.maximum(q, 1e-12)
        tip = np.pi * self.radius_mm**2 * 2 * j1(bessel) / bessel
        spectrum = cover.gain_at(q) * tip * aperture_mean(array, u, v) / PERIOD_MM**2
        across, down = (np.exp(2j * np.pi * np.outer(each, waves)) for each in (x, y))
        return np.asarray(np.einsum("nv,vu,nu->n", down, spectrum, across, optimize=True).real)


@dataclass(frozen=True, slots=True)
class HalfPlane:
    """All that lies on one side of a straight edge."""

    offset_mm: float  # of the edge from the array's middle
    angle_rad: float  # of its normal, which points to the pressed side, from x

    def readings(self, array: Array, cover: Kernel) -> Floats:
        """What taxels (N,) feel of unit pressure: the integral over the waves along the normal."""
        normal = np.array([np.cos(self.angle_rad), np.sin(self.angle_rad)])
        depth = (array.positions - middle(array)) @ normal - self.offset_mm
        k = (np.arange(round(cover.q[-1] * PERIOD_MM * EDGE_WAVES)) + 0.5) / (PERIOD_MM * EDGE_WAVES)
        passed = cover.gain_at(k) * aperture_mean(array, *(k * normal[:, None])) / k
        waves = np.sin(2 * np.pi * np.outer(depth, k)) @ passed / (np.pi * PERIOD_MM * EDGE_WAVES)
        return np.asarray(0.5 + waves)


Shape = Disc | HalfPlane  # that presses evenly


def middle(array: Array) -> Floats:
    """Centre (2,) of an array, mm."""
    return np.asarray((array.positions.min(axis=0) + array.positions.max(axis=0)) / 2)


def press_series(
    skin: SimulatedSkin, shapes: Sequence[Shape], peaks_kpa: Floats, random: np.random.Generator
) -> FrameSeries:
    """Frames of one press after the other, with pauses between; `peaks_kpa` are their highest readings."""
    load = np.concatenate([
        np.zeros(round(FREE_S * RATE_HZ)),
        np.linspace(0, 1, round(RAMP_S * RATE_HZ), endpoint=False),
        np.ones(round(PLATEAU_S * RATE_HZ)),
        np.linspace(1, 0, round(RAMP_S * RATE_HZ), endpoint=False),
    ])  # fmt: skip
    feel = [shape.readings(skin.array, skin.cover) for shape in shapes]
    frames = [peak * load[:, None] * one / one.max() for one, peak in zip(feel, peaks_kpa, strict=True)]
    pressure = np.concatenate([*frames, np.zeros((round(FREE_S * RATE_HZ), skin.array.size))])
    return skin.series(pressure, np.arange(len(pressure)) / RATE_HZ, random)


def uniform_series(
    skin: SimulatedSkin,
    steps_kpa: Sequence[float],
    random: np.random.Generator,
    step_s: float = STEP_S,
    rate_hz: float = RATE_HZ,
) -> FrameSeries:
    """Frames of uniform pressures, one after another."""
    steps = np.repeat(steps_kpa, round(step_s * rate_hz))
    return skin.series(np.outer(steps, np.ones(skin.array.size)), np.arange(len(steps)) / rate_hz, random)


def tour_series(skin: SimulatedSkin, seconds: float, random: np.random.Generator) -> FrameSeries:
    """Frames of the demo's tour from a random moment on, on cells finer than the demo's."""
    surface = Surface(skin.cover, skin.array, TOUR_FINER)
    times = random.uniform(0, TOUR_START_S) + np.arange(0, seconds, 1 / TOUR_RATE_HZ)
    scenes = [SCENES[TOUR[int(t / SCENE_S) % len(TOUR)]] for t in times]
    felt = [
        surface.sense(scene(surface.x, surface.y, t, surface.size, surface.grain))
        for scene, t in zip(scenes, times, strict=True)
    ]
    return skin.series(np.stack(felt), times, random)
