import threading

import pytest

from tactiled.live.watchdog import HANGS_AFTER_S, Watchdog
from tests.conftest import Clock, pressed, until
from tests.systemd import Manager

SILENT = {"STATUS": "http://here: 0 of 1 sensors live, palm silent", "WATCHDOG": "1"}


@pytest.fixture
def look(rig, tmp_path, monkeypatch):
    """One look, `after` s after the one before, once every thread but `hanging` has turned; what systemd gets."""
    clock, address = Clock(), f"@{tmp_path}"
    monkeypatch.setenv("NOTIFY_SOCKET", address)
    watchdog = Watchdog(rig.service, "http://here", clock.monotonic)
    with Manager(address) as manager:

        def sends(hanging=(), after=1.0):
            before = rig.service.turns()
            due = {name for name, count in before.items() if count is not None} - {*hanging}
            until(lambda: all(rig.service.turns()[name] != before[name] for name in due))
            clock.now += after
            watchdog.look()
            return manager.receive()

        yield sends
    watchdog.look()  # a manager that has ended is no fault


def test_a_silent_bus_is_well_and_ready_is_sent_once(rig, look):
    assert look() == SILENT | {"READY": "1"}
    assert look() == look() == SILENT
    rig.stale_after(600.0)
    rig.show(pressed())
    assert look()["STATUS"] == "http://here: 1 of 1 sensors live"


@pytest.mark.parametrize("threads", [("bus can0",), ("restore palm",), ("bus can0", "restore palm"), ("watch",)])
def test_a_thread_that_hangs_is_named_and_starves_the_watchdog_until_it_moves(rig, look, caplog, threads):
    hangs, free = threading.Event(), threading.Event()
    rig.sensor.hand_over._took_s = 0.0 if len(threads) == 2 else 1.0  # s: which of them restores
    owner, name = {
        "bus can0": (rig.service._sources["can0"]._router, "flush"),
        "restore palm": (rig.sensor.pipeline, "process"),
        "watch": (rig.sensor, "drain_warnings"),
    }[threads[-1]]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(owner, name, lambda *_: (hangs.set(), free.wait()))
        rig.send(pressed())
        assert hangs.wait(60)
    try:
        look(threads)
        assert "WATCHDOG" not in look(threads)
        assert look(threads, after=HANGS_AFTER_S)["STATUS"].startswith(f"{', '.join(threads)}: no turn for ")
        assert "WATCHDOG" not in look(threads)
        assert caplog.text.count("threads hang") == caplog.text.count(f"{threads[-1]}: no turn") == 1
    finally:
        free.set()
    assert look()["WATCHDOG"] == "1"
