import re
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from tactiled.cli.app import app
from tactiled.restore.auto import Auto
from tactiled.restore.methods import make
from tactiled.study import ablation, iterations, page, report
from tactiled.study.faults import Setting, white
from tactiled.study.frontier import QUICK
from tactiled.study.report_page import write
from tactiled.study.signs import signs
from tactiled.study.skin import rubber
from tactiled.study.sweeps import SWEEPS

SMALL = Setting(rubber(1.5, 12), 1, ("punches",))


@pytest.fixture
def tiny(monkeypatch):
    """A report of one skin, three faults and as little of the rest as there is."""
    few = tuple(sweep for sweep in SWEEPS if sweep.name in ("cover", "white noise", "offset"))
    monkeypatch.setattr("tactiled.study.sweeps.SWEEPS", few)
    monkeypatch.setattr("tactiled.study.discriminate.GAPS", (2.0, 4.0))
    monkeypatch.setattr("tactiled.study.pairs.FAULTS", {"noise": (3, 10), "offset": (-5, 5)})
    made = report.plan((rubber(1.0, 12),), True, 1)
    effort = replace(QUICK, noises=(0.02,), frames=1, rounds=1, stops=(3,))
    return replace(
        made, effort=effort, setting=SMALL, values=slice(0, 1), iterations=3, trials=2, places=1, frames=2
    )


def test_the_page_holds_every_chart_and_table_and_needs_nothing_else(tiny, tmp_path):
    done = []
    path = write(tmp_path, report.measure(tiny, done.append), 1)
    html = path.read_text()
    assert len(done) == tiny.steps
    assert html.count("<svg") == html.count("</svg>") == 7
    assert not re.search(r'(?:src|href)="(?!#)(?!http://www\.w3\.org)[^"]*//', html)
    assert "noise 10 % with offset 5 %" in html
    assert "auto is on the Pareto front in" in html
    assert "Of 7 more sound frames" in html
    assert "<img" not in html
    assert "<script" not in html
    assert {p.name for p in tmp_path.iterdir()} >= {"frontier.csv", "stability-table.csv", "stability.json"}


def test_command_takes_a_configuration(tiny, tmp_path, monkeypatch):
    monkeypatch.setattr(report, "plan", lambda skins, _quick, _seed: replace(tiny, skins=skins or tiny.skins))
    told = CliRunner().invoke(app, ["bench", "report", "--quick", "--out", str(tmp_path)])
    assert told.exit_code == 0, told.output
    assert told.output.strip().endswith("index.html")


def test_tables_shade_what_they_are_told_and_escape_the_rest():
    html = page.table(("a <b>",), (("never",), ("no (1)",), ("<i>",)), good="never", bad="no .*")
    assert "<th>a &lt;b&gt;</th>" in html
    assert "<td class='good'>never</td>" in html
    assert "<td class='bad'>no (1)</td>" in html
    assert "<td>&lt;i&gt;</td>" in html


def test_unstopped_richardson_lucy_ends_worse_than_stopped():
    found = iterations.measure(SMALL, 300, (5.0,))
    last = {one.method: one.over_raw for one in found if one.iterations == 300}
    assert last["rl"] < last["unstopped"]


@pytest.fixture(scope="module")
def earned():
    return {one.rule: one for one in ablation.measure([rubber(0.1, 12), rubber(1.0, 12)], (0.02,), 10, 1)}


def test_every_rule_is_put_out_in_turn(earned):
    assert set(earned) == set(ablation.RULES)
    assert {one.of for one in earned.values()} == {2 * 8 * (10 + ablation.REST)}
    assert len({(one.time, one.error, one.changes) for one in earned.values()}) == 1
    assert all(earned[rule].frames for rule in ("idle", "wiener", "points", "warm start"))


def test_a_rule_that_is_out_stands_for_one_that_auto_has():
    for _, kind in ablation.RULES.values():
        (instead,) = [name for name in vars(kind) if not name.startswith("__")]
        assert instead in vars(Auto)


def test_what_a_rule_decides_changes_without_it(earned):
    assert earned["points"].error_without > 1.02 * earned["points"].error
    assert earned["points"].worse > 1.1
    assert earned["pause"].error_without == pytest.approx(earned["pause"].error, rel=0.02)


def sign_of(frame, case, flags=None):
    image = make("nnls", case.skin.blur, case.noise)(frame, flags).image
    return signs(case.skin.blur, frame, image, case.noise, flags)


def test_each_sign_rises_with_its_fault():
    case = next(white(1.0, Setting(rubber(1.5, 16), 1, ("blobs",))))
    fine = sign_of(case.frame, case)
    spiked = case.frame.copy()
    spiked[3, 3] += 40 * case.noise
    assert sign_of(spiked, case).outlier > 2 * fine.outlier
    assert sign_of(case.frame - 30 * case.noise, case).below > 2 * max(fine.below, 1)
    clipped = np.minimum(case.frame, 0.6 * case.frame.max())
    assert sign_of(clipped, case).plateau > 3 >= fine.plateau
    rough = case.frame + np.random.default_rng(0).normal(0, 10 * case.noise, case.frame.shape).astype(np.float32)
    assert sign_of(rough, case).tail > fine.tail + 1


def test_signs_leave_flagged_taxels_out():
    case = next(white(1.0, SMALL))
    flags = np.zeros(case.frame.shape, np.uint8)
    flags[2, 2] = 4
    wild = case.frame.copy()
    wild[2, 2] = 1e4
    assert sign_of(wild, case, flags).outlier < 50
    assert np.isnan(signs(case.skin.blur, wild, wild, case.noise, np.full(wild.shape, 4, np.uint8)).residual)
