"""scikit-image as an independent reference: where its assumptions are ours, its results are ours."""

import numpy as np
import pytest
from scipy.signal import fftconvolve
from skimage import restoration

from tactiled.cover.operator import stencil
from tactiled.geometry import grid
from tactiled.restore.blur import Blur
from tactiled.restore.solvers import richardson_lucy
from tactiled.study.truth import kernel

SIDE = 32


@pytest.fixture(scope="module")
def response():
    """The stencil under 1 mm of rubber, pitch 1 mm: (63, 63), its middle the taxel under its own cell."""
    return stencil(kernel(1.0, "layered"), grid(SIDE, SIDE, 1.0, 0.8))


@pytest.fixture(scope="module")
def frame(response):
    """What the taxels feel of two discs in the middle: nothing reaches the border, so that no boundary matters."""
    y, x = np.mgrid[:SIDE, :SIDE]
    truth = 1.0 * (np.hypot(x - 13, y - 15) < 3) + 0.6 * (np.hypot(x - 19, y - 18) < 2)
    return Blur.grid(response, (SIDE, SIDE)).forward(truth)


@pytest.mark.parametrize("balance", [0.003, 0.03])
def test_a_flat_spectrum_in_the_blurs_modes_is_wieners_filter(response, frame, balance):
    modes = Blur.grid(response, (SIDE, SIDE)).modes
    left, right = modes.taxel
    c = left.T @ frame @ right
    ours = modes.surface[0] @ (c * modes.gain / (modes.gain**2 + balance)) @ modes.surface[1].T
    psf = response[16:47, 16:47]
    theirs = restoration.wiener(frame, psf, balance, reg=np.ones((1, 1)), clip=False)
    assert np.linalg.norm(ours - theirs) < 0.02 * np.linalg.norm(theirs)


@pytest.mark.parametrize("iterations", [1, 10, 30])
def test_without_weights_from_a_flat_image_our_richardson_lucy_is_theirs(response, frame, iterations):
    psf = response[16:47, 16:47]
    y = np.maximum(frame, 1e-4).astype(np.float32)
    x = np.full(y.shape, 0.5, np.float32)

    def forward(image):
        return fftconvolve(image, psf, "same").astype(np.float32)

    def adjoint(image):
        return fftconvolve(image, psf[::-1, ::-1], "same").astype(np.float32)

    assert richardson_lucy(forward, adjoint, y, x, np.ones_like(x), iterations) == iterations
    theirs = restoration.richardson_lucy(y.astype(float), psf, iterations, clip=False)
    assert np.linalg.norm(x - theirs) < 1e-3 * np.linalg.norm(theirs)
