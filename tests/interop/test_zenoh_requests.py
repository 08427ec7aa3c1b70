"""What a server asks of readers: who may change something, and which answers a client gets."""

import json
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import pytest

from tactiled.config import Server, Zenoh
from tactiled.interop.zenoh.fleet import Fleet
from tactiled.interop.zenoh.messages import MAX_ANSWER_BYTES
from tactiled.interop.zenoh.questions import MAX_PENDING
from tactiled.interop.zenoh.reader import Requests
from tactiled.interop.zenoh.session import Answer, Request
from tactiled.interop.zenoh.signatures import NO_CLAIM, USED, WRONG_KEY, robot_key, sign
from tactiled.web.app import create
from tests.conftest import BUSY_S, ask, problem, until
from tests.interop.zenoh_kit import KEY, NAME, TOKEN, kinds


def beside(session, answer=lambda _: None):
    """The queries that a third peer sees which answers the keys of r1/palm, too."""
    queries = []

    def take(query):
        with query:
            parts = query.payload, query.attachment
            queries.append((str(query.key_expr), *(part.to_bytes() if part else b"" for part in parts)))
            answer(query)

    session.declare_queryable("tactiled/r1/palm/**", take)
    return queries


def details(session, key, body, about):
    """What a reader says against a change."""
    replies = session.get(key, payload=body, attachment=about if isinstance(about, bytes) else json.dumps(about))
    return [json.loads(each.ok.payload.to_bytes())["detail"] for each in replies if each.ok]


def test_a_change_needs_the_servers_token_and_a_claim_and_no_secret_leaves_the_server(rig, routed):
    fleet, url, session = routed(server=Server(port=0, control_token=TOKEN), token=TOKEN)
    queries = beside(session)
    path, bearer = f"{url}/sensors/r1/palm/method", {"Authorization": f"Bearer {TOKEN}"}
    problem(ask("PUT", path, json={"method": "nnls"}), 401)  # by the server
    until(lambda: ask("GET", path, headers=bearer).json()["method"] == "wiener" and queries)
    assert not any(b"claim" in attachment for _, _, attachment in queries)
    assert ask("PUT", path, json={"method": "nnls"}, headers=bearer).json()["method"] == "nnls"
    assert rig.sensor.method == "nnls"
    until(lambda: fleet.sensors[NAME].method == "nnls" and kinds(fleet, "method_set"))
    until(lambda: any(b"claim" in attachment for _, _, attachment in queries))
    for secret in (TOKEN, KEY, robot_key(KEY, "r1")):
        assert not any(secret.encode() in b"".join((key.encode(), *rest)) for key, *rest in queries)
    rig.service.set_method("palm", "wiener", False)
    copy = next(each for each in queries if b"claim" in each[2])
    assert details(session, *copy) == [USED]
    assert rig.sensor.method == "wiener"


def test_a_claim_of_another_robots_key_changes_nothing_and_neither_does_none(rig, routed):
    fleet, url, session = routed()
    base, body = f"tactiled/r1/palm/{fleet.sensors[NAME].line.session}", b'{"method": "raw"}'
    key, change = f"{base}/rest/method", {"method": "PUT", "query": "", "headers": {}}
    until(lambda: list(session.get(f"{base}/clock")))
    (challenge,) = [each.ok.payload.to_string() for each in session.get(f"{base}/challenge")]
    about = change | {"challenge": challenge}
    of_another = sign(robot_key(KEY, "r2"), key, about, body)
    assert details(session, key, body, about | {"claim": of_another}) == [WRONG_KEY]
    assert details(session, key, body, change) == [NO_CLAIM]
    assert details(session, key, body, change | {"headers": {"authorization": f"Bearer {TOKEN}"}}) == []
    assert rig.sensor.method == "wiener"
    claim = sign(robot_key(KEY, "r1"), key, about, body)
    assert details(session, key, b'{"method": "tv"}', about | {"claim": claim}) == [WRONG_KEY]  # another body
    assert ask("PUT", f"{url}/sensors/r1/palm/method", json={"method": "nnls"}).json()["method"] == "nnls"


def test_what_another_peer_answers_to_a_change_is_not_taken_for_its_readers_answer(rig, routed):
    _, url, session = routed()

    def answer(query):
        head = {"status": 409, "headers": {"content-type": "application/problem+json"}}
        if "/rest/" in str(query.key_expr):
            text = '{"title": "Conflict", "status": 409, "detail": "no"}'
            query.reply(query.key_expr, text, attachment=json.dumps(head))

    queries, path = beside(session, answer), f"{url}/sensors/r1/palm/method"
    until(lambda: ask("GET", path) and queries)
    assert ask("PUT", path, json={"method": "nnls"}).json()["method"] == rig.sensor.method == "nnls"


@pytest.mark.parametrize(
    ("fleet_key", "key", "why"),
    [
        (None, robot_key(KEY, "r1"), "this server has no zenoh.control_key"),
        (KEY, None, "this reader has no zenoh.control_key"),
        (KEY, KEY, "the claim does not fit this reader's zenoh.control_key"),
    ],
)
def test_without_the_right_key_on_both_sides_the_fleet_is_read_only_and_says_so(rig, routed, fleet_key, key, why):
    _, url, _ = routed(fleet_key, key)
    path = f"{url}/sensors/r1/palm/method"
    assert why in problem(ask("PUT", path, json={"method": "nnls"}), 403)
    assert ask("GET", path).json()["method"] == rig.sensor.method == "wiener"


