"""Compiled looks at a frame's modes against plain numpy, to the rounding of float32."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tactiled.core import coefficients

SIDES = st.integers(1, 40)
SEEDS = st.integers(0, 9)


def normal(random, *shape):
    return random.standard_normal(shape).astype(np.float32)


@given(SIDES, SIDES, SIDES, SIDES, SEEDS)
def test_images_are_transformed_by_both_matrices(m, rows, columns, n, seed):
    random = np.random.default_rng(seed)
    left, x, right = normal(random, m, rows), normal(random, rows, columns), normal(random, columns, n)
    out = np.empty((m, n), np.float32)
    coefficients.transform(left, x, right, out)
    size = abs(left).astype(float) @ abs(x) @ abs(right)
    assert (abs(out - left.astype(float) @ x @ right) <= 2e-6 * size).all()


def blocks(n):
    return np.array([each for each in (0, 1, 2, 5, 9, 20) if each < n])


@given(SIDES, SIDES, st.integers(1, 60), SEEDS)
def test_the_likeliest_is_the_cheapest_of_the_power_in_blocks(m, n, spectra, seed):
    random = np.random.default_rng(seed)
    left, frame, right = normal(random, m, 12), normal(random, 12, 7), normal(random, 7, n)
    rows, columns = blocks(m), blocks(n)
    costs = normal(random, spectra, len(rows) * len(columns) + 1)
    squares = (left.astype(float) @ frame @ right) ** 2
    power = np.add.reduceat(np.add.reduceat(squares, rows, axis=0), columns, axis=1)
    expected = costs[:, :-1].astype(float) @ power.ravel() + costs[:, -1]
    found = coefficients.likeliest(left, frame, right, rows, columns, costs)
    assert expected[found] <= expected.min() + 1e-5 * (abs(costs[:, :-1]) @ power.ravel()).max()


def excess(squares):
    return max(float(np.sort(squares)[len(squares) // 2]) / 0.455 - 1, 0)


def mean_of_windows(squares):
    """By the definition: a mean over the rows of a window, of means over its columns."""
    near = [(abs(np.subtract.outer(np.arange(n), np.arange(n))) <= 2).astype(float) for n in squares.shape]
    rows, columns = (each / each.sum(axis=1, keepdims=True) for each in near)
    return rows @ squares @ columns.T


@given(SIDES, SIDES, SEEDS, st.sampled_from([0.0, 0.3, 30.0]), st.sampled_from([1.0, 2.0]))
def test_modes_stand_out_of_their_spectrum_and_of_what_rows_and_columns_share(m, n, seed, shared, limit):
    random = np.random.default_rng(seed)
    squares = normal(random, m, n) ** 2
    squares[:, 0] *= 1 + shared
    squares[0] *= 1 + shared
    squares[m // 2, n // 2] += 100
    variance = np.float32(0.25)
    quiet = np.full((m, n), 1 / (m * n), np.float32)
    down, across = abs(normal(random, m)), abs(normal(random, n))
    limits, inverse, firm, weight = (abs(normal(random, m, n)) + limit for _ in range(4))
    out = np.full((m, n), 7, np.float32)
    found = coefficients.outstanding(
        variance * squares, variance, limits, quiet, down, across, inverse, firm, weight, out
    )
    p, level = mean_of_windows(squares), max(1.0, float((quiet * squares).sum(dtype=float)))
    q = np.maximum(1 + excess(squares[0, n // 2 :]) * down[:, None] + excess(squares[m // 2 :, 0]) * across, level)
    strong, own = p > limits * q, np.maximum(p - 1, 0)
    clear = abs(p - limits * q) > 1e-4 * p  # of rounding
    assert not clear.all() or found == strong.any()
    if found:
        expected = np.where(strong, own * inverse / (own * firm + 1), weight)
        np.testing.assert_allclose(out[clear], expected[clear], rtol=1e-5)


@given(SIDES, SIDES, SEEDS)
def test_sums_are_of_what_is_above_zero_and_below_and_the_highest_beside(m, n, seed):
    x = normal(np.random.default_rng(seed), m, n)
    above, below = np.maximum(x, 0).astype(float), np.minimum(x, 0).astype(float)
    expected = above.sum(), (above**2).sum(), (below**2).sum(), x.max()
    np.testing.assert_allclose(coefficients.signed_sums(x), expected, rtol=1e-5)


def test_shapes_that_do_not_fit_are_refused():
    x, row, at = np.ones((6, 6), np.float32), np.ones(6, np.float32), np.arange(6)
    calls = {
        coefficients.transform: [x] * 4,
        coefficients.likeliest: [x, x, x, at, at, np.ones((3, 37), np.float32)],
        coefficients.outstanding: [x, 1.0, x, x, row, row, x, x, x, x],
    }
    for function, arguments in calls.items():
        function(*arguments)
        for n, each in enumerate(arguments):
            if not isinstance(each, np.ndarray):
                continue
            wrong = [*arguments]
            wrong[n] = (
                np.append(each, each[:1] + 1, axis=0) if each.ndim == 1 else np.ascontiguousarray(each[:, 1:])
            )
            with pytest.raises(ValueError, match="do not fit"):
                function(*wrong)
