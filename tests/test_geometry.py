import numpy as np
import pytest

from tactiled.errors import ConfigError
from tactiled.geometry import grid, layout, raster, tiling


def test_a_grid_runs_along_its_rows_from_the_first_taxel():
    array = grid(2, 3, pitch=0.5, width=0.4)
    np.testing.assert_array_equal(array.positions, [[0, 0], [0.5, 0], [1, 0], [0, 0.5], [0.5, 0.5], [1, 0.5]])
    assert (array.shape, array.frame_shape, array.size) == ((2, 3), (2, 3), 6)
    assert (array.pitch, array.width, array.aperture) == (0.5, 0.4, "square")


def test_a_layout_has_the_least_distance_as_its_pitch():
    array = layout(np.array([[0.0, 0], [3, 4], [3, 6]]))
    assert (array.pitch, array.width, array.shape, array.frame_shape) == (2.0, 2.0, None, (3,))


def test_one_or_two_taxels_are_a_layout_too():
    array = layout(np.zeros((1, 2)), width=3.0)
    assert array.pitch == 3.0
    np.testing.assert_allclose(tiling(array).areas, np.pi * (0.7 * 3.0) ** 2, rtol=0.05)
    assert tiling(layout([(0, 0), (3, 0)])).areas == pytest.approx([12.64, 12.64], rel=0.06)


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda: grid(4, 4, float("nan")), "pitch is nan mm"),
        (lambda: grid(4, 4, 1.0, -0.5), "width is -0.5 mm"),
        (lambda: grid(4, 4, 1.0, 1.2), "width is 1.2 mm: apertures overlap past the pitch of 1.0 mm"),
        (
            lambda: layout([[0, 0], [1.5, 2], [3, 0], [1.5, 2]]),
            r"array\.positions_mm: taxels 1 and 3 are both at \[1\.5, 2\]",
        ),
    ],
)
def test_an_array_that_cannot_be_is_refused_by_name(make, text):
    with pytest.raises(ConfigError, match=text):
        make()


def test_an_images_cells_cover_a_grid():
    array = grid(3, 4, 2.0)
    for refine in (1, 2, 3):
        cells = raster(array, refine)
        assert cells.felt.sum() * cells.side**2 == pytest.approx(3 * 4 * 2.0**2)
        np.testing.assert_allclose(cells.positions.mean(axis=0), array.positions.mean(axis=0))
        assert cells.taxel[-1].tolist() == np.repeat([8, 9, 10, 11], refine).tolist()
    np.testing.assert_allclose(raster(array, 1).positions, array.positions)


def test_an_images_cells_lie_around_a_layouts_taxels():
    y, x = (2.0 * each.ravel() for each in np.mgrid[:6, :6])
    cells = raster(layout(np.column_stack([x, y])[(x < 7) | (y < 7)]), 2)  # a corner of 2 x 2 has none
    assert (cells.shape, cells.side, cells.corner.tolist()) == ((12, 12), 1.0, [-0.5, -0.5])
    row, column = np.indices(cells.shape)
    np.testing.assert_array_equal(cells.felt, (row < 8) | (column < 8))
    assert cells.taxel[2].tolist() == [6, 6, 7, 7, 8, 8, 9, 9, 10, 10, 11, 11]
    assert (cells.rim[7, 8:].all(), cells.rim[6, 8:11].any()) == (True, False)
    values = np.arange(144, dtype=np.float32).reshape(12, 12)
    values[2, 2] = np.nan  # not known
    means = cells.at_taxels(np.stack([values, -values]), 32)
    assert means[:, 7].tolist() == pytest.approx([(27 + 38 + 39) / 3, -(27 + 38 + 39) / 3])
    close = raster(layout(np.array([[0, 0], [0.1, 0], [5, 0], [0, 5], [5, 5], [10, 0], [10, 5]])), 2)
    assert set(range(7)) - set(close.taxel.ravel()) <= {1}  # two in one cell: one of them has it


def test_cells_of_a_hexagonal_layout_are_hexagons():
    rows = [[(x + 0.5 * (y % 2), y * 3**0.5 / 2) for x in range(9)] for y in range(9)]
    array = layout(np.concatenate(rows), 0.5)
    cells = tiling(array)
    inside = (np.abs(array.positions - array.positions.mean(axis=0)) < 2.5).all(axis=1)
    np.testing.assert_allclose(cells.areas[inside], 3**0.5 / 2, rtol=0.05)
    np.testing.assert_allclose(cells.positions[inside], array.positions[inside], atol=0.05)
    assert cells.areas.max() < 1.5  # a cell at the rim does not reach into nothing


@pytest.mark.parametrize("ratio", [1.25, 2.0, 3.0])
def test_cells_of_an_uneven_layout_have_no_holes_between_them(ratio):
    x, y = np.meshgrid(np.arange(12), ratio * np.arange(12))
    cells = tiling(layout(np.column_stack([x.ravel(), y.ravel()])))
    inner = ~cells.rim
    np.testing.assert_array_equal(inner, np.pad(np.ones((10, 10), bool), 1).ravel())
    np.testing.assert_allclose(cells.areas[inner].mean(), ratio, rtol=0.01)


def test_a_gap_between_the_parts_of_a_layout_belongs_to_no_cell():
    x, y = np.meshgrid([0, 1, 2, 3, 6, 7, 8, 9], np.arange(6))
    cells = tiling(layout(np.column_stack([x.ravel(), y.ravel()])))
    assert np.count_nonzero(~cells.rim) == 2 * 2 * 4
    assert cells.rim.reshape(6, 8)[2].tolist() == [True, False, False, True] * 2


def test_the_rim_of_any_array():
    assert tiling(grid(3, 4, 2.0)).rim.reshape(3, 4)[1].tolist() == [True, False, False, True]
    angles = np.arange(6) * np.pi / 3
    hexagon = layout(np.concatenate([[[0, 0]], np.column_stack([np.cos(angles), np.sin(angles)])]))
    assert tiling(hexagon).rim.tolist() == [False] + 6 * [True]
