"""Rows and columns from what presses: right or none, for the simulator's scenes under its covers."""

import numpy as np
import pytest

from tactiled.bus.grid_shape import alike_shapes
from tactiled.geometry import grid
from tactiled.simulate.array import Surface
from tactiled.simulate.scenes import SCENES
from tests.plans import plan

TELLING = {"ring", "sphere", "straightedge"}
SILENT = {"empty", "steps", "uniform"}


@pytest.mark.parametrize(("rows", "columns", "thickness_mm"), [(16, 10, 1.0), (10, 16, 3.0), (9, 14, 2.0)])
def test_rows_and_columns_are_those_of_the_array_or_none(rows, columns, thickness_mm):
    kernel = plan((rows, columns), thickness_mm / 2.0, pitch=2.0).kernel
    surface = Surface(kernel, grid(rows, columns, 2.0, None, "square"))
    rng = np.random.default_rng(rows)
    solved = set()
    for name, scene in SCENES.items():
        pressure = [
            surface.sense(scene(surface.x, surface.y, 7 + n / 10, surface.size, surface.grain)) for n in range(30)
        ]
        level = 100 + rng.normal(0, 6, rows * columns)
        counts = np.round(level + 8 * np.array(pressure) + rng.normal(0, 1, (30, rows * columns)))
        if shapes := alike_shapes(counts, [rows * columns]):
            assert (name, shapes[0]) == (name, (rows, columns))
            solved.add(name)
    assert solved >= TELLING
    assert not SILENT & solved
