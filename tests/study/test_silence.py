from dataclasses import replace

import numpy as np
import pytest

from tactiled.study import claims
from tactiled.study.faults import Setting
from tactiled.study.feasible import lawful
from tactiled.study.pairs import FAULTS, Pair, combined
from tactiled.study.report_failures import silent_failures
from tactiled.study.signs import Signs
from tactiled.study.silence import FAINT, LIFT, REASONS, UNKNOWN, lines, listed, verdict
from tactiled.study.skin import rubber
from tactiled.study.stability import WORSE, Row, noticed, rows
from tactiled.study.sweeps import SWEEPS

SWEEP = {sweep.name: sweep for sweep in SWEEPS}
SMALL = Setting(rubber(1.5, 16), 1, ("punches",))
ROW = Row(
    sweep="",
    value=0,
    scene="punches",
    method="auto",
    ran="nnls",
    nrmse=0.6,
    over_raw=1.2,
    over_wiener=1.0,
    error=10.0,
    claimed=4.0,
    signs=Signs(),
    flagged=False,
    lawful=True,
)


def alone(name, **told):
    return SWEEP[name], [replace(ROW, sweep=name, value=5, **told)]


def both(*faults, **told):
    row = replace(ROW, sweep=" with ".join(faults), **told)
    return Pair(dict.fromkeys(faults, 5.0), {"auto": 1.2}, 1, 1, 0, (row,))


@pytest.mark.parametrize(
    ("fault", "by", "why"),
    [
        ("offset", "5 % of the peak", LIFT),
        ("drift", "5 % of the peak", LIFT),
        ("dead taxels untold", "5 %, read 0", FAINT),
    ],
)
def test_what_a_press_would_look_like_is_a_reason(fault, by, why):
    (one,) = listed([alone(fault)], [])
    assert (one.reason, one.by) == (why, by)


def test_a_pair_is_listed_with_the_reason_of_the_fault_that_has_one():
    (one,) = listed([], [both("noise", "offset")])
    assert (one.row.sweep, one.by, one.reason) == ("noise with offset", "", LIFT)
    (one,) = listed([], [both("offset", "dead")])
    assert one.reason == f"{LIFT}; {FAINT}"


def test_every_reason_is_that_of_a_fault_that_is_tried():
    assert set(REASONS) <= {*SWEEP, *FAULTS}


@pytest.mark.parametrize(
    "silent",
    [
        ([alone("thickness wrong")], []),
        ([alone("drift", lawful=False)], []),
        ([], [both("noise", "modulus")]),
        ([], [both("noise", "offset", lawful=False)]),
    ],
)
def test_a_silent_image_for_which_no_reason_is_on_record_is_loud(silent):
    (one,) = listed(*silent)
    assert one.reason == UNKNOWN
    said = verdict(listed(*silent))
    assert "NO REASON IS KNOWN FOR 1 OF THEM" in said
    html = "".join(silent_failures(*silent))
    assert said in html
    assert f"<td class='bad'>{UNKNOWN}</td>" in html


@pytest.mark.parametrize(
    "other",
    [{"over_raw": WORSE}, {"warned": ("a warning",)}, {"flagged": True}, {"claimed": 5.0}, {"method": "nnls"}],
)
def test_only_what_fails_in_silence_is_listed(other):
    assert listed([alone("drift", **other)], [both("noise", "offset", **other)]) == []
    assert "No image" in verdict([])


def test_the_worst_comes_first_and_every_line_tells_its_fault():
    found = listed([alone("drift", over_raw=1.1), alone("offset", over_raw=1.3)], [both("noise", "offset")])
    assert [line[:2] for line in lines(found)] == [
        ("offset", "5 % of the peak"),
        ("noise with offset", ""),
        ("drift", "5 % of the peak"),
    ]
    assert "A reason is known for each" in verdict(found)


@pytest.mark.parametrize(
    ("faults", "there"),
    [
        ({}, True),
        ({"offset": 5}, True),
        ({"offset": -5}, False),
        ({"dead": 5}, False),
        ({"thickness": -20, "noise": 0.2}, False),
    ],
)
def test_what_no_press_explains_is_not_lawful(faults, there):
    (case,) = combined(SMALL, faults)
    assert lawful(case.skin.blur, case.frame, case.noise) is there


def test_a_layout_is_asked_like_a_grid():
    from tactiled.restore.blur import MatrixBlur

    A = np.eye(40) + 0.3 * np.eye(40, k=1) + 0.3 * np.eye(40, k=-1)
    press = np.maximum(np.random.default_rng(1).normal(0, 10, 40), 0)
    assert lawful(MatrixBlur(A), A @ press, 0.1)
    assert not lawful(MatrixBlur(A), A @ press - 2, 0.1)


def test_only_silent_images_of_auto_are_asked_whether_a_press_explains_them(monkeypatch):
    monkeypatch.setattr("tactiled.study.stability.lawful", lambda *_: True)
    sweep = SWEEP["drift"]
    found = [row for case in sweep.make(20, SMALL) for row in rows(sweep, 20, case)]
    assert all(row.lawful is None for row in found if row.method != "auto" or noticed(row))
    monkeypatch.setattr("tactiled.study.stability.noticed", lambda _: False)
    monkeypatch.setattr("tactiled.study.stability.WORSE", 0.0)
    found = [row for case in sweep.make(20, SMALL) for row in rows(sweep, 20, case)]
    assert {row.method for row in found if row.lawful} == {"auto"}


def test_claims_that_fall_short_are_counted_with_their_warnings():
    row = replace(ROW, sweep="offset")
    short, warned, fair = row, replace(row, claimed=2.0, warned=("tare",)), replace(row, claimed=8.0)
    better = replace(row, over_raw=0.9, claimed=0.1)
    found = [(SWEEP["offset"], [short, warned, fair, better]), (SWEEP["cover"], [better])]
    assert claims.lines(found, []) == [("offset", "3", "2.5", "5.0", "2", "1 of 2")]
    assert claims.lines([], [both("noise", "offset")]) == [("two at once", "1", "2.5", "2.5", "1", "0 of 1")]
