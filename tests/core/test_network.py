"""The compiled stages of the network against plain numpy, to the rounding of float32."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import correlate

from tactiled.core import network

ROUNDING = 2e-6  # of the sum of all terms' magnitudes


def images(random, *shape):
    return random.standard_normal(shape).astype(np.float32)


def redrawn(images, fixed, kernels, scales, offsets, draw):
    """Give the image, float64, and the sum of the magnitudes of all that is added up in it."""

    def add(taps, layers):
        return sum(correlate(x, k, mode="constant") for x, k in zip(layers, taps, strict=True))

    images, fixed, kernels, draw = (np.float64(each) for each in (images, fixed[:, :, :-1], kernels, draw))
    filtered = np.array([add(kernel, images) for kernel in kernels]) + fixed
    sizes = np.array([add(abs(kernel), abs(images)) for kernel in kernels]) + abs(fixed)
    scales, offsets, draw = scales[:, None, None], offsets[:, None, None], np.moveaxis(draw, -1, 0)
    image = add(draw, np.maximum(scales * filtered + offsets, 0))
    return image, add(abs(draw), abs(scales) * sizes + abs(offsets))


def stage(random, inputs, filters, rows, columns):
    shapes = ((inputs, rows, columns), (filters, rows, columns + 1), (filters, inputs, 3, 3))
    return [images(random, *shape) for shape in (*shapes, (filters,), (filters,), (3, 3, filters))]


SIDES = st.integers(1, 40)


@given(st.integers(1, 5), st.integers(1, 20), SIDES, SIDES, st.integers(0, 9))
def test_an_image_is_redrawn_by_correlation(inputs, filters, rows, columns, seed):
    if rows * (columns + 1) < 4:
        rows = 4
    arrays, out = (
        stage(np.random.default_rng(seed), inputs, filters, rows, columns),
        np.empty((rows, columns), "f"),
    )
    network.redraw(*arrays, out)
    expected, size = redrawn(*arrays)
    assert (abs(out - expected) <= ROUNDING * size).all()


def test_what_is_not_known_stays_unknown_and_spreads_by_two_cells_only():
    arrays, out = stage(np.random.default_rng(1), 3, 16, 12, 33), np.empty((12, 33), np.float32)
    arrays[0][1, 5, 20] = np.nan
    network.redraw(*arrays, out)
    there = np.zeros(out.shape, bool)
    there[3:8, 18:23] = True
    np.testing.assert_array_equal(np.isnan(out), there)


def test_shapes_that_do_not_fit_are_refused():
    arrays, out = stage(np.random.default_rng(1), 3, 16, 12, 12), np.empty((12, 12), np.float32)
    for n, array in enumerate((*arrays, out)):
        wrong = [*arrays, out]
        wrong[n] = np.ascontiguousarray(array[..., :-1])
        with pytest.raises(ValueError, match="do not fit"):
            network.redraw(*wrong)
    z, U, h, other = out, arrays[0][0], out.copy(), out[:, :11].copy()
    for wrong in range(6):
        each = [other if n == wrong else value for n, value in enumerate((z, U, U, U, h, h))]
        with pytest.raises(ValueError, match="do not fit"):
            network.hold(*each, 1.0, out)
    with pytest.raises(ValueError, match="do not fit"):
        network.misfit(z, U, U, h, other, 1.0, 1.0)


@given(SIDES, SIDES, st.floats(0.01, 1), st.floats(0.01, 1), st.integers(0, 9), st.floats(1e-3, 10))
def test_an_image_is_held_to_a_frame_and_misses_it_by_so_much(rows, columns, low, across, seed, firmness):
    random = np.random.default_rng(seed)
    K, L = max(1, int(rows * low)), max(1, int(columns * across))
    U, V = (np.linalg.qr(random.standard_normal((n, n)))[0][:, :m] for n, m in ((rows, K), (columns, L)))
    z, c, h = images(random, rows, columns), images(random, K, L), abs(images(random, K, L))
    bases = [np.ascontiguousarray(each, np.float32) for each in (U, V, V.T)]
    out = np.empty_like(z)
    network.hold(z, *bases, h, c, firmness, out)
    missed = c - h * (U.T @ z @ V)
    expected = z + U @ (h * missed / (h**2 + firmness)) @ V.T
    np.testing.assert_allclose(out, expected, atol=1e-5 * (1 + abs(c).max() / firmness**0.5))
    found = network.misfit(z, *bases[:2], h, c, 0.25, 0.5)
    assert found == pytest.approx((missed**2 / ((0.25 * h) ** 2 * (z**2).mean() + 0.25)).mean(), rel=1e-4)
