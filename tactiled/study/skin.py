"""A skin to measure on: an array under a cover, blurred exactly, restored with what a user would have solved."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tactiled.build import make_array, make_blur, make_stack
from tactiled.config import load
from tactiled.cover.kernel import cached, solve
from tactiled.cover.stack import Stack
from tactiled.errors import ConfigError
from tactiled.geometry import Array, grid
from tactiled.restore.blur import Blur
from tactiled.simulate.array import FINER, Surface
from tactiled.study.truth import APERTURE, DRAWN, PEAK, psf_of, stack

Floats = NDArray[np.float64]
Frames = NDArray[np.float32]

FELT = 0.01 * PEAK  # kPa
MOST = 0.4999  # of a Poisson's ratio
STEP = 0.1  # pitches that a scene moves from one frame of its film to the next


@dataclass(frozen=True, slots=True, eq=False)
class Skin:
    """An array under a cover: the surface that blurs scenes exactly, and the operators that undo it."""

    name: str
    thickness: float  # pitches, of all that lies over the taxels
    array: Array
    stack: Stack  # as believed
    surface: Surface
    blur: Blur
    psf: Floats | None  # odd; None where the array is no grid


@dataclass(frozen=True, slots=True, eq=False)
class Film:
    """Successive frames of one scene and the truth under each, kPa."""

    scene: str
    sigma: float  # kPa, a taxel's standard deviation
    frames: Frames
    truths: Floats  # means over cells of the pitch


@cache
def rubber(thickness: float, size: int) -> Skin:
    """Lay rubber, `thickness` pitches, over size x size taxels."""
    under = stack(thickness)
    return _skin(f"t/pitch {thickness:g}", grid(size, size, 1.0, APERTURE), under, under)


@cache
def covered(skin: Skin, thickness: float) -> Skin:
    """The same with a cover of another thickness, in pitches, that restoration knows of."""
    under = scaled(skin.stack, thickness=thickness / skin.thickness)
    return _skin(f"t/pitch {thickness:g}", skin.array, under, under)


@cache
def mistaken(skin: Skin, **factors: float) -> Skin:
    """The same under a cover that is not as believed: see `scaled`."""
    return _skin(skin.name, skin.array, scaled(skin.stack, **factors), skin.stack)


@cache
def doubled(skin: Skin) -> Skin:
    """The same with a grid of twice as many rows and columns."""
    rows, columns = skin.array.frame_shape
    array = grid(2 * rows, 2 * columns, skin.array.pitch, skin.array.width, skin.array.aperture)
    return _skin(skin.name, array, skin.stack, skin.stack)


def scaled(under: Stack, thickness: float = 1.0, young: float = 1.0, poisson: float = 1.0) -> Stack:
    """Scale what every layer over the sensing plane is; Poisson's ratio stays below a half."""
    layers = list(under.layers)
    for n, layer in enumerate(layers[: under.sensing]):
        ratio = min(layer.poisson * poisson, max(MOST, layer.poisson))
        layers[n] = replace(layer, thickness=layer.thickness * thickness, young=layer.young * young, poisson=ratio)
    return replace(under, layers=tuple(layers))


def configured(path: Path, sensor: str | None = None) -> Skin:
    """Take a sensor of a configuration, the first if none is named; ConfigError where there is none."""
    sensors = load(path).sensor
    name = sensor or next(iter(sensors))
    if name not in sensors:
        raise ConfigError(f"{path}: no sensor {name!r}: choose one of {', '.join(sensors)}")
    chosen = sensors[name]
    array, under = make_array(chosen), make_stack(chosen)
    made = _skin(name, array, under, under)
    if min(array.frame_shape) < 2:
        raise ConfigError(
            f"{path}: sensor {name} has a single line of taxels: measure on one with both dimensions"
        )
    return made


def _skin(name: str, array: Array, true: Stack, believed: Stack) -> Skin:
    solved = cached(believed)
    surface, blur = Surface(solve(true, "layered"), array), make_blur(solved, array, 1)
    psf = None if array.shape is None else psf_of(blur)
    return Skin(name, believed.depth / array.pitch, array, believed, surface, blur, psf)


def films(skin: Skin, noise: float, count: int, seed: int, scenes: tuple[str, ...] = ()) -> Iterator[Film]:
    """Film every scene that touches the skin, `count` frames long, with white noise of `noise` of its peak."""
    for scene in scenes or DRAWN:
        fine = [drawn(skin, scene, seed, STEP * n) for n in range(count)]
        truths = np.stack([means(skin, each) for each in fine])
        if not pressed(truths):
            continue
        clean = np.stack([skin.surface.sense(each).reshape(skin.array.frame_shape) for each in fine])
        sigma = noise * float(clean[0].max())
        random = np.random.default_rng([seed, 1, int(1e6 * noise)])
        frames = (clean + random.normal(0, sigma, clean.shape)).astype(np.float32)
        yield Film(scene, sigma, frames, truths)


def pressed(truths: Floats) -> bool:
    """Whether a scene touches the taxels in every frame: on a sparse layout it may fall between them."""
    return bool((truths.reshape(len(truths), -1).max(axis=1) > FELT).all())


def drawn(skin: Skin, scene: str, seed: int, along: float = 0.0, down: float = 0.0) -> Floats:
    """Draw a scene on the fine cells, moved by `along` and `down` pitches."""
    x, y = skin.surface.x / skin.array.pitch, skin.surface.y / skin.array.pitch
    return DRAWN[scene](x - along, y - down, np.random.default_rng([seed, 0]))


def means(skin: Skin, fine: Floats) -> Floats:
    """Mean of fine cells over each restored cell: a square of the pitch around every taxel."""
    if skin.array.shape is not None:
        rows, columns = skin.array.shape
        return np.asarray(fine.reshape(rows, FINER, columns, FINER).mean(axis=(1, 3)))
    low, high = skin.array.positions.min(axis=0), skin.array.positions.max(axis=0)
    places = skin.array.positions - (low + high) / 2
    x, y = skin.surface.x[0], skin.surface.y[:, 0]
    half = skin.array.pitch / 2
    rows_of = (np.abs(y[None] - places[:, 1:]) <= half).astype(float)
    columns_of = (np.abs(x[None] - places[:, :1]) <= half).astype(float)
    inside = np.maximum(rows_of.sum(1) * columns_of.sum(1), 1)
    return np.asarray(np.einsum("ni,ij,nj->n", rows_of, fine, columns_of, optimize=True) / inside)
