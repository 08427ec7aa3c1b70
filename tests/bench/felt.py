"""What is wrong with cells and with forces of regions where a share of what the taxels feel is lost."""

from typing import Annotated

import numpy as np
import typer

from tactiled.cli.bench import print_table
from tactiled.contacts.felt import is_known, shares
from tactiled.frames import MISSING
from tactiled.restore.methods import make
from tests.bench.judge import THICKNESSES
from tests.bench.presses import FAMILIES, presses

BINS = np.arange(0, 1, 0.1)  # of the share that is left, from
HEADINGS = (
    "share left from",
    "cells: error over pressure, rms",
    "force of regions: median error",
    "nine of ten below",
)


def lose(shape, random):
    """Taxels that a frame lacks: rows, a block, or single ones."""
    lost, (rows, columns) = np.zeros(shape, bool), shape
    top, left = random.integers(rows), random.integers(columns)
    match random.integers(3):
        case 0:
            lost[top : top + random.integers(1, rows)] = True
        case 1:
            lost[top : top + random.integers(1, rows), left : left + random.integers(1, columns)] = True
        case 2:
            lost[...] = random.random(shape) < random.uniform(0.05, 0.9)
    return lost


def felt(
    size: Annotated[int, typer.Option(help="Taxels along each side.")] = 16,
    repeats: Annotated[int, typer.Option(help="Presses of each scene and t/pitch.")] = 4,
    seed: Annotated[int, typer.Option(help="Random seed.")] = 1,
) -> None:
    """Measure errors of restored cells, and of the force of regions, by the share that lost messages leave."""
    random, cells, forces = np.random.default_rng(seed), [], []
    for press in presses(size, THICKNESSES, (0.01,), repeats, seed, FAMILIES["second"]):
        flags = np.where(lose(press.frame.shape, random), np.uint8(MISSING), np.uint8(0))
        share = shares(flags, press.blur)
        if share is None or not share.any():
            continue
        frame = np.where(flags > 0, np.float32(np.nan), press.frame)
        image = make("auto", press.blur, press.sigma)(frame, flags).image
        cells += zip(share.ravel(), (image - press.truth).ravel(), press.truth.ravel(), strict=True)
        for _ in range(8):
            corner, sides = random.integers(0, size - 3, 2), random.integers(3, 8, 2)
            region = tuple(slice(a, a + n) for a, n in zip(corner, sides, strict=True))
            true = press.truth[region].sum()
            if true > 0.02 * press.truth.sum() and is_known(share[region]).all():
                forces.append((share[region].mean(), abs(image[region].sum() / true - 1)))
    cells, forces = np.array(cells), np.array(forces)
    rows = []
    for low in BINS:
        some, sums = (each[(each[:, 0] >= low) & (each[:, 0] < low + 0.0999)] for each in (cells, forces))
        error, pressure = np.sqrt(np.mean(some[:, 1:] ** 2, axis=0))
        wrong = [f"{np.quantile(sums[:, 1], q):.2f}" if len(sums) else "unknown" for q in (0.5, 0.9)]
        rows.append((f"{low:.1f}", f"{error / pressure:.2f}", *wrong))
    print_table("Shares that lost messages leave", HEADINGS, rows)
