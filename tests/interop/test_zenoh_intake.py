"""What a server takes of robots: bounds, budgets, and whose fault it is."""

import json
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest

from tactiled.config import Server
from tactiled.interop.zenoh import intake as zenoh_intake
from tactiled.interop.zenoh import robots as zenoh_robots
from tactiled.interop.zenoh.intake import Intake
from tactiled.interop.zenoh.session import Head
from tactiled.wire import pack
from tests.attack.test_fleet import CELLS, DETAIL, GEOMETRY, SIDE, STATE, image
from tests.conftest import until
from tests.interop.zenoh_kit import fleet_at
from tests.process import free_port

SESSION = "ab" * 8


@contextmanager
def intake(history_mb=64.0):
    made = Intake(Server(history_mb=history_mb))
    try:
        yield made
    finally:
        made.builders.shutdown()
        for sensor in made.sensors.values():
            sensor.stop()


def join(made, name, session=SESSION, state=STATE, geometry=GEOMETRY):
    """A publisher appears and answers what it is asked."""
    made.take_token(f"{name}/alive/{session}", True)
    if line := made.lines.get(name):
        made.describe(line, session, (json.dumps(state).encode(), json.dumps(geometry).encode()), None)
    return made.sensors.get(name)


def show(made, name, number=1, changes=(), detail=DETAIL):
    frame = replace(image(np.full((SIDE, SIDE), number, np.float32), number), **dict(changes))
    for kind, more in (("raw", b""), ("restored", json.dumps(detail).encode())):
        made.take_image(kind, f"{name}/{kind}", pack(frame, kind, 1.0), Head(SESSION, number, 2).pack(more))
    made.work()


def texts(made, kind):
    return [event.text for event in made.events.after(0) if event.kind == kind]


LINE = {"rows": 1, "columns": 4, "cell_mm": 1.0}
WRONG_GEOMETRIES = {
    "restored: 6000 x 6000 cells: give 262144 at most": {"restored": CELLS | {"rows": 6000, "columns": 6000}},
    "restored: 12 x 8 cells do not fit 4 x 4 taxels": {"restored": CELLS | {"rows": 12, "columns": 8}},
    "raw: 4 x 4 cells do not fit 15 positions": {"positions_mm": GEOMETRY["positions_mm"][1:]},
    "shape[0] = 0: give 1 to 1024": {"shape": [0, 4]},
    "pitch_mm = nan: give 0.01 to 1000 mm": {"pitch_mm": float("nan")},
    "array width is 1.5 mm: apertures overlap": {"aperture_mm": 1.5},
    "geometry: ": {"shape": None, "positions_mm": [[0.0, 0.0]] * 4, "raw": LINE, "restored": LINE},
}  # fmt: skip


@pytest.mark.parametrize("why", WRONG_GEOMETRIES)
def test_a_geometry_that_no_array_has_is_refused_by_its_field_before_anything_is_made_of_it(why):
    with intake() as made:
        assert join(made, "bad/palm", geometry=GEOMETRY | WRONG_GEOMETRIES[why]) is None
        (text,) = texts(made, "message_refused")
        assert text.startswith("robot bad: ")
        assert why in text
        assert (made.sensors, made.faults.now) == ({}, {})


def test_a_wrong_message_makes_its_sensor_stale_and_changes_nothing_else_until_a_right_one_comes():
    with intake() as made:
        bad, good = join(made, "bad/palm"), join(made, "good/palm")
        for each in ("bad/palm", "good/palm"):
            show(made, each)
        for wrong in (
            STATE | {"rate_hz": "fast"},
            {name: STATE[name] for name in ("state", "detail")},
            STATE | {"clock": "a\nb"},
        ):
            data, head = json.dumps(wrong).encode(), Head(SESSION, 0, 2).pack()
            made.take_state("bad/palm/state", data, head)
            made.work()
            assert (bad.reported.model_dump() == good.reported.model_dump(), bad.status().state) == (True, "stale")
        assert "a message of its reader is refused: state: clock = 'a\\\\nb'" in bad.status().detail
        assert good.status().state == "live"
        assert texts(made, "message_refused") == [
            "robot bad: state: rate_hz = 'fast': Input should be a valid number (its reader has release 1)"
        ]  # once
        bad.line.refused_at -= 10.0
        assert bad.status().state == "live"


@pytest.mark.parametrize(
    ("changes", "detail", "why"),
    [
        ({"noise": float("inf")}, DETAIL, "one is out of bounds"),
        ({"sequence": 2**60}, DETAIL, "one is out of bounds"),
        ({"restored": np.full((SIDE, SIDE), np.inf, np.float32)}, DETAIL, "a value is infinite"),
        ({"raw": np.full((SIDE, SIDE), np.inf, np.float32)}, DETAIL, "a value is infinite"),
        ({"flags": np.zeros(3, np.uint8)}, DETAIL, "3 flags: one a taxel"),
        ({"restored": np.zeros((2, 2), np.float32)}, DETAIL, "restored of 4 values: its geometry has 16"),
        ({}, DETAIL | {"warnings": [{"code": "new", "text": ""}]}, "detail: warnings[0].code = 'new'"),
        ({}, {}, "detail: why: missing"),
    ],
)
def test_an_image_of_another_form_is_refused_and_the_next_one_is_shown(changes, detail, why):
    with intake() as made:
        sensor = join(made, "bad/palm")
        show(made, "bad/palm", 1)
        show(made, "bad/palm", 2, changes, detail)
        assert sensor.hub.latest().sequence == 1
        assert why in sensor.line.refused
        show(made, "bad/palm", 3)
        assert sensor.hub.latest().sequence == 3


