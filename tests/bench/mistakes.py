"""What becomes of a cover's thickness from touch where what a person believes of skin or tool is wrong.

Held-out skins as `tactiled bench calibration` draws them, counts of 12 bits, gains calibrated by steps. Rigid
tools press as frictionless contact with the true stack has it (`tests.rigid`).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
import typer
from scipy.special import j0, j1

from tactiled.bench import calibration as bench
from tactiled.bench.presses import EDGE_WAVES, PERIOD_MM, middle, press_series, simulated_skin
from tactiled.calibrate.cover.edge import edge_touch
from tactiled.calibrate.cover.presses import find_presses
from tactiled.calibrate.cover.result import fit_cover
from tactiled.calibrate.cover.tip import Tip, tip_touch
from tactiled.calibrate.cover.unknowns import CALIPER_ERROR_MM
from tactiled.cli.bench import print_table
from tactiled.cover.operator import aperture_mean
from tactiled.cover.stack import Layer, Stack
from tactiled.geometry import grid
from tests import rigid
from tests.bench.blind import HEADINGS, judged, line

COARSER, LOWER = 5.0, 0.2  # counts and zeros than those of 16 bits
TRUE_APERTURE, RIDGES_MM = 0.8, (0.6, 2.0)
MAX_WAVE = 12.0  # cycles/mm: no cover here passes more


@dataclass(frozen=True)
class Row:
    """One mistake; what is not named is as it is believed to be."""

    way: str = "tip"  # tip, edge or ridge
    pressed: Callable | None = None  # (stack, size, random) -> transform of what presses
    aperture: float = TRUE_APERTURE
    believed_aperture: float = TRUE_APERTURE
    poisson: float | None = None
    believed_poisson: float | None = None
    size_error_mm: float = CALIPER_ERROR_MM
    size_factor: float = 1.0  # believed over true, or its inverse
    is_measured: bool = True  # the tip's diameter
    bend: float = 0.0  # of all taxels' curves at bench.PEAK_KPA


def even(_, size, __):
    return lambda q: 2 * j1(np.pi * q * size) / np.maximum(np.pi * q * size, 1e-9)


def cone(_, size, __):
    r = (np.arange(400) + 0.5) / 400
    weight = np.arccosh(1 / r) * r
    x = np.linspace(0, np.pi * 1.5 * MAX_WAVE * size, 4000)
    table = (weight * j0(np.outer(x, r))).sum(axis=1) / weight.sum()
    return lambda q: np.interp(np.pi * q * size, x, table)


def soft(_, __, random):
    blur = random.uniform(0.1, 0.35)
    return lambda q: np.exp(-((2 * np.pi * q * blur) ** 2) / 2)


def fading(_, __, random):
    length = random.uniform(0.1, 0.6)
    return lambda q: 1 / (1 + 2j * np.pi * q * length)


def hard(stack, _, random):
    rise, width = random.uniform(0.5, 1.5), stack.depth / 3  # pressure 1 + rise exp(-x / width) behind the edge

    def transform(q):
        wave = 2j * np.pi * q * width
        return 1 + rise * wave / (1 + wave)

    return transform


ROWS = {
    "tip": Row(),
    "tip, aperture 0.6 for 0.8 pitch": Row(aperture=0.6),
    "tip, aperture 0.8 for 1 pitch": Row(believed_aperture=1.0),
    "tip, diameter 10 % wrong": Row(size_factor=1.1),
    "tip, rigid": Row(pressed=lambda stack, size, _: rigid.tip_transform(stack, size / 2)),
    "tip, rigid, of unknown diameter": Row(
        pressed=lambda stack, size, _: rigid.tip_transform(stack, size / 2), is_measured=False
    ),
    "tip, worn to a cone": Row(pressed=cone),
    "tip, Poisson's ratio 0.4 for 0.48": Row(poisson=0.4, believed_poisson=0.48),
    "tip, curves bend by 5 %": Row(bend=0.05),
    "edge": Row("edge"),
    "edge, aperture 0.6 for 0.8 pitch": Row("edge", aperture=0.6),
    "edge, soft": Row("edge", soft),
    "edge, fading": Row("edge", fading),
    "edge, hard plate": Row("edge", hard),
    "edge, curves bend by 5 %": Row("edge", bend=0.05),
    "ridge": Row("ridge"),
    "ridge, width to 0.05 mm": Row("ridge", size_error_mm=0.05),
    "ridge, rigid": Row("ridge", lambda stack, size, _: rigid.ridge_transform(stack, size)),
    "ridge, aperture 0.6 for 0.8 pitch": Row("ridge", aperture=0.6),
}


@dataclass(frozen=True)
class Pressed:
    """A tip at a place from the array's middle, or a line at an offset along a normal."""

    way: str
    place: tuple[float, float]
    transform: Callable

    def readings(self, array, cover):
        if self.way == "tip":
            return self._round(array, cover)
        offset, angle = self.place
        normal = np.array([np.cos(angle), np.sin(angle)])
        depth = (array.positions - middle(array)) @ normal - offset
        length = PERIOD_MM * EDGE_WAVES
        k = (np.arange(round(min(cover.q[-1], MAX_WAVE) * length)) + 0.5) / length
        passed = cover.gain_at(k) * aperture_mean(array, *(k * normal[:, None])) * self.transform(k)
        waves = np.exp(2j * np.pi * np.outer(depth, k))
        if self.way == "ridge":
            return 2 * (waves @ passed).real / length
        return 0.5 + (waves @ (passed / k)).imag / (np.pi * length)

    def _round(self, array, cover):
        x, y = (array.positions - middle(array) - self.place).T
        end = min(cover.q[-1], MAX_WAVE)
        waves = np.arange(-end, end, 1 / PERIOD_MM)
        u, v = waves, waves[:, None]
        q = np.hypot(u, v)
        spectrum = cover.gain_at(q) * self.transform(q) * aperture_mean(array, u, v)
        across, down = (np.exp(2j * np.pi * np.outer(each, waves)) for each in (x, y))
        return np.einsum("nv,vu,nu->n", down, spectrum, across, optimize=True).real


