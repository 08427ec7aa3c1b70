import threading
from dataclasses import dataclass
from types import SimpleNamespace

import pytest

from tactiled.diagnostics.warning_codes import warning
from tactiled.runtime.events import CLEAR_S, Events, Faults
from tactiled.runtime.watch import Heard, Watch
from tests.conftest import until


def test_events_are_numbered_and_the_oldest_fall_out():
    events = Events(most=3, clock=lambda: 7.0)
    for n in range(5):
        events.add("method_set", f"m{n}", "palm")
    assert [(each.id, each.text) for each in events.after(0)] == [(3, "m2"), (4, "m3"), (5, "m4")]
    assert [each.id for each in events.after(4)] == [5]
    assert events.after(5) == ()
    assert (events.newest, events.after(0)[0].time) == (5, 7.0)


def test_ids_are_each_given_once_whatever_the_threads():
    events = Events()
    threads = [
        threading.Thread(target=lambda: [events.add("tare_asked", "") for _ in range(100)]) for _ in range(4)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert [each.id for each in events.after(0)] == list(range(1, 401))


def test_who_waits_is_woken_until_it_stops():
    events, woken = Events(), []
    stop = events.subscribe(lambda: woken.append(events.newest))
    events.add("bus_up", "")
    stop()
    events.add("bus_up", "")
    assert woken == [1]


@dataclass
class Sensor:
    name: str
    bus_name: str = "can0"
    down: str | None = None
    tared: int = 0
    lapsed: int = 0
    state: str = "silent"
    detail: str = ""
    taring: bool = False

    def __post_init__(self):
        self.heard = Heard()

    def status(self):
        return SimpleNamespace(state=self.state, detail=self.detail)

    def lapse(self):
        self.lapsed += self.taring and self.state != "live"

    def warn(self, code, taxels):
        self.heard.add(SimpleNamespace(warnings=(warning(code, taxels),)))


@pytest.fixture
def palm():
    return Sensor("palm")


@pytest.fixture
def told(palm):
    """Look, and give what is new."""
    events = Events()
    watch = Watch([palm, Sensor("thumb")], events, Faults(events))

    def look(now=0.0):
        last = events.newest
        watch.look(now)
        return [(each.kind, each.sensor or each.bus, each.text) for each in events.after(last)]

    return look


def test_a_change_of_state_is_told_once(palm, told):
    assert told() == []
    palm.state = "live"
    assert told() == [("sensor_live", "palm", "frames come")]
    assert told() == []
    palm.state, palm.detail = "stale", "no frame for 0.6 s"
    assert told() == [("sensor_stale", "palm", "no frame for 0.6 s")]
    palm.detail = "no frame for 0.7 s"
    assert told() == []


def test_a_bus_that_goes_and_comes_is_told_once_for_all_its_sensors(palm, told):
    palm.down, palm.state, palm.detail = "unplugged", "down", "unplugged"
    assert told() == [("bus_down", "can0", "unplugged"), ("sensor_down", "palm", "unplugged")]
    assert told() == []
    palm.down, palm.state, palm.detail = None, "live", ""
    assert told() == [("bus_up", "can0", "is there again"), ("sensor_live", "palm", "frames come")]


def test_a_tare_that_is_done(palm, told):
    palm.tared = 1
    assert [kind for kind, *_ in told()] == ["tare_done"]
    assert told() == []


def test_a_tare_lapses_when_the_sensor_is_no_longer_live(palm, told):
    palm.state, palm.taring = "live", True
    assert [kind for kind, *_ in told()] == ["sensor_live"]
    palm.state = "stale"
    assert [kind for kind, *_ in told()] == ["sensor_stale", "tare_lapsed"]
    palm.taring = False
    assert told() == []


def test_a_warning_is_raised_once_per_code_and_cleared_after_a_while(palm, told):
    palm.state = "live"
    told()
    palm.warn("dead", 2)
    palm.warn("dead", 3)
    assert told(0.0) == [("warning_raised", "palm", warning("dead", 3).text)]
    palm.warn("dead", 4)
    assert told(0.9 * CLEAR_S) == []
    assert told(1.8 * CLEAR_S) == []
    assert told(2.0 * CLEAR_S) == [("warning_cleared", "palm", warning("dead", 4).text)]
    palm.warn("dead", 5)
    assert [kind for kind, *_ in told(3 * CLEAR_S)] == ["warning_raised"]
    palm.state = "stale"
    assert [kind for kind, *_ in told(9 * CLEAR_S)] == ["sensor_stale"]  # silence clears nothing


def test_a_fault_is_told_once_and_cleared_when_it_is_gone_for_a_while(caplog):
    now, events = [0.0], Events()
    faults = Faults(events, lambda: now[0])

    def turn(error=None):
        last = events.newest
        with faults.turn("part"):
            if error:
                raise error
        faults.clear()
        return [(each.kind, each.text) for each in events.after(last)]

    assert turn() == []
    assert turn(KeyError("a")) == [("fault_raised", "part: KeyError: 'a'")]
    assert turn(KeyError("b")) == turn() == []  # it flickers
    assert faults.now == {"part": "KeyError: 'b'"}
    assert [each.exc_info[0] for each in caplog.records] == [KeyError]
    now[0] += CLEAR_S
    assert turn() == [("fault_cleared", "part: KeyError: 'b'")]
    assert faults.now == {}
    assert turn(KeyError("a")) == [("fault_raised", "part: KeyError: 'a'")]


def test_a_fault_of_a_part_that_has_no_more_turns_is_cleared_by_the_watch():
    now, events = [0.0], Events()
    faults = Faults(events, lambda: now[0])
    watch = Watch([], events, faults)
    with faults.turn("part"):
        raise KeyError("a")
    for now[0] in (0.0, 0.9 * CLEAR_S, CLEAR_S, 2 * CLEAR_S):
        watch.look(now[0])
        assert bool(faults.now) == (now[0] < CLEAR_S)
    assert [each.kind for each in events.after(0)] == ["fault_raised", "fault_cleared"]


def test_a_sensor_that_cannot_be_looked_at_is_told_and_the_others_are_watched_on(palm, caplog):
    events, thumb = Events(), Sensor("thumb")
    faults = Faults(events)
    watch = Watch([palm, thumb], events, faults)
    palm.status = lambda: 1 / 0
    watch.start()
    until(lambda: faults.now)
    thumb.state = "live"
    until(lambda: events.newest == 2)
    watch.stop()
    assert [(each.kind, each.text) for each in events.after(0)] == [
        ("fault_raised", "watch of palm: ZeroDivisionError: division by zero"),
        ("sensor_live", "frames come"),
    ]
    assert "ZeroDivisionError" in caplog.text
