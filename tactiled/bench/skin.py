"""A skin to measure on: an array under a cover, blurred exactly, restored with the operators that a user has."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactiled import surface
from tactiled.arrays import Floats, Floats32
from tactiled.bench.scenes import PEAK_KPA, TEST_SCENES
from tactiled.build import make_array, make_stack
from tactiled.config import load
from tactiled.cover.kernel import cached, solve
from tactiled.cover.stack import Layer, Stack
from tactiled.errors import ConfigError
from tactiled.geometry import Array, grid
from tactiled.restore.blur import Blur
from tactiled.simulate.array import FINER, Surface

Frames = Floats32

APERTURE = 0.8  # of the pitch
TOUCH_KPA = 0.01 * PEAK_KPA  # lowest pressure on a cell that counts as contact
MAX_POISSON = 0.4999
STEP = 0.1  # pitches that a scene moves from one frame of a clip to the next


@dataclass(frozen=True, slots=True, eq=False)
class Skin:
    """An array under a cover: the surface that blurs scenes exactly, and the operators that restore."""

    name: str
    thickness: float  # pitches, of all layers over the taxels
    array: Array
    stack: Stack  # as configured
    surface: Surface
    blur: Blur
    psf: Floats | None  # odd; None where the array is no grid

    @property
    def felt(self) -> NDArray[np.bool_]:
        """Which cells taxels feel: errors are of those."""
        return np.asarray(self.blur.taxel >= 0)


@dataclass(frozen=True, slots=True, eq=False)
class Clip:
    """Successive frames of one scene and the truth under each, kPa."""

    scene: str
    sigma: float  # kPa, standard deviation of a taxel's noise
    frames: Frames
    truths: Floats  # means over the restored cells


@cache
def rubber(thickness: float, size: int, finer: int = FINER, young: float = 0.6, poisson: float = 0.48) -> Skin:
    """Rubber, `thickness` pitches of 1 mm, on a stiff board with size x size taxels; `finer` cells along each."""
    stack = Stack((Layer(thickness, young, poisson), Layer(1.0, 980.0, 0.3)))
    return make_skin(f"t/pitch {thickness:g}", grid(size, size, 1.0, APERTURE), stack, stack, finer)


@cache
def with_thickness(skin: Skin, thickness: float) -> Skin:
    """The skin under a cover of another thickness (pitches), restored with that cover."""
    stack = _scaled(skin.stack, thickness=thickness / skin.thickness)
    return make_skin(f"t/pitch {thickness:g}", skin.array, stack, stack)


@cache
def misconfigured(skin: Skin, **factors: float) -> Skin:
    """The skin under a cover that differs from the configured one by `factors` of its layers' properties."""
    return make_skin(skin.name, skin.array, _scaled(skin.stack, **factors), skin.stack)


@cache
def doubled(skin: Skin) -> Skin:
    """The skin with a grid of twice as many rows and columns."""
    rows, columns = skin.array.frame_shape
    array = grid(2 * rows, 2 * columns, skin.array.pitch, skin.array.width, skin.array.aperture)
    return make_skin(skin.name, array, skin.stack, skin.stack)


def _scaled(stack: Stack, thickness: float = 1.0, young: float = 1.0, poisson: float = 1.0) -> Stack:
    """Scale the layers over the sensing plane; Poisson's ratio stays below a half."""

    def scaled(layer: Layer) -> Layer:
        ratio = min(layer.poisson * poisson, max(MAX_POISSON, layer.poisson))
        return Layer(layer.thickness * thickness, layer.young * young, ratio)

    return stack.with_cover(scaled)


def configured(path: Path, sensor: str | None = None) -> Skin:
    """Build a sensor of a configuration, the first if none is named; ConfigError where there is none."""
    sensors = load(path).sensor
    name = sensor or next(iter(sensors))
    if name not in sensors:
        raise ConfigError(f"{path}: no sensor {name!r}: choose one of {', '.join(sensors)}")
    array, stack = make_array(sensors[name]), make_stack(sensors[name])
    skin = make_skin(name, array, stack, stack)
    if min(array.frame_shape) < 2:
        raise ConfigError(
            f"{path}: sensor {name} has a single line of taxels: measure on one with both dimensions"
        )
    return skin


