"""Faults, each swept from harmless to hopeless: frames that go wrong, the settings for them, and the truth."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates

from tactiled.arrays import Flags, Floats, Mask
from tactiled.bench.scenes import PEAK_KPA, smooth_step
from tactiled.bench.skin import Frames, Skin, doubled, draw, misconfigured, sense, touches, with_thickness
from tactiled.frames import DEAD, MISSING, SATURATED
from tactiled.live.noise import NOISE_FRAMES
from tactiled.simulate.array import FINER

NOISE = 1.0  # % of the frame's peak, where noise is not the fault
CORRELATION = 1.5  # pitches, of correlated noise
DRIFT_FRAMES = 8  # frames over which a drift hardly changes; along x and y a quarter of the array
TAXELS_PER_MESSAGE = 5  # of 12 bits in a classic CAN message
OF_PEAK = "% of the peak"
STRONGER = (0.1, 0.3, 1, 2, 5, 10, 20)


@dataclass(frozen=True, slots=True)
class Setting:
    """What all sweeps share."""

    skin: Skin
    seed: int
    scenes: tuple[str, ...]
    step: int = 1  # through each sweep's values


@dataclass(frozen=True, slots=True, eq=False)
class Case:
    """One frame, what restoration is configured with, and the truth."""

    skin: Skin  # its surface blurred the frame
    scene: str
    clean: Floats  # without noise
    truth: Floats
    peak_kpa: float
    frame: Frames
    noise: float  # kPa, as configured
    random: np.random.Generator  # for the fault
    flags: Flags
    floor: float = 0.0  # kPa, the part of the noise that rounding causes
    before: Frames | tuple[()] = ()  # frames (T, ...) that a method restores before this one
    still: Frames | None = None  # frames (T, ...) from which the service measures the noise


Sensed = Iterator[tuple[str, Floats, Floats, float]]  # scene, frame without noise, truth, peak (kPa)


def _touching(skin: Skin, setting: Setting, _: float) -> Sensed:
    """Every scene that touches the skin."""
    for scene in setting.scenes:
        clean, truth = sense(skin, draw(skin, scene, [setting.seed, 0]))
        if touches(truth):
            yield scene, clean, truth, float(clean.max())


@dataclass(frozen=True, slots=True)
class Sweep:
    """One fault, its values, and the value at which it is harmless."""

    name: str
    unit: str
    values: tuple[float, ...]
    harmless: float
    spoil: Callable[[Case, float], Case] = lambda case, _: case
    skin: Callable[[Skin, float], Skin] = lambda skin, _: skin
    sense: Callable[[Skin, Setting, float], Sensed] = _touching
    grid: bool = False  # whether it needs rows and columns
    configured: bool = True  # whether restoration has the right settings or flags for it


def cases(setting: Setting, sweep: Sweep, value: float) -> Iterator[Case]:
    """A frame of every scene with the fault at `value`."""
    skin = sweep.skin(setting.skin, value)
    for number, (scene, clean, truth, peak) in enumerate(sweep.sense(skin, setting, value)):
        random = np.random.default_rng([setting.seed, number, 2])
        sigma = (value if sweep.name == "white noise" else NOISE) / 100 * peak
        frame = (clean + random.normal(0, sigma, clean.shape)).astype(np.float32)
        flags = np.zeros(frame.shape, np.uint8)
        yield sweep.spoil(Case(skin, scene, clean, truth, peak, frame, sigma, random, flags), value)


def _add(case: Case, error: Any, **changes: Any) -> Case:
    return replace(case, frame=(case.frame + error).astype(np.float32), **changes)


def _correlated(case: Case, value: float) -> Case:
    """Noise that neighbours share; its strength is configured."""
    smooth = gaussian_filter(case.random.normal(0, 1, case.frame.shape), CORRELATION, mode="wrap")
    shared = value / 100 * case.peak_kpa
    return _add(case, shared * smooth / smooth.std(), noise=float(np.hypot(case.noise, shared)))


def _rowwise(case: Case, value: float) -> Case:
    """An error that the taxels of a row share; its strength is configured."""
    shared = value / 100 * case.peak_kpa
    rows = shared * case.random.normal(0, 1, (len(case.frame), 1))
    return _add(case, rows, noise=float(np.hypot(case.noise, shared)))


def _offset(case: Case, value: float) -> Case:
    return _add(case, value / 100 * case.peak_kpa)


def _drift(case: Case, value: float) -> Case:
    """An offset that wanders over array and time."""
    extent = (DRIFT_FRAMES, *(n / 4 for n in case.frame.shape))
    field = gaussian_filter(case.random.normal(0, 1, (3 * DRIFT_FRAMES, *case.frame.shape)), extent, mode="wrap")
    drift = value / 100 * case.peak_kpa * field / field.std()
    white = case.random.normal(0, case.noise, drift[:-1].shape)
    return _add(case, drift[-1], before=(case.clean + drift[:-1] + white).astype(np.float32))


def _misjudged(case: Case, value: float) -> Case:
    """True noise is `value` times the configured one; the service measures it from frames that stand still."""
    still = case.clean + case.random.normal(0, case.noise, (NOISE_FRAMES, *case.clean.shape))
    return replace(case, noise=case.noise / value, still=still.astype(np.float32))


def _blank(case: Case, missing: Mask, flag: int) -> Case:
    """Set taxels to 0, and flag them."""
    flags = np.where(missing, flag, 0).astype(np.uint8)
    return replace(case, frame=np.where(missing, np.float32(0), case.frame), flags=flags)


def _dead(case: Case, value: float, flag: int = 0) -> Case:
    order = case.random.permutation(case.frame.size).reshape(case.frame.shape)
    return _blank(case, order < round(value / 100 * case.frame.size), flag)


def _lost(case: Case, value: float) -> Case:
    count = -(-case.frame.size // TAXELS_PER_MESSAGE)
    missing = np.repeat(case.random.permutation(count) < round(value / 100 * count), TAXELS_PER_MESSAGE)
    return _blank(case, missing[: case.frame.size].reshape(case.frame.shape), MISSING)


def _saturated(case: Case, value: float, flag: int = 0) -> Case:
    ceiling = np.float32(value / 100 * case.peak_kpa)
    flags = np.where(case.frame >= ceiling, flag, 0).astype(np.uint8)
    return replace(case, frame=np.minimum(case.frame, ceiling), flags=flags)


def _quantised(case: Case, value: float) -> Case:
    """Rounded to `value` bits over a full scale of 1.25 peaks."""
    step = 1.25 * case.peak_kpa / 2**value
    floor = step / 12**0.5
    frame = (np.round(case.frame / step) * step).astype(np.float32)
    return replace(case, frame=frame, noise=float(np.hypot(case.noise, floor)), floor=floor)


EDGE_CONTACTS: dict[str, Callable[[Floats, Floats], Floats]] = {
    "disc": lambda x, y: PEAK_KPA * smooth_step(3 - np.hypot(x, y)),
    "blob": lambda x, y: PEAK_KPA * np.exp(-(x**2 + y**2) / (2 * 2.5**2)),
    "bar": lambda x, y: PEAK_KPA * smooth_step(1 - np.abs(y)) * (np.abs(x) < 6),
}


def _over_the_edge(skin: Skin, _: Setting, value: float) -> Sensed:
    """Contacts whose middle is `value` pitches past the array's edge; what lies outside presses as well."""
    wide = doubled(skin)
    rows, columns = skin.array.frame_shape
    inside = slice(rows // 2, rows // 2 + rows), slice(columns // 2, columns // 2 + columns)
    x, y = wide.surface.x / skin.array.pitch, wide.surface.y / skin.array.pitch
    for name, contact in EDGE_CONTACTS.items():
        clean, truth = sense(wide, contact(x - columns / 2 - value, y))
        yield name, clean[inside], truth[inside], float(wide.surface.sense(contact(x, y)).max())


def _misplaced(skin: Skin, setting: Setting, value: float) -> Sensed:
    """Taxels off their places by `value` % of the pitch, standard deviation along x and y."""
    random = np.random.default_rng([setting.seed, 6])
    rows, columns = skin.array.frame_shape
    places = np.mgrid[:rows, :columns] + random.normal(0, value / 100, (2, rows, columns))
    for scene, _, truth, peak in _touching(skin, setting, value):
        between = np.empty((rows * FINER, columns * FINER))  # what taxels a FINERth of the pitch apart would sense
        padded = np.pad(draw(skin, scene, [setting.seed, 0]), ((0, FINER), (0, FINER)))
        for down, along in np.ndindex(FINER, FINER):
            moved = padded[down : down + rows * FINER, along : along + columns * FINER]
            between[down::FINER, along::FINER] = skin.surface.sense(moved).reshape(rows, columns)
        yield scene, map_coordinates(between, places * FINER, order=3, mode="nearest"), truth, peak


def _cover(layer_property: str) -> Callable[[Skin, float], Skin]:
    """A cover whose `layer_property` is `value` % above the configured one."""
    return lambda skin, value: misconfigured(skin, **{layer_property: 1 + value / 100})


COVERS = (0.05, 0.1, 0.2, 0.35, 0.5, 0.7, 1, 1.5, 2, 3, 4, 6, 10)
NOISES = (0.01, 0.03, 0.1, 0.3, 1, 2, 5, 10, 20)
RATIOS = (0.1, 0.2, 0.5, 1, 2, 3, 5, 10)
STEPS = (-30, -20, -10, -5, 0, 5, 10, 20, 30)
OFFSETS = (-10, -5, -2, -1, 0, 1, 2, 5, 10)
CEILINGS = (100, 90, 80, 70, 60, 50, 40, 30)
SHARES = (0, 1, 2, 5, 10, 20)
EDGES = (-6, -4, -3, -2, -1, 0, 1, 2)
PLACES = (0, 2, 5, 10, 15, 20, 30)
SWEEPS = (
    Sweep("cover", "t/pitch", COVERS, 1, skin=with_thickness),
    Sweep("white noise", OF_PEAK, NOISES, 0.01),
    Sweep("correlated noise", OF_PEAK, STRONGER, 0.1, _correlated, grid=True, configured=False),
    Sweep("row-wise noise", OF_PEAK, STRONGER, 0.1, _rowwise, grid=True, configured=False),
    Sweep("offset", OF_PEAK, OFFSETS, 0, _offset, configured=False),
    Sweep("drift", OF_PEAK, STRONGER, 0.1, _drift, grid=True, configured=False),
    Sweep("noise misjudged", "true / configured", RATIOS, 1, _misjudged, configured=False),
    Sweep("thickness wrong", "% thicker", STEPS, 0, skin=_cover("thickness"), configured=False),
    Sweep("modulus wrong", "% stiffer", (-30, -15, 0, 15, 30), 0, skin=_cover("young"), configured=False),
    Sweep("Poisson's ratio wrong", "% higher", (*STEPS[:5], 2, 3.9), 0, skin=_cover("poisson"), configured=False),
    Sweep("dead taxels", "%, flagged", SHARES, 0, partial(_dead, flag=DEAD)),
    Sweep("dead taxels unflagged", "%, read 0", (0, 0.2, 1, 2, 5, 10), 0, _dead, configured=False),
    Sweep("messages lost", "%", SHARES, 0, _lost),
    Sweep("saturation", "ceiling, % of the peak, flagged", CEILINGS, 100, partial(_saturated, flag=SATURATED)),
    Sweep("saturation unflagged", "ceiling, % of the peak", CEILINGS[:6], 100, _saturated, configured=False),
    Sweep("over the edge", "pitches past it", EDGES, -6, sense=_over_the_edge, grid=True, configured=False),
    Sweep("quantisation", "bits", (16, 14, 12, 10, 8, 7, 6, 5, 4), 16, _quantised),
    Sweep("taxels out of place", "% of the pitch", PLACES, 0, sense=_misplaced, grid=True, configured=False),
)


def sweeps(setting: Setting) -> tuple[Sweep, ...]:
    """The sweeps that the setting's skin allows."""
    return tuple(sweep for sweep in SWEEPS if setting.skin.array.shape is not None or not sweep.grid)
