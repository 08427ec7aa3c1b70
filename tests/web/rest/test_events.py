import threading
import time
from contextlib import ExitStack

import httpx
import pytest
from pydantic import SecretStr

from tactiled.config import Server, parse
from tactiled.config.schema import Bus
from tactiled.runtime.service import Service
from tactiled.runtime.state import StateFile
from tactiled.web.rest import events
from tactiled.web.server import running
from tests.conftest import BUSY_S, CONFIG, HTTP, ask, pressed, until
from tests.web.http.raw import plug
from tests.web.rest.test_sensors import problem


@pytest.fixture
def client(url):
    with httpx.Client(**HTTP, base_url=url + "/api/v1") as made:
        yield made


def kinds(client, **query):
    return [each["kind"] for each in client.get("/events", params=query).json()["events"]]


def test_what_happens_to_a_sensor_is_told_in_order(rig, client):
    rig.stale_after(600)
    rig.show(pressed())
    until(lambda: kinds(client) == ["sensor_live"])
    client.put("/sensors/palm/method", json={"method": "raw"})
    client.put("/sensors/palm/method", json={"method": "sharpen"})
    client.post("/sensors/palm/tare?force=true")
    for _ in range(16):
        rig.show(pressed())
    until(lambda: kinds(client)[-1] == "tare_done")
    client.post("/sensors/palm/tare?force=true")
    rig.stale_after(0.3)
    until(lambda: kinds(client)[-1] == "tare_lapsed")
    told = client.get("/events").json()
    assert kinds(client) == [
        "sensor_live", "method_set", "tare_asked", "tare_done", "tare_asked", "sensor_stale", "tare_lapsed"
    ]  # fmt: skip
    assert [each["id"] for each in told["events"]] == [1, 2, 3, 4, 5, 6, 7]
    assert {each["sensor"] for each in told["events"]} == {"palm"}
    assert (told["newest"], told["missed"]) == (7, 0)
    assert told["events"][1]["text"] == "raw"
    assert abs(told["events"][5]["time"] - time.time()) < BUSY_S


def test_pages_lead_on_and_what_has_fallen_out_is_counted(rig, client):
    for n in range(1500):
        rig.service.events.add("method_set", f"m{n}", "palm")
    first = client.get("/events", params={"limit": 1000}).json()
    assert (first["missed"], len(first["events"]), first["events"][0]["text"]) == (500, 1000, "m500")
    page = client.get("/events", params={"after": 1490, "limit": 4}).json()
    assert [each["id"] for each in page["events"]] == [1491, 1492, 1493, 1494]
    assert client.get("/events", params={"after": 1500}).json()["events"] == []
    restarted = client.get("/events", params={"after": 10**6, "wait": 30}).json()
    assert (len(restarted["events"]), restarted["newest"]) == (100, 1500)


def test_a_client_that_waits_hears_of_the_next_event_when_it_happens(rig, client):
    def later():
        time.sleep(0.3)
        rig.service.events.add("bus_up", "is there again", bus="can0")

    newest = client.get("/events").json()["newest"]
    thread = threading.Thread(target=later)
    began = time.monotonic()
    thread.start()
    told = client.get("/events", params={"after": newest, "wait": 25}).json()
    thread.join()
    assert [each["text"] for each in told["events"]] == ["is there again"]
    assert 0.3 <= time.monotonic() - began < BUSY_S
    none = client.get("/events", params={"after": told["newest"], "wait": 0.2}).json()
    assert none == {"events": [], "newest": told["newest"], "missed": 0}
    until(lambda: not rig.service.events._listeners)


@pytest.mark.parametrize("query", [{"wait": 31}, {"wait": "nan"}, {"after": -1}, {"limit": 0}, {"after": "x"}])
def test_what_is_wrong_is_named(client, query):
    (name, value), *_ = query.items()
    assert f"{name} = '{value}'" in problem(client.get("/events", params=query), 422)


def test_recordings_are_told(rig, tmp_path):
    with (
        running(rig.service, Server(port=0, recordings=tmp_path)) as url,
        httpx.Client(**HTTP, base_url=url + "/api/v1") as client,
    ):
        client.post("/recordings", json={"bus": "can0", "name": "a.log"})
        client.post("/recordings/a.log/stop")
        told = client.get("/events").json()["events"]
    assert [(each["kind"], each["bus"], each["text"]) for each in told] == [
        ("recording_started", "can0", "a.log"),
        ("recording_ended", "can0", "a.log: 0 messages"),
    ]


