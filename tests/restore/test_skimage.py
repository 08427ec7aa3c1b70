"""Where the assumptions agree, the answers must: a compact scene in the middle, a narrow separable blur."""

import numpy as np
import pytest
from skimage import restoration

from tactiled.restore.blur import Blur
from tactiled.restore.scene import Scene
from tactiled.restore.solvers import richardson_lucy
from tactiled.restore.wiener import Wiener

SHAPE = (40, 40)


@pytest.fixture
def scene_and_psf(gauss):
    response = gauss(SHAPE)
    blur = Blur.grid(response, SHAPE)
    truth = np.zeros(SHAPE)
    truth[16:22, 17:25] = 1.0
    truth[24, 20] = 3.0
    return blur, blur.forward(truth).astype(np.float32), response[39 - 8 : 39 + 9, 39 - 8 : 39 + 9]


@pytest.mark.parametrize("balance", [0.3, 0.03])
def test_the_linear_filter_is_wieners(scene_and_psf, monkeypatch, balance):
    blur, frame, psf = scene_and_psf
    scene = Scene(blur, 0.01)
    scene.look(frame)
    monkeypatch.setattr(scene.prior, "ratio", lambda _: np.full(SHAPE, 1 / balance))
    monkeypatch.setattr(scene, "force_scale", lambda _: 1.0)
    reference = restoration.wiener(frame, psf, balance, reg=np.ones((1, 1)), is_real=True, clip=False)
    np.testing.assert_allclose(Wiener(scene)(), reference, atol=1e-3 * reference.max())


@pytest.mark.parametrize("iterations", [1, 10, 30])
def test_richardson_lucy_is_richardson_lucy(scene_and_psf, iterations):
    blur, frame, psf = scene_and_psf
    x = np.full(SHAPE, 0.5, np.float32)
    done = richardson_lucy(blur.forward, blur.adjoint, frame, x, np.ones(SHAPE, np.float32), iterations)
    reference = restoration.richardson_lucy(frame, psf, iterations, clip=False)
    assert done == iterations
    np.testing.assert_allclose(x, reference, atol=1e-3 * reference.max())
