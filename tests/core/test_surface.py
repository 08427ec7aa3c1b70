"""Where a surface is pressed and what lies beyond, compiled, against plain numpy."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from tactiled.core import surface


@given(st.lists(st.floats(-2, 2, width=32), min_size=1, max_size=30), st.integers(0, 9), st.floats(0.1, 3))
def test_the_box_is_around_all_that_reads_more_where_the_rest_is_as_noise_is(y, seed, noise):
    random, whole = np.random.default_rng(seed), (0, 12, 0, 14, False)
    rows, columns = random.integers(0, 9, (2, len(y)), np.int32)
    ends = tuple(int(f(each)) for each in (rows, columns) for f in (np.min, np.max))
    found = surface.box(np.array(y, np.float32), rows, columns, ends, (12, 14), 1, 2, noise, 4, 0.5)
    above = np.array(y) > 1
    if not above.any():
        assert found == whole
        return
    first, last = ((f(rows[above]), f(columns[above])) for f in (np.min, np.max))
    (top, left), (bottom, right) = np.array(first) - 2, np.array(last) + 2
    out = np.array(y)[~((rows >= top) & (rows <= bottom) & (columns >= left) & (columns <= right))]
    stray = 4 * np.sqrt(2 * len(out)) * noise**2
    bounds = np.array([noise**2 * len(out) + stray, 16 * noise**2 * len(out), 0.25 * np.square(y).sum()])
    measured = np.array([np.square(out).sum(), out.sum() ** 2, stray])
    assume(np.abs(bounds - measured).min() > 1e-4)
    if (measured > bounds).any():
        assert found == whole
        return
    free = top > rows.min(), bottom < rows.max(), left > columns.min(), right < columns.max()
    expected = zip((top, bottom + 1, left, right + 1), free, whole[:4], strict=True)
    assert found == (*(cell if each else end for cell, each, end in expected), all(free))


@given(st.data(), st.integers(0, 9))
def test_a_frame_is_completed_in_the_box_and_zero_elsewhere(data, seed):
    random = np.random.default_rng(seed)
    shape, own = random.integers(1, 9, 2), random.integers(0, 4, (2, 2))
    whole = shape + own.sum(axis=1)
    there = np.zeros(whole, bool)
    there[tuple(slice(before, before + n) for (before, _), n in zip(own, shape, strict=True))] = True
    ends = [data.draw(st.lists(st.integers(0, int(n)), min_size=2, max_size=2).map(sorted)) for n in whole]
    rows, columns = map(np.ascontiguousarray, np.nonzero(~there))
    y = random.normal(size=shape).astype(np.float32)
    matrix = random.normal(size=(len(rows), y.size)).astype(np.float32)
    frame, inside = np.full(whole, np.nan, np.float32), np.zeros(whole, bool)
    inside[tuple(slice(*each) for each in ends)] = True
    surface.complete(matrix, y, rows, columns, *own[:, 0].tolist(), (*ends[0], *ends[1]), frame)
    expected = np.zeros(whole)
    expected[~there] = matrix @ np.where(inside[there], y.ravel(), 0)
    expected[~inside] = 0
    expected[there] = y.ravel()
    np.testing.assert_allclose(frame, expected, atol=1e-5)
    for wrong in (
        (matrix[:, 1:], y, rows),
        (matrix, y[:, 1:], rows),
        (matrix, y, rows[:-1]),
        (matrix, y, rows + 99),
    ):
        if len(rows):
            with pytest.raises(ValueError, match="complete"):
                surface.complete(*map(np.ascontiguousarray, wrong), columns, 0, 0, (0, 1, 0, 1), frame)
