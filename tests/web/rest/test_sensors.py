import io
import re
import socket
import threading
from concurrent.futures import ThreadPoolExecutor

import can
import httpx
import matplotlib.image
import numpy as np
import pytest

from tactiled.bus.error_frames import KINDS
from tactiled.config import Server
from tactiled.runtime.pipeline import TARE_FRAMES
from tactiled.web import answers
from tactiled.web.http import limits
from tactiled.web.rest import common, picture
from tactiled.web.server import running as serving
from tactiled.web.ws import asyncapi
from tests.conftest import GAIN, HTTP, NO_LOAD, SIDE, ask, pressed, until

PNG = "/api/v1/sensors/palm/frames/raw?format=png"


@pytest.fixture
def client(url):
    with httpx.Client(**HTTP, base_url=url + "/api/v1") as made:
        yield made


def problem(answer, status):
    assert answer.status_code == status
    assert answer.headers["content-type"] == "application/problem+json"
    body = answer.json()
    assert body["status"] == status
    assert body["title"]
    return body["detail"]


def test_before_the_first_frame_it_says_so(client):
    answer = client.get("/sensors/palm/frames/raw")
    assert problem(answer, 503) == "sensor 'palm': no frame yet on can0"
    assert answer.headers["retry-after"] == "1"
    health = client.get("/health").json()
    assert health["status"] == "degraded"
    assert health["sensors"]["palm"]["state"] == "silent"
    assert health["sensors"]["palm"]["age_s"] is None


def test_a_frame_is_the_same_in_every_format(rig, client):
    rig.stale_after(600)
    image = rig.show(pressed())
    told = client.get("/sensors/palm/frames/raw").json()
    assert (told["unit"], told["sequence"], told["kind"], told["state"]) == ("kPa", 0, "raw", "live")
    np.testing.assert_allclose(told["values"], (pressed() - NO_LOAD) * GAIN)
    assert told["timestamp"] == image.time
    assert told["loss"]["lost"] == 0
    restored = client.get("/sensors/palm/frames/restored", headers={"Accept": "application/x-npy"})
    np.testing.assert_array_equal(np.load(io.BytesIO(restored.content)), image.restored)
    assert restored.headers["x-tactiled-sequence"] == "0"
    assert restored.headers["x-tactiled-unit"] == "kPa"
    png = client.get("/sensors/palm/frames/restored", params={"format": "png", "top_kpa": 300})
    assert png.headers["content-type"] == "image/png"
    assert matplotlib.image.imread(io.BytesIO(png.content)).shape[2] == 4


def test_the_deviation_of_a_restored_image_is_told_in_kpa(rig, client):
    counts = np.full((8, 8), NO_LOAD)
    counts[1:6, 1:6] += 400  # 200 kPa, on more than a few spots, which might be elsewhere
    rig.show(counts)
    known = np.array(client.get("/sensors/palm/frames/deviation").json()["values"])
    assert known.shape == (8, 8)
    assert known.min() > 0.5  # kPa, the noise of a taxel, which undoing the blur amplifies
    assert known.max() < 20  # a tenth of what the taxels feel: a block so sharp says that finer ones may be there


def test_a_missing_taxel_is_null_and_flagged_never_zero(rig, client):
    rig.show(pressed())
    rig.send(pressed(), drop=[0])
    rig.send(pressed())  # closes the one before, marked
    rig.send(pressed(), drop=[0])
    until(lambda: rig.sensor.status().loss.incomplete == 1)
    until(lambda: rig.sensor.status().loss.lost == 2)  # the last one is given up on when it is too old
    until(lambda: rig.sensor.hub.latest().sequence == 3)
    told = client.get("/sensors/palm/frames/raw").json()
    taxels = rig.sensor.codec.taxels
    values, flags = np.ravel(told["values"]), np.ravel(told["flags"])
    assert all(value is None for value in values[:taxels])
    assert all(value is not None for value in values[taxels:])
    assert (flags[:taxels] == 1).all()
    text = f"{taxels} taxels did not arrive: restored from their neighbours"
    raised = {"code": "missing", "taxels": taxels, "text": text}
    assert told["warnings"] == [raised]
    until(lambda: raised in [each["warning"] for each in client.get("/events").json()["events"]])
    assert None not in np.ravel(client.get("/sensors/palm/frames/restored").json()["values"])


