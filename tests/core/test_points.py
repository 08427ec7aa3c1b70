"""Compiled peaks, responses and fits of small loads against plain numpy, to rounding."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tactiled.core import points
from tactiled.restore import point_response


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


LIMITS = 0.5, 0.05, 0.5, 1e-6, 0.03, 0.4


def fitted(response, y, places, variance, steps):
    """A fit by the definition: steps made, places, what is left, `found`, the common width and its variance."""
    clear, settled, farthest, ridge, own_width, own_share = LIMITS
    far = np.array([ROWS, COLUMNS]) - 0.5

    def drawn(places):
        out = np.empty((4, len(places), y.size), np.float32)
        at = (places * point_response.PHASES).round().astype(int)
        points.responses(response.down, response.across, at, 0, out)
        return out.astype(float)

    def firm(squares):
        return squares + ridge * np.diag(squares.diagonal())

    for done in range(1, steps + 1):
        places = (places.clip(-0.5, far) * point_response.PHASES).round() / point_response.PHASES
        n = len(places)
        J = drawn(places)[:3].reshape(3 * n, -1)
        force = np.linalg.solve(firm(J[:n] @ J[:n].T), J[:n] @ y)
        moves = np.linalg.solve(firm(J @ J.T), J @ (y - J[:n].T @ force))[n:].reshape(2, n) / force
        shown = force * np.linalg.norm(J[:n], axis=1) > clear
        if not shown.all():
            places = places[shown]
            if not shown.any() or done == steps:
                return done, None
        elif done == steps or abs(moves).max() < settled:
            break
        else:
            places = places + moves.T.clip(-farthest, farthest)
    J = drawn(places).reshape(4 * n, -1)
    left = y - J[:n].T @ force
    J *= np.concatenate([np.ones(n), force, force, force])[:, None]
    normal, right = firm(J @ J.T), J @ left
    inverse = np.linalg.inv(normal)
    own, own_variance = inverse[3 * n :] @ right, inverse.diagonal()[3 * n :]
    common_variance = 1 / (1 / own_variance).sum()
    width = max((own / own_variance).sum() * common_variance, 0)
    held = np.repeat([0, variance / (own_width + own_share * width) ** 2], [3 * n, n])
    inverse = np.linalg.inv(normal + np.diag(held))
    last = inverse @ (right + held * width)
    found = [force, *last.reshape(4, n), own, own_variance, *inverse.diagonal()[: 3 * n].reshape(3, n)]
    return done, (places, left - J.T @ last, found, width, common_variance)


def gaussian(n):
    """A response along an axis, of eight cells a pitch."""
    return np.exp(-((np.arange(8 * (2 * n - 1)) - 4 * (2 * n - 1) + 0.5) ** 2) / 64)


@given(st.integers(1, 3), st.integers(1, 3), st.sampled_from([0.0, 0.3, 5.0]), st.integers(0, 40))
def test_a_fit_is_made_of_steps_by_normal_equations(n, steps, faintest, seed):
    random = np.random.default_rng(seed)
    response = point_response.PointResponse(np.outer(gaussian(ROWS), gaussian(COLUMNS)), (ROWS, COLUMNS), 8)
    true = np.array([[0.3, 0.6], [3.7, 2.2], [1.2, 5.8]])[:n]
    clean = np.empty((1, n, ROWS * COLUMNS), np.float32)
    points.responses(response.down, response.across, (true * 64).astype(int), 0, clean)
    y = np.float32([faintest, 2.0, 4.0][:n] @ clean[0] + random.normal(0, 0.02, ROWS * COLUMNS))
    places, found = np.full((4, 2), np.nan), np.empty((10, 4))
    places[:n] = start = true + random.uniform(-0.5, 0.5, true.shape)
    jacobian, left = np.empty((16, y.size), np.float32), np.empty_like(y)
    tables, limits = (response.down, response.across), np.array(LIMITS)
    done, count, *common = points.fit(*tables, y, places, n, 4e-4, steps, limits, jacobian, left, found)
    expected_steps, expected = fitted(response, y.astype(float), start, 4e-4, steps)
    assert (done, count > 0) == (expected_steps, expected is not None)
    if expected:
        assert count == len(expected[0])
        np.testing.assert_allclose(places[:count], expected[0], atol=1e-12)
        np.testing.assert_allclose(left, expected[1], rtol=1e-3, atol=1e-3)
        np.testing.assert_allclose(found[:, :count], expected[2], rtol=2e-3, atol=1e-3)
        np.testing.assert_allclose(common, expected[3:], rtol=2e-3, atol=1e-4)


def test_shapes_that_do_not_fit_are_refused():
    down, across = (table(np.random.default_rng(0), n) for n in (ROWS, COLUMNS))
    out, image = np.empty((3, 2, ROWS * COLUMNS), np.float32), np.ones((4, 4), np.float32)
    at, places, y = np.zeros((2, 2), int), np.zeros((7, 2)), np.ones(ROWS * COLUMNS, np.float32)
    memory = np.array(LIMITS), np.empty((28, y.size), np.float32), np.empty_like(y), np.empty((10, 7))
    fit = y, places, 2, 1.0, 3, *memory
    points.responses(down, across, at, 0, out)
    points.fit(down, across, *fit)
    for wrong in (
        lambda: points.peaks(image.T[:, ::2], 1, 0.1, 2.0, places),
        lambda: points.peaks(image, 1, 0.1, 2.0, np.empty((7, 3))),
        lambda: points.responses(down[:, :2].copy(), across, at, 0, out),
        lambda: points.responses(down, across, at[:1], 0, out),
        lambda: points.responses(down, across, at, 2, out),
        lambda: points.responses(down, across, at + PHASES * ROWS + 1, 0, out),
        lambda: points.responses(down, across, at - PHASES - 1, 0, out),
        lambda: points.fit(down, across, *fit[:-1], np.empty((9, 7))),
        lambda: points.fit(down, across, fit[0][1:], *fit[1:]),
        lambda: points.fit(down, across, *fit[:2], 8, *fit[3:]),
        lambda: points.fit(down[:, :, :2].copy(), across, *fit),
    ):
        with pytest.raises(ValueError, match=r"fit|off the table"):
            wrong()
