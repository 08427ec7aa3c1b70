"""The operators that a configuration makes, against their definition: the cover's stencil."""

import numpy as np
import pytest
from scipy.signal import correlate

from tactiled.cover.operator import cached, stencil
from tests.plans import plan

OPERATORS = {
    "square": {"shape": (9, 9)},
    "wide": {"shape": (4, 7), "thickness": 0.2},
    "row": {"shape": (1, 6)},
    "column": {"shape": (3, 1), "refine": 2},
    "taxel": {"shape": (1, 1)},
    "twice as fine": {"shape": (6, 5), "refine": 2},
    "three times as fine": {"shape": (5, 6), "refine": 3},
    "layout": {"shape": (5, 6), "layout": True},
}


def table(sensor, k):
    """The cover's response to cells k times finer than the pitch."""
    return cached(stencil, sensor.kernel, sensor.array, k)


def exact(sensor, fine, k):
    """What the taxels feel of `fine`, pressure that steps from cell to cell, k of them a pitch."""
    return correlate(table(sensor, k), fine, "valid", "fft")[::-k, ::-k]


@pytest.mark.parametrize("operator", OPERATORS)
@pytest.mark.parametrize("batch", [(), (3,), (2, 2)])
def test_the_adjoint_is_the_adjoint(operator, batch):
    blur, random = plan(**OPERATORS[operator]).blur, np.random.default_rng(1)
    x, y = random.normal(size=(*batch, *blur.surface_shape)), random.normal(size=(*batch, *blur.frame_shape))
    forward = blur.forward(x)
    scale = np.linalg.norm(forward) * np.linalg.norm(y)
    assert abs(np.vdot(forward, y) - np.vdot(x, blur.adjoint(y))) <= 1e-10 * scale


@pytest.mark.parametrize("operator", OPERATORS)
def test_single_precision_stays_single_and_close(operator):
    blur = plan(**OPERATORS[operator]).blur
    x = np.random.default_rng(0).random(blur.surface_shape)
    single = blur.forward(x.astype(np.float32))
    assert single.dtype == np.float32
    np.testing.assert_allclose(single, blur.forward(x), rtol=1e-5)


@pytest.mark.parametrize("operator", [name for name in OPERATORS if name != "layout"])
def test_even_pressure_is_felt_as_the_stencil_sums_it(operator):
    sensor, refine = plan(**OPERATORS[operator]), OPERATORS[operator].get("refine", 1)
    cells = np.ones(sensor.blur.surface_shape)
    np.testing.assert_allclose(sensor.blur.forward(cells), exact(sensor, cells, refine), rtol=1e-5)


@pytest.mark.parametrize("refine", [1, 2, 3])
@pytest.mark.parametrize("thickness", [0.2, 1.0])
def test_pressure_is_smooth_between_the_cells(thickness, refine):
    """Steps leave three to ten times the error."""
    shape, parts = (10, 12), 12
    sensor = plan(shape, thickness, refine=refine)
    y, x = np.mgrid[: shape[0] * parts, : shape[1] * parts] / parts
    fine = np.exp(-((x - 6.3) ** 2 + (y - 4.1) ** 2) / (2 * 1.2**2)) + 0.5 * np.exp(-((x - 12) ** 2) / 6)
    truth = exact(sensor, fine, parts)
    each = parts // refine
    cells = fine.reshape(shape[0] * refine, each, shape[1] * refine, each).mean(axis=(1, 3))
    smooth, steps = sensor.blur.forward(cells), exact(sensor, cells, refine)
    errors = [np.linalg.norm(frame - truth) / np.linalg.norm(truth) for frame in (smooth, steps)]
    assert errors[0] < 0.005
    assert errors[1] > 3 * errors[0]


@pytest.mark.parametrize("thickness", [0.5, 1.0, 3.0])
@pytest.mark.parametrize("refine", [1, 2])
def test_modes_are_orthonormal_and_come_near_the_blur(covered, thickness, refine):
    blur = covered((10, 8), thickness, refine)
    modes = blur.modes
    for basis in (*modes.taxel, *modes.surface):
        np.testing.assert_allclose(basis.T @ basis, np.eye(basis.shape[1]), atol=1e-12)
    x = np.random.default_rng(0).random(blur.surface_shape)
    y = blur.forward(x)
    coefficients = modes.to_surface_modes()
    c = coefficients(x.astype(np.float32), coefficients.empty())[modes.head] * modes.gain
    back = modes.to_taxels()
    approximation = back(c.astype(np.float32), back.empty())
    assert np.linalg.norm(approximation - y) < 0.05 * np.linalg.norm(y)


@pytest.mark.parametrize("thickness", [0.5, 1.0])
def test_aliases_miss_what_random_pressure_shows(thickness):
    """White pressure on quarters of cells, blurred, against the blur of its means, far from the border."""
    shape, k, row, columns = (9, 12), 4, 4, (5, 6)
    sensor = plan(shape, thickness)
    random = np.random.default_rng(0).normal(size=(2000, shape[0] * k, shape[1] * k))
    means = random.reshape(-1, shape[0], k, shape[1], k).mean(axis=(2, 4))
    down = slice(k * (shape[0] - 1 - row), k * (2 * shape[0] - 1 - row))
    across = [slice(k * (shape[1] - 1 - column), k * (2 * shape[1] - 1 - column)) for column in columns]
    frames = [np.tensordot(random, table(sensor, k)[down, each]) for each in across]
    missed = np.transpose(frames) - sensor.blur.forward(means)[:, row, columns[0] : columns[1] + 1]
    assert missed.var() / means.var() == pytest.approx(sensor.blur.aliasing.variance(np.ones_like).mean(), rel=0.1)


def test_a_smooth_scene_has_next_to_no_aliases(covered):
    missed = covered((9, 12)).aliasing.variance(lambda q: (1 + (q / 0.05) ** 2) ** -3)
    assert missed[0, 0] < 1e-6
    assert missed[0, 0] < missed[0, 3] < missed[0, 6] < missed[0, 9] < 0.1