def test_contacts_keep_their_id_from_request_to_request(rig, client):
    assert client.get("/sensors/palm/contacts").status_code == 503
    for at in (2, 3):
        image = rig.show(pressed(at))
        told = client.get("/sensors/palm/contacts").json()
        (contact,) = told["contacts"]
        assert (told["sequence"], contact["id"]) == (image.sequence, 1)
        assert contact["x_mm"] == pytest.approx(at + 0.5, abs=0.1)
        assert contact["y_mm"] == pytest.approx(3.5, abs=0.1)


def test_what_the_bus_counts_and_how_evenly_frames_come_is_told(rig, client):
    silent = client.get("/sensors/palm").json()
    assert (silent["jitter_s"], silent["skew_s"]) == (None, None)
    rig.show(pressed())
    told = client.get("/sensors/palm").json()
    assert told["skew_s"] >= 0
    assert told["clock"] == "python-can virtual"
    assert {kind: told["loss"][kind] for kind in ("dropped", "errors", "bus_off")} == {
        "dropped": 0,
        "errors": 0,
        "bus_off": 0,
    }
    assert told["error_kinds"] == dict.fromkeys(KINDS, 0)


def test_error_frames_are_told_by_kind(rig, client):
    rig.bus._bus.send(can.Message(is_error_frame=True))
    until(lambda: client.get("/sensors/palm").json()["loss"]["errors"] == 1)
    assert client.get("/sensors/palm").json()["error_kinds"] == dict.fromkeys(KINDS, 0) | {"other": 1}


def test_a_stale_frame_says_how_stale(rig, client):
    rig.show(pressed())
    until(lambda: client.get("/health").json()["status"] == "degraded")
    told = client.get("/sensors/palm/frames/raw").json()
    assert told["state"] == "stale"
    assert told["age_s"] > 0.3
    state = client.get("/sensors/palm").json()
    assert (state["state"], state["rate_hz"]) == ("stale", 0)
    assert re.fullmatch(r"no frame for \d+\.\d s", state["detail"])


def test_polling_an_unchanged_image_costs_nothing(rig, client):
    rig.show(pressed())
    first = client.get("/sensors/palm/frames/raw", headers={"Accept": "application/x-npy"})
    tag = {"If-None-Match": first.headers["etag"], "Accept": "application/x-npy"}
    again = client.get("/sensors/palm/frames/raw", headers=tag)
    assert (again.status_code, again.content) == (304, b"")
    rig.show(pressed())
    assert client.get("/sensors/palm/frames/raw", headers=tag).status_code == 200


@pytest.mark.parametrize(
    ("accept", "gives"),
    [
        ("*/*", "application/json"),
        ("image/*, application/json;q=0.5", "image/png"),
        ("text/html, application/x-npy;q=0.1", "application/x-npy"),
        ("application/json;q=0, image/png;q=x", 406),
        ("application/json;q=0, */*", "application/x-npy"),
        ("application/*;q=0, */*;q=0.1", "image/png"),
        ("application/*;q=0, application/x-npy;q=0.1", "application/x-npy"),
        ("text/html", 406),
    ],
)
def test_the_accept_header_chooses(rig, client, accept, gives):
    rig.show(pressed())
    answer = client.get("/sensors/palm/frames/raw", headers={"Accept": accept})
    if gives == 406:
        assert accept in problem(answer, 406)
    else:
        assert answer.headers["content-type"] == gives


def test_the_method_is_changed_within_a_frame_and_a_wrong_one_changes_nothing(rig, client):
    rig.show(pressed())
    told = client.put("/sensors/palm/method", json={"method": "raw"}).json()
    assert told == {"method": "raw", "configured": "wiener", "kept": None}
    assert rig.show(pressed()).method == "raw"
    assert "method = 'sharpen': no such method" in problem(
        client.put("/sensors/palm/method", json={"method": "sharpen"}), 422
    )
    problem(client.put("/sensors/palm/method", json={"methd": "raw"}), 422)
    problem(client.put("/sensors/palm/method", content=b"{"), 415)
    assert client.get("/sensors/palm/method").json() == told


