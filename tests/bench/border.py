"""Presses that go on beyond the array, under covers that do: what is restored of them within it."""

from collections import Counter
from collections.abc import Iterable
from functools import cache
from itertools import product
from typing import Annotated, Literal, NamedTuple

import numpy as np
import typer
from numpy.typing import NDArray
from skimage.segmentation import expand_labels

from tactiled import surface
from tactiled.bench.skin import nrmse
from tactiled.cli.bench import print_table
from tactiled.contacts.detection import Finder
from tactiled.cover.kernel import cached, solve
from tactiled.cover.stack import Layer, Stack
from tactiled.geometry import Array, Raster, grid, layout, raster
from tactiled.restore.methods import make
from tactiled.simulate.array import Surface
from tactiled.units import FORCE_SCALES, PRESSURE
from tests.bench.held_out_scenes import FINER, hertz, inside
from tests.bench.judge import PRESSED, WORSE

Floats = NDArray[np.float64]
APERTURE, OUTSIDE = 0.7, 5  # pitches: of a taxel; that pressure may lie beyond the outermost
THICKNESSES = (0.55, 1.1, 2.15, 2.8)  # pitches; the network saw none of these
NOISES = (0.002, 0.01, 0.05)  # of the frame's peak
FAINTEST, MIN_INSIDE = 0.03, 0.2  # of a press' peak: what a frame and the pressure on the array must reach
WHERE = ("anywhere", "border", "cut off")
MATERIALS = ((0.6, 0.48), (98.0, 0.3))  # rubber, and the film of the paper
HEADINGS = (
    "array", "presses", "raw", "restored", "> 2 % over raw", f"t/pitch {' / '.join(map(str, THICKNESSES))}",
    "within 2 deviations", "forces", "methods",
)  # fmt: skip


def hexagonal(rows: int, columns: int) -> Floats:
    """Places of taxels a pitch from six others."""
    return np.array([[x + 0.5 * (y % 2), y * 3**0.5 / 2] for y in range(rows) for x in range(columns)])


def _jittered(rows: int, columns: int) -> Floats:
    y, x = np.mgrid[:rows, :columns]
    moves = np.random.default_rng(3).uniform(-0.12, 0.12, (rows * columns, 2))
    return np.column_stack([x.ravel(), y.ravel()]) + moves


TRIANGLE = np.array([[x + 0.5 * y, y * 3**0.5 / 2] for y in range(4) for x in range(4 - y)])
GRIDS = {f"{rows} x {columns}": (rows, columns) for rows, columns in ((4, 6), (6, 6), (12, 6), (16, 16))}
LAYOUTS = {"hexagonal 6 x 6": hexagonal(6, 6), "jittered 6 x 6": _jittered(6, 6), "triangle of 10": TRIANGLE}


@cache
def taxels(name: str) -> Array:
    """Taxels a pitch of 1 mm apart."""
    if name in GRIDS:
        return grid(*GRIDS[name], 1.0, APERTURE)
    return layout(LAYOUTS[name], APERTURE, "square")


@cache
def skin(name: str, thickness: float, material: int) -> tuple[Surface, Stack]:
    """The surface over an array and OUTSIDE beyond it, blurred exactly; far taxels follow the array's own."""
    stack = Stack((Layer(thickness, *MATERIALS[material]), Layer(1.0, 980.0, 0.3)))
    places = taxels(name).positions
    low, high = places.min(axis=0) - OUTSIDE, places.max(axis=0) + OUTSIDE
    far = [[low[0], low[1]], [high[0], low[1]], [low[0], high[1]], [high[0], high[1]]]
    return Surface(solve(stack, "layered"), layout(np.vstack([places, far]), APERTURE, "square"), FINER), stack


def contact(x: Floats, y: Floats, random: np.random.Generator) -> Floats:
    """One of seven kinds about (0, 0), in pitches; 1 at its peak."""
    angle, kind = random.uniform(0, np.pi), random.integers(7)
    u, v = x * np.cos(angle) + y * np.sin(angle), y * np.cos(angle) - x * np.sin(angle)
    r, radius = np.hypot(u, v), random.uniform(0.8, 3.5)
    dome = hertz(r, radius)
    match kind:
        case 0:
            return dome
        case 1:
            return np.exp(-(u**2 + random.uniform(0.4, 1) * v**2) / (2 * random.uniform(0.8, 2.5) ** 2))
        case 2:
            return dome * (0.5 + 0.5 * np.tanh(2 * np.cos(2 * np.pi * u / random.uniform(1.8, 4))))
        case 3:
            distance = radius - r
        case 4:
            distance = random.uniform(0.3, 0.7) - np.abs(r - max(radius, 1.2))
        case 5:
            distance = np.minimum(random.uniform(0.3, 1.2) - np.abs(u), random.uniform(2, 8) - np.abs(v))
        case _:
            distance = np.minimum(*(random.uniform(0.8, 3) - np.abs(each) for each in (u, v)))
    return inside(distance)


class Case(NamedTuple):
    """A frame, its noise, and the truth (means over the restored cells), in kPa."""

    frame: NDArray[np.float32]
    sigma: float
    truth: Floats


