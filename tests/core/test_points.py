"""Compiled peaks, responses and fits of small loads against plain numpy, to rounding."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tactiled.core import points


def peeled(image, reach, remainder, most):
    """Peaks by the definition, and the sum of what is left."""
    cells = np.pad(image.astype(float), reach)
    rows, columns = np.indices(cells.shape) - reach
    places, total = [], cells.sum()
    while cells.sum() > remainder * total and len(places) < most:
        row, column = np.unravel_index(cells.argmax(), cells.shape)
        around = slice(row - reach, row + reach + 1), slice(column - reach, column + reach + 1)
        weight = cells[around]
        places.append([(each[around] * weight).sum() / weight.sum() for each in (rows, columns)])
        cells[around] = 0
    return np.array(places).reshape(-1, 2), cells.sum()


@given(st.integers(1, 20), st.integers(1, 20), st.integers(1, 3), st.sampled_from([0.05, 0.3]), st.integers(0, 9))
def test_peaks_are_the_centroids_of_what_is_highest_time_after_time(m, n, reach, remainder, seed):
    random = np.random.default_rng(seed)
    image = random.uniform(size=(m, n + 3)).astype(np.float32)[:, 3:] ** 8  # rows apart in memory
    image *= random.uniform(size=image.shape) < 0.5
    places = np.empty((7, 2))
    found, pairs, total, squares, rest = points.peaks(image, reach, remainder, 3.5, places)
    expected, left = peeled(image, reach, remainder, len(places))
    assert found == len(expected)
    np.testing.assert_allclose(places[:found], expected, atol=1e-5)
    near = (abs(expected[:, None] - expected) < 3.5).all(axis=2)
    assert 2 * pairs + found == near.sum()
    image = image.astype(float)
    assert (total, squares, rest) == pytest.approx((image.sum(), (image**2).sum(), left), abs=1e-5)


PHASES, PARTS, ROWS, COLUMNS = 4, 3, 5, 7


def table(random, n):
    return random.normal(size=(PHASES, 3, PARTS, 2 * n + 1)).astype(np.float32)


@given(st.lists(st.tuples(st.integers(-2, 18), st.integers(-2, 26)), min_size=1, max_size=4), st.integers(0, 9))
def test_responses_are_sums_of_products_of_the_tables_at_each_distance(at, seed):
    random = np.random.default_rng(seed)
    down, across = table(random, ROWS), table(random, COLUMNS)
    out = np.empty((4, len(at), ROWS * COLUMNS), np.float32)
    points.responses(down, across, np.array(at), 0, out)
    for n, place in enumerate(at):
        # At taxel r: of the distance `place` - r, which the table has from its n-th pitch on down.
        factors = []
        for whole, p, size in ((down, place[0], ROWS), (across, place[1], COLUMNS)):
            behind = (size + np.arange(size)) * PHASES - p
            factors.append(whole[behind % PHASES, :, :, behind // PHASES].transpose(1, 2, 0).astype(float))
        (value, slope, bend), (across_value, across_slope, across_bend) = factors
        wider = bend.T @ across_value + value.T @ across_bend
        expected = value.T @ across_value, slope.T @ across_value, value.T @ across_slope, wider / 2
        np.testing.assert_allclose(out[:, n], np.reshape(expected, (4, -1)), atol=1e-5)
    last = np.empty((1, len(at), ROWS * COLUMNS), np.float32)
    points.responses(down, across, np.array(at), 3, last)
    np.testing.assert_array_equal(last[0], out[3])


@given(st.integers(1, 7), st.sampled_from([0, 1e-6, 0.1]), st.integers(0, 9))
def test_a_step_is_of_the_normal_equations(n, ridge, seed):
    random = np.random.default_rng(seed)
    J, y = random.normal(size=(3 * n, 40)), random.normal(size=40)
    gram, along, out = J @ J.T, J @ y, np.empty((4, n))
    points.step(gram, along, ridge, out)
    firm = gram + ridge * np.diag(gram.diagonal())
    force = np.linalg.solve(firm[:n, :n], along[:n])
    moves = np.linalg.solve(firm, J @ (y - J[:n].T @ force))[n:].reshape(2, n) / force
    np.testing.assert_allclose(out, [force, np.linalg.norm(J[:n], axis=1), *moves], rtol=1e-6, atol=1e-8)


def test_shapes_that_do_not_fit_are_refused():
    down, across = (table(np.random.default_rng(0), n) for n in (ROWS, COLUMNS))
    out, image = np.empty((3, 2, ROWS * COLUMNS), np.float32), np.ones((4, 4), np.float32)
    at, system, places = np.zeros((2, 2), int), np.eye(6), np.empty((7, 2))
    points.responses(down, across, at, 0, out)
    for wrong in (
        lambda: points.peaks(image.T[:, ::2], 1, 0.1, 2.0, places),
        lambda: points.peaks(image, 1, 0.1, 2.0, np.empty((7, 3))),
        lambda: points.responses(down[:, :2].copy(), across, at, 0, out),
        lambda: points.responses(down, across, at[:1], 0, out),
        lambda: points.responses(down, across, at, 2, out),
        lambda: points.responses(down, across, at + PHASES * ROWS + 1, 0, out),
        lambda: points.responses(down, across, at - PHASES - 1, 0, out),
        lambda: points.step(system, np.ones(5), 0.0, np.empty((4, 2))),
        lambda: points.step(system, np.ones(6), 0.0, np.empty((4, 2))[:, :1].copy()),
    ):
        with pytest.raises(ValueError, match=r"fit|off the table"):
            wrong()
