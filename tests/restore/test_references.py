"""scikit-image as an independent reference: where its assumptions are ours, its results are ours."""

import numpy as np
import pytest
from scipy.signal import fftconvolve
from skimage import restoration

from tactiled.bench.skin import psf_of
from tactiled.cover.operator import stencil
from tactiled.restore.prior import Spectrum
from tactiled.restore.scene import Scene
from tactiled.restore.solvers import richardson_lucy
from tactiled.restore.wiener import Wiener
from tests.plans import plan

SIDE = 32


@pytest.fixture
def blur():
    return plan((SIDE, SIDE), beyond=False).blur


@pytest.fixture
def frame(blur):
    """What the taxels feel of two discs in the middle: nothing reaches the border, so that no boundary matters."""
    y, x = np.mgrid[:SIDE, :SIDE]
    truth = 1.0 * (np.hypot(x - 13, y - 15) < 3) + 0.6 * (np.hypot(x - 19, y - 18) < 2)
    return blur.forward(truth.astype(np.float32))


@pytest.mark.parametrize("balance", [0.003, 0.03])
def test_for_a_flat_spectrum_the_linear_filter_is_wieners(blur, frame, monkeypatch, balance):
    scene = Scene(blur, 10.0)  # kPa: no mode stands out
    scene.look(frame)
    monkeypatch.setattr(scene, "spectrum", Spectrum(1 / balance, np.ones(blur.surface_shape), 0.2, 1.25))
    monkeypatch.setattr(scene, "force_scale", lambda _: 1.0)
    theirs = restoration.wiener(frame, psf_of(blur), balance, reg=np.ones((1, 1)), clip=False)
    assert np.linalg.norm(Wiener(scene)() - theirs) < 0.02 * np.linalg.norm(theirs)


@pytest.mark.parametrize("iterations", [1, 10, 30])
def test_iterations_from_a_flat_image_without_weights_are_theirs(frame, iterations):
    sensor = plan((SIDE, SIDE))
    psf = stencil(sensor.kernel, sensor.array)[16:47, 16:47]
    y = np.maximum(frame, 1e-4)
    x = np.full(y.shape, 0.5, np.float32)

    def forward(image):
        return fftconvolve(image, psf, "same").astype(np.float32)

    def adjoint(image):
        return fftconvolve(image, psf[::-1, ::-1], "same").astype(np.float32)

    assert richardson_lucy(forward, adjoint, y, x, np.ones_like(x), iterations) == iterations
    theirs = restoration.richardson_lucy(y.astype(float), psf, iterations, clip=False)
    assert np.linalg.norm(x - theirs) < 1e-3 * np.linalg.norm(theirs)
