import csv
import json

import numpy as np
import pytest
from typer.testing import CliRunner

from tactiled.cli.app import app
from tactiled.config.example import GRASP
from tactiled.restore.methods import Restorer
from tactiled.study import pairs, stability
from tactiled.study.faults import Setting
from tactiled.study.signs import Signs
from tactiled.study.skin import configured, rubber
from tactiled.study.stability import (
    WORSE,
    Row,
    alarms,
    breaks,
    curve,
    failure,
    limits,
    noticed,
    rows,
    shown,
    table,
)
from tactiled.study.stability_table import HEADINGS, lines
from tactiled.study.sweeps import SWEEPS, sweeps

SMALL = Setting(rubber(1.5, 12), 1, ("punches",))
SWEEP = {sweep.name: sweep for sweep in SWEEPS}


def row(value, over_raw, method="auto", scene="punches", **other):
    told = {
        "sweep": "offset",
        "ran": method,
        "over_wiener": 1.0,
        "error": 4.0,
        "claimed": 1.0,
        "signs": Signs(1.0),
    }
    told |= {"flagged": False} | other
    return Row(value=value, scene=scene, method=method, nrmse=0.5 * over_raw, over_raw=over_raw, **told)


def film(ratios, **other):
    """Rows of auto, and of a raw image of error 0.5."""
    return [row(value, ratio, **other) for value, ratio in ratios.items()] + [row(v, 1.0, "raw") for v in ratios]


def test_breaks_is_the_first_value_over_the_limit_on_either_side():
    ratios = {-10: 1.5, -5: 1.1, -1: 1.0, 0: 0.5, 1: 0.9, 2: 1.03, 5: 0.9, 10: 2.0}
    assert breaks(ratios, 0) == (-5, 2)
    assert breaks(ratios, 0, limit=1.6) == (10,)
    assert breaks(ratios, 10) == (10,)
    assert breaks({0: 0.5, 1: 1.02}, 0) == ()


def test_breaks_reads_a_sweep_that_is_harmless_at_its_high_end():
    assert breaks({30: 1.4, 50: 1.1, 100: 0.5}, 100) == (50,)


def test_curve_is_the_ratio_of_mean_errors():
    found = [row(0, 0.2, scene="a"), row(0, 0.6, scene="b"), row(0, 1.0, "raw", "a"), row(0, 1.0, "raw", "b")]
    assert curve(found, "auto") == pytest.approx({0: 0.4})


def test_a_failure_names_its_place_scene_and_whether_it_was_silent():
    told = failure(SWEEP["offset"], film({0: 0.5, 2: 1.2, 5: 1.4}), "auto")
    assert (told.breaks_at, told.worst_at, told.scene, told.scene_at) == ((2,), 5, "punches", 2)
    assert told.worst == pytest.approx(1.4)
    assert (told.noticed, told.by) == ("no (0 of 2)", "")


def test_what_signs_would_show_is_counted():
    found = film({0: 0.5, 2: 1.2}) + film({5: 1.4}, signs=Signs(9.0))
    assert failure(SWEEP["offset"], found, "auto", {"residual": 3.0}).by == "signs would show 1 of 2 silent"


@pytest.mark.parametrize(
    ("other", "there"),
    [({}, False), ({"flagged": True}, True), ({"claimed": 2.0}, True), ({"claimed": np.nan}, False)],
)
def test_flags_and_honest_claims_are_noticed(other, there):
    assert noticed(row(0, 1.5, **other)) is there


def test_nothing_that_works_is_called_a_failure():
    told = failure(SWEEP["offset"], film({0: 0.5, 2: 0.6}), "auto")
    assert (told.breaks_at, told.scene, told.scene_at, told.noticed) == ((), "", None, "")


@pytest.mark.parametrize("sweep", SWEEPS, ids=lambda sweep: sweep.name)
def test_every_sweep_is_harmless_where_it_says_and_deterministic(sweep):
    assert sweep.harmless in sweep.values
    first, second = (next(sweep.make(sweep.harmless, SMALL)) for _ in range(2))
    assert np.array_equal(first.frame, second.frame)
    assert first.frame.dtype == np.float32
    assert first.frame.shape == first.truth.shape == (12, 12)
    worst = max(sweep.values, key=lambda value: abs(value - sweep.harmless))
    other = next(sweep.make(worst, SMALL))
    assert not np.array_equal(other.frame, first.frame) or other.noise != first.noise


def test_flagged_sweeps_flag_what_they_spoil():
    clean, gone = (next(SWEEP["dead taxels"].make(value, SMALL)) for value in (0, 10))
    assert np.count_nonzero(gone.flags) == 14
    assert np.array_equal(gone.frame[gone.flags == 0], clean.frame[gone.flags == 0])
    assert np.isin(np.count_nonzero(next(SWEEP["messages lost"].make(10, SMALL)).flags), (14, 15))


def test_errors_are_the_same_in_every_run():
    case = next(SWEEP["thickness wrong"].make(-20, SMALL))
    told = [[(r.method, round(r.nrmse, 6)) for r in rows(SWEEP["thickness wrong"], -20, case)] for _ in range(2)]
    assert told[0] == told[1]
    assert {name for name, _ in told[0]} == {"raw", *stability.OURS, *stability.THEIRS}


def test_a_sign_is_rare_where_all_is_well():
    found = [(SWEEP["cover"], [row(1, 0.5, signs=Signs(n / 100), sweep="cover") for n in range(400)])]
    assert sum(shown(r, limits(found, "auto")) == ["residual"] for r in found[0][1]) in (1, 2)


