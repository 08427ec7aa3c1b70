import numpy as np
import pytest

from tactiled.cover.kernel import solve
from tactiled.cover.operator import matrix, stencil, surface_matrix
from tactiled.geometry import Raster, grid, layout


@pytest.mark.parametrize("ratio", [0.05, 0.5, 1.0, 3.0])
@pytest.mark.parametrize("refine", [1, 3])
def test_a_wide_grid_sums_to_one(paper, ratio, refine):
    pitch = 0.2 / ratio
    cells = stencil(solve(paper(), "layered"), grid(81, 81, pitch, pitch * 0.7, "round"), refine)
    assert cells.sum() == pytest.approx(1, abs=2e-4)


@pytest.mark.parametrize(("rows", "columns", "refine"), [(4, 5, 1), (1, 6, 2), (3, 1, 4), (1, 1, 3)])
def test_matrix_and_stencil_agree(paper, rows, columns, refine):
    kernel = solve(paper(), "layered")
    array = grid(rows, columns, 0.3, 0.2)
    side = 0.3 / refine
    y, x = np.mgrid[: rows * refine, : columns * refine] * side - (refine - 1) / 2 * side
    dense = matrix(kernel, array, np.column_stack([x.ravel(), y.ravel()]), side)
    cells = stencil(kernel, array, refine)
    assert cells.shape == (refine * (2 * rows - 1), refine * (2 * columns - 1))
    for taxel, row in enumerate(dense):
        i, j = divmod(taxel, columns)
        top, first = refine * (rows - 1 - i), refine * (columns - 1 - j)
        window = cells[top : top + rows * refine, first : first + columns * refine]
        np.testing.assert_allclose(row.reshape(window.shape), window, atol=1e-12)


def test_layout_is_symmetric(paper):
    points = np.random.default_rng(1).uniform(0, 2, (9, 2))
    dense = matrix(solve(paper(), "layered"), layout(points), points, 0.1)
    np.testing.assert_allclose(dense, dense.T, atol=1e-15)


@pytest.mark.parametrize("aperture", [0.1, 0.25])
def test_taxels_between_cells_feel_pressure_that_rises_evenly_as_squares_show_it(paper, aperture):
    kernel = solve(paper(), "layered")
    moves = np.random.default_rng(2).uniform(-0.1, 0.1, (9, 2))
    array = layout(3 + 0.6 * np.indices((3, 3)).reshape(2, -1).T + moves, aperture)
    surface = Raster(np.full(2, 0.15), 0.3, np.full((24, 24), -1))
    x, y = surface.positions.T
    felt_of_cells = surface_matrix(kernel, array, surface) @ (5 + 0.7 * x - 0.3 * y)
    fine = Raster(np.full(2, 0.025), 0.05, np.full((144, 144), -1)).positions
    exact = matrix(kernel, array, fine, 0.05) @ (5 + fine @ [0.7, -0.3])
    np.testing.assert_allclose(felt_of_cells, exact, rtol=1e-4)
