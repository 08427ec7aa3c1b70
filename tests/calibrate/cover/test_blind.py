"""The cover's thickness from the tour's scenes, which shaped no constant, blurred by the exact kernel."""

import numpy as np
import pytest

from tactiled.bench.presses import Disc, press_series, simulated_skin
from tactiled.calibrate.counts.calibration import Calibration
from tactiled.calibrate.cover import blind, deblur
from tactiled.calibrate.cover.blind import (
    LOG_FACTORS,
    MODEL_ERROR,
    WEIGHT_ERROR,
    Frames,
    Profiles,
    _fit,
    fit_blind,
    simulate,
)
from tactiled.calibrate.cover.deblur import REFINE, Convolution, Precision, deblurred
from tactiled.calibrate.cover.recorded_touch import RecordedTouch, fit_touch
from tactiled.cover.family import CoverFamily
from tactiled.cover.operator import stencil
from tactiled.cover.stack import Layer, Stack
from tactiled.frames import FrameSeries
from tactiled.geometry import grid, layout
from tactiled.simulate.array import Surface
from tactiled.simulate.scenes import SCENES
from tests.calibrate.files import gain_section

SIZE, NOISE = 20, 0.1
ARRAY = grid(SIZE, SIZE, 1.0, 0.8)
BOARD = Layer(1.0, 980.0, 0.3)
SHARP = ("ring", "indenters", "edge", "sphere", "ring")


def rubber(thickness):
    return Stack((Layer(thickness, 0.6, 0.48), BOARD))


def blob(width):
    """A press without an edge, its width in mm."""
    return lambda x, y, *_: 90 * np.exp(-(x**2 + y**2) / (2 * width**2))


def pressed(thickness, scenes, seed, gain_error=0.0):
    """Frames (T, SIZE, SIZE) in kPa: two of each scene, 20 ms apart, and twelve without contact after each."""
    surface, random = (
        Surface(CoverFamily(rubber(thickness)).kernel(1.0), ARRAY, finer=8),
        np.random.default_rng(seed),
    )
    start = random.uniform(0, 60)
    frames = []
    for n, scene in enumerate(scenes):
        draw = SCENES[scene] if isinstance(scene, str) else scene
        at = start + 8 * n + np.arange(2) / 50
        frames += [surface.sense(draw(surface.x, surface.y, t, surface.size, surface.grain)) for t in at]
        frames += [np.zeros(ARRAY.size)] * 12
    gains = 1 + gain_error * random.normal(size=ARRAY.size)
    noisy = gains * np.array(frames) + random.normal(0, NOISE, (len(frames), ARRAY.size))
    return noisy.reshape(-1, SIZE, SIZE)


def check(fit, thickness, factor):
    assert fit.reason == ""
    assert fit.factor == pytest.approx(factor, rel=0.1)
    assert fit.interval[0] < factor < fit.interval[1]
    assert fit.interval[1] < 1.4 * fit.interval[0]
    assert fit.thickness_mm == pytest.approx(thickness, rel=0.1)
    assert 0.5 < fit.residual < 1.1


def test_the_thickness_is_within_10_percent_and_its_interval_covers_it():
    frames = pressed(0.7, SHARP, seed=8, gain_error=0.01)
    frames[:, np.random.default_rng(1).permutation(ARRAY.size).reshape(SIZE, SIZE) < 8] = np.nan
    check(fit_blind(frames, NOISE, CoverFamily(rubber(0.7 / 1.35)), ARRAY), 0.7, 1.35)


def test_a_recording_s_counts_tell_the_same_whatever_taxels_rest_at():
    rest = np.random.default_rng(8).normal(500, 100, ARRAY.size)
    counts = (rest + pressed(1.5, SHARP, seed=0, gain_error=0.01).reshape(-1, ARRAY.size) / 0.05).astype(
        np.float32
    )
    series, curves = FrameSeries(np.arange(len(counts)) / 100, counts), gain_section(np.full(400, 0.05)).curves
    calibration = Calibration(0.05, 500, noise_kpa=NOISE, curves=curves)
    check(fit_touch(RecordedTouch(series, ARRAY, rubber(2.0), calibration, (0, 65535)), "blind", None), 1.5, 0.75)


@pytest.mark.parametrize(
    "scenes", [[blob(width) for width in (1.8, 2.2, 2.7, 3.2)], ["fingertip"] * 4], ids=["blobs", "fingertips"]
)
def test_scenes_without_a_sharp_edge_do_not_tell(scenes):
    fit = fit_blind(pressed(1.0, scenes, seed=2), NOISE, CoverFamily(rubber(1.0)), ARRAY)
    assert "sharp edges in 0 of 4 scenes: press more coins or keys" in fit.reason
    assert fit.interval[1] > 4 * fit.interval[0]


