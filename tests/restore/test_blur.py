import itertools
from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tactiled.cover.kernel import solve
from tactiled.cover.operator import cached, stencil
from tactiled.cover.stack import Layer, Stack
from tactiled.errors import PhysicsError
from tactiled.geometry import grid
from tactiled.restore.blur import Blur, _between, _terms
from tactiled.restore.forms import Forms

FORMS = ("dense", "separable", "fourier")


def symmetric(shape, refine, seed=0):
    """A stencil that is not separable, its middle where a taxel's own cells are."""
    random = np.random.default_rng(seed)
    return random.normal(size=[refine * (2 * n - 1) for n in shape])


def cover(thickness):
    return solve(Stack((Layer(thickness, 0.6, 0.48),)), "layered")


def pair(form, response, shape, refine):
    return Forms(*_terms(response, shape, refine), response).make(form)


def by_hand(response, shape, refine):
    """The matrix (taxels, cells), entry by entry, from what a stencil is defined to be."""
    rows, columns = shape
    A = np.zeros((rows * columns, refine**2 * rows * columns))
    for (i, j), (y, x) in itertools.product(np.ndindex(*shape), np.ndindex(refine * rows, refine * columns)):
        dy, dx = y - refine * i + refine * (rows - 1), x - refine * j + refine * (columns - 1)
        A[i * columns + j, y * refine * columns + x] = response[dy, dx]
    return A


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("refine", [1, 2, 3])
@pytest.mark.parametrize("shape", [(4, 5), (1, 6), (3, 1)])
def test_every_form_is_the_stencil_entry_by_entry(form, refine, shape):
    response = symmetric(shape, refine)
    forward, adjoint = pair(form, response, shape, refine)
    A = by_hand(response, shape, refine)
    random = np.random.default_rng(1)
    x, y = random.normal(size=(refine * shape[0], refine * shape[1])), random.normal(size=shape)
    np.testing.assert_allclose(forward(x).ravel(), A @ x.ravel(), atol=1e-6 * np.abs(A).sum(1).max())
    np.testing.assert_allclose(adjoint(y).ravel(), A.T @ y.ravel(), atol=1e-6 * np.abs(A).sum(0).max())


@settings(max_examples=60)
@given(
    form=st.sampled_from(FORMS),
    refine=st.integers(1, 3),
    shape=st.tuples(st.integers(1, 7), st.integers(1, 7)),
    batch=st.sampled_from([(), (3,), (2, 2)]),
    seed=st.integers(0, 2**32 - 1),
)
def test_the_adjoint_is_the_adjoint(form, refine, shape, batch, seed):
    random = np.random.default_rng(seed)
    forward, adjoint = pair(form, symmetric(shape, refine, seed), shape, refine)
    x = random.normal(size=(*batch, refine * shape[0], refine * shape[1]))
    y = random.normal(size=(*batch, *shape))
    left, right = np.vdot(forward(x), y), np.vdot(x, adjoint(y))
    scale = np.linalg.norm(forward(x)) * np.linalg.norm(y) + 1e-300
    assert abs(left - right) <= 1e-10 * scale


@settings(max_examples=30)
@given(taxels=st.integers(1, 30), cells=st.integers(1, 30), seed=st.integers(0, 2**32 - 1))
def test_the_adjoint_of_a_matrix_is_its_transpose(taxels, cells, seed):
    random = np.random.default_rng(seed)
    A = random.normal(size=(taxels, cells))
    blur = Blur.matrix(A)
    x, y = random.normal(size=cells), random.normal(size=(4, taxels))
    np.testing.assert_allclose(blur.forward(x), A @ x, atol=1e-12)
    np.testing.assert_allclose(blur.adjoint(y), y @ A, atol=1e-12)


@pytest.mark.parametrize("refine", [1, 2, 3])
def test_single_precision_stays_single_and_close(covered, refine):
    blur = covered((9, 8), refine=refine)
    x = np.random.default_rng(0).random(blur.surface_shape)
    single = blur.forward(x.astype(np.float32))
    assert single.dtype == np.float32
    np.testing.assert_allclose(single, blur.forward(x), rtol=1e-5)


def test_a_blur_takes_the_form_that_is_picked():
    response, made = symmetric((4, 4), 1), []

    def pick(forms):
        made.append(forms.names)
        return "fourier"

    blur = Blur.grid(response, (4, 4), pick=pick)
    x = np.random.default_rng(0).random((4, 4))
    np.testing.assert_array_equal(blur.forward(x), pair("fourier", response, (4, 4), 1)[0](x))
    assert set(made[0]) == set(FORMS)


@pytest.mark.parametrize("soonest", FORMS)
def test_the_fastest_is_the_one_that_took_least_time(soonest):
    """A clock that runs on by a second a multiplication, but for one form."""
    forms = Forms(*_terms(symmetric((4, 4), 1), (4, 4), 1), symmetric((4, 4), 1))
    now, make = [0.0], forms.make

    def slow(name):
        forward, adjoint = make(name)

        def wait(x):
            now[0] += name != soonest
            return adjoint(x)

        return forward, wait

    forms.make = slow
    assert forms.fastest(lambda: now[0]) == soonest


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: Blur.grid(np.ones((5, 5)), (4, 4)), r"stencil of shape \(5, 5\)"),
        (lambda: Blur.grid(np.full((7, 7), np.nan), (4, 4)), "finite"),
        (lambda: Blur.matrix(np.ones(5)), r"blur matrix of shape \(5,\)"),
        (lambda: Blur.matrix(np.full((2, 2), np.inf)), "finite"),
    ],
)
def test_what_is_no_blur_is_refused(make, said):
    with pytest.raises(PhysicsError, match=said):
        make()


@pytest.mark.parametrize("refine", [1, 2, 3])
@pytest.mark.parametrize("thickness", [0.2, 1.0])
def test_with_finer_stencils_pressure_is_smooth_between_cells(thickness, refine):
    """Steps leave three to ten times the error."""
    shape, parts = (10, 12), 12
    finer = partial(cached, stencil, cover(thickness), grid(*shape, 1.0, 0.8))
    y, x = np.mgrid[: shape[0] * parts, : shape[1] * parts] / parts
    fine = np.exp(-((x - 6.3) ** 2 + (y - 4.1) ** 2) / (2 * 1.2**2)) + 0.5 * np.exp(-((x - 12) ** 2) / 6)
    whole = Blur.grid(finer(parts), shape, parts).forward(fine)
    each = parts // refine
    cells = fine.reshape(shape[0] * refine, each, shape[1] * refine, each).mean(axis=(1, 3))
    smooth = Blur.grid(finer(refine), shape, refine, finer=finer).forward(cells)
    steps = Blur.grid(finer(refine), shape, refine).forward(cells)
    missed = [np.linalg.norm(found - whole) / np.linalg.norm(whole) for found in (smooth, steps)]
    assert missed[0] < 0.005
    assert missed[1] > 3 * missed[0]


@pytest.mark.parametrize("parts", [2, 4])
@pytest.mark.parametrize("n", [1, 2, 3, 9])
def test_smooth_pressure_has_the_cells_own_means(n, parts):
    between = _between(n, parts)
    np.testing.assert_allclose(between.reshape(n, parts, n).mean(axis=1), np.eye(n), atol=1e-12)
    np.testing.assert_allclose(between.sum(axis=1), 1, atol=1e-12)


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
    near = back(c.astype(np.float32), back.empty())
    assert np.linalg.norm(near - y) < 0.02 * np.linalg.norm(y)
