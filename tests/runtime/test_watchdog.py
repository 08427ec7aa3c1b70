import logging
import threading

import pytest

from tactiled.runtime.watchdog import HANGS_AFTER_S, Watchdog
from tests.conftest import Clock, pressed, until
from tests.systemd import Manager


@pytest.fixture
def look(rig, tmp_path, monkeypatch):
    """One look at a service that runs, `after` s after the one before; what systemd receives of it."""
    clock = Clock()
    with Manager(tmp_path) as manager:
        monkeypatch.setenv("NOTIFY_SOCKET", manager.address)
        watchdog = Watchdog(rig.service, "http://here", clock.monotonic)

        def sends(after=1.0):
            clock.now += after
            watchdog.look()
            return manager.receive()

        sends.first = sends()
        yield sends


def turned(service, but=None):
    """Wait until every thread that has to, but one, has taken a turn."""
    before = service.turns()
    waits = {name for name, count in before.items() if count is not None} - {but}
    until(lambda: all(service.turns()[name] != before[name] for name in waits))


def test_a_silent_bus_is_well_and_ready_is_sent_once(rig, look):
    assert look.first == {"STATUS": "http://here: 0 of 1 sensors live, palm silent", "READY": "1", "WATCHDOG": "1"}
    for _ in range(3):
        turned(rig.service)
        states = look()
        assert states.pop("WATCHDOG") == "1"
        assert states == {"STATUS": "http://here: 0 of 1 sensors live, palm silent"}
    rig.stale_after(60.0)
    rig.show(pressed())
    assert look()["STATUS"] == "http://here: 1 of 1 sensors live"


@pytest.mark.parametrize("part", ["bus can0", "restore palm", "watch"])
def test_a_thread_that_hangs_is_named_and_starves_the_watchdog_until_it_moves(
    rig, look, monkeypatch, caplog, part
):
    hangs, free = threading.Event(), threading.Event()

    def hang(*_):
        hangs.set()
        free.wait()

    with monkeypatch.context() as patch:
        owner, name = {
            "bus can0": (rig.service._sources["can0"]._router, "flush"),
            "restore palm": (rig.sensor.pipeline, "process"),
            "watch": (rig.sensor, "drain_warnings"),
        }[part]
        patch.setattr(owner, name, hang)
        if part == "restore palm":
            rig.send(pressed())
        assert hangs.wait(60)
    try:
        turned(rig.service, part)
        look()  # the thread may have moved since the last one
        turned(rig.service, part)
        assert "WATCHDOG" not in look()
        with caplog.at_level(logging.ERROR):
            assert look(HANGS_AFTER_S)["STATUS"].startswith(f"{part}: no turn for ")
            assert "WATCHDOG" not in look()
        assert [each.levelname for each in caplog.records] == ["ERROR"]
        assert part in caplog.text
    finally:
        free.set()
    turned(rig.service)
    assert look()["WATCHDOG"] == "1"
