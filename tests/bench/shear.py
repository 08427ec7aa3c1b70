"""Presses with friction on 3-axis skins: tangential load and pressure, as read and as restored."""

from functools import cache, lru_cache
from typing import Annotated, NamedTuple

import numpy as np
import typer
from numpy.typing import NDArray

from tactiled import surface
from tactiled.bench.skin import nrmse
from tactiled.cli.bench import print_table
from tactiled.cover.kernel import cached, solve
from tactiled.cover.operator import matrix
from tactiled.cover.stack import Layer, Stack
from tactiled.cover.tangential import responses
from tactiled.geometry import Array, grid, raster
from tactiled.restore.blur import Blur
from tactiled.restore.methods import make
from tactiled.restore.traction import Traction
from tests.bench.border import APERTURE, PRESSED, contact, means

Floats = NDArray[np.float64]
SKINS = {(4, 4): 2, (4, 6): 2, (16, 16): 1}  # rows and columns, and cells a pitch
THICKNESSES = (0.5, 1.0, 2.0)  # pitches
RUBBERS = ((0.3, 0.45), (0.6, 0.49))  # MPa, Poisson's ratio, on a board
FINER, OUTSIDE, OFF = 6, 4, 0.03  # cells a pitch; pitches beyond the array; pitches that they are off the grid
WRONG_THICKNESS, WRONG_POISSON = 1.03, -0.02  # of the cover that restores
NOISE = 0.01  # of the largest pressure read
MIN_READ, MIN_PRESSURE, MIN_TRACTION = 4.0, 25.0, 4.0  # kPa, of a press worth a frame
SLIPS = (0.0, 0.0, 0.5, 0.8)  # radius that sticks, over the contact's
HEADINGS = (
    "array", "t/pitch", "tangential: raw", "restored once", "twice", "over raw", "within 2 deviations",
    "pressure: raw", "restored", "less what shear adds", "readings without friction",
)  # fmt: skip


def stack(thickness: float, rubber: int, wrong: bool = False) -> Stack:
    """A cover on a board, or what is believed of it; pitches are mm."""
    young, poisson = RUBBERS[rubber]
    poisson, factor = (poisson + WRONG_POISSON, WRONG_THICKNESS) if wrong else (poisson, 1.0)
    return Stack((Layer(factor * thickness, young, poisson), Layer(1.0, 20_000.0, 0.3)))


class Truth(NamedTuple):
    """Fine cells over an array and around it, and what its taxels feel of them: pressure, then shear."""

    array: Array
    x: Floats
    y: Floats
    felt: Floats  # (3 N, 3 M)


@lru_cache(2)
def truth(rows: int, columns: int, thickness: float, rubber: int) -> Truth:
    """The exact response."""
    array, side = grid(rows, columns, 1.0, APERTURE), 1 / FINER
    x, y = np.meshgrid(*(np.arange(-OUTSIDE, n + OUTSIDE, side) - 0.5 + side / 2 + OFF for n in (columns, rows)))
    cells, exact = np.column_stack([x.ravel(), y.ravel()]), stack(thickness, rubber)
    normal = matrix(solve(exact, "layered"), array, cells, side)
    shear = responses(exact, array, cells, side)
    return Truth(array, x, y, np.block([[normal, shear.tilt], [shear.apart, shear.tangential]]).astype(np.float32))


@cache
def model(rows: int, columns: int, thickness: float, rubber: int) -> tuple[Blur, Traction]:
    """What restores: pressure by finite elements, shear by flat layers, both of a cover that is a little wrong."""
    array, believed = grid(rows, columns, 1.0, APERTURE), stack(thickness, rubber, wrong=True)
    blur = surface.make(cached(believed, "fem"), array, SKINS[rows, columns])
    return blur, Traction(surface.coupled(believed, blur, array))