def places(way, random):
    """Where it presses, away from the border; or offset and angle of each line."""
    if way == "tip":
        half = (bench.SIDE - 1) / 2 - 2.5
        return random.uniform(-half, half, (bench.PRESSES, 2))
    slants = np.radians(random.uniform(5, 40, bench.EDGES)) * random.choice([-1, 1], bench.EDGES)
    return np.column_stack(
        [random.uniform(-2, 2, bench.EDGES), slants + np.pi / 2 * random.integers(0, 4, bench.EDGES)]
    )


def draw(row, random):
    """The skin, true and believed cover, the believed array."""
    thickness, young = bench._even_log(random, bench.THICKNESS), bench._even_log(random, bench.YOUNG_MPA)
    poisson = row.poisson or float(random.uniform(0.45, 0.499))
    true = Stack((Layer(thickness, young, poisson), bench.SUBSTRATE), 1)
    believed = Layer(thickness * bench._even_log(random, bench.MISTAKE), young, row.believed_poisson or poisson)
    array = grid(bench.SIDE, bench.SIDE, 1.0, row.aperture)
    skin = simulated_skin(true, array, random, bench.NOISE_KPA, bench.SPREAD, 2)
    skin = replace(skin, kpa_per_count=COARSER * skin.kpa_per_count, no_load=LOWER * skin.no_load)
    return bench.Truth(skin, true, Stack((believed, bench.SUBSTRATE), 1)), grid(
        bench.SIDE, bench.SIDE, 1.0, row.believed_aperture
    )


def bent(series, skin, bend):
    """The same counts from taxels whose curves bend."""
    over = series.counts - skin.no_load
    return replace(
        series, counts=np.round(skin.no_load + over * (1 - bend * over * skin.kpa_per_count / bench.PEAK_KPA))
    )


def trial(row, seed, number):
    """One skin, pressed, fitted and judged."""
    random = np.random.default_rng([seed, number])
    truth, array = draw(row, random)
    skin, gains = truth.skin, bench.calibrated(truth, random)
    size = float(random.uniform(*RIDGES_MM) if row.way == "ridge" else 2 * random.uniform(*bench.TIP_RADII_MM))
    usual = even if row.way == "tip" else lambda _, size, __: lambda q: np.sinc(q * size)
    usual = usual if row.way != "edge" else lambda *_: np.ones_like
    transform = (row.pressed or usual)(truth.true, size, random)
    shapes = [Pressed(row.way, tuple(each), transform) for each in places(row.way, random)]
    series = press_series(skin, shapes, bench.PEAK_KPA * random.uniform(0.6, 1, len(shapes)), random)
    series = bent(series, skin, row.bend) if row.bend else series
    presses = find_presses(gains.in_kpa(series), array, bench.NOISE_KPA, border=row.way in ("edge", "ridge"))
    gain_error, factor = gains.for_touch[2], row.size_factor ** random.choice([-1, 1])
    measured = float(random.normal(size * factor, row.size_error_mm))
    if row.way == "tip":
        tip = Tip(measured) if row.is_measured else Tip()
        touch = tip_touch(presses, array, truth.configured, tip, gain_error)
        return judged(fit_cover(touch, presses, "tip"), truth.factor)
    width = measured if row.way == "ridge" else None
    touch = edge_touch(presses, array, truth.configured, gain_error, width)
    return judged(fit_cover(touch, presses, "edge"), truth.factor)


def mistakes(
    trials: Annotated[int, typer.Option(help="Skins a row.", min=1)] = 8,
    only: Annotated[str, typer.Option(help="Rows whose names begin so.")] = "",
    seed: Annotated[int, typer.Option(help="Random seed.", min=0)] = 1,
) -> None:
    """Fit covers by touch where what is believed of skin or tool is wrong."""
    rows = [
        line(name, [trial(row, seed, number) for number in range(trials)])
        for name, row in ROWS.items()
        if name.startswith(only)
    ]
    print_table(f"Thickness from touch, {trials} skins a row, seed {seed}", HEADINGS, rows)
