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


@given(SIDES, SIDES, SIDES, SIDES, SEEDS)
def test_an_analysis_gives_the_total_of_the_coefficients_and_of_their_squares(m, rows, columns, n, seed):
    random = np.random.default_rng(seed)
    left, x, right = normal(random, m, rows), normal(random, rows, columns), normal(random, columns, n)
    weights, out = normal(random, m * n), np.empty((m, n), np.float32)
    total, square = coefficients.analyse(left, x, right, weights, out)
    c = (left.astype(float) @ x @ right).ravel()
    assert total == pytest.approx(weights @ c, abs=1e-5 * float(abs(weights) @ abs(c)) + 1e-4)
    assert square == pytest.approx(c @ c, rel=1e-4)


@given(SIDES, SIDES, SEEDS, st.sampled_from([0.0, 0.3, 30.0]), st.sampled_from([1.0, 2.0, np.inf]))
def test_modes_stand_out_of_their_spectrum_and_of_what_rows_and_columns_share(m, n, seed, shared, limit):
    random = np.random.default_rng(seed)
    c = normal(random, m, n)
    c[:, 0] *= 1 + shared
    c[0] *= 1 + shared
    c[m // 2, n // 2] += 10
    variance, squares = np.float32(0.25), c.astype(float) ** 2
    quiet = np.full((m, n), 1 / (m * n))
    down, across = abs(normal(random, m)), abs(normal(random, n))
    limits, inverse, firm, weight = (abs(normal(random, m, n)) + limit for limit in (limit, 1, 1, 0))
    left, right, total = normal(random, 7, m), normal(random, n, 9), normal(random, m * n)
    used, out = np.empty((m, n), np.float32), np.empty((7, 9), np.float32)
    fixed = np.float32([quiet, inverse, firm]), np.concatenate([down, across]), total, left, right
    c *= np.sqrt(variance)
    of_weights, of_image, *sums = coefficients.filtered(
        c, variance, np.float32([limits, weight]), *fixed, used, out
    )
    p, level = mean_of_windows(squares), max(1.0, float((quiet * squares).sum()))
    q = np.maximum(1 + excess(squares[0, n // 2 :]) * down[:, None] + excess(squares[m // 2 :, 0]) * across, level)
    own = np.maximum(p - 1, 0)
    clear = abs(p - limits * q) > 1e-4 * p  # of rounding
    expected = np.where((p > limits * q) & (p > level * limits).any(), own * inverse / (own * firm + 1), weight)
    np.testing.assert_allclose(used[clear], expected[clear], rtol=1e-5)
    assert of_weights == pytest.approx((used.astype(float) ** 2).sum(), rel=1e-4)
    modes = used.astype(float) * c
    assert of_image == pytest.approx(
        total @ modes.ravel(), abs=1e-5 * float(abs(total) @ abs(modes.ravel())) + 1e-4
    )
    assert (abs(out - left @ modes @ right) <= 1e-5 * (abs(left) @ abs(modes) @ abs(right))).all()
    above, below = np.maximum(out, 0).astype(float), np.minimum(out, 0).astype(float)
    expected = above.sum(), (above**2).sum(), (below**2).sum(), out.max()
    np.testing.assert_allclose(sums, expected, rtol=1e-5)


def test_shapes_that_do_not_fit_are_refused():
    x, row, at = np.ones((6, 6), np.float32), np.ones(36, np.float32), np.arange(6)
    both, three = np.ones((2, 6, 6), np.float32), np.ones((3, 6, 6), np.float32)
    calls = {
        coefficients.transform: [x] * 4,
        coefficients.likeliest: [x, x, x, at, at, np.ones((3, 37), np.float32)],
        coefficients.analyse: [x, x, x, row, x.copy()],
        coefficients.filtered: [x, 1.0, both, three, np.ones(12, np.float32), row, x, x, x.copy(), x.copy()],
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
