"""Errors in one form, whatever is wrong, and without secrets."""

import json
import sys
from contextlib import ExitStack
from unittest.mock import Mock

import pytest
from can.interfaces.virtual import VirtualBus
from websockets.sync.client import connect

from tactiled.bus import reader
from tactiled.config import Server, parse
from tactiled.live.sensor import Sensor
from tactiled.live.service import Service
from tactiled.web.http import auth, problems
from tactiled.web.server import running
from tests.conftest import CONFIG, ask, pressed, problem, until
from tests.web.http.raw import websocket_url

METHOD = "/api/v1/sensors/palm/method"


def test_405_names_the_methods_of_the_path(url):
    for verb, path, allowed in (
        ("POST", METHOD, "GET, HEAD, PUT"),
        ("FOO", "/api/v1/health", "GET, HEAD"),
        ("GET", "/api/v1/restore", "POST"),
        ("POST", "/static/app.js", "GET, HEAD"),
    ):
        answer = ask(verb, url + path)
        assert f"{verb} {path}" in problem(answer, 405)
        assert answer.headers["allow"] == allowed


TOO_DEEP = (
    "maximum recursion depth exceeded"
    if sys.version_info < (3, 14)
    else "no JSON at character 5000: Expecting value"
)
WRONG_BODIES = {
    b"{": (400, "body: no JSON at character 1: Expecting property name enclosed in double quotes"),
    b"\xff\xfe": (400, "body: no JSON at character 0: Expecting value"),
    b'"\xff"': (400, "body: 'utf-8' codec can't decode byte 0xff in position 1"),
    b"[" * 5000: (400, f"body: {TOO_DEEP}"),
    b'{"method": "raw", "x": 1}': (422, "x = 1: unknown key"),
    b"": (422, "body: give a JSON object"),
    b"1e999": (422, "body = inf: give a JSON object"),
    b"[]": (422, "body = []: give a JSON object"),
}


def test_a_body_that_is_not_the_expected_json_is_described(url):
    for content, (status, detail) in WRONG_BODIES.items():
        answer = ask("PUT", url + METHOD, content=content, headers={"Content-Type": "application/json"})
        assert problem(answer, status).startswith(detail)


FORMS = (
    ("GET", "/sensors/palm/regions/.heel/series", "region = '.heel': give 1 to 40 letters, digits, _ . - or "),
    ("GET", "/recordings/a.txt", "name = 'a.txt': give 1 to 100 ASCII letters, digits, _ or -, a letter or digit"),
    ("POST", "/recordings", "name = 'a.log\\n': give 1 to 100 ASCII letters"),
    ("GET", "/sensors/palm/frames?last=2", "last = '2': give seconds, such as 2s or 0.5s"),
    ("GET", "/sensors/palm/frames?before=x", "before = 'x': give `before` of the previous answer, or a sequence"),
)


def test_what_a_text_may_hold_is_said_in_words(rig, tmp_path):
    with running(rig.service, Server(port=0, recordings=tmp_path)) as url:
        for verb, path, detail in FORMS:
            body = {"json": {"bus": "can0", "name": "a.log\n"}} if verb == "POST" else {}
            assert problem(ask(verb, f"{url}/api/v1{path}", **body), 422).startswith(detail)


@pytest.mark.parametrize("kind", ["text/plain", "application/x-www-form-urlencoded", "multipart/form-data"])
def test_a_body_that_a_form_can_send_is_refused(rig, url, kind):
    answer = ask("PUT", url + METHOD, content=b'{"method": "raw"}', headers={"Content-Type": kind})
    assert problem(answer, 415) == f"Content-Type: {kind}: give application/json"
    assert rig.sensor.method == "wiener"


NO_BODY = (
    ("POST", "/sensors/palm/tare"), ("DELETE", "/sensors/palm/tare"), ("POST", "/sensors/palm/regions/heel/reset"),
    ("DELETE", "/sensors/palm/regions/heel"), ("POST", "/sensors/palm/calibration/history/1"),
    ("POST", "/sensors/palm/calibration/session/fit"), ("POST", "/config/reload"),
)  # fmt: skip


def test_a_problem_names_half_a_pair_of_utf_16_which_json_may_have():
    assert (
        json.loads(problems.response(404, "bus \ud800: no such bus").body)["detail"] == "bus \\ud800: no such bus"
    )
    assert problems.close_reason("bus \ud800") == "bus \\ud800"


def test_a_close_reason_ends_with_a_whole_word():
    assert problems.close_reason("x" * 123) == "x" * 123
    assert problems.close_reason("sensor 'plam': there are " + "palm, " * 30) == (
        "sensor 'plam': there are " + "palm, " * 14 + "palm, …"
    )
    assert all(len(each.encode()) <= 123 for each in (auth.UNAUTHORIZED, auth.UNKNOWN, auth.READ_ONLY))


def test_a_body_that_a_request_does_not_take_is_refused_and_changes_nothing(rig, url):
    rig.stale_after(600)  # a tare needs a live sensor
    rig.show(pressed(force=0))
    for verb, path in NO_BODY:
        answer = ask(verb, f"{url}/api/v1{path}", json={"frames": 50})
        assert problem(answer, 422) == """body = '{"frames":50}': this request takes none"""
        for content in (b"", b"{}\n"):
            assert ask(verb, f"{url}/api/v1{path}", content=content).status_code != 422, path
    binary = ask("POST", f"{url}/api/v1/config/reload", content=b"\xff" * 1000)
    assert problem(binary, 422).startswith("body = '\ufffd")
    assert [each.kind for each in rig.service.events.after(0)].count("tare_asked") == 2


def test_an_internal_error_has_no_details_and_the_security_headers(rig, url, monkeypatch):
    rig.show(pressed())
    monkeypatch.setattr(Sensor, "contacts", lambda _: {}["hush"])
    answer = ask("GET", url + "/api/v1/sensors/palm/contacts")
    assert problem(answer, 500) == "the service failed at this: see its log"
    assert "default-src 'none'" in answer.headers["content-security-policy"]
    assert "hush" not in answer.text
    assert ask("GET", url + "/api/v1/health").status_code == 200


def test_no_answer_has_the_login_of_a_bus(tmp_path, monkeypatch):
    channel = "socket://palm:hush-hush@adapter:1?pin=hush"
    service = Service(parse(CONFIG.format(channel=channel)))
    fail = Mock(side_effect=OSError(f"no answer from {channel}"))
    with ExitStack() as stack:
        service.start()
        stack.callback(service.stop)
        url = stack.enter_context(running(service, Server(port=0, recordings=tmp_path)))
        stream = stack.enter_context(connect(websocket_url(url, "/api/v1/sensors/palm/stream")))
        monkeypatch.setattr(reader, "Bus", fail)
        monkeypatch.setattr(VirtualBus, "_recv_internal", fail)
        until(lambda: service.sensors["palm"].status().state == "down" and service.events.newest)
        texts = [problem(ask("POST", url + "/api/v1/recordings", json={"bus": "can0"}), 503)]
        texts.append(next(each for each in stream if '"down"' in each))
        texts += [
            ask("GET", f"{url}/api/v1/{path}").text for path in ("health", "sensors/palm", "events", "config")
        ]
    for text in texts:
        assert "socket://adapter:1" in text
        assert "hush" not in text