def test_a_request_that_its_reader_does_not_answer_ends_in_time(routed, monkeypatch):
    _, url, _ = routed()
    monkeypatch.setattr(Fleet.answer, "__defaults__", (0.3,))
    monkeypatch.setattr(Requests, "__call__", lambda *_: (time.sleep(1), Answer(200, {}, b"{}"))[1])
    refused = problem(ask("GET", f"{url}/sensors/{NAME}/method"), 503)
    assert refused == f"sensor {NAME!r}: its reader did not answer within 0.3 s"
    change = problem(ask("PUT", f"{url}/sensors/{NAME}/method", json={"method": "raw"}), 503)
    assert change == f"{refused}: whether it was done is unknown"


JSON, SCRIPT = {"content-type": "application/json"}, b"<script>1</script>"
METHOD = b'{"method": "nnls", "configured": "nnls", "kept": null}'
WRONG_ANSWERS = {
    "html": (200, {"content-type": "text/html", "content-security-policy": "default-src *"}, SCRIPT),
    "html called json": (200, JSON, SCRIPT),
    "a picture with a script": (200, {"content-type": "image/svg+xml"}, b"<svg/>"),
    "a redirect": (302, {"location": "https://elsewhere/"}, b""),
    "a prompt for a password": (401, {"content-type": "application/problem+json"}, b"{}"),
    "fields of another type": (200, JSON, b'{"method": 1, "configured": [], "kept": 0}'),
    "deep": (200, JSON, b"[" * 100_000),
    "long": (200, JSON, METHOD + b" " * MAX_ANSWER_BYTES),
    "no problem": (422, JSON, b'{"detail": "no"}'),
    "another success": (202, JSON, METHOD),
    "no kind": (200, {}, METHOD),
}


def test_what_no_reader_answers_is_a_bad_gateway_and_headers_are_the_servers_own(served, monkeypatch):
    _, url = served()
    answer = Answer(200, JSON, METHOD)
    monkeypatch.setattr(Requests, "__call__", lambda *_: answer)
    path = f"{url}/sensors/{NAME}/method"
    own = ask("GET", path)
    answer = answer._replace(headers={"set-cookie": "a=b", "location": "/", "x-frame-options": "ALLOW"} | JSON)
    good = ask("GET", path)
    assert (good.content, good.headers.keys()) == (own.content, own.headers.keys())
    assert good.headers["x-frame-options"] == own.headers["x-frame-options"] == "DENY"
    for name, wrong in WRONG_ANSWERS.items():
        answer = Answer(*wrong)
        refused = ask("GET", path)
        assert "its reader answers wrongly" in problem(refused, 502), name
        assert refused.headers.keys() == own.headers.keys(), name


def test_a_resource_that_no_sensor_has_never_reaches_a_reader(served, monkeypatch):
    _, url = served()
    requests = []
    monkeypatch.setattr(Requests, "__call__", lambda _, request: requests.append(request))
    wrong = "nowhere ../../config regions/a/b/c %2e%2e/palm2 rest/method method/ frames/x/y frames/x"
    for path in wrong.split():
        assert ask("GET", f"{url}/sensors/{NAME}/{path}").status_code in (404, 422), path
    assert ask("DELETE", f"{url}/sensors/{NAME}/method").status_code == 405
    assert requests == []


def test_one_robots_requests_that_wait_leave_another_its_own(served, monkeypatch):
    fleet, url = served()
    waiting, path = threading.Event(), f"{url}/sensors/{NAME}/method"
    monkeypatch.setattr(Requests, "__call__", lambda *_: waiting.wait(BUSY_S))
    with ThreadPoolExecutor(MAX_PENDING) as clients:
        held_up = [clients.submit(ask, "GET", path) for _ in range(MAX_PENDING)]
        until(lambda: fleet._questions._pending["r1"] == MAX_PENDING)
        assert f"{MAX_PENDING} requests wait" in problem(ask("GET", path), 503)
        waiting.set()
        assert all(each.result().status_code >= 500 for each in held_up)
    until(lambda: not fleet._questions._pending)


def test_a_change_that_came_by_no_server_is_done_only_on_a_network_of_loopback_without_any_key(rig):
    server, body = Server(), b'{"method": "raw"}'
    for settings, status in (
        ({"connect": ["tcp/127.0.0.1:7447"]}, 200),
        ({"connect": ["tcp/127.0.0.1:7447"], "control_key": KEY}, 403),
        ({"connect": ["tcp/10.0.0.1:7447"]}, 403),
    ):
        requests = Requests(create(rig.service, server), server, Zenoh(robot="r1", **settings))
        with requests.running():
            headers = {"content-type": "application/json"}
            assert requests(Request("PUT", "/sensors/palm/method", "", headers, body)).status == status
            assert requests(Request("GET", "/sensors/palm/method")).status == 200