def test_tare_takes_the_load_off(rig, client):
    rig.stale_after(600)
    rig.show(pressed())
    client.put("/sensors/palm/method", json={"method": "raw"})
    assert client.post("/sensors/palm/tare?force=true").status_code == 202
    for _ in range(17):
        image = rig.show(pressed())
    assert np.abs(image.raw).max() == 0


def test_a_tare_is_refused_under_a_load_unless_it_is_forced(rig, client):
    rig.stale_after(600)
    rig.show(pressed())
    refused = client.post("/sensors/palm/tare")
    says = "sensor 'palm': contact of 200 kPa on 4 taxels: unload the array, or tare anyway with force=true"
    assert problem(refused, 409) == says
    assert (refused.json()["code"], refused.json()["seen"]) == ("loaded", "contact of 200 kPa on 4 taxels")
    assert problem(client.post("/sensors/palm/tare?force=false"), 409) == says
    for _ in range(20):
        image = rig.show(pressed())
    assert (rig.sensor.pipeline.tared, np.abs(image.raw).max()) == (0, 200)
    assert client.post("/sensors/palm/tare?force=true").status_code == 202
    for _ in range(TARE_FRAMES):
        rig.show(pressed())
    until(lambda: rig.service.events.after(0)[-1].kind == "tare_done")
    texts = {each.kind: each.text for each in rig.service.events.after(0)}
    assert texts["tare_asked"] == "the next frames are taken as no load (forced)"


def test_what_was_seen_before_a_tare_or_a_break_forbids_no_tare(rig, client):
    rig.stale_after(600)
    rig.show(pressed())
    client.post("/sensors/palm/tare?force=true")
    for _ in range(TARE_FRAMES):
        rig.show(pressed())
    assert client.post("/sensors/palm/tare").status_code == 202  # it reads zero now
    for _ in range(TARE_FRAMES):
        rig.show(pressed(force=0))
    rig.show(pressed())
    assert problem(client.post("/sensors/palm/tare"), 409).startswith("sensor 'palm': contact of ")
    rig.stale_after(0.05)
    until(lambda: rig.sensor.status().state == "stale")
    rig.show(pressed(force=0))
    rig.stale_after(600)
    assert client.post("/sensors/palm/tare").status_code == 202


def test_no_tare_is_begun_while_readings_move(rig, client):
    rig.stale_after(600)
    for load in range(0, 80, 10):
        rig.show(np.full((SIDE, SIDE), NO_LOAD + load))
    says = problem(client.post("/sensors/palm/tare"), 409)
    assert says.startswith("sensor 'palm': readings that move by 17.5 kPa: unload the array, ")


def test_no_tare_is_begun_while_no_frame_comes(rig, client):
    says = problem(client.post("/sensors/palm/tare"), 409)
    assert says == "sensor 'palm': silent, no frame yet on can0: a tare needs frames"
    assert problem(client.post("/sensors/palm/tare?force=true"), 409) == says
    assert client.post("/sensors/palm/tare").json().keys() == {"type", "title", "status", "detail"}
    rig.stale_after(0.01)
    rig.show(pressed())
    until(lambda: rig.sensor.status().state == "stale")
    says = problem(client.post("/sensors/palm/tare"), 409)
    assert re.fullmatch(r"sensor 'palm': stale, no frame for \d+\.\d s: a tare needs frames", says)
    rig.sensor.down = "unplugged"
    says = problem(client.post("/sensors/palm/tare"), 409)
    assert says == "sensor 'palm': down, unplugged: a tare needs frames"
    rig.sensor.down = None
    rig.stale_after(600)
    for _ in range(20):
        image = rig.show(pressed())
    assert np.abs(image.raw).max() == 400 * GAIN
    assert "tare_asked" not in [each.kind for each in rig.service.events.after(0)]


