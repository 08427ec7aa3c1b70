import time
from contextlib import ExitStack

from tactiled.config import Server
from tactiled.config.schema import Bus
from tactiled.web.rest.events import MAX_WAITING_PER_CLIENT
from tactiled.web.server import running
from tests.conftest import BUSY_S, ask, pressed, problem, until
from tests.web.http.raw import plug


def kinds(client):
    """Kinds of events without those that depend on the number of frames or on when the first one comes."""
    everything = [each["kind"] for each in client.get("/events").json()["events"]]
    return [each for each in everything if not each.startswith(("warning_", "sensor_silent"))]


def test_events_of_a_sensor_come_in_order(rig, client):
    rig.stale_after(600)
    rig.show(pressed())
    until(lambda: kinds(client) == ["sensor_live"])
    client.put("/sensors/palm/method", json={"method": "raw"})
    client.put("/sensors/palm/method", json={"method": "sharpen"})
    client.post("/sensors/palm/tare?force=true")
    rig.show_until_tared(pressed())
    until(lambda: kinds(client)[-1] == "tare_done")
    client.post("/sensors/palm/tare?force=true")
    rig.stale_after(0.3)
    until(lambda: kinds(client)[-1] == "tare_lapsed")
    answer = client.get("/events").json()
    events = answer["events"]
    assert kinds(client) == [
        "sensor_live", "method_set", "tare_asked", "tare_done", "tare_asked", "sensor_stale", "tare_lapsed"
    ]  # fmt: skip
    assert [each["id"] for each in events] == [*range(1, len(events) + 1)]
    assert {each["sensor"] for each in events} == {"palm"}
    assert (answer["newest"], answer["missed"]) == (len(events), 0)
    assert [each["text"] for each in events if each["kind"] == "method_set"] == ["raw"]
    assert abs(events[-1]["time"] - time.time()) < BUSY_S


def test_pages_of_events_and_the_count_of_discarded_ones(rig, client):
    rig.stale_after(600)
    for n in range(1500):
        rig.service.events.add("method_set", f"m{n}", "palm")
    first = client.get("/events", params={"limit": 1000}).json()
    assert (first["missed"], len(first["events"]), first["events"][0]["text"]) == (500, 1000, "m500")
    page = client.get("/events", params={"after": 1490, "limit": 4}).json()
    assert [each["id"] for each in page["events"]] == [1491, 1492, 1493, 1494]
    assert client.get("/events", params={"after": 1500}).json()["events"] == []
    restarted = client.get("/events", params={"after": 10**6, "wait": 30}).json()
    assert (len(restarted["events"]), restarted["newest"]) == (100, 1500)


def test_requests_that_wait_are_bounded_for_each_client(rig, url):
    rig.stale_after(600)
    path = f"/api/v1/events?after={rig.service.events.newest}"
    with ExitStack() as stack:
        sockets = [stack.enter_context(plug(url)) for _ in range(MAX_WAITING_PER_CLIENT)]
        for each in sockets:
            each.sendall(f"GET {path}&wait=30 HTTP/1.1\r\nHost: localhost\r\n\r\n".encode())
        until(lambda: ask("GET", f"{url}{path}&wait=0.1").status_code == 429)
        refused = ask("GET", f"{url}{path}&wait=0.1")
        assert "events_waiting_per_client = 16" in problem(refused, 429)
        assert refused.headers["retry-after"] == "1"
        assert ask("GET", url + "/api/v1/events").status_code == 200
        rig.service.events.add("method_set", "raw", "palm")
        assert all(each.recv(1 << 16).startswith(b"HTTP/1.1 200") for each in sockets)
    newest = rig.service.events.newest
    none = ask("GET", f"{url}/api/v1/events?after={newest}&wait=0.01").json()
    assert none == {"events": [], "newest": newest, "missed": 0}
    until(lambda: not rig.service.events._listeners)


def test_the_configuration_is_shown_without_its_secrets(rig):
    token = "hush-hush-hush-1"
    secrets = {"password": "hush-bus", "host": "ws://palm:hush-in-@ddress@elsewhere:1", "pinky": 5}
    buses = rig.service.config.bus
    buses["can0"] = Bus(**(buses["can0"].settings() | secrets))
    headers = {"Authorization": f"Bearer {token}"}
    with running(rig.service, Server(port=0, control_token=token)) as url:
        answer = ask("GET", url + "/api/v1/config", headers=headers)
    config = answer.json()
    assert "hush" not in answer.text
    bus, server = config["bus"]["can0"], config["server"]
    assert [bus[key] for key in secrets] == ["hidden", "ws://elsewhere:1", 5]
    switches = ("read_token", "control_token", "tls", "recordings", "keeps_state")
    assert [server[key] for key in switches] == [True, True, False, False, False]
    assert server.keys() == Server.model_fields.keys() - {"tls_certificate", "tls_key", "state"} | {*switches}
    assert (server["host"], server["history_s"], server["foxglove"]) == ("127.0.0.1", 5.0, None)
    assert config["sensor"]["palm"]["codec"]["name"] == "packed"
    assert config["sensor"]["palm"]["cover"][0]["thickness_mm"] == 0.8
    assert config["overrides"] == []
