"""The compiled stages of the network against plain numpy, to the rounding of float32."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import correlate

from tactiled.core import network

ROUNDING = 2e-6  # of the sum of all terms' magnitudes
NOISE, FIRM = 0.5, (1.0, 0.3)  # of a firmness, see restore


def images(random, *shape):
    return random.standard_normal(shape).astype(np.float32)


def redrawn(images, fixed, kernels, scales, offsets, draw):
    """Give the image, float64, and the sum of the magnitudes of all that is added up in it."""

    def add(taps, layers):
        return sum(correlate(x, k, mode="constant") for x, k in zip(layers, taps, strict=True))

    kernels = np.moveaxis(kernels, -1, 0)
    images, fixed, kernels, draw = (np.float64(each) for each in (images, fixed[:, :, :-1], kernels, draw))
    filtered = np.array([add(kernel, images) for kernel in kernels]) + fixed
    sizes = np.array([add(abs(kernel), abs(images)) for kernel in kernels]) + abs(fixed)
    scales, offsets, draw = scales[:, None, None], offsets[:, None, None], np.moveaxis(draw, -1, 0)
    image = add(draw, np.maximum(scales * filtered + offsets, 0))
    return image, add(abs(draw), abs(scales) * sizes + abs(offsets))


def stage(random, inputs, filters, rows, columns):
    shapes = ((inputs, rows, columns), (filters, rows, columns + 1), (inputs, 3, 3, filters))
    return [images(random, *shape) for shape in (*shapes, (filters,), (filters,), (3, 3, filters))]


SIDES = st.integers(1, 40)


@given(st.integers(1, 5), st.sampled_from([8, 16, 24]), SIDES, SIDES, st.integers(0, 9))
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
    random, out = np.random.default_rng(1), np.empty((12, 12), np.float32)
    every = stages(random, 8, 12, 12)
    known = [images(random, *shape) for shape in ((3,), (3,), (3,), (4, 2), (3, 5), (5,))]
    for function, arrays in (
        (network.redraw, [*stage(random, 3, 16, 12, 12), out]),
        (lambda *each: restored(each, (0, 12, 0, 12), out), every),
        (network.tune, known),
    ):
        for n, array in enumerate(arrays):
            with pytest.raises(ValueError, match="do not fit"):
                function(*arrays[:n], np.ascontiguousarray(array[..., :-1]), *arrays[n + 1 :])
    for within in ((-1, 12, 0, 12), (0, 13, 0, 12), (0, 12, 5, 5), (0, 12, 0, 13)):
        with pytest.raises(ValueError, match="do not fit"):
            restored(every, within, out)


def stages(random, filters, rows, columns):
    """All that a restoration takes, but its image: of two stages."""
    parts = [stage(random, 3, filters, rows, columns) for _ in range(2)]
    layers, fixed, kernels, scales, offsets, draw = (np.stack(each) for each in zip(*parts, strict=True))
    tuned = np.concatenate([scales, offsets, scales[:, :1]], axis=1)
    bases = (np.linalg.qr(random.standard_normal((n, n)))[0][:, : max(n // 2, 1)] for n in (rows, columns))
    down, across = (np.ascontiguousarray(each, np.float32) for each in bases)
    shape, linear = (down.shape[1], across.shape[1]), layers[0][2].copy()
    gain, c = abs(images(random, *shape)), images(random, *shape)
    return [linear, fixed, kernels, tuned, draw, down, across, gain, c, layers[0]]


def restored(every, within, out, scale=1.0):
    """Restore by what `stages` gives."""
    linear, *rest, c, seen = every
    network.restore(linear, scale, *rest, c, NOISE, FIRM, within, seen, out)


@given(SIDES, SIDES, st.integers(0, 9), st.data())
def test_stages_redraw_in_turn_and_hold_to_the_frame_what_is_within_a_part(rows, columns, seed, data):
    rows, filters = max(rows, 4), 8
    every = stages(np.random.default_rng(seed), filters, rows, columns)
    linear, fixed, kernels, tuned, draw, down, across, gain, c, layers = every
    firmness = NOISE * np.exp(FIRM[0] * tuned[:, -1] + FIRM[1])
    first, left = data.draw(st.integers(0, rows - 4)), data.draw(st.integers(0, columns - 1))
    end, right = data.draw(st.integers(first + 4, rows)), data.draw(st.integers(left + 1, columns))
    part = slice(first, end), slice(left, right)
    U, V, scale = down[part[0]].astype(float), across[part[1]].astype(float), 4.0
    whole, linear = linear, linear[part] / scale
    held, image = np.maximum(linear, 0), linear
    for n in range(2):
        seen = np.stack([held, image, linear]).astype(np.float32)
        drawn, there = np.empty(linear.shape, np.float32), np.zeros((filters, *linear.shape), np.float32)
        there[...] = fixed[n][:, *part]
        there = np.ascontiguousarray(np.pad(there, ((0, 0), (0, 0), (0, 1))))
        network.redraw(seen, there, kernels[n], tuned[n, :filters], tuned[n, filters:-1], draw[n], drawn)
        image = seen[0] + drawn
        held = image + U @ (gain * (c / scale - gain * (U.T @ image @ V)) / (gain**2 + firmness[n])) @ V.T
    out = np.empty((rows, columns), np.float32)
    restored(every, (first, end, left, right), out, scale)
    rounding = 1e-5 * abs(seen).max()
    np.testing.assert_allclose(layers[:, *part], seen, atol=rounding)
    np.testing.assert_allclose(layers[2], whole / scale, rtol=1e-6)
    np.testing.assert_allclose(out[part] / scale, np.maximum(held, 0), atol=100 * rounding)
    out[part] = layers[:2, *part] = 0
    assert not out.any()
    assert not layers[:2].any()


@given(st.integers(1, 20), st.integers(1, 40), st.integers(1, 99), st.integers(0, 9))
def test_a_network_is_tuned_by_what_is_known_within_bounds(known, units, count, seed):
    random = np.random.default_rng(seed)
    shapes = (known,), (known,), (known,), (known + 1, units), (units + 1, count), (count,)
    k, low, high, hidden, tuned, out = (images(random, *shape) for shape in shapes)
    low, high = np.minimum(low, high), np.maximum(low, high)
    network.tune(k, low, high, hidden, tuned, out)
    unit = np.maximum(np.append(np.clip(k, low, high), 1) @ hidden.astype(float), 0)
    np.testing.assert_allclose(out, np.append(unit, 1) @ tuned, atol=1e-4 * (1 + unit.max()))
