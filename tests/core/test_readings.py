"""Compiled looks at taxels' readings against plain numpy, to the rounding of float32."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import norm

from tactiled.core import readings
from tactiled.frames import DEAD, MISSING, SATURATED, UNKNOWN

SEEDS = st.integers(0, 99)


@given(SEEDS, st.integers(1, 4), st.integers(1, 40), st.sampled_from([np.nan, 500.0]), st.sampled_from([-1, 1]))
def test_counts_become_pressure_and_flags(seed, frames, taxels, saturation, sign):
    random, shape = np.random.default_rng(seed), (frames, taxels)
    read, flags = random.integers(0, 1000, shape), random.choice([0, MISSING], shape, p=[0.9, 0.1])
    states, (zero, added) = random.choice([0, DEAD], taxels), random.normal(100, 50, (2, taxels))
    gain = sign * (random.random(taxels) + 0.01)
    pressure, out = np.empty(shape, np.float32), np.empty(shape, np.uint8)
    of_taxels = [np.uint8(states), *(np.float32(each) for each in (zero, gain, added))]
    kinds = saturation, UNKNOWN, SATURATED
    readings.calibrate(np.float32(read), np.uint8(flags), *of_taxels, *kinds, pressure, out)
    unknown = (flags | states) & UNKNOWN > 0
    full = ~unknown & (sign * (read - saturation) >= 0)
    np.testing.assert_array_equal(out, flags | states | np.where(full, SATURATED, 0))
    expected = np.where(unknown, np.nan, (read - zero + added) * gain)
    np.testing.assert_allclose(pressure, expected, atol=1e-3)


@given(SEEDS, st.integers(0, 70))
def test_a_look_is_at_what_is_known(seed, size):
    random = np.random.default_rng(seed)
    x = np.where(random.random(size) < 0.3, np.nan, random.normal(size=size)).astype(np.float32)
    known = x[~np.isnan(x)]
    expected = known.min(initial=np.inf), known.max(initial=-np.inf), known.size
    assert readings.look(x) == expected


def held(x, weight, *bounds):
    total, likely, most_noise, agrees, clear, least, most, passes = bounds
    x, scale = x.astype(float), 1.0
    missed = total - float(weight @ x)
    noise = likely * missed if abs(missed) < most_noise else 0.0
    for _ in range(passes):
        felt = float(weight @ x)
        missed, scale = total - noise - felt, 1.0
        if abs(missed) >= agrees and abs(total) >= clear and (felt + noise) * total > 0:
            scale = min(max(total / (felt + noise), least), most)
        if scale >= 1:
            break
        x = np.maximum(x + missed / float(weight @ (x > 0)), 0) * (x > 0)
    return x * scale


@given(SEEDS, st.integers(1, 70), st.floats(0.1, 3), st.floats(0, 1), st.sampled_from([0, 9]), st.integers(1, 8))
def test_an_excess_is_taken_from_all_that_is_pressed_and_a_lack_is_scaled_up(
    seed, size, part, likely, most, passes
):
    random = np.random.default_rng(seed)
    x = np.maximum(random.normal(size=size), 0).astype(np.float32)
    weight = random.random(size).astype(np.float32)
    total = part * float(weight @ x)
    bounds = total, likely, most, 0.01 * total, 0.1, 0.5, 2.0, passes
    expected = held(x, weight, *bounds)
    readings.keep_total(x, weight, *bounds)
    np.testing.assert_allclose(x, expected, rtol=1e-3, atol=1e-4)


@given(SEEDS, st.integers(1, 60), st.sampled_from([0.0, 0.3, 1.0]))
def test_readings_are_compared_with_what_is_felt_of_an_image_where_they_count(seed, size, lost):
    random = np.random.default_rng(seed)
    read, felt = random.integers(-9, 9, size).astype(np.float32), random.normal(0, 9, size).astype(np.float32)
    flags = np.uint8(random.random(size) < lost) * MISSING
    known, lowest, highest, same, below, expected, outliers, square, *of_all = readings.compare(
        read, felt, flags, 0.5, 0.3, 2.0
    )
    of_all_expected = np.vdot(felt, felt), np.vdot(felt, np.where(flags, felt, read))
    np.testing.assert_allclose(of_all, of_all_expected, rtol=1e-4, atol=1e-3)
    y, off = read[flags == 0], abs(felt - read)[flags == 0]
    assert known == y.size
    if known:
        assert (lowest, highest, same) == (y.min(), y.max(), np.count_nonzero(y == y.max()))
        assert below == pytest.approx((np.minimum(y, 0) ** 2).sum())
        assert expected == pytest.approx(np.hypot(0.5, 0.3 * abs(y).max()))
        off /= expected
        assert outliers == np.count_nonzero(off > 2)
        assert square == pytest.approx((off**2).mean(), rel=1e-4)


@given(SEEDS, st.integers(1, 30), st.integers(1, 30))
def test_parts_are_summed_each_for_itself(seed, rows, columns):
    random = np.random.default_rng(seed)
    x = random.normal(size=(rows, columns)).astype(np.float32)
    down, across = (np.flatnonzero(np.append(True, random.random(n - 1) < 0.3)) for n in x.shape)
    out = np.empty((len(down), len(across)))
    readings.part_sums(x, down, across, out)
    expected = np.add.reduceat(np.add.reduceat(x.astype(float), down, axis=0), across, axis=1)
    np.testing.assert_allclose(out, expected, atol=1e-4)


def test_shapes_that_do_not_fit_are_refused():
    rows, row = np.zeros((2, 5), np.float32), np.zeros(5, np.float32)
    flags, states = np.zeros((2, 5), np.uint8), np.zeros(5, np.uint8)
    arguments = [rows, flags, states, row, row, row, 0.0, 1, 2, rows.copy(), flags.copy()]
    readings.calibrate(*arguments)
    for n, each in enumerate(arguments):
        if isinstance(each, np.ndarray):
            wrong = [*arguments]
            wrong[n] = np.ascontiguousarray(each[..., 1:])
            with pytest.raises(ValueError, match="do not fit"):
                readings.calibrate(*wrong)
    for down, across in (([0, 2], [0]), ([0], [0, 5]), ([1], [0]), ([0], [])):
        parts = np.array(down, int), np.array(across, int)
        with pytest.raises(ValueError, match="do not fit"):
            readings.part_sums(rows, *parts, np.empty((len(down), len(across))))
    with pytest.raises(ValueError, match="do not fit"):
        readings.keep_total(row, row[1:].copy(), 1.0, 0.0, 0.0, 0.0, 0.0, 0.5, 2.0, 8)
    for wrong in ([row, row[1:].copy(), states], [row, row, states[1:].copy()]):
        with pytest.raises(ValueError, match="do not fit"):
            readings.compare(*wrong, 1.0, 0.01, 16.0)


@given(SEEDS, st.integers(1, 8), st.sampled_from([1e-3, 1.0, 30.0]))
def test_values_above_bounds_are_each_the_mean_given_the_others(seed, size, sigma):
    random = np.random.default_rng(seed)
    root = random.normal(size=(size, 2 * size))
    precision, right = root @ root.T, random.normal(0, 5, size)
    bounds = np.where(random.random(size) < 0.5, random.normal(0, 3, size), -np.inf)
    x = np.maximum(np.linalg.solve(precision, right), bounds)
    readings.raise_above(precision, right, bounds, sigma, 2000, x)
    own = precision.diagonal()
    mean, spread = (right - (precision - np.diag(own)) @ x) / own, sigma / np.sqrt(own)
    above = (bounds - mean) / spread
    expected = mean + spread * np.exp(norm.logpdf(above) - norm.logsf(above))
    np.testing.assert_allclose(x, expected, rtol=1e-4, atol=1e-6)