def make_skin(name: str, array: Array, true: Stack, believed: Stack, finer: int = FINER) -> Skin:
    """An array under the `true` cover, with `finer` cells along a taxel, restored with the `believed` one."""
    blur = surface.make(cached(believed), array, 1 if array.shape else surface.cells_a_pitch(array, None))
    psf = None if array.shape is None else psf_of(blur)
    exact = Surface(solve(true, "layered"), array, finer)
    return Skin(name, believed.depth / array.pitch, array, believed, exact, blur, psf)


def psf_of(blur: Blur) -> Floats:
    """The frame that one cell of pressure in the middle of a grid causes: odd, and no larger than the array."""
    middle = [n // 2 for n in blur.frame_shape]
    cell = np.zeros(blur.surface_shape, np.float32)
    cell[tuple(middle)] = 1
    around = tuple(slice(max(2 * m - n + 1, 0), 2 * m + 1) for m, n in zip(middle, cell.shape, strict=True))
    return np.asarray(blur.forward(cell), float)[around]


def draw(skin: Skin, scene: str, seed: list[int] | np.random.Generator, shift: float = 0.0) -> Floats:
    """Draw a scene on the surface's fine cells (kPa), `shift` pitches along x."""
    x, y = skin.surface.x / skin.array.pitch, skin.surface.y / skin.array.pitch
    return TEST_SCENES[scene](x - shift, y, np.random.default_rng(seed))


def sense(skin: Skin, fine: Floats) -> tuple[Floats, Floats]:
    """The noiseless frame and the truth (mean of each restored cell) of pressure on fine cells, kPa."""
    return skin.surface.sense(fine).reshape(skin.array.frame_shape), cell_means(skin, fine)


def clips(skin: Skin, noise: float, count: int, seed: int, scenes: tuple[str, ...] = ()) -> Iterator[Clip]:
    """A clip of `count` frames of every scene that touches the skin; white noise is `noise` of its peak."""
    for scene in scenes or TEST_SCENES:
        sensed = [sense(skin, draw(skin, scene, [seed, 0], STEP * n)) for n in range(count)]
        clean, truths = (np.stack(each) for each in zip(*sensed, strict=True))
        if all(touches(truth) for truth in truths):
            sigma = noise * float(clean[0].max())
            white = np.random.default_rng([seed, 1, int(1e6 * noise)]).normal(0, sigma, clean.shape)
            yield Clip(scene, sigma, (clean + white).astype(np.float32), truths)


def touches(truth: Floats) -> bool:
    """Whether a scene touches a taxel: on a sparse layout it may fall between them."""
    return bool(truth.max() > TOUCH_KPA)


def into(bases: tuple[Floats, ...], image: Floats) -> Floats:
    """Coefficients of an image in the modes along its axes."""
    return np.asarray(bases[0].T @ image.ravel() if len(bases) == 1 else bases[0].T @ image @ bases[1])


def cell_means(skin: Skin, fine: Floats) -> Floats:
    """Mean of fine cells over each restored cell that taxels feel; 0 on the others."""
    if skin.array.shape is not None:
        rows, columns = skin.array.shape
        return np.asarray(fine.reshape(rows, len(fine) // rows, columns, -1).mean(axis=(1, 3)))
    rows, columns = skin.blur.surface_shape
    half = skin.blur.cell_mm / 2
    down, across = ((np.arange(n) - (n - 1) / 2) * 2 * half for n in (rows, columns))
    in_row: Any = np.abs(skin.surface.y[None, :, 0] - down[:, None]) <= half
    in_column: Any = np.abs(skin.surface.x[None, 0] - across[:, None]) <= half
    cells = np.maximum(np.outer(in_row.sum(1), in_column.sum(1)), 1)
    return np.asarray(in_row @ fine @ in_column.T / cells * skin.felt)


def nrmse(image: NDArray[Any], truth: NDArray[Any]) -> float:
    """||image - truth|| / ||truth||."""
    return float(np.linalg.norm(image - truth) / np.linalg.norm(truth))


def rms(values: NDArray[Any]) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(values, dtype=float))))