def case(name: str, surface: Surface, where: str, refine: int, random: np.random.Generator) -> Case:
    """Draw a press at random on an array; its middle anywhere over it, or within a pitch of its border."""
    array = taxels(name)
    middle, half = (array.positions.min(0) + array.positions.max(0)) / 2, np.ptp(array.positions, axis=0) / 2 + 0.5
    on = (np.abs(surface.x) < half[0]) & (np.abs(surface.y) < half[1])
    noise = random.choice(NOISES)
    while True:
        place = random.uniform(-half, half)
        if where == "border":
            axis = random.integers(2)
            place[axis] = random.choice((-1, 1)) * (half[axis] + random.uniform(-1, 1))
        fine = 100 * contact(surface.x - place[0], surface.y - place[1], random)
        fine = fine * on if where == "cut off" else fine
        clean = np.ravel(surface.sense(fine))[: array.size].reshape(array.frame_shape)
        cells = raster(array, refine)
        (truth,), felt = means(cells, surface.x + middle[0], surface.y + middle[1], [fine]), cells.felt
        if clean.max() > 100 * FAINTEST and truth[felt].max() > 100 * MIN_INSIDE:
            sigma = noise * clean.max()
            return Case((clean + random.normal(0, sigma, clean.shape)).astype(np.float32), sigma, truth)


def means(cells: Raster, x: Floats, y: Floats, fields: Iterable[Floats]) -> Floats:
    """Means (n, R, C), over cells, of fields on fine cells at x, y (mm)."""
    rows, columns = cells.shape
    column, row = (np.rint((each - at) / cells.side) for each, at in zip((x, y), cells.corner, strict=True))
    there = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
    cell = (row * columns + column)[there].astype(int)
    sums = np.stack([np.bincount(cell, each[there], rows * columns) for each in fields])
    return (sums / np.bincount(cell, minlength=rows * columns)).reshape(-1, rows, columns)


def border(
    presses: Annotated[int, typer.Option(help="Of each array and place.")] = 48,
    seed: Annotated[int, typer.Option(help="Random seed.")] = 1,
    refine: Annotated[int, typer.Option(help="Cells along the distance between taxels.")] = 1,
    where: Annotated[Literal["anywhere", "border", "cut off"] | None, typer.Option(help="Left out: each.")] = None,
    method: Annotated[str, typer.Option(help="Method.")] = "auto",
) -> None:
    """Measure what is restored of presses that go on beyond the array."""
    rows = []
    for place, name in product([where] if where else WHERE, [*GRIDS, *LAYOUTS]):
        random, errors, within = np.random.default_rng([seed, WHERE.index(place)]), [], []
        methods, forces = Counter(), []
        for n in range(presses):
            thickness, material = THICKNESSES[n % 4], n // 4 % 2
            surface, _ = skin(name, thickness, material)
            press = case(name, surface, place, refine, random)
            restorer, taxel = _restorer(name, thickness, material, refine, method)
            done, felt = restorer(press.frame / np.float32(press.sigma)), taxel >= 0
            each = (
                done.image * press.sigma,
                restorer.deviation() * press.sigma,
                press.truth,
                press.frame.ravel()[taxel],
            )
            image, spread, truth, raw = (values[felt] for values in each)
            errors.append((nrmse(raw, truth), nrmse(image, truth), thickness))
            pressed = truth > PRESSED * truth.max()
            within.append(np.mean((np.abs(image - truth) <= 2 * spread)[pressed]))
            methods[done.method] += 1
            forces += _force_known(taxels(name), refine, done.noise_gain, each[:3], press.sigma)
        table = np.array(errors)
        by_thickness = (f"{table[table[:, 2] == each, 1].mean():.3f}" for each in THICKNESSES)
        rows.append((
            name, place, *(f"{each:.3f}" for each in table[:, :2].mean(axis=0)),
            f"{np.count_nonzero(table[:, 1] > WORSE * table[:, 0])} of {presses}", " / ".join(by_thickness),
            f"{np.mean(within):.0%}", f"{sum(forces)} of {len(forces)}",
            ", ".join(f"{name} {count}" for name, count in methods.most_common()),
        ))  # fmt: skip
    print_table("Presses that go on beyond the array: mean NRMSE within it", HEADINGS, rows)


def _force_known(array, refine, noise_gain, images, sigma):
    """Whether the force of a press, where it is one contact, is within two deviations of its cells' true force."""
    image, spread, truth = images
    cells = raster(array, refine)
    find = Finder(array, cells)
    found = find(image.astype(np.float32), sigma * max(noise_gain, 1.0), deviation=lambda: spread)
    if len(found) != 1:
        return []
    skirt = np.where(cells.felt, expand_labels(find.parts, 1), 0) > 0
    force = truth[skirt].sum() * cells.side**2 * FORCE_SCALES[PRESSURE]
    return [abs(found[0].force - force) <= 2 * found[0].force_deviation]


@cache
def _restorer(name, thickness, material, refine, method):
    """For frames over their noise; with the taxel of each cell."""
    blur = surface.make(cached(skin(name, thickness, material)[1]), taxels(name), refine)
    return make(method, blur, 1.0), blur.taxel
