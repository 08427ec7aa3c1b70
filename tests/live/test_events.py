from dataclasses import replace

import pytest

from tactiled.calibrate.upkeep.creep import Creep
from tactiled.calibrate.upkeep.health import Change, Fault
from tactiled.diagnostics.warning_codes import warning
from tactiled.frames import MISSING
from tactiled.live.events import CLEAR_AFTER_S, Events, Faults
from tactiled.live.sensor import Sensor
from tactiled.live.watch import WARNING_STAYS_S, Watch
from tests.conftest import until
from tests.live.conftest import Timed, frame


class Watched(Timed):
    """The palm and the thumb on one bus, and the watch over both."""

    def __init__(self, plan):
        super().__init__(plan)
        self.events = Events()
        self.thumb = Sensor(replace(plan, name="thumb"), lambda: self.now)
        self.watch = Watch([self.sensor, self.thumb], self.events, Faults(self.events), lambda _: "kept")

    def look(self):
        """New events."""
        last = self.events.newest
        self.watch.look(self.now)
        return [(each.kind, each.sensor or each.bus, each.text) for each in self.events.after(last)]


@pytest.fixture
def watched(plan):
    return Watched(replace(plan, method="raw"))


def test_changes_of_sensor_and_bus_are_one_event_each(watched):
    assert watched.look() == []
    watched.sensor.restore(frame())
    assert watched.look() == [("sensor_live", "palm", "receiving frames")]
    assert watched.look() == []
    watched.now += 0.6
    silent = ("sensor_silent", "thumb", "no frame yet on can0")
    assert watched.look() == [("sensor_stale", "palm", "no frame for 0.6 s"), silent]
    watched.now += 0.1
    assert watched.look() == []
    watched.sensor.health.down = "unplugged"
    assert watched.look() == [("bus_down", "can0", "unplugged"), ("sensor_down", "palm", "unplugged")]
    assert watched.look() == []
    watched.sensor.health.down = None
    watched.sensor.restore(frame(1))
    assert watched.look() == [("bus_up", "can0", "is there again"), ("sensor_live", "palm", "receiving frames")]
    watched.sensor.health.ended = "a.log has ended"
    assert watched.look() == [("sensor_ended", "palm", "a.log has ended")]


def test_a_sensor_of_which_no_frame_has_come_is_an_event_once_its_patience_is_over(watched):
    silent = [("sensor_silent", name, "no frame yet on can0") for name in ("palm", "thumb")]
    assert watched.look() == []
    watched.now += 0.9 * watched.sensor.plan.stale_after_s
    assert watched.look() == []
    watched.now += 0.2 * watched.sensor.plan.stale_after_s
    assert watched.look() == silent
    watched.now += 10
    assert watched.look() == []
    watched.sensor.restore(frame())
    assert watched.look() == [("sensor_live", "palm", "receiving frames")]
    watched.watch.sensors = (watched.sensor,)
    watched.look()
    watched.watch.sensors = (watched.sensor, watched.thumb)  # anew, as after a reload
    assert watched.look() == []


def test_a_sensor_that_a_bus_brings_back_without_frames_is_silent_after_its_patience(watched):
    watched.thumb.restore(frame())
    watched.sensor.health.down = "unplugged"
    watched.look()
    watched.now += 10
    watched.sensor.health.down = None
    assert [each for each in watched.look() if each[1] == "palm"] == []
    watched.now += 1
    assert ("sensor_silent", "palm", "no frame yet on can0") in watched.look()


def test_a_warning_is_raised_once_per_code_and_cleared_after_a_while(plan):
    watched = Watched(replace(plan, method="raw", stale_after_s=5 * WARNING_STAYS_S))
    start = watched.now

    def events_at(seconds, *missing):
        watched.now = start + seconds
        for taxels in missing:
            watched.sensor.restore(frame(flags=[MISSING] * taxels + [0] * (64 - taxels)))
        last = watched.events.newest
        watched.look()
        return [(each.kind, each.warning and each.warning.taxels) for each in watched.events.after(last)]

    assert events_at(0.0, 2, 3) == [("sensor_live", None), ("warning_raised", 3)]
    assert events_at(0.9 * WARNING_STAYS_S, 4) == []
    assert events_at(1.8 * WARNING_STAYS_S) == []
    assert events_at(2.0 * WARNING_STAYS_S) == [("warning_cleared", 4)]
    raised, cleared = (each for each in watched.events.after(0) if each.warning)
    assert (raised.text, cleared.warning.code) == (raised.warning.text, "missing")
    assert cleared.text == f"it was: {cleared.warning.text}"
    assert events_at(3.0 * WARNING_STAYS_S, 5) == [("warning_raised", 5)]
    assert events_at(9.0 * WARNING_STAYS_S) == [("sensor_stale", None), ("sensor_silent", None)]  # clear nothing


