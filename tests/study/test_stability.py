import csv
import json

import numpy as np
import pytest
from typer.testing import CliRunner

from tactiled.cli.app import app
from tactiled.config.example import GRASP
from tactiled.restore.methods import Restorer
from tactiled.study import stability
from tactiled.study.faults import SWEEPS, Setting, cases, sweeps
from tactiled.study.skin import configured, rubber
from tactiled.study.stability import Row, breaks, curve, lines, restore, verdict
from tests.study import false_warnings, fault_pairs

SETTING = Setting(rubber(1.5, 12), 1, ("punches",))
SWEEP = {sweep.name: sweep for sweep in SWEEPS}


def case(**faults):
    (one,) = cases(SETTING, {name.replace("_", " "): value for name, value in faults.items()})
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
        ({30: 1.4, 50: 1.1, 100: 0.5}, 100, [50]),
    ],
)
def test_a_method_breaks_at_the_first_value_over_the_limit_on_either_side(ratios, harmless, values):
    assert breaks(ratios, harmless) == values


def test_a_curve_is_the_ratio_of_mean_errors():
    rows = [row(0, 0.2, scene="a"), row(0, 0.6, scene="b"), row(0, 1.0, "raw", "a"), row(0, 1.0, "raw", "b")]
    assert curve(rows, "auto") == pytest.approx({0: 0.4})


def test_the_table_has_places_of_failures_and_how_many_are_noticed():
    rows = sweep_of({-5: 1.2, 0: 0.5, 2: 1.4}) + sweep_of({5: 1.3}, flagged=True)
    (line,) = lines([(SWEEP["offset"], rows)])
    assert line == ("offset (% of the peak)", "auto −5, 2", "1.40 at 2", "1 of 3")
    (line,) = lines([(SWEEP["offset"], sweep_of({0: 0.5, 2: 0.6}))])
    assert line == ("offset (% of the peak)", "none", "0.60 at 2", "nothing to notice")


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
    assert row(0, 1.5, **other).noticed is noticed
    results = [(SWEEP["offset"], [row(5, 1.5, **other), row(5, 0.9), row(5, 1.5, "nnls")])]
    assert f"show it by nothing: {int(not noticed)} of 2" in verdict(results)[0]


def test_warnings_with_the_right_settings_are_counted_on_good_images():
    rows = [row(1, 0.5), row(1, 0.5, warnings=("negative",)), row(1, 1.5, warnings=("negative",))]
    assert (
        verdict([(SWEEP["cover"], rows), (SWEEP["offset"], rows)])[1]
        == "Warnings on 3 images with the right settings: 1."
    )


@pytest.mark.parametrize("sweep", SWEEPS, ids=lambda sweep: sweep.name)
def test_every_sweep_is_deterministic_and_its_worst_value_changes_the_frame(sweep):
    assert sweep.harmless in sweep.values
    first, second = (next(cases(SETTING, {sweep.name: sweep.harmless})) for _ in range(2))
    assert np.array_equal(first.frame, second.frame)
    assert first.frame.dtype == np.float32
    assert first.frame.shape == first.truth.shape == (12, 12)
    worst = max(sweep.values, key=lambda value: abs(value - sweep.harmless))
    other = next(cases(SETTING, {sweep.name: worst}))
    assert not np.array_equal(other.frame, first.frame) or other.noise != first.noise


def test_missing_taxels_are_flagged():
    clean, dead = case(dead_taxels=0), case(dead_taxels=10)
    assert np.count_nonzero(dead.flags) == 14
    assert np.array_equal(dead.frame[dead.flags == 0], clean.frame[dead.flags == 0])
    assert np.isin(np.count_nonzero(case(messages_lost=10).flags), (14, 15))


