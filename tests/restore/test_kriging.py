"""What completes frames, against the same by dense matrices."""

import numpy as np
import pytest

from tactiled.frames import MISSING
from tactiled.restore.inpaint import Inpainter
from tactiled.restore.kriging import Gaps
from tactiled.restore.prior import MAX_KEPT
from tactiled.restore.scene import Scene

SIGMA = 0.5


@pytest.fixture(params=["a grid", "finer cells", "no grid"])
def scene(covered, request):
    """Of 6 x 6 taxels, on a surface that goes on beyond them."""
    refine, layout = {"a grid": (1, False), "finer cells": (2, False), "no grid": (1, True)}[request.param]
    scene = Scene(covered((6, 6), 1.5, refine, layout, beyond=True), SIGMA)
    scene.gain_variance[...] = 0  # nothing but noise and the spectrum
    scene.spectrum = scene.prior.spectra[len(scene.prior.spectra) // 2]
    return scene


def normal(scene):
    """What taxels feel (N, M) by the modes, and the pressure's covariance (M, M), over the noise's variance."""
    modes, wide = scene.modes, scene.array.wide
    V, U = np.kron(*modes.surface), np.kron(*modes.taxel)
    if wide.felt is None:
        there = np.zeros([len(basis) for basis in modes.taxel], bool)
        there[wide.own] = True
        felt = (U * modes.gain.ravel())[there.ravel()] @ V.T
    else:
        felt = wide.felt
    return felt, (V * scene.spectrum.ratio.ravel()) @ V.T


def test_the_linear_image_of_a_completed_frame_is_the_mean_given_the_frame(scene):
    felt, S = normal(scene)
    y = np.random.default_rng(1).normal(0, 5, scene.array.frame_shape).astype(np.float32)
    expected = S @ felt.T @ np.linalg.solve(felt @ S @ felt.T + np.eye(len(felt)), y.ravel())
    modes, ratio = scene.modes, scene.spectrum.ratio
    c = modes.taxel[0].T @ scene.kriging(y, scene.spectrum) @ modes.taxel[1]
    linear = modes.surface[0] @ (modes.gain * ratio / (modes.gain**2 * ratio + 1) * c) @ modes.surface[1].T
    assert np.linalg.norm(linear.ravel() - expected) < 0.01 * np.linalg.norm(expected)


def test_the_precision_of_a_taxel_is_that_by_the_others(scene):
    felt, S = normal(scene)
    expected = np.linalg.inv(felt @ S @ felt.T + np.eye(len(felt)))
    shape = scene.array.frame_shape
    each = np.eye(len(felt), dtype=np.float32).reshape(-1, *shape)
    ours = np.array([scene.kriging.precise(one, scene.spectrum).ravel().copy() for one in each])
    np.testing.assert_allclose(ours, expected, atol=1e-3 * expected.max())
    np.testing.assert_allclose(scene.kriging.precision(scene.spectrum).ravel(), expected.diagonal(), rtol=1e-2)
    some = np.zeros(shape, bool)
    some.flat[5:9] = True
    np.testing.assert_allclose(scene.kriging.rows(some, scene.spectrum), expected[5:9], atol=1e-3 * expected.max())


@pytest.mark.parametrize("at_once", [True, False])
def test_a_hole_in_a_frame_is_the_mean_given_the_others(scene, at_once, monkeypatch):
    if not at_once:
        monkeypatch.setattr("tactiled.restore.inpaint.MAX_SOLVED", 0)
    error, hole = (1e-3, slice(7, 20)) if at_once else (0.1, slice(7, 9))
    lost = np.zeros(scene.array.frame_shape, np.uint8)
    lost.flat[hole] = MISSING
    y = np.cumsum(np.random.default_rng(1).normal(0, 50, lost.shape), axis=-1).astype(np.float32)
    inpainter = Inpainter(scene)
    inpainter.weigh(None)
    inpainter.mask(y, lost)
    filled = inpainter.fill().ravel()
    scene.spectrum = inpainter._spectrum
    felt, S = normal(scene)
    C, known = felt @ S @ felt.T + np.eye(len(felt)), lost.ravel() == 0
    expected = C[np.ix_(~known, known)] @ np.linalg.solve(C[np.ix_(known, known)], y.ravel()[known])
    assert np.linalg.norm(filled[~known] - expected) < error * np.linalg.norm(expected)


@pytest.mark.parametrize("missing", [0, 3])
def test_what_no_taxel_reads_is_in_the_variance(scene, missing):
    felt, S = normal(scene)
    lost = np.zeros(scene.array.frame_shape, bool)
    lost.flat[7 : 7 + missing] = True
    known = felt[~lost.ravel()]
    exact = S - S @ known.T @ np.linalg.solve(known @ S @ known.T + np.eye(len(known)), known @ S)
    modes, ratio = scene.modes, scene.spectrum.ratio
    full = [basis**2 for basis in modes.surface]
    of_full = full[0] @ (ratio / (modes.gain**2 * ratio + 1)) @ full[1].T
    gaps = Gaps(lost, np.zeros(missing), np.ones(lost.shape)) if missing else None
    ours = of_full + scene.kriging.unfelt(scene.spectrum, gaps)
    np.testing.assert_allclose(ours.ravel(), exact.diagonal(), rtol=0.03)


def test_a_frame_is_the_same_whatever_was_restored_before_it(covered, monkeypatch):
    """Where near spectra share a matrix it is of a fixed one, not of the one that was met first."""
    monkeypatch.setattr("tactiled.restore.kriging.FEW_VALUES", 0)
    fresh, used = (Scene(covered((6, 6), 1.5, beyond=True), SIGMA) for _ in range(2))
    y = np.random.default_rng(1).normal(0, 5, (6, 6)).astype(np.float32)
    for spectrum in used.prior.spectra:
        used.kriging(y, spectrum)
    assert len(used.kriging._matrices) < len(used.prior.spectra) / 2
    for spectrum in fresh.prior.spectra[::-7]:
        np.testing.assert_array_equal(fresh.kriging(y, spectrum), used.kriging(y, spectrum))


def test_arrays_that_are_alike_share_what_is_made_of_a_spectrum_whatever_their_noise(covered, monkeypatch):
    y = np.random.default_rng(1).normal(0, 5, (6, 6)).astype(np.float32)
    one, other, thin = (
        Scene(covered((6, 6), t, beyond=True), sigma) for t, sigma in ((1.5, 1), (1.5, 2), (1.4, 1))
    )
    expected = one.kriging(y, one.prior.spectra[40]).copy()
    near = thin.kriging(y, thin.prior.spectra[40]).copy()
    monkeypatch.setattr(np.linalg, "solve", None)
    np.testing.assert_array_equal(other.kriging(y, other.prior.spectra[40]), expected)
    assert (near != expected).any()


def test_no_spectrum_costs_memory_without_end(covered, monkeypatch):
    monkeypatch.setattr("tactiled.restore.prior.MAX_KEPT_VALUES", 3 * 28 * 36)
    scene = Scene(covered((6, 6), 1.5, beyond=True), SIGMA)
    for spectrum in scene.prior.spectra[:9]:
        scene.kriging(np.ones((6, 6), np.float32), spectrum)
    assert len(scene.kriging._matrices) <= 3


def test_of_many_holes_few_are_kept_and_the_one_that_comes_again_is(covered):
    scene, random = Scene(covered((6, 6), 1.5, beyond=True), SIGMA), np.random.default_rng(1)
    kriging, spectrum = scene.kriging, scene.prior.spectra[0]
    dead = np.arange(36).reshape(6, 6) == 8
    first = kriging.rows(dead, spectrum)
    for _ in range(2 * MAX_KEPT):
        kriging.rows(random.random((6, 6)) < 0.3, spectrum)
        assert kriging.rows(dead, spectrum) is first
    assert len(kriging._of_taxels) <= MAX_KEPT
