"""Total variation against scikit-image's where nothing is blurred, against a general solver where it is."""

import numpy as np
import pytest
from scipy.optimize import minimize
from skimage.restoration import denoise_tv_chambolle

from tactiled.bench.skin import nrmse
from tactiled.restore import total_variation
from tactiled.restore.methods import make
from tactiled.restore.scene import FORCE_AGREES_SIGMAS, Scene
from tactiled.restore.total_variation import VARIANCE_POWER, VARIATION_WEIGHT, Edges, TotalVariation
from tactiled.restore.wiener import Wiener
from tests.bench.presses import presses

SIGMA = 0.5


def differences(x):
    """Along rows and down columns, 0 past the border."""
    return np.diff(x, axis=1, append=x[:, -1:]), np.diff(x, axis=0, append=x[-1:])


@pytest.mark.parametrize("shape", [(9, 13), (1, 12), (12, 1)])
def test_without_a_blur_it_is_scikit_images(shape):
    t = (40 + 10 * np.random.default_rng(0).normal(size=shape)).astype(np.float32)
    edges = Edges(shape)
    edges.reset(6.0)
    for _ in range(20_000):
        edges.fill(t.reshape(-1))
        edges.follow()
    reference = denoise_tv_chambolle(t.squeeze().astype(float), weight=6.0, eps=1e-14, max_num_iter=20_000)
    np.testing.assert_allclose(edges.x.reshape(shape).squeeze(), reference, atol=2e-3)


def weight(scene, frame):
    """Of the variation, in the problem that is to be solved for a frame."""
    h, S = np.zeros_like(scene.spectrum.ratio), scene.spectrum.ratio
    h[scene.modes.head] = scene.modes.gain
    variance = (S / (1 + h**2 * S)).mean()
    return VARIATION_WEIGHT * np.sqrt(scene.noise * np.sqrt((frame**2).mean())) / variance**VARIANCE_POWER


def objective(scene, frame, x, smooth=0.0):
    """The problem that is to be solved: its value and slope at any image of the shape of `x`."""
    heavy, modes = weight(scene, frame), scene.modes
    V, W = modes.surface
    c = modes.taxel[0].T @ frame.astype(float) @ modes.taxel[1]

    def at(flat):
        image = flat.reshape(x.shape)
        z = V.T @ image @ W
        across, down = differences(image)
        length = np.sqrt(across**2 + down**2 + smooth**2)
        misfit = modes.gain * z - c
        value = (misfit**2).sum() / 2 + heavy * length.sum()
        slope = V @ (modes.gain * misfit) @ W.T
        for part, axis in ((across, 1), (down, 0)):
            pull = heavy * part / np.maximum(length, 1e-300)
            slope += np.roll(pull, 1, axis) - pull
        return value, slope.ravel()

    return at


@pytest.mark.parametrize("seed", range(2))
def test_what_it_comes_to_is_the_least(covered, pressed, monkeypatch, seed):
    blur = covered((8, 8))
    frame, _ = pressed(blur, SIGMA, seed)
    scene = Scene(blur, SIGMA)
    monkeypatch.setattr(scene, "keep_force", lambda _: None)
    monkeypatch.setattr(total_variation, "ITERATIONS", 20_000)
    monkeypatch.setattr(total_variation, "MODES_MISS", 1e-9)  # the problem is that of the modes
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


def test_over_presses_of_all_kinds_it_is_nearer_the_truth_than_plain_least_squares():
    errors = [
        [nrmse(make(name, each.blur, each.sigma)(each.frame).image, each.truth) for name in ("tv", "nnls")]
        for each in presses(16, (1.0, 3.0), (0.01, 0.05), seed=40, beyond=False)
    ]
    tv, nnls = np.log(errors).mean(axis=0)
    assert tv < nnls + np.log(0.95)


def test_an_excess_of_force_is_taken_from_all_pressed_cells_alike(covered, pressed):
    blur = covered((16, 16))
    scene = Scene(blur, SIGMA)
    frame, _ = pressed(blur, SIGMA, 1)
    scene.look(frame)
    solver = TotalVariation(scene)
    solver.flatten(Wiener(scene)().clip(0))
    with_haze = solver.image + np.random.default_rng(2).uniform(0, 3, (16, 16)).astype(np.float32)
    solver.image[...] = with_haze
    scene.keep_force(solver.image.reshape(-1))
    assert (blur.reach * solver.image).sum() == pytest.approx(frame.sum(), abs=FORCE_AGREES_SIGMAS * SIGMA * 16)
    assert solver.image.min() == 0
    excess = with_haze - solver.image
    pressed_still = solver.image > 0
    assert np.ptp(excess[pressed_still]) < 1e-3
    assert (with_haze[~pressed_still] <= excess[pressed_still].max() + 1e-3).all()


@pytest.mark.parametrize("thickness", [1.0, 2.0])
def test_in_little_noise_a_press_over_the_edge_is_restored_as_the_exact_blur_has_it(thickness):
    """The blur's modes miss most where pressure reaches the border: five times the noise, and twice the error."""
    for press in presses(24, (thickness,), (0.002,), 2, seed=11, scenes=("edges",), beyond=False):
        image = make("tv", press.blur, press.sigma)(press.frame).image
        residual = press.blur.forward(image) - press.frame
        assert np.sqrt(np.mean(residual**2)) < 2.5 * press.sigma
        assert nrmse(image, press.truth) < 0.02


def test_the_force_of_few_pressed_cells_is_not_that_of_all_taxels_noise(covered):
    blur = covered((16, 16))
    scene, image = Scene(blur, SIGMA), np.zeros((16, 16), np.float32)
    image[6:9, 7:9] = 20 * SIGMA
    force = float((blur.reach * image).sum())
    frame = blur.forward(image)
    scene.look(frame + np.float32(2 * SIGMA / 16))  # two standard deviations of the sum of 256 taxels
    scene.keep_force(image.reshape(-1))
    assert (blur.reach * image).sum() == pytest.approx(force, rel=0.03)  # 27 % more than that is in the frame