def test_faults_add_up():
    clean = case()
    assert np.array_equal(case(offset=5).frame > clean.frame, np.ones((12, 12), bool))
    assert np.count_nonzero(case(dead_taxels_unflagged=5, offset=5).frame == 0) == 7
    assert case(saturation_unflagged=60, white_noise=10).frame.max() < 0.62 * clean.frame.max()
    assert case(white_noise=10).noise == pytest.approx(10 * clean.noise)
    assert case(correlated_noise=10).noise == pytest.approx(np.hypot(10, 1) * clean.noise)
    assert not np.allclose(case(thickness_wrong=-20).frame, clean.frame, atol=5 * clean.noise)


def test_a_drift_grows_from_the_frames_before_which_the_method_restores_first(monkeypatch):
    slow, fast = case(drift=0.1), case(drift=20)
    assert slow.before.shape == fast.before.shape == (23, 12, 12)
    assert 5 < 100 * np.abs(fast.frame - slow.frame).max() / slow.frame.max() < 80
    assert np.abs(fast.before[-1] - fast.frame).max() < np.abs(fast.before[11] - fast.frame).max()
    calls, call = [], Restorer.__call__
    monkeypatch.setattr(Restorer, "__call__", lambda *each: calls.append(1) or call(*each))
    restore("drift", 20, fast)
    assert len(calls) == 24 * (1 + len(stability.OURS))


@pytest.mark.parametrize(("value", "noticed"), [(0.5, False), (1, False), (3, True), (10, True)])
def test_noise_that_the_service_measures_is_noticed(value, noticed):
    assert all(
        (stability.NOISY in each.warnings) is noticed for each in restore("", value, case(noise_misjudged=value))
    )


def test_a_configured_layout_is_swept_where_no_grid_is_needed(tmp_path):
    (tmp_path / "it.toml").write_text(GRASP)
    layout = Setting(configured(tmp_path / "it.toml"), 1, ("blobs",))
    allowed = sweeps(layout)
    assert [sweep.grid for sweep in SWEEPS].count(True) == 5 == len(SWEEPS) - len(allowed)
    for sweep in allowed:
        one = next(cases(layout, {sweep.name: sweep.values[-1]}))
        assert [each.method for each in restore(sweep.name, 0, one)] == ["raw", *stability.OURS]


def test_command_writes_charts_and_tables(tmp_path, monkeypatch):
    monkeypatch.setattr("tactiled.study.faults.SWEEPS", tuple(SWEEP[name] for name in ("cover", "offset")))
    monkeypatch.setattr(stability, "setting", lambda *_: (SETTING, slice(0, 2)))
    done = CliRunner().invoke(app, ["bench", "stability", "--quick", "--out", str(tmp_path)])
    assert done.exit_code == 0, done.output
    for name in ("stability.svg", "calibration.svg"):
        assert (tmp_path / name).read_text().startswith("<?xml")
    assert "│ offset (% of the" in done.output
    assert max(len(line) for line in done.output.splitlines() if "│" in line) <= 80
    images = list(csv.DictReader((tmp_path / "stability.csv").read_text().splitlines()))
    assert {each["method"] for each in images} == {"raw", *stability.OURS, *stability.PEERS}
    assert len(json.loads((tmp_path / "stability.json").read_text())["table"]) == 2


def test_every_pair_of_faults_is_made_and_judged(monkeypatch):
    monkeypatch.setattr(
        fault_pairs, "FAULTS", {"white noise": (3, 10), "offset": (-5, 5), "thickness wrong": (-20, 20)}
    )
    pairs = list(fault_pairs.measure(SETTING, bad_only=True))
    assert pairs[0].name == "white noise 10 % with offset 5 %"
    assert len(pairs) == 3
    assert all(bool(pair.noticed) == (pair.over_raw["auto"] > stability.WORSE) for pair in pairs)
    assert len(list(fault_pairs.measure(SETTING, bad_only=False))) == 12


def test_frames_with_nothing_wrong_have_no_warning():
    assert false_warnings.measure((1.0,), 12, (0.02,), 1, 1) == (7, {})