def loads(skin: Truth, random: np.random.Generator) -> Floats:
    """Pressure and traction (3, M) of one or two contacts that slide, or stick in their middle, or turn.

    A middle that sticks takes what a contact with as much less pressure would, and the rest slips (Ciavarella, for
    spheres Cattaneo and Mindlin).
    """
    middle, half = skin.array.positions.mean(axis=0), np.ptp(skin.array.positions, axis=0) / 2 + 0.5
    total = np.zeros((3, *skin.x.shape))
    for _ in range(random.integers(1, 3)):
        x, y = (line - at for line, at in zip((skin.x, skin.y), middle + random.uniform(-half, half), strict=True))
        pressure = 100 * random.uniform(0.4, 1) * contact(x, y, random) * (total[0] == 0)
        friction, angle, stuck = random.uniform(0.2, 0.9), random.uniform(0, 2 * np.pi), random.choice(SLIPS)
        turn = random.uniform(-1, 1) if random.random() < 0.3 else 0.0
        way = np.stack([np.cos(angle) - turn * y, np.sin(angle) + turn * x])
        way /= np.maximum(np.hypot(*way), 1e-9)
        if stuck:
            inner = np.sqrt(np.maximum(pressure**2 - pressure.max() ** 2 * (1 - stuck**2), 0))
            way *= 1 - np.divide(inner, pressure, out=np.zeros_like(inner), where=pressure > 0)
        total += np.concatenate([pressure[None], friction * way * pressure])
    return total.reshape(3, -1)


def press(
    skin: Truth, refine: int, random: np.random.Generator, friction: float
) -> tuple[Floats, Floats, Floats, float]:
    """Readings (3, N) with friction and without it, the truth (3, R, C) on the cells, and the noise, in kPa."""
    cells, size = raster(skin.array, refine), skin.array.size
    while True:
        load = loads(skin, random)
        load[1:] *= friction
        read = (skin.felt @ load.ravel()).reshape(3, size)
        true = means(cells, skin.x, skin.y, load.reshape(3, *skin.x.shape))
        dragged = np.abs(true[1:]).max() >= friction * MIN_TRACTION
        if read[0].max() > MIN_READ and true[0].max() > MIN_PRESSURE and dragged:
            noise = NOISE * read[0].max()
            pressed = skin.felt[:size, : load.shape[1]] @ load[0]
            return *(each + random.normal(0, noise, each.shape) for each in (read, pressed)), true, noise


def measure(
    rows: int, columns: int, thickness: float, presses: int, seed: int, scale: float = 1.0, friction: float = 1.0
) -> Floats:
    """Figures (presses, 8) in the order of the headings; shear is taken to be `scale` times what it is."""
    random, figures, refine = np.random.default_rng(seed), [], SKINS[rows, columns]
    for n in range(presses):
        skin, (blur, traction) = (make(rows, columns, thickness, n % 2) for make in (truth, model))
        readings, frictionless, (pressure, *shear), noise = press(skin, refine, random, friction)
        restorer, shape = make("auto", blur, noise), (rows, columns)
        taxel = raster(skin.array, refine).taxel
        readings[1:] *= scale
        raw, *read = readings[:, taxel]

        def restored(values, restorer=restorer, shape=shape):
            return restorer(values.reshape(shape).astype(np.float32)).image.copy()

        first = restored(readings[0])
        once = traction(restorer.surface, readings, np.full(3, noise))
        second = restored(readings[0] - once.pressure)
        twice = traction(restorer.surface, readings, np.full(3, noise))
        dragged = pressure > PRESSED * pressure.max()
        known = np.mean((np.abs(twice.traction - shear) <= 2 * twice.deviation)[:, dragged])
        images = (read, once.traction, twice.traction)
        errors = [nrmse(np.asarray(each), np.asarray(shear)) for each in images]
        figures.append([
            *errors, known, *(nrmse(each, pressure) for each in (raw, first, second, restored(frictionless))),
        ])  # fmt: skip
    return np.array(figures)


def shear(
    presses: Annotated[int, typer.Option(help="Of each array and thickness.")] = 24,
    seed: Annotated[int, typer.Option(help="Random seed.")] = 1,
    scale: Annotated[float, typer.Option(help="What shear is taken to be, over what it is.")] = 1.0,
    friction: Annotated[float, typer.Option(help="Friction, over what is drawn.")] = 1.0,
) -> None:
    """Measure what is restored of tangential load, and what that does for pressure."""
    rows = []
    for shape in SKINS:
        for thickness in THICKNESSES:
            mean = measure(*shape, thickness, presses, seed, scale, friction).mean(axis=0)
            errors, known, pressures = mean[:3], mean[3], mean[4:]
            rows.append((
                f"{shape[0]} x {shape[1]}", f"{thickness:g}", *(f"{each:.3f}" for each in errors),
                f"{errors[2] / errors[0]:.2f}", f"{known:.0%}", *(f"{each:.3f}" for each in pressures),
            ))  # fmt: skip
    print_table("Presses with friction: mean NRMSE within the array", HEADINGS, rows)
