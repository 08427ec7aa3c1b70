"""Total variation against scikit-image's where nothing is blurred, against a general solver where it is."""

import tracemalloc

import numpy as np
import pytest
from scipy.optimize import minimize
from skimage.restoration import denoise_tv_chambolle

from tactiled.restore.methods import make
from tactiled.restore.nonnegative import GAUSSIAN_SHARE, SPARSE_SHARE
from tactiled.restore.scene import Scene
from tactiled.restore.total_variation import FLAT_CORNER, VARIATION_WEIGHT, Edges, TotalVariation
from tactiled.restore.wiener import Wiener

SIGMA = 0.5


def differences(x):
    """Along rows and down columns, 0 past the border."""
    return np.diff(x, axis=1, append=x[:, -1:]), np.diff(x, axis=0, append=x[-1:])


@pytest.mark.parametrize("shape", [(9, 13), (1, 12), (12, 1)])
def test_without_a_blur_it_is_scikit_images(shape):
    t = (40 + 10 * np.random.default_rng(0).normal(size=shape)).astype(np.float32)
    edges = Edges(shape)
    edges.limit(6.0)
    for _ in range(20_000):
        edges.fill(t.reshape(-1))
        edges.follow()
    reference = denoise_tv_chambolle(t.squeeze().astype(float), weight=6.0, eps=1e-14, max_num_iter=20_000)
    np.testing.assert_allclose(edges.x.reshape(shape).squeeze(), reference, atol=2e-3)


@pytest.mark.parametrize("shape", [(5, 7), (1, 6), (6, 1), (1, 1)])
def test_the_sum_of_differences_is_that_of_all_differences(shape):
    edges = Edges(shape)
    edges.x[...] = np.random.default_rng(1).normal(size=edges.x.size)
    expected = sum(np.abs(each).sum() for each in differences(edges.x.reshape(shape)))
    assert edges.sum_of_differences() == pytest.approx(expected, rel=1e-5, abs=1e-6)


def weights(scene, x):
    """What the image of a scene is weighed by: its Gaussian (surface modes), its sum and its variation."""
    share = x.sum() ** 2 / (x.size * (x**2).sum())
    contrast = (x**2).sum() / sum(np.abs(each).sum() for each in differences(x))
    flat = 1 / (1 + (scene.spectrum.corner / FLAT_CORNER) ** 2)
    return (
        min(1, share / GAUSSIAN_SHARE) / scene.spectrum.ratio,
        min(1, SPARSE_SHARE / share) * scene.noise,
        VARIATION_WEIGHT * flat * np.sqrt(scene.noise * contrast),
    )


def objective(scene, frame, x, smooth=0.0):
    """The problem that is to be solved, the weights being those of `x`; its value and slope at any image."""
    (gaussian, total, weight), modes = weights(scene, x), scene.modes
    V, W = modes.surface
    c = modes.taxel[0].T @ frame.astype(float) @ modes.taxel[1]

    def at(flat):
        image = flat.reshape(x.shape)
        z = V.T @ image @ W
        across, down = differences(image)
        length = np.sqrt(across**2 + down**2 + smooth**2)
        misfit = modes.gain * z - c
        value = (misfit**2).sum() / 2 + (gaussian * z**2).sum() / 2 + total * flat.sum() + weight * length.sum()
        slope = V @ (modes.gain * misfit + gaussian * z) @ W.T + total
        for part, axis in ((across, 1), (down, 0)):
            pull = weight * part / np.maximum(length, 1e-300)
            slope += np.roll(pull, 1, axis) - pull
        return value, slope.ravel()

    return at


@pytest.mark.parametrize("seed", range(3))
def test_what_it_comes_to_is_the_least(covered, pressed, monkeypatch, seed):
    blur = covered((8, 8))
    frame, _ = pressed(blur, SIGMA, seed)
    scene = Scene(blur, SIGMA)
    monkeypatch.setattr(scene, "force_scale", lambda _: 1.0)
    monkeypatch.setattr(TotalVariation, "_max_iterations", 20_000)
    solver = TotalVariation(scene)
    scene.look(frame)
    solver(Wiener(scene)())
    ours = solver.image.astype(float)
    exact = objective(scene, frame, ours)
    best = ours.ravel()
    for smooth in (1.0, 0.1, 0.01, 1e-3):
        solution = minimize(
            objective(scene, frame, ours, smooth),
            np.maximum(best, 0) if smooth < 1 else np.full(ours.size, frame.mean(), float),
            jac=True,
            method="L-BFGS-B",
            bounds=[(0, None)] * ours.size,
            options={"maxiter": 20_000, "maxfun": 100_000, "ftol": 1e-15, "gtol": 1e-9, "maxcor": 50},
        )
        best = solution.x
    assert exact(ours.ravel())[0] <= exact(best)[0] * (1 + 1e-5)
    assert np.linalg.norm(ours.ravel() - best) < 0.01 * np.linalg.norm(best)


@pytest.mark.parametrize(("thickness", "sigma"), [(1.0, 0.5), (1.0, 3.0), (2.0, 3.0)])
def test_flat_parts_come_out_flat(covered, thickness, sigma):
    blur = covered((24, 24), thickness)
    y, x = np.mgrid[:24, :24] - 11.5
    truth = 80.0 * (np.hypot(x, y) < 7)
    clean = blur.forward(truth)
    frame = (clean + np.random.default_rng(3).normal(0, sigma, clean.shape)).astype(np.float32)
    images = {name: make(name, blur, sigma)(frame).image for name in ("tv", "nnls")}
    inside = np.hypot(x, y) < 5
    assert images["tv"][inside].std() < 0.6 * images["nnls"][inside].std()
    assert np.linalg.norm(images["tv"] - truth) < 0.9 * np.linalg.norm(images["nnls"] - truth)


def test_without_a_grid_it_is_plain_least_squares_and_says_so(covered, pressed):
    blur = covered((8, 8), layout=True)
    frame, _ = pressed(blur, SIGMA)
    done, nnls = make("tv", blur, SIGMA)(frame), make("nnls", blur, SIGMA)(frame)
    assert done.method == "nnls"
    assert "grid" in done.why
    np.testing.assert_array_equal(done.image, nnls.image)


def test_a_frame_allocates_next_to_nothing(covered, pressed):
    blur = covered((64, 64))
    frames = [pressed(blur, SIGMA, seed)[0] for seed in range(4)]
    restorer = make("tv", blur, SIGMA)
    for frame in frames:
        restorer(frame)
    tracemalloc.start()
    restorer(frames[0])
    before, _ = tracemalloc.get_traced_memory()
    tracemalloc.reset_peak()
    for frame in frames:
        restorer(frame)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak - before < frames[0].nbytes / 2