@pytest.mark.parametrize("code", ["cut_short", "noise_unknown"])
def test_what_does_not_harm_is_an_event_only_once_it_lasts(watched, code):
    cut = {code: warning(code, budget_ms=1.0)}
    watched.sensor.restore(frame())
    watched.look()
    watched.sensor.drain_warnings = lambda: cut

    def raised(seconds, gap=0.0):
        watched.now += gap
        kinds = []
        for _ in range(round(2 * seconds)):
            watched.now += 0.5
            watched.sensor.restore(frame())
            kinds += [kind for kind, _, text in watched.look() if text == cut[code].text]
        return kinds

    assert raised(10) == raised(9, gap=1.0) == []
    assert raised(2) == ["warning_raised"]


def test_a_fault_is_one_event_and_the_watch_clears_it_after_a_while(caplog):
    now, events = [0.0], Events()
    faults = Faults(events, lambda: now[0])
    watch = Watch([], events, faults, str)

    def turn(error=None):
        last = events.newest
        with faults.turn("part"):
            if error:
                raise error
        watch.look(now[0])
        return [(each.kind, each.text) for each in events.after(last)]

    assert turn() == []
    assert turn(KeyError("a")) == [("fault_raised", "part: KeyError: 'a'")]
    assert turn(KeyError("b")) == turn() == []  # it flickers
    assert faults.now == {"part": "KeyError: 'b'"}
    assert [each.exc_info[0] for each in caplog.records if each.exc_info] == [KeyError]
    now[0] = 0.9 * CLEAR_AFTER_S
    assert turn() == []
    now[0] = CLEAR_AFTER_S
    assert turn() == [("fault_cleared", "part: KeyError: 'b'")]
    assert faults.now == {}
    assert turn(KeyError("a")) == [("fault_raised", "part: KeyError: 'a'")]


def test_a_sensor_that_cannot_be_looked_at_is_a_fault_and_the_others_are_watched_on(watched, monkeypatch, caplog):
    monkeypatch.setattr(watched.sensor, "status", lambda: 1 / 0)
    watched.watch.start()
    until(lambda: watched.events.newest == 1)
    watched.thumb.restore(frame())
    until(lambda: watched.events.newest == 2)
    watched.watch.stop()
    assert [(each.kind, each.text) for each in watched.events.after(0)] == [
        ("fault_raised", "watch of palm: ZeroDivisionError: division by zero"),
        ("sensor_live", "receiving frames"),
    ]
    assert "ZeroDivisionError" in caplog.text


def test_taxels_that_fail_heal_or_creep_are_events(watched):
    monitor = watched.sensor.pipeline.monitor
    watched.look()
    for taxel in (3, 1, *range(20, 30)):
        monitor._changes.append(Change(1.0, taxel, Fault.HEALTHY, Fault.DEAD if taxel < 5 else Fault.STUCK))
    assert watched.look() == [
        ("taxel_faulty", "palm", "taxels 1, 3 dead: it feels no load, and its neighbours do"),
        ("taxel_faulty", "palm", "taxels 20, 21, 22, 23, 24, 25, 26, 27 and 2 more stuck: "
         "its reading does not change, as noise or no load would let it"),
    ]  # fmt: skip
    monitor._changes.append(Change(2.0, 3, Fault.DEAD, Fault.HEALTHY))
    monitor._creep.creep = Creep(4.123, 0.21, 600.0, 34)
    creep = "a load that stays on 34 taxels reads +4.1 % ± 0.2 % for each tenfold time"
    assert watched.look() == [
        ("taxel_healed", "palm", "taxel 3: works again"), ("creep_measured", "palm", creep)
    ]  # fmt: skip
    assert watched.look() == []
