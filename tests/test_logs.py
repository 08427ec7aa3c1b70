import io
import json
import logging
import re
import sys
import threading

import pytest

from tactiled import logs
from tactiled.config import parse
from tactiled.live.events import Events
from tests.conftest import CONFIG, ask, problem

UTC_TIME = re.compile(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{3}\+00:00")


@pytest.fixture
def lines(monkeypatch):
    """Logs as a process does that was given --log-format; returns the lines so far."""
    errors = io.StringIO()
    for module, name in ((sys, "excepthook"), (threading, "excepthook")):
        monkeypatch.setattr(module, name, getattr(module, name))
    monkeypatch.setattr(logs.HANDLER, "filters", [])

    def start(style):
        monkeypatch.setattr(sys, "stderr", errors)
        logs.configure(style)
        return lambda: errors.getvalue().splitlines()

    yield start
    logging.getLogger().removeHandler(logs.HANDLER)
    logging.getLogger("tactiled").setLevel(logging.NOTSET)
    logs.HANDLER.setFormatter(None)


def test_an_event_is_one_json_object_on_one_line(lines):
    written = lines("json")
    Events().add("sensor_stale", 'no "frame"\nfor 0.6 s\u2028', "palm")
    (line,) = map(json.loads, written())
    assert UTC_TIME.fullmatch(line.pop("time"))
    assert line == {
        "level": "warning", "logger": "tactiled.events", "event": "sensor_stale", "sensor": "palm",
        "text": 'no "frame"\nfor 0.6 s\u2028',
    }  # fmt: skip


def test_a_line_for_people_cannot_be_forged_nor_control_a_terminal(lines):
    written = lines("console")
    Events().add("sensor_live", "frames come\n2026 FORGED \x1b[2J", "palm")
    (line,) = written()
    time, rest = line.split(" ", 1)
    assert UTC_TIME.fullmatch(time)
    assert rest == r"INFO sensor_live palm: frames come\n2026 FORGED \x1b[2J"


@pytest.mark.parametrize("style", ["console", "json"])
def test_no_secret_of_the_configuration_or_of_an_address_is_logged(lines, style):
    secrets = ["reads-and-reads-1", "controls-and-more", "buspassword", "asked-by-one", "shown-by-one", "login:pw"]
    reads, controls, bus, query, bearer, login = secrets
    text = CONFIG.format(channel="x").replace('channel = "x"', f'channel = "ws://user:{bus}@can.local:9/x"')
    parse(f'[server]\nread_token = "{reads}"\ncontrol_token = "{controls}"\n' + text)
    written, log = lines(style), logging.getLogger("tactiled.x")
    log.warning("tokens %s %s, bus %s, GET /x?token=%s&a=1", reads, controls, bus, query)
    error = OSError(f"http://{login}@elsewhere: Authorization: Bearer {bearer}: {bus}")
    log.error("failed", exc_info=error)
    output = "\n".join(written())
    assert [each for each in secrets if each in output] == []
    assert "tokens hidden hidden, bus hidden, GET /x?token=hidden&a=1" in output
    assert "http://hidden@elsewhere: Authorization: Bearer hidden hidden" in output


def test_each_kind_of_event_of_each_sensor_is_limited_apart(lines):
    written, events = lines("json"), Events()
    for n in range(3 * logs.MAX_A_MINUTE):
        events.add("sensor_stale", f"no frame for {n} s", "palm1")
    events.add("sensor_stale", "no frame for 1 s", "palm2")
    events.add("sensor_live", "frames come", "palm1")
    kinds = [(line["event"], line["sensor"]) for line in map(json.loads, written())]
    others = [("sensor_stale", "palm2"), ("sensor_live", "palm1")]
    assert kinds == [("sensor_stale", "palm1")] * logs.MAX_A_MINUTE + others


def test_faults_of_requests_of_uvicorn_and_of_threads_are_objects_with_a_traceback(lines, rig, url, monkeypatch):
    written = lines("json")
    monkeypatch.setattr(rig.sensor, "status", lambda: 1 / 0)
    problem(ask("GET", url + "/api/v1/sensors/palm"), 500)
    logging.getLogger("uvicorn.error").error("Exception\n", exc_info=RuntimeError("of uvicorn"))
    thread = threading.Thread(target=lambda: [][1])
    thread.start()
    thread.join()
    faults = {line["logger"]: line["exception"] for line in map(json.loads, written()) if "exception" in line}
    assert faults["tactiled.web.http.auth"].endswith("ZeroDivisionError: division by zero")
    assert faults["uvicorn.error"].endswith("RuntimeError: of uvicorn")
    assert faults["tactiled"].endswith("IndexError: list index out of range")