@pytest.mark.parametrize("looked", [True, False])
def test_a_tare_under_way_lapses_when_the_sensor_is_no_longer_live(rig, client, looked):
    """Whether or not it was seen before the frames came back."""
    rig.stale_after(600)
    rig.show(pressed())
    if not looked:
        rig.service._watch.stop()
    assert client.post("/sensors/palm/tare?force=true").status_code == 202
    rig.show(pressed())
    rig.stale_after(0.05)
    until(lambda: rig.sensor.status().state == "stale")
    if looked:
        until(lambda: rig.service.events.after(0)[-1].kind == "tare_lapsed")
    rig.show(pressed())
    rig.stale_after(600)
    for _ in range(20):
        image = rig.show(pressed())
    assert np.abs(image.raw).max() == 400 * GAIN
    assert (rig.sensor.pipeline.tared, rig.sensor.pipeline.lapsed) == (0, 1)


@pytest.mark.parametrize(
    ("path", "status", "says"),
    [
        ("/sensors/plam", 404, "sensor 'plam': no such sensor: there are palm"),
        ("/sensors/plam/frames/raw", 404, "there are palm"),
        ("/sensors/palm/frames/blurred", 422, "kind = 'blurred'"),
        ("/sensors/palm/frames/raw?format=tiff", 422, "format = 'tiff'"),
        ("/sensors/palm/frames/raw?top_kpa=-1", 422, "top_kpa = '-1'"),
        ("/nothing", 404, ""),
        ("/sensors/palm/frames/raw?fromat=npy", 422, "fromat: no such parameter: there are format, top_kpa"),
        ("/sensors/palm/frames/raw?format=npy&format=npy", 422, "format: given 2 times: give it once"),
        ("/events?limit=1&limit=2", 422, "limit: given 2 times"),
        ("/health?sensor=palm", 422, "sensor: no such parameter: there is none"),
        (f"/health?{'x' * 5000}=1", 422, f"{'x' * 80}: no such parameter"),
        (f"/sensors/{'x' * 5000}", 404, f"sensor {'x' * 80!r}: no such sensor: there are palm"),
    ],
)
def test_what_is_wrong_is_named(rig, client, path, status, says):
    rig.show(pressed())
    assert says in problem(client.get(path), status)


def test_a_token_may_stand_in_every_address_and_the_viewers_own_takes_anything(client):
    assert client.get("/health?token=x").status_code == 200
    assert client.get("/sensors/palm/frames?token=x&last=1s").status_code == 200
    for path in ("/?sensor=palm", "/metrics?x=1", "/static/app.js?1"):
        assert ask("GET", str(client.base_url.join("/")).rstrip("/") + path).status_code == 200


def test_the_kernel_and_the_geometry(client):
    kernel = client.get("/sensors/palm/kernel").json()
    assert kernel["q_per_mm"][0] == 0
    assert kernel["gain"][0] == pytest.approx(1, abs=1e-6)
    q, gain = np.array(kernel["q_per_mm"]), np.array(kernel["gain"])
    r, g = np.array(kernel["r_mm"]), np.array(kernel["g_per_mm2"])
    assert np.interp(kernel["nyquist_per_mm"], q, gain) == pytest.approx(kernel["nyquist_gain"], abs=1e-3)
    assert np.trapezoid(2 * np.pi * r * g, r) == pytest.approx(1, abs=5e-3)  # all of the force gets through
    geometry = client.get("/sensors/palm/geometry").json()
    assert geometry["positions_mm"][9] == [1.0, 1.0]
    assert geometry["restored"] == {"rows": 8, "columns": 8, "cell_mm": 1.0}


LASTING = ("colormap", "sensors/palm/geometry", "sensors/palm/kernel", "openapi.json", "asyncapi.json")


