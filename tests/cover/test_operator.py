import numpy as np
import pytest

from tactiled.cover.kernel import solve
from tactiled.cover.operator import matrix, stencil, tiled
from tactiled.geometry import grid, layout, tiling


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


def test_cells_of_any_layout_cover_it_as_squares_cover_a_grid(paper):
    kernel = solve(paper(), "layered")
    square = grid(5, 4, 0.3, 0.2)
    of_squares = tiled(kernel, square, tiling(square))
    np.testing.assert_allclose(of_squares, matrix(kernel, square, square.positions, 0.3), atol=1e-9)
    jitter = np.random.default_rng(2).uniform(-0.06, 0.06, (169, 2))
    array = layout(np.column_stack([each.ravel() for each in np.mgrid[:13, :13]]) * 0.3 + jitter, 0.1)
    sensed = tiled(kernel, array, tiling(array)).sum(axis=1)  # under 1 kPa all over
    inside = (np.abs(array.positions - 1.8) < 0.6).all(axis=1)
    assert sensed[inside] == pytest.approx(1, abs=0.025)  # less what lies outside the layout