def test_table_has_a_line_for_every_sweep_and_a_failure_for_every_method():
    found = [(SWEEP["offset"], rows(SWEEP["offset"], 0, next(SWEEP["offset"].make(0, SMALL))))]
    failures = table(found)
    assert [one.method for one in failures] == [*stability.OURS, *stability.THEIRS]
    (line,) = lines(failures)
    assert len(line) == len(HEADINGS)
    assert line[0] == "offset (% of the peak)"


def test_command_writes_charts_and_tables(tmp_path, monkeypatch):
    few = tuple(SWEEP[name] for name in ("cover", "offset"))
    monkeypatch.setattr("tactiled.study.sweeps.SWEEPS", few)
    monkeypatch.setattr(pairs, "FAULTS", {"noise": (3, 10), "offset": (-5, 5)})
    monkeypatch.setattr(stability, "setting", lambda quick, *_: (SMALL, slice(0, 1 + quick)))
    told = CliRunner().invoke(app, ["bench", "stability", "--quick", "--out", str(tmp_path)])
    assert told.exit_code == 0, told.output
    for name in ("stability.svg", "stability-wiener.svg", "calibration.svg"):
        assert (tmp_path / name).read_text().startswith("<?xml")
    together = list(csv.DictReader((tmp_path / "stability-pairs.csv").read_text().splitlines()))
    assert {row["sweep"] for row in together} == {"noise 10 % with offset 5 %"}
    assert "offset (% of the peak)" in told.output
    assert max(len(line) for line in told.output.splitlines() if "│" in line) <= 80
    assert "noise 10 % with offset 5 %, error over the raw image's: auto" in told.output
    written = list(csv.DictReader((tmp_path / "stability-table.csv").read_text().splitlines()))
    expected = 2 * len(stability.OURS + stability.THEIRS)
    assert len(written) == expected
    assert len(json.loads((tmp_path / "stability.json").read_text())["table"]) == expected


def test_false_alarms_are_counted_by_the_limits_of_other_scenes():
    fine = [
        row(1, 0.5, signs=Signs(level), sweep="cover", scene=scene) for scene, level in (("a", 1.0), ("b", 3.0))
    ]
    assert alarms([(SWEEP["cover"], fine)], "auto") == ["residual"]
    assert limits([(SWEEP["cover"], fine)], "auto") == {"residual": 3.0}


def test_a_configured_layout_is_swept_where_no_grid_is_needed(tmp_path):
    (tmp_path / "it.toml").write_text(GRASP)
    skin = configured(tmp_path / "it.toml")
    allowed = sweeps(Setting(skin, 1, ("blobs",)))
    assert {sweep.name for sweep in SWEEPS} - {sweep.name for sweep in allowed} == {
        "correlated noise",
        "row-wise noise",
        "drift",
        "over the edge",
        "taxels out of place",
    }
    for sweep in allowed:
        told = [r.method for r in rows(sweep, 0, next(sweep.make(sweep.values[-1], Setting(skin, 1, ("blobs",)))))]
        assert told == ["raw", *stability.OURS]


@pytest.mark.parametrize(("value", "there"), [(0.5, False), (1, False), (3, True), (10, True)])
def test_noise_that_the_service_measures_is_noticed(value, there):
    sweep = SWEEP["noise misjudged"]
    (case,) = sweep.make(value, SMALL)
    assert all((stability.NOISY in row.warned) is there for row in rows(sweep, value, case))


@pytest.fixture(scope="module")
def both():
    return list(pairs.measure(Setting(rubber(1.5, 12), 1, ("punches",)), quick=True))


def test_every_pair_of_faults_is_made_and_judged(both):
    assert len(both) == pairs.count(quick=True) == len(pairs.FAULTS) * (len(pairs.FAULTS) - 1) // 2
    assert {pair.scenes for pair in both} == {1}
    assert all(pair.over_raw["raw"] == 1 for pair in both)
    assert all(pair.failed == (pair.over_raw["auto"] > WORSE) for pair in both)
    assert max(pair.over_raw["auto"] for pair in both) == pairs.worst(both, 3)[0].over_raw["auto"]
    found = pairs.lines(pairs.worst(both, 3))
    assert [len(line) for line in found] == [len(pairs.HEADINGS)] * 3


def test_a_pair_holds_both_of_its_faults():
    def frame(**faults):
        (case,) = pairs.combined(SMALL, faults)
        return case.frame, case.noise

    (plain, sigma), peak = frame(), frame()[0].max()
    assert np.array_equal(frame(offset=5)[0] > plain, np.ones((12, 12), bool))
    assert np.count_nonzero(frame(dead=5, offset=5)[0] == 0) == 7
    assert frame(ceiling=60, noise=10)[0].max() < 0.62 * peak
    assert frame(noise=10)[1] == pytest.approx(10 * sigma)
    assert frame(correlated=10)[1] == pytest.approx(np.hypot(10, 1) * sigma)
    assert not np.allclose(frame(thickness=-20)[0], plain, atol=5 * sigma)


def test_a_drift_comes_after_the_frames_that_it_grew_from():
    (still,), (far,) = (list(SWEEP["drift"].make(value, SMALL)) for value in (0.1, 20))
    assert still.before.shape == far.before.shape == (23, 12, 12)
    moved = far.frame - still.frame
    assert 5 < 100 * np.abs(moved).max() / still.frame.max() < 80
    assert np.abs(far.before[-1] - far.frame).max() < np.abs(far.before[11] - far.frame).max()


def test_what_came_before_is_seen_by_the_method(monkeypatch):
    seen, restore = [], Restorer.__call__
    monkeypatch.setattr(Restorer, "__call__", lambda *each: seen.append(1) or restore(*each))
    rows(SWEEP["drift"], 1, next(SWEEP["drift"].make(1, SMALL)))
    assert len(seen) == 24 * (1 + len(stability.OURS))