def test_a_method_is_kept_where_the_service_keeps_state(tmp_path, client):
    detail = problem(client.put("/sensors/palm/method", json={"method": "raw", "keep": True}), 409)
    assert detail.startswith("keep = true: this service keeps no state")
    assert client.get("/sensors/palm/method").json()["method"] == "wiener"
    config = parse(CONFIG.format(channel="none"))
    for _ in range(2):
        service = Service(config, state=StateFile(tmp_path / "state.json"))
        with running(service) as url:
            asked = {"method": "nnls", "keep": True}
            told = ask("PUT", url + "/api/v1/sensors/palm/method", json=asked).json()
            assert told == {"method": "nnls", "configured": "wiener", "kept": "nnls"}
            (override,) = ask("GET", url + "/api/v1/config").json()["overrides"]
            assert override == {
                "sensor": "palm", "key": "method", "configured": "wiener", "value": "nnls", "kept": True
            }  # fmt: skip
    assert service.events.after(0)[0].kind == "method_kept"


def test_the_configuration_is_told_without_its_secrets(rig):
    token = SecretStr("hush-hush-hush-1")
    secrets = {
        "password": "hush-bus",
        "login": {"user": "palm", "passphrase": "hush-deep"},
        "nodes": [{"auth": "hush-listed"}, 5],
        "host": "ws://palm:hush-in-@ddress@elsewhere:1",
        "channel": "https://elsewhere/x?api=hush-asked&id=hush-too#there",
        "dongle_pin": "hush-pin",
        "dongle_key": 123456,
        "pinky": 5,
        "url": "https://elsewhere/hush-path",
    }
    buses = rig.service.config.bus
    buses["can0"] = Bus(**(buses["can0"].settings() | secrets))
    with running(rig.service, Server(port=0, control_token=token)) as url:
        answer = ask(
            "GET", url + "/api/v1/config", headers={"Authorization": f"Bearer {token.get_secret_value()}"}
        )
    told = answer.json()
    assert "hush" not in answer.text
    bus = told["bus"]["can0"]
    assert (bus["password"], bus["login"]) == ("hidden", {"user": "hidden", "passphrase": "hidden"})
    assert (bus["nodes"], bus["host"]) == ([{"auth": "hidden"}, 5], "ws://elsewhere:1")
    assert (bus["channel"], bus["url"]) == ("https://elsewhere/x", "hidden")
    assert (bus["dongle_pin"], bus["dongle_key"], bus["pinky"]) == ("hidden", "hidden", 5)
    assert (told["server"]["control_token"], told["server"]["tls"]) == (True, False)
    assert told["sensor"]["palm"]["codec"]["name"] == "packed"
    assert told["sensor"]["palm"]["cover"][0]["thickness_mm"] == 0.8
    assert told["overrides"] == []


def test_the_calibration_is_told_as_it_is_now(rig, client):
    told = client.get("/sensors/palm/calibration").json()
    assert (told["kpa_per_count"], told["noise_kpa"], told["saturation"], told["tared"]) == (0.5, 0.5, 4000, 0)
    assert told["no_load"] == [100.0] * 64
    rig.stale_after(600)
    rig.show(pressed())
    client.post("/sensors/palm/tare?force=true")
    for _ in range(17):
        rig.show(pressed())
    told = client.get("/sensors/palm/calibration").json()
    assert told["no_load"] == pressed().ravel().tolist()
    assert told["tared"] == 1


def test_a_client_has_a_few_requests_that_wait_and_no_more(rig, url):
    with ExitStack() as stack:
        ends = [stack.enter_context(plug(url)) for _ in range(events.WAITING_PER_CLIENT)]
        for end in ends:
            end.sendall(b"GET /api/v1/events?wait=30 HTTP/1.1\r\nHost: localhost\r\n\r\n")
        until(lambda: ask("GET", url + "/api/v1/events?wait=0.1").status_code == 429)
        answer = ask("GET", url + "/api/v1/events?wait=0.1")
        assert "events_waiting_per_client = 16" in problem(answer, 429)
        assert answer.headers["retry-after"] == "1"
        assert ask("GET", url + "/api/v1/events").status_code == 200
        rig.service.events.add("method_set", "raw", "palm")
        assert all(end.recv(1 << 16).startswith(b"HTTP/1.1 200") for end in ends)
    assert ask("GET", url + "/api/v1/events?after=1&wait=0.01").status_code == 200
