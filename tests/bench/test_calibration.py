import numpy as np
import pytest

from tactiled.bench import calibration
from tactiled.bench.calibration import lines, write
from tactiled.bench.presses import Disc, HalfPlane
from tactiled.cover.kernel import solve
from tactiled.cover.operator import matrix
from tactiled.cover.stack import Layer, Stack
from tactiled.geometry import grid

ARRAY = grid(6, 6, 1.0, 0.8)
COVER = solve(Stack((Layer(0.8, 0.6, 0.48), Layer(1.0, 980.0, 0.3)), 1), "layered")
GRAIN = 0.1  # mm


@pytest.mark.parametrize(
    ("shape", "inside"),
    [
        (Disc(0.3, -0.4, 1.1), lambda x, y: np.hypot(x - 0.3, y + 0.4) < 1.1),
        (HalfPlane(0.2, 0.5), lambda x, y: x * np.cos(0.5) + y * np.sin(0.5) > 0.2),
    ],
)
def test_readings_are_those_of_fine_cells(shape, inside):
    cells = np.stack(np.meshgrid(*2 * (np.arange(-12, 12, GRAIN) + GRAIN / 2,)), axis=-1).reshape(-1, 2)
    pressed = cells[inside(*cells.T)]
    expected = matrix(COVER, ARRAY, pressed + 2.5, GRAIN).sum(axis=1)
    np.testing.assert_allclose(shape.readings(ARRAY, COVER), expected, atol=0.01)


def test_a_skin_is_calibrated_and_held_against_the_truth(tmp_path, monkeypatch):
    monkeypatch.setattr(calibration, "WAYS", {"tip": (10, 1.0, calibration.tip_fit)})
    monkeypatch.setattr(calibration, "LARGE", 10)
    monkeypatch.setattr(calibration, "RESTORED_SKINS", 1)
    monkeypatch.setattr(calibration, "LARGE_S", 6.0)
    results = calibration.measure(1, seed=3)
    assert np.abs(results.gain_errors).max() < calibration.GAIN_AIM
    assert abs(results.trials[0].error) < calibration.AIMS["tip"]
    assert all(each.after < calibration.NRMSE_AIM * each.true for each in results.restored)
    assert len(results.restored) >= len(calibration.TEST_SCENES) - 2
    assert len({line[0] for line in lines(results)}) == len(lines(results))
    write(tmp_path, results)
    assert (tmp_path / "calibration_trials.svg").exists()
    assert "tip,0," in (tmp_path / "calibration_trials.csv").read_text()
    alone = calibration.measure(1, 3, "tip")
    assert alone.trials[0][:-1] == results.trials[0][:-1]
    assert len(lines(alone)) < len(lines(results))
