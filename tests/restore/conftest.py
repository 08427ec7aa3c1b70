from functools import cache

import numpy as np
import pytest

from tactiled.cover.kernel import solve
from tactiled.cover.operator import cached, matrix, stencil
from tactiled.cover.stack import Layer, Stack
from tactiled.geometry import grid
from tactiled.restore.blur import Blur


@cache
def cover(thickness):
    return solve(Stack((Layer(thickness, 0.6, 0.48),)), "layered")


@cache
def grid_blur(shape, thickness=1.0, refine=1):
    array = grid(*shape, 1.0, 0.8)
    return Blur.grid(cached(stencil, cover(thickness), array, refine), shape, refine, 1.0 / refine)


@cache
def layout_blur(shape, thickness=1.0):
    array = grid(*shape, 1.0, 0.8)
    return Blur.matrix(matrix(cover(thickness), array, array.positions, 1.0), 1.0)


@pytest.fixture
def covered():
    """Blurs under a cover of `thickness` pitches: of a grid, or of the same taxels as a mere list of positions."""

    def make(shape=(12, 12), thickness=1.0, refine=1, layout=False):
        return layout_blur(shape, thickness) if layout else grid_blur(shape, thickness, refine)

    return make


@pytest.fixture
def gauss():
    """Stencils of a Gaussian, cut off where it is nothing: separable, so that its modes are exact."""

    def make(shape, width=1.0):
        y, x = (np.arange(1 - n, n) for n in shape)
        response = np.exp(-(y[:, None] ** 2 + x**2) / (2 * width**2))
        return response / response.sum()

    return make


@pytest.fixture
def pressed():
    """A frame of a few flat presses under a blur, its noise of `sigma` kPa, and the truth."""

    def make(blur, sigma=0.5, seed=0):
        random = np.random.default_rng(seed)
        truth = np.zeros(blur.surface_shape)
        grid_like = truth.ndim == 2
        view = truth if grid_like else truth.reshape(int(np.sqrt(truth.size)), -1)
        rows, columns = view.shape
        view[rows // 4 : rows // 2, columns // 4 : columns // 2] = 80.0
        view[2 * rows // 3 : 2 * rows // 3 + 2, 2 * columns // 3 : 2 * columns // 3 + 2] = 120.0
        clean = blur.forward(truth)
        return (clean + random.normal(0, sigma, clean.shape)).astype(np.float32), truth

    return make