def test_a_narrow_tip_does_not_tell():
    random = np.random.default_rng(1)
    skin = simulated_skin(rubber(0.6), ARRAY, random, NOISE, spread=0.0)
    tips = [Disc(*random.uniform(-5, 5, 2), 0.5) for _ in range(3)]
    series = press_series(skin, tips, np.full(3, 100.0), random)
    frames = ((series.counts - skin.no_load) * skin.kpa_per_count).reshape(-1, SIZE, SIZE)[::6]
    fit = fit_blind(frames, NOISE, CoverFamily(rubber(0.66)), ARRAY)
    assert fit.interval_mm[1] < 0.6
    assert "narrower than three taxels" in fit.reason


def profiles(best, slope):
    """Scenes whose misfit is least at logarithms `best` (S,), and whose cells grow by `slope`."""
    chi2, cells = 500 * (LOG_FACTORS - best[:, None]) ** 2, np.tile(slope * LOG_FACTORS, (len(best), 1))
    sharp, area = np.ones_like(chi2), np.full_like(chi2, 100)
    rest = np.full(len(best), 125.0), sharp, area, np.arange(len(best)), np.full(len(best), 100)
    return Profiles(chi2, cells, *rest)


def test_intervals_of_four_scenes_that_disagree_hold_as_often_as_they_say(monkeypatch):
    random, family = np.random.default_rng(9), CoverFamily(rubber(1.0))
    monkeypatch.setattr(blind, "MODEL_ERROR", 0.0)
    ends = np.array([_fit(profiles(random.normal(0, 0.03, 4), 0.0), family).interval for _ in range(300)])
    assert 0.92 < ((ends[:, 0] < 1) & (ends[:, 1] > 1)).mean() < 0.98


def test_scenes_that_agree_are_as_uncertain_as_the_weight_of_cells():
    low, high = _fit(profiles(np.zeros(4), 40.0), CoverFamily(rubber(1.0))).interval
    moved = 40 / (2 * 500)  # by twice the weight
    assert np.log(high / low) / 2 == pytest.approx(1.96 * np.hypot(WEIGHT_ERROR * moved, MODEL_ERROR), rel=0.05)


def test_what_simulated_scenes_are_off_by_is_taken_off_and_part_of_the_interval():
    kept, moved = profiles(np.zeros(4), 40.0), profiles(np.full(4, 0.1), 40.0)
    plain, corrected = (_fit(kept, CoverFamily(rubber(1.0)), each) for each in (None, lambda *_: moved))
    assert np.log(corrected.factor) == pytest.approx(np.log(plain.factor) - 0.1, abs=0.006)
    half, more = (np.log(each.interval[1] / each.interval[0]) / 2 for each in (plain, corrected))
    assert np.hypot(half, 1.96 * blind.BIAS_ERROR * 0.1) == pytest.approx(more, rel=0.05)


def test_simulated_frames_are_flat_things_with_the_same_outlines():
    array, family = grid(12, 12, 1.0), CoverFamily(rubber(0.8))
    block = np.zeros((1, 32, 32), np.float32)
    block[0, 9:20, 10:22] = 1000 * (1 + 0.3 * np.sin(np.arange(12)))
    y = Convolution(family, 1.0, array).forward(block)
    y[0, 5, 5] = np.nan
    simulated = simulate(
        Frames(y, np.zeros(1, np.intp), 0.01, (4.0, 0.0, 0.0)), 1.0, 0.0, (family, array)
    ).over_noise
    block[block > 0] = 1000
    flat = Convolution(family, 1.0, array).forward(block)
    assert np.isnan(simulated[0, 5, 5])
    assert np.nanstd(simulated - flat) < 0.08 * flat.max()
    noise = (simulated - flat)[0, :, [0, 11]]  # beside the block
    assert 1.0 < noise.mean(axis=0).std() < 4.0


def test_gains_do_not_count_as_known_better_than_cells_explain_frames():
    array, family, random = grid(12, 12, 1.0), CoverFamily(rubber(0.8)), np.random.default_rng(2)
    blur = Convolution(family, 1.0, array)
    blocks = np.zeros((3, *blur.cells), np.float32)
    for block, (row, column) in zip(blocks, ((8, 9), (12, 8), (9, 13)), strict=True):
        block[row : row + 10, column : column + 11] = 60
    pressed = np.array([0, 0, 1, 1, 0, 0])[:, None, None]
    frames = np.concatenate([pressed * each for each in blur.forward(blocks)])
    frames = frames + random.normal(0, 0.1, frames.shape)
    fits = [fit_blind(frames, 0.1, family, array, error) for error in (0.001, 0.01, 0.1)]
    assert fits[0].residual == fits[1].residual > fits[2].residual
    assert ["calibrate the gain first" in " ".join(each.notes) for each in fits] == [False, False, True]


@pytest.mark.parametrize(
    ("frames", "message"),
    [
        (np.zeros((50, SIZE, SIZE)), "0 scenes with a clear contact"),
        (pressed(1.0, ["ring", "edge"], seed=3), "2 scenes with a clear contact"),
    ],
)
def test_too_few_scenes_do_not_tell(frames, message):
    assert message in fit_blind(frames, NOISE, CoverFamily(rubber(1.0)), ARRAY).reason


