import signal
import threading
import time
from unittest.mock import MagicMock, Mock

import numpy as np
import pytest

from tactiled.errors import CalibrationStateError, ConfigError, NoCalibrationError, PhysicsError
from tactiled.guided.calibrations import GuidedCalibrations
from tactiled.guided.quality import Quality
from tactiled.guided.session import IDLE_S, NEXT_STATE, CalibrationSession
from tests.conftest import Clock, pressed, until


class Scripted:
    """A procedure whose fit waits for its script: an outcome, or an error."""

    def __init__(self):
        self.marks, self.series, self.looks = [], [], 0
        self.script, self.turn = [], threading.Semaphore(0)

    def mark(self, series, value):
        if value < 0:
            raise ConfigError("moving")
        self.marks.append((len(series.times), value))

    def quality(self, collector):
        self.looks += 1
        return Quality(f"{len(collector)} frames", enough=False)

    def fit(self, series, _process):
        self.series.append(series)
        self.turn.acquire()
        outcome = self.script.pop(0)
        if isinstance(outcome, Exception):
            raise outcome
        return outcome


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def session(rig, clock):
    rig.stale_after(600)
    return CalibrationSession(rig.sensor, Scripted(), clock.monotonic)


def finish(session, outcome):
    session.procedure.script.append(outcome)
    session.procedure.turn.release()
    until(lambda: session.state != "fitting")


def test_what_was_collected_is_fitted_and_applied_once(rig, session):
    for n in range(3):
        rig.show(pressed(n))
    session.mark(20.0)
    assert session.procedure.marks == [(3, 20.0)]
    session.fit()
    assert session.state == "fitting"
    finish(session, "thickness")
    assert (session.state, session.outcome, session.error) == ("fitted", "thickness", "")
    np.testing.assert_array_equal(session.procedure.series[0].counts[2], pressed(2).ravel())
    applied = []
    session.apply(applied.append)
    assert applied == ["thickness"]
    assert (session.state, session.outcome, len(session.collector)) == ("ended", None, 0)
    rig.show(pressed())
    assert len(session.collector) == 0
    with pytest.raises(
        CalibrationStateError, match="'palm': apply: not possible, as the calibration is ended; possible: nothing"
    ):
        session.apply(applied.append)


def test_a_fit_or_an_apply_that_fails_changes_nothing_and_more_can_be_collected(rig, session):
    rig.show(pressed())
    for error, text in ((PhysicsError("no press"), "no press"), (ZeroDivisionError("x"), "ZeroDivisionError: x")):
        session.fit()
        finish(session, error)
        assert (session.state, session.outcome, session.error) == ("collecting", None, text)
    rig.show(pressed())
    assert len(session.collector) == 2
    session.fit()
    finish(session, 1.2)
    with pytest.raises(ConfigError, match="disk"):
        session.apply(Mock(side_effect=ConfigError("disk")))
    assert (session.state, session.outcome) == ("fitted", 1.2)
    with pytest.raises(ConfigError, match="moving"):
        session.mark(-1.0)
    assert session.state == "fitted"


def test_the_outcome_of_a_cancelled_fit_is_dropped(session):
    session.fit()
    session.cancel()
    assert session.state == "collecting"
    session.fit()
    session.procedure.script += ["first", "second"]
    session.procedure.turn.release()
    until(lambda: len(session.procedure.script) == 1)
    assert session.state == "fitting"
    session.procedure.turn.release()
    until(lambda: session.state == "fitted")
    assert session.outcome == "second"
    session.discard()
    assert session.state == "ended"


def test_a_calibration_that_was_applied_meanwhile_is_not_discarded(session, monkeypatch):
    service = MagicMock()
    calibrations = GuidedCalibrations(service)
    monkeypatch.setattr(calibrations, "session", lambda _: session)
    session.state, session.outcome = "fitted", "first"
    session.apply(lambda _: None)
    with pytest.raises(NoCalibrationError, match="no calibration is open"):
        calibrations.discard("palm")
    service.events.add.assert_not_called()


@pytest.mark.parametrize("give_up", [CalibrationSession.cancel, CalibrationSession.discard])
def test_the_process_of_a_fit_that_is_given_up_ends(session, give_up):
    session.procedure.fit = lambda _, process: process.run(time.sleep, 3600)
    session.fit()
    until(lambda: session._process._process)
    work = session._process._process
    give_up(session)
    until(lambda: work.exitcode == -signal.SIGKILL)  # a second thread that joins it may see None first
    assert session.state in ("collecting", "ended")


@pytest.mark.parametrize("state", ["collecting", "fitting", "fitted", "ended"])
def test_every_action_is_refused_where_the_table_has_no_state_for_it(session, state):
    session.state = state
    actions = {"mark": lambda: session.mark(1.0), "fit": session.fit, "cancel": session.cancel}
    actions["apply"] = lambda: session.apply(lambda _: None)
    for name, action in actions.items():
        if (state, name) not in NEXT_STATE:
            with pytest.raises(
                CalibrationStateError, match=f"{name}: not possible, as the calibration is {state}"
            ):
                action()
            assert session.state == state


def test_a_session_ends_when_its_client_has_gone_away_and_the_bus_goes_on(rig, session, clock):
    rig.show(pressed())
    clock.now += 0.9 * IDLE_S
    session.touch()
    clock.now += 0.9 * IDLE_S
    rig.show(pressed())
    assert (session.state, len(session.collector)) == ("collecting", 2)
    clock.now += 0.2 * IDLE_S
    rig.show(pressed())
    assert session.lapsed()
    assert (session.state, len(session.collector)) == ("ended", 0)
    assert rig.show(pressed())


def test_quality_is_looked_at_again_for_new_frames_only(rig, session, clock):
    rig.show(pressed())
    assert session.quality() == session.quality() == Quality("1 frames", enough=False)
    clock.now += 1
    session.quality()
    assert session.procedure.looks == 1
    rig.show(pressed())
    clock.now += 1
    assert session.quality().advice == "2 frames"
    session.mark(1.0)
    session.quality()
    assert session.procedure.looks == 3
