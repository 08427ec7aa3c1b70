import numpy as np
import pytest
from typer.testing import CliRunner

import tactiled.cli
from tactiled.cli.app import app
from tactiled.restore.methods import METHODS, make
from tactiled.study import restore as bench
from tactiled.study.restore import OURS, accuracy, moving, nrmse, speed
from tactiled.study.truth import DRAWN, PEAK, presses


@pytest.fixture
def few():
    """Every scene once, small, at one thickness and noise."""
    return list(presses(16, (1.0,), (0.01,)))


def test_presses_are_blurred_truth_with_the_noise_they_say(few):
    assert [press.scene for press in few] == list(DRAWN)
    for press in few:
        assert press.frame.shape == press.truth.shape == (16, 16)
        assert 0.3 * PEAK < press.truth.max() < 12 * PEAK
        assert press.truth.min() >= 0
        assert press.sigma == pytest.approx(0.01 * press.frame.max(), rel=0.1)
        assert press.psf.shape[0] % 2 == 1
        assert np.unravel_index(press.psf.argmax(), press.psf.shape) == (press.psf.shape[0] // 2,) * 2
        predicted = press.blur.forward(press.truth)
        within = 0.4 if press.scene == "points" else 0.08  # what lies between taxels is not in the truth's cells
        assert nrmse(predicted, press.frame) < within


@pytest.mark.parametrize("method", METHODS)
def test_no_method_explodes_on_loads_far_smaller_than_its_cells(method):
    for press in presses(16, (1.0,), (0.002,)):
        image = make(method, press.blur, press.sigma)(press.frame).image
        assert np.abs(image).max() < 3 * max(press.truth.max(), press.frame.max()), press.scene


def test_the_same_seed_draws_the_same_presses(few):
    for first, second in zip(few, presses(16, (1.0,), (0.01,)), strict=True):
        np.testing.assert_array_equal(first.frame, second.frame)


def test_auto_is_nearer_the_truth_than_skimage_that_knows_it(few):
    found = accuracy(iter(few))
    assert found.mean("auto") < found.mean("best") < found.mean("raw")
    assert found.slips("auto") == 0
    assert found.mean("rl") < found.mean("skimage rl 30")
    assert found.worst("auto") < 1.02
    assert found.mean("best") <= min(found.mean("skimage wiener"), found.mean("skimage rl"))


@pytest.mark.parametrize(
    ("thicknesses", "seed", "least"),
    [
        ((0.2, 0.35, 0.5), 77, 0.8),  # by pressure that steps from cell to cell ten were worse, up to 2.7 times
        ((0.05, 0.1, 0.35, 0.5), 11, 0.75),  # without weighing what restoring spares, seven, up to 1.47 times
        ((0.05, 0.1, 0.35, 0.5), 14, 0.8),  # five
    ],
)
def test_auto_leaves_alone_what_restoring_may_harm(thicknesses, seed, least):
    found = [
        (
            nrmse(make("auto", press.blur, press.sigma)(press.frame).image, press.truth),
            nrmse(press.frame, press.truth),
        )
        for press in presses(16, thicknesses, (0.002, 0.01), seed=seed)
    ]
    assert len(found) == 14 * len(thicknesses)
    assert max(auto / raw for auto, raw in found) < 1.02
    assert np.mean([auto for auto, _ in found]) < least * np.mean([raw for _, raw in found])


def test_speed_is_measured_side_by_side():
    found = speed(16, 0.05)
    assert set(found.times) == {"skimage wiener", "skimage rl", "FFT pair", *OURS}
    assert found.ratio("skimage wiener", "wiener") > 0
    assert found.ratio("skimage rl", "rl") > 0
    assert set(found.jitter) == set(found.times)
    assert min(found.jitter.values()) >= 1


def test_jitter_of_one_frame_is_that_of_all_runs(monkeypatch):
    """Two runs in a thousand that take a hundred times as long, in every round."""
    monkeypatch.setattr(bench, "timed", lambda *_: np.repeat([1.0, 100.0], [998, 2]))
    found = speed(16, 0.05)
    assert set(found.times.values()) == {1.0}
    assert set(found.jitter.values()) == {100.0}


def test_moving_scenes_and_an_idle_pad():
    found = moving(16, 20)
    assert sum(found.chosen.values()) == 100
    assert found.idle < found.median <= found.p99 <= found.worst


def test_the_command_knows_its_options():
    assert tactiled.cli
    result = CliRunner().invoke(app, ["bench", "restore", "--help"], env={"COLUMNS": "200", "NO_COLOR": "1"})
    assert result.exit_code == 0
    assert "--quick" in result.output