def test_noise_that_a_blind_fit_does_not_stand_is_named():
    frames = pressed(1.0, SHARP, seed=4) + np.random.default_rng(6).normal(0, 1, (70, SIZE, SIZE))
    assert "% of the pressure" in fit_blind(frames, 1.0, CoverFamily(rubber(1.0)), ARRAY).reason


@pytest.mark.parametrize(
    ("array", "message"),
    [
        (layout(np.random.default_rng(0).uniform(0, 9, (12, 2))), "the array is no grid"),
        (grid(1, 12, 1.0), "the array has 1 x 12 taxels"),
        (grid(12, 1, 1.0), "the array has 12 x 1 taxels"),
    ],
)
def test_an_array_that_a_blind_fit_cannot_use_is_named(array, message):
    frames = np.where(np.arange(9)[:, None] % 3, 0, np.random.default_rng(2).uniform(0, 100, (9, 12)))
    fit = fit_blind(frames.reshape(-1, *array.frame_shape), 0.1, CoverFamily(rubber(1.0)), array)
    assert message in fit.reason


@pytest.mark.parametrize("factor", [0.6, 1.5])
def test_the_convolution_is_the_exact_response_and_its_adjoint_fits(factor):
    array, family, random = grid(7, 9, 1.2, 0.9, "round"), CoverFamily(rubber(1.0)), np.random.default_rng(4)
    blur = Convolution(family, factor, array)
    x, y = (random.random((2, *shape)).astype(np.float32) for shape in (blur.cells, array.frame_shape))
    assert np.vdot(blur.forward(x), y) == pytest.approx(np.vdot(x, blur.adjoint(y)), rel=1e-5)
    cell = np.zeros((1, *blur.cells), np.float32)
    row, column = (n // 2 for n in blur.cells)
    cell[0, row, column] = 1
    exact = stencil(family.kernel(factor), array, REFINE)
    margin = (blur.cells[0] - REFINE * 7) // 2
    for taxel in ((2, 3), (3, 4), (5, 8)):
        offset = tuple(
            at - margin - REFINE * i + REFINE * (n - 1)
            for at, i, n in zip((row, column), taxel, array.frame_shape, strict=True)
        )
        assert blur.forward(cell)[0][taxel] == pytest.approx(exact[offset], abs=2e-4 * exact.max())


def test_pressure_is_not_negative_and_explains_the_taxels_that_work():
    family, random = CoverFamily(rubber(1.0)), np.random.default_rng(5)
    blur = Convolution(family, 1.0, grid(8, 8, 1.0, 0.8))
    true = np.maximum(random.normal(size=(1, *blur.cells)), 0).astype(np.float32)
    y = blur.forward(true)
    weight = np.ones_like(y)
    weight[0, 3, 3] = 0
    spoilt = y + 50 * (1 - weight)
    x = deblurred(blur, spoilt, Precision(weight), np.zeros_like(true), 400)
    assert x.min() >= 0
    np.testing.assert_allclose(blur.forward(x)[weight > 0], y[weight > 0], atol=1e-3 * y.max())


def test_noise_that_rows_columns_and_frames_share_counts_by_its_covariance():
    random, shared = np.random.default_rng(6), (0.5, 0.2, 0.1)
    weight = random.uniform(0.2, 1, (2, 3, 4)).astype(np.float32)
    residual = random.normal(size=(2, 3, 4)).astype(np.float32)
    row, column = np.divmod(np.arange(12), 4)
    common = shared[0] * (row[:, None] == row) + shared[1] * (column[:, None] == column) + shared[2]
    for n, product in enumerate(Precision(weight, shared)(residual)):
        covariance = np.diag(1 / weight[n].ravel().astype(float)) + common
        np.testing.assert_allclose(product.ravel(), np.linalg.solve(covariance, residual[n].ravel()), rtol=1e-4)


def test_pressure_under_a_peak_that_counts_little_is_found_in_few_steps(monkeypatch):
    family, array = CoverFamily(rubber(1.0)), grid(16, 16, 1.0, 0.8)
    blur = Convolution(family, 1.0, array)
    block = np.zeros((1, *blur.cells), np.float32)
    block[0, 12:24, 14:26] = 2000
    y = blur.forward(block)
    precision = Precision(1 / (1 + (0.01 * y) ** 2))
    misfits = []
    for lowest in (deblur.MIN_CURVATURE, 1.0):  # with 1, one step for all cells
        monkeypatch.setattr(deblur, "MIN_CURVATURE", lowest)
        x = deblurred(blur, y, precision, np.zeros_like(block), 60)
        misfits.append(precision.square(blur.forward(x) - y)[0] / y.size)
    assert 20 * misfits[0] < 20 < misfits[1]
