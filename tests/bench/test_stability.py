import csv
import json

import numpy as np
import pytest

from tactiled.bench import stability
from tactiled.bench.faults import SWEEPS, Setting, cases, sweeps
from tactiled.bench.skin import configured, rubber
from tactiled.bench.stability import Row, breaks, curve, lines, restore, verdict
from tactiled.config.example import GRASP
from tests.cli.commands import succeed

SETTING = Setting(rubber(1.5, 12), 1, ("punches",))
SWEEP = {sweep.name: sweep for sweep in SWEEPS}


def case(sweep, value):
    (one,) = cases(SETTING, SWEEP[sweep], value)
    return one


def row(value, over_raw, method="auto", scene="punches", **other):
    fields = {"sweep": "offset", "used": method, "error": 4.0, "stated": 1.0, "flagged": False} | other
    return Row(value=value, scene=scene, method=method, nrmse=0.5 * over_raw, over_raw=over_raw, **fields)


def sweep_of(ratios, **other):
    """Rows of auto, and of a raw image of error 0.5."""
    return [row(value, ratio, **other) for value, ratio in ratios.items()] + [row(v, 1.0, "raw") for v in ratios]


@pytest.mark.parametrize(
    ("ratios", "harmless", "values"),
    [
        ({-10: 1.5, -5: 1.1, -1: 1.0, 0: 0.5, 1: 0.9, 2: 1.03, 5: 0.9, 10: 2.0}, 0, [-5, 2]),
        ({-10: 1.5, 10: 2.0}, 10, [10]),
        ({0: 0.5, 1: 1.02}, 0, []),
    ],
)
def test_a_method_breaks_at_the_first_value_over_the_limit_on_either_side(ratios, harmless, values):
    assert breaks(ratios, harmless) == values


def test_the_table_has_places_of_failures_and_how_many_are_noticed():
    rows = sweep_of({-5: 1.2, 0: 0.5, 2: 1.4}) + sweep_of({5: 1.3}, flagged=True)
    (line,) = lines([(SWEEP["offset"], rows)])
    assert line == ("offset (% of the peak)", "auto −5, 2", "1.40 at 2", "1 of 3")
    (line,) = lines([(SWEEP["offset"], sweep_of({0: 0.5, 2: 0.6}))])
    assert line == ("offset (% of the peak)", "none", "0.60 at 2", "nothing to notice")
    scenes = [row(0, 0.2, scene="a"), row(0, 0.6, scene="b"), row(0, 1.0, "raw", "a"), row(0, 1.0, "raw", "b")]
    assert curve(scenes, "auto") == pytest.approx({0: 0.4})


@pytest.mark.parametrize(
    ("other", "noticed"),
    [
        ({}, False),
        ({"flagged": True}, True),
        ({"warnings": ("negative",)}, True),
        ({"stated": 2.0}, True),
        ({"stated": np.nan}, False),
    ],
)
def test_flags_warnings_and_honest_deviations_are_noticed(other, noticed):
    results = [
        (SWEEP["offset"], [row(5, 1.5, **other), row(5, 0.9), row(5, 1.5, "nnls")]),
        (SWEEP["cover"], [row(1, 0.5), row(1, 0.5, warnings=("negative",)), row(1, 1.5, warnings=("negative",))]),
    ]
    silent, false_warnings = verdict(results)
    assert silent.endswith(f"show it by nothing: {int(not noticed)} of 5.")
    assert false_warnings == "Warnings on 3 images with the right settings: 1."


@pytest.mark.parametrize("sweep", SWEEPS, ids=lambda sweep: sweep.name)
def test_every_sweep_is_deterministic_and_its_worst_value_changes_the_frame(sweep):
    first, second = (next(cases(SETTING, sweep, sweep.harmless)) for _ in range(2))
    assert np.array_equal(first.frame, second.frame)
    assert first.frame.dtype == np.float32
    assert first.frame.shape == first.truth.shape == (12, 12)
    worst = max(sweep.values, key=lambda value: abs(value - sweep.harmless))
    other = next(cases(SETTING, sweep, worst))
    assert not np.array_equal(other.frame, first.frame) or other.noise != first.noise


def test_faults_are_as_large_as_stated():
    clean, peak = case("dead taxels", 0), case("dead taxels", 0).peak_kpa
    assert clean.noise == 0.01 * peak
    dead = case("dead taxels", 10)
    assert np.count_nonzero(dead.flags) == 14
    assert np.array_equal(dead.frame[dead.flags == 0], clean.frame[dead.flags == 0])
    assert np.isin(np.count_nonzero(case("messages lost", 10).flags), (14, 15))
    unflagged = case("dead taxels unflagged", 5)
    assert (np.count_nonzero(unflagged.frame == 0), unflagged.flags.any()) == (7, False)
    np.testing.assert_allclose(case("offset", 5).frame - clean.frame, 0.05 * peak, rtol=1e-3)
    assert case("saturation unflagged", 60).frame.max() == pytest.approx(0.6 * peak)
    assert case("white noise", 10).noise == pytest.approx(10 * clean.noise)
    assert case("correlated noise", 10).noise == pytest.approx(np.hypot(10, 1) * clean.noise)
    assert not np.allclose(case("thickness wrong", -20).frame, clean.frame, atol=5 * clean.noise)


def test_a_drift_grows_from_the_frames_before():
    slow, fast = case("drift", 0.1), case("drift", 20)
    assert slow.before.shape == fast.before.shape == (23, 12, 12)
    assert 5 < 100 * np.abs(fast.frame - slow.frame).max() / slow.frame.max() < 80
    assert np.abs(fast.before[-1] - fast.frame).max() < np.abs(fast.before[11] - fast.frame).max()


def test_noise_that_the_service_measures_is_noticed():
    for value in (1, 3):
        rows = restore("", value, case("noise misjudged", value))
        assert all(("noise_high" in each.warnings) is (value == 3) for each in rows)


def test_a_configured_layout_is_swept_where_no_grid_is_needed(tmp_path):
    (tmp_path / "it.toml").write_text(GRASP)
    layout = Setting(configured(tmp_path / "it.toml"), 1, ("blobs",))
    allowed = sweeps(layout)
    assert len(SWEEPS) - len(allowed) == 5
    for sweep in allowed:
        one = next(cases(layout, sweep, sweep.values[-1]))
        assert [each.method for each in restore(sweep.name, 0, one)] == ["raw", *stability.OURS]


def test_command_writes_charts_and_tables(tmp_path, monkeypatch):
    monkeypatch.setattr("tactiled.bench.faults.SWEEPS", tuple(SWEEP[name] for name in ("cover", "offset")))
    setting = Setting(SETTING.skin, 1, SETTING.scenes, step=8)
    monkeypatch.setattr(stability, "setting", lambda *_: setting)
    output = succeed("bench", "stability", "--quick", "--out", tmp_path)
    for name in ("stability.svg", "calibration.svg"):
        assert (tmp_path / name).read_text().startswith("<?xml")
    assert "│ offset (% of the" in output
    assert max(len(line) for line in output.splitlines() if "│" in line) <= 80
    images = list(csv.DictReader((tmp_path / "stability.csv").read_text().splitlines()))
    assert {each["method"] for each in images} == {"raw", *stability.OURS, *stability.PEERS}
    assert len(json.loads((tmp_path / "stability.json").read_text())["table"]) == 2