@pytest.mark.parametrize("path", LASTING)
def test_what_stays_the_same_is_made_once(client, path, monkeypatch):
    plain = client.get(f"/{path}", headers={"Accept-Encoding": "identity"})
    for made in (picture, "colors"), (answers, "geometry"), (answers, "kernel"), (asyncapi, "models_json_schema"):
        monkeypatch.setattr(*made, lambda *_, **__: pytest.fail("made twice"))
    packed = client.get(f"/{path}", headers={"Accept-Encoding": "br, gzip"})
    assert (plain.headers.get("content-encoding"), packed.headers["content-encoding"]) == (None, "gzip")
    assert packed.json() == plain.json()
    assert "Accept-Encoding" in packed.headers["vary"]
    assert "Accept-Encoding" in plain.headers["vary"]
    tag = packed.headers["etag"]
    same = client.get(f"/{path}", headers={"If-None-Match": f'"x", {tag}'})
    assert (same.status_code, same.content, same.headers["etag"]) == (304, b"", tag)
    assert client.get(f"/{path}", headers={"If-None-Match": '"x"'}).content == plain.content
    assert client.head(f"/{path}").headers["etag"] == tag


def test_every_error_of_every_resource_is_documented_as_a_problem_and_every_field_has_a_type(client):
    spec = client.get("/openapi.json").json()
    assert len(spec["paths"]) == 16
    for path, operations in spec["paths"].items():
        for operation in operations.values():
            for status, answer in operation["responses"].items():
                if status >= "400":
                    assert "application/problem+json" in answer["content"], (path, status)
            assert operation["summary"], path
    assert "HTTPValidationError" not in spec["components"]["schemas"]


@pytest.mark.parametrize(
    ("headers", "says"),
    [
        ({"Origin": "https://elsewhere.example"}, "pages of another site may not use this service"),
        ({"Host": "elsewhere.example"}, "this service answers to localhost only"),
    ],
)
def test_pages_of_other_sites_are_refused(client, headers, says):
    assert says in problem(client.put("/sensors/palm/method", json={"method": "raw"}, headers=headers), 403)
    assert client.get("/sensors/palm/method").json()["method"] == "wiener"


def test_every_answer_carries_the_security_headers(client):
    for path in ("/health", "/nothing"):
        headers = client.get(path).headers
        assert "default-src 'none'" in headers["content-security-policy"]
        assert headers["x-content-type-options"] == "nosniff"


def test_clients_record_only_where_a_folder_is_configured(rig, tmp_path):
    for folder, status in ((None, 404), (tmp_path, 200)):
        with serving(rig.service, Server(port=0, recordings=folder)) as url:
            assert ask("GET", url + "/api/v1/recordings").status_code == status
    with serving(rig.service, Server(port=0, recordings=tmp_path)) as url:
        started = ask("POST", url + "/api/v1/recordings", json={"bus": "can0", "name": "a.log"})
        assert started.status_code == 201
        for _ in range(5):
            rig.show(pressed())
        until(lambda: ask("GET", url + "/api/v1/recordings").json()["recordings"][0]["messages"] >= 5)
        assert ask("POST", url + "/api/v1/recordings/a.log/stop").json()["running"] is False
        assert ask("GET", url + "/api/v1/recordings/a.log").text.count("#") >= 5


@pytest.fixture
def drawing(monkeypatch):
    """What drawing a picture waits for, and for each that was begun whether it was the only one."""
    go_on, running, begun = threading.Event(), threading.Lock(), []

    def png(*_):
        alone = running.acquire(blocking=False)
        begun.append(alone)
        assert go_on.wait(60)
        if alone:
            running.release()
        return b"a picture"

    monkeypatch.setattr(picture, "png", png)
    yield go_on, begun
    go_on.set()


@pytest.fixture
def image_for(url):
    """Asks for a picture as one of some clients."""
    return lambda who, **headers: ask("GET", url + PNG, headers={"X-Forwarded-For": f"10.0.0.{who}"} | headers)