def test_an_image_with_unknown_cells_is_shown_as_it_came():
    holes = np.where(np.eye(SIDE) > 0, np.float32(np.nan), np.float32(2))
    with intake() as made:
        sensor = join(made, "good/palm")
        show(made, "good/palm", 1, {"restored": holes})
        assert sensor.line.refused == ""
        np.testing.assert_array_equal(sensor.hub.latest().restored, holes)


def test_a_robot_over_its_budget_loses_its_own_messages_and_no_others(monkeypatch):
    monkeypatch.setattr(zenoh_robots, "MESSAGES_HZ", 10.0)
    with intake() as made:
        bad, good = join(made, "bad/palm"), join(made, "good/palm")
        for number in range(1, 20):
            show(made, "bad/palm", number)
        show(made, "good/palm", 4)
        assert bad.hub.latest().sequence < 10
        assert good.hub.latest().sequence == 4
        for at in range(200):
            event = {"kind": "method_set", "text": f"{at}", "sensor": "palm", "bus": None}
            made.take_event("good/events", json.dumps(event).encode(), b"")
            made.work()
        assert len(texts(made, "method_set")) < 20
        assert texts(made, "message_refused")[-1].startswith("robot bad: more messages, or bytes, a second")


def test_names_and_robots_are_bounded_and_one_that_says_nothing_gives_way(monkeypatch):
    monkeypatch.setattr(zenoh_intake, "MAX_ROBOTS", 3)
    monkeypatch.setattr(zenoh_intake, "MAX_NAMES", 2)
    with intake() as made:
        join(made, "good/palm")
        for name in ("a/b", "../b", "a/b/c", "é/b", "a b/c", "a/" + "b" * 65, "/b", "x" * 5000 + "/b", "bad/x"):
            made.take_token(f"{name}/alive/{SESSION}", True)
        for session in ("xy", SESSION.upper(), f"{SESSION}0", ""):
            made.take_token(f"bad/y/alive/{session}", True)
        for sensor in "yz":
            made.take_token(f"bad/{sensor}/alive/{SESSION}", True)
        assert [*made.lines] == ["good/palm", "a/b", "bad/x", "bad/y"]
        made.take_token(f"late/palm/alive/{SESSION}", True)
        assert ("late" in made.robots, made.left_out) == (False, True)
        made.robots["a"]._appeared -= zenoh_robots.DESCRIBED_S + 1.0
        assert join(made, "late/palm")
        assert [*made.robots] == ["good", "bad", "late"]
        for at in range(9):
            made.take_token(f"good/palm/alive/{at:016x}", True)
        assert len(made.lines["good/palm"].sessions) == zenoh_robots.MAX_SESSIONS


def test_an_event_is_its_robots_in_words_too_and_one_of_a_stranger_is_none():
    with intake() as made:
        join(made, "good/palm")
        made.take_token(f"bad/palm/alive/{SESSION}", True)
        event = {"kind": "config_refused", "text": "all is lost", "sensor": None, "bus": None}
        for robot in ("good", "bad", "nobody"):
            made.take_event(f"{robot}/events", json.dumps(event).encode(), b"")
            made.work()
        assert texts(made, "config_refused") == ["good: all is lost"]


def test_no_robot_has_more_than_its_part_of_the_memory_and_it_comes_back():
    with intake(history_mb=1.0) as made:
        for at in range(5):
            join(made, f"bad/s{at}")
        join(made, "good/palm")
        assert made.robots["bad"].history_bytes <= 250_000
        assert made.sensors["good/palm"].history.capacity > 500
        before = made._history_left
        for line in [*made.robots["bad"].lines.values()]:
            made.forget(line)
        assert made._history_left > before
        assert ([*made.sensors], "bad" in made.robots) == (["good/palm"], False)


def test_a_sensor_whose_reader_is_long_gone_is_forgotten_and_may_come_back(monkeypatch):
    monkeypatch.setattr("tactiled.interop.zenoh.fleet.FORGET_S", 0.0)
    with fleet_at("", mode="peer", connect=[], listen=[f"tcp/127.0.0.1:{free_port()}"]) as fleet:
        join(fleet, "r1/palm")
        fleet.take_token(f"r1/palm/alive/{SESSION}", False)
        until(lambda: not fleet.sensors and not fleet.robots)
        assert texts(fleet, "sensor_removed")
        assert join(fleet, "r1/palm", session="cd" * 8)


def test_a_name_that_appears_while_another_thread_looks_at_its_robot_is_no_error():
    robot = zenoh_robots.Robot("r1")

    class Appearing:
        @property
        def described(self):
            robot.lines["r1/tip"] = self

    robot.lines["r1/palm"] = Appearing()
    assert not robot.has_sensors