def test_what_costs_much_is_made_one_at_a_time_and_the_rest_does_not_wait(rig, client, image_for, drawing):
    """More pictures than the service has threads, of which the first is not done before something else is."""
    rig.show(pressed())
    go_on, begun = drawing
    with ThreadPoolExecutor(50) as many:
        answers = [many.submit(image_for, number % 5) for number in range(50)]
        until(lambda: begun, 60)
        assert client.get("/sensors/palm").status_code == 200
        assert client.get("/sensors/palm/frames/deviation").status_code == 200
        assert client.get("/sensors/palm/frames").status_code == 200
        go_on.set()
        assert [each.result().status_code for each in answers] == [200] * 50
    assert begun == [True] * 50


@pytest.mark.parametrize(
    ("bound", "clients", "says", "another"),
    [
        ("MAX_WAITING", 20, "3 such answers are waited for already: wait", 429),
        ("MAX_WAITING_PER_CLIENT", 1, "3 such answers are waited for by 10.0.0.0 already: wait", 200),
    ],
)
def test_no_more_than_a_few_wait_for_their_turn(
    rig, client, image_for, drawing, monkeypatch, bound, clients, says, another
):
    monkeypatch.setattr(limits, bound, 3)
    rig.show(pressed())
    go_on, _ = drawing
    with ThreadPoolExecutor(21) as many:
        answers = [many.submit(image_for, number % clients) for number in range(20)]
        until(lambda: sum(each.done() for each in answers) == 16, 60)
        assert client.get("/sensors/palm/frames").status_code == 200  # another kind
        other = many.submit(image_for, 99)
        until(lambda: other.done() == (another == 429), 60)
        go_on.set()
        assert other.result().status_code == another
        refused = [got for each in answers if (got := each.result()).status_code != 200]
    assert len(refused) == 16
    for each in refused:
        assert problem(each, 429) == says
        assert int(each.headers["retry-after"]) >= 1


def test_who_finds_the_queue_full_has_not_asked(rig, monkeypatch):
    """Six costly answers a minute are one at a time, which refusals do not use up."""
    monkeypatch.setattr(picture, "png", lambda *_: b"a picture")
    rig.show(pressed())
    with serving(rig.service, Server(port=0, control_per_minute=6)) as url:
        with monkeypatch.context() as full:
            full.setattr(limits, "MAX_WAITING", 0)
            for _ in range(3):
                says = problem(ask("GET", url + PNG), 429)
                assert says == "0 such answers are waited for already: wait"
        assert ask("GET", url + PNG).status_code == 200
        assert problem(ask("GET", url + PNG), 429) == "more than 6 a minute: wait"


def test_an_image_that_is_known_already_waits_for_nobody_and_does_not_count(rig, drawing):
    go_on, begun = drawing
    rig.show(pressed())
    until(lambda: rig.sensor.status().state == "stale")  # and so it stays: its tag is known
    with serving(rig.service, Server(port=0, control_per_minute=6)) as url, ThreadPoolExecutor(1) as other:
        go_on.set()
        known = {"If-None-Match": ask("GET", url + PNG).headers["etag"]}
        go_on.clear()
        drawn = other.submit(ask, "GET", url + PNG, headers={"X-Forwarded-For": "10.0.0.1"})
        until(lambda: len(begun) == 2, 60)
        assert [ask("GET", url + PNG, headers=known).status_code for _ in range(5)] == [304] * 5
        go_on.set()
        assert drawn.result().status_code == 200
    assert len(begun) == 2


def test_nothing_is_drawn_for_a_client_that_left(rig, drawing, monkeypatch):
    go_on, begun = drawing
    made = []
    monkeypatch.setattr(common, "Turns", lambda each: made.append(limits.Turns(each)) or made[-1])
    rig.show(pressed())
    with serving(rig.service) as url, ThreadPoolExecutor(1) as other:
        first = other.submit(ask, "GET", url + PNG)
        until(lambda: begun, 60)
        with socket.create_connection(url[7:].split(":")) as leaves:
            leaves.sendall(f"GET {PNG} HTTP/1.1\r\nHost: {url[7:]}\r\n\r\n".encode())
            until(lambda: sum(turns._waiting.total() for turns in made) == 1, 60)
        go_on.set()
        assert [first.result().status_code, ask("GET", url + PNG).status_code] == [200, 200]
    assert begun == [True, True]
