import re
import shutil
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from tactiled.calibrate.upkeep.health import RULES, Fault
from tactiled.config import parse
from tactiled.frames import Loss, RawFrame
from tactiled.live.service import Service
from tactiled.live.state_file import StateFile
from tactiled.web.rest import events, trace
from tactiled.web.server import running
from tests.calibrate.counts.skins import contact
from tests.conftest import BUSY_S, CONFIG, GAIN, NO_LOAD, SIDE, ask, pressed, problem, until
from tests.web.ws.clients import images, stream

TARE = "/sensors/palm/tare"


@pytest.fixture
def live(rig):
    """The rig, whose frames do not become stale by themselves."""
    rig.stale_after(600)
    return rig


def show(rig, count, force=400):
    for _ in range(count):
        image = rig.show(pressed(force=force))
    return image


def test_a_sensor_is_silent_before_its_first_frame_and_stale_after_its_last(rig, client):
    health = client.get("/health").json()
    assert (health["status"], health["sensors"]["palm"]["state"]) == ("degraded", "silent")
    silent = client.get("/sensors/palm").json()
    assert [silent[key] for key in ("age_s", "jitter_s", "skew_s", "sequence")] == [None] * 4
    assert (silent["clock"], silent["shear"], silent["rows"]) == ("python-can virtual", False, SIDE)
    assert client.get("/sensors").json() == {"sensors": [client.get("/sensors/palm").json()]}
    rig.stale_after(600)
    rig.show(pressed())
    assert client.get("/health").json()["status"] == "ok"
    rig.stale_after(0.3)
    until(lambda: client.get("/health").json()["status"] == "degraded")


def test_the_method_is_changed_within_a_frame_and_a_wrong_one_changes_nothing(rig, client):
    rig.show(pressed())
    selected = client.put("/sensors/palm/method", json={"method": "raw"}).json()
    assert selected == {"method": "raw", "configured": "wiener", "kept": None}
    assert rig.show(pressed()).method == "raw"
    refused = client.put("/sensors/palm/method", json={"method": "sharpen"})
    assert "method = 'sharpen': no such method" in problem(refused, 422)
    problem(client.put("/sensors/palm/method", json={"methd": "raw"}), 422)
    problem(client.put("/sensors/palm/method", json={"method": "nnls", "keep": 0}), 422)
    refused = client.put("/sensors/palm/method", json={"method": "nnls", "keep": True})
    assert problem(refused, 409).startswith("keep = true: this service keeps no state")
    assert client.get("/sensors/palm/method").json() == selected


def test_a_kept_method_is_an_override_of_the_configuration(tmp_path):
    override = {"sensor": "palm", "key": "method", "configured": "wiener", "value": "nnls", "kept": True}
    state = tmp_path / "state" / "state.json"
    service = Service(parse(CONFIG.format(channel="none")), state=StateFile(state))
    with running(service) as url:
        path = url + "/api/v1/sensors/palm/method"
        answer = ask("PUT", path, json={"method": "nnls", "keep": True}).json()
        assert answer == {"method": "nnls", "configured": "wiener", "kept": "nnls"} == ask("GET", path).json()
        assert ask("GET", url + "/api/v1/config").json()["overrides"] == [override]
        shutil.rmtree(state.parent)
        state.parent.write_text("a file is in the way")
        refused = problem(ask("PUT", path, json={"method": "raw", "keep": True}), 503)
        assert refused == "state: File exists: nothing was kept"


def test_a_tare_is_refused_under_a_load_unless_it_is_forced(live, client):
    live.show(pressed())
    client.put("/sensors/palm/method", json={"method": "raw"})
    text = "sensor 'palm': contact of 200 kPa on 4 taxels: unload the array, or tare anyway with force=true"
    for refused in (client.post(TARE), client.post(f"{TARE}?force=false")):
        assert problem(refused, 409) == text
        assert (refused.json()["code"], refused.json()["seen"]) == ("loaded", "contact of 200 kPa on 4 taxels")
    assert np.abs(show(live, 20).raw).max() == 200
    before = client.get("/sensors/palm/calibration").json()
    assert (before["kpa_per_count"], before["noise_kpa"], before["saturation"]) == (0.5, 0.5, 4000)
    assert (before["calibrated"], before["no_load"], before["tared"]) == (True, [100.0] * 64, 0)
    assert client.post(f"{TARE}?force=true").json() == {"frames": 16, "seconds": 0.5}
    assert np.abs(live.show_until_tared(pressed()).raw).max() == 0
    after = client.get("/sensors/palm/calibration").json()
    assert (after["no_load"], after["tared"], after["can_undo"]) == (pressed().ravel().tolist(), 1, True)
    assert after["tared_at"] == client.get("/sensors/palm").json()["tared_at"]
    assert after["tared_at"] == pytest.approx(time.time(), abs=600)
    undone = client.delete(TARE).json()
    assert [undone[key] for key in ("can_undo", "tared_at", "no_load")] == [False, None, before["no_load"]]
    assert live.show(pressed()).raw.max() == 200
    assert problem(client.delete(TARE), 409) == "sensor 'palm': no tare to undo"
    until(lambda: any(each.kind == "tare_done" for each in live.service.events.after(0)))
    texts = {each.kind: each.text for each in live.service.events.after(0)}
    assert texts["tare_asked"] == "the next frames are taken as no load (forced)"


def test_loads_before_a_tare_or_a_pause_forbid_no_tare(live, client):
    live.show(pressed())
    client.post(f"{TARE}?force=true")
    live.show_until_tared(pressed())
    assert client.post(TARE).status_code == 202  # it reads zero now
    live.show_until_tared(pressed(force=0))
    live.show(pressed())
    assert problem(client.post(TARE), 409).startswith("sensor 'palm': contact of ")
    live.stale_after(0.05)
    until(lambda: live.sensor.status().state == "stale")
    live.show(pressed(force=0))
    live.stale_after(600)
    assert client.post(TARE).status_code == 202


def test_no_tare_begins_while_readings_move_or_no_frame_comes(live, client):
    for query in ("", "?force=true"):
        refused = client.post(TARE + query)
        assert problem(refused, 409) == "sensor 'palm': silent, no frame yet on can0: a tare needs frames"
        assert refused.json().keys() == {"type", "title", "status", "detail"}
    for load in range(0, 80, 10):
        live.show(np.full((SIDE, SIDE), NO_LOAD + load))
    refused = problem(client.post(TARE), 409)
    assert refused.startswith("sensor 'palm': readings that move by 17.5 kPa: unload the array, ")
    live.stale_after(0.01)
    until(lambda: live.sensor.status().state == "stale")
    stale = problem(client.post(TARE), 409)
    assert re.fullmatch(r"sensor 'palm': stale, no frame for \d+\.\d s: a tare needs frames", stale)
    live.stale_after(600)
    assert np.abs(show(live, 20).raw).max() == 400 * GAIN
    assert "tare_asked" not in [each.kind for each in live.service.events.after(0)]


WRONG_WINDOWS = (
    ("last", "2"), ("last", "2min"), ("last", "٢s"), ("kind", "deviation"), ("limit", "0"), ("limit", "1001"),
    ("before", "-1"), ("before", "5@"), ("before", "5@nan"), ("format", "png"),
)  # fmt: skip


def test_wrong_paths_and_parameters_are_named(rig, client):
    rig.show(pressed())
    for path, status, detail in (
        ("/sensors/plam", 404, "sensor 'plam': no such sensor: there are palm"),
        ("/sensors/plam/frames/raw", 404, "there are palm"),
        (f"/sensors/{'x' * 5000}", 404, f"sensor {'x' * 80!r}: no such sensor: there are palm"),
        ("/recordings", 404, "GET /api/v1/recordings: not found"),  # no folder is configured
        ("/sensors/palm/frames/blurred", 422, "kind = 'blurred'"),
        ("/sensors/palm/frames/raw?format=tiff", 422, "format = 'tiff'"),
        ("/sensors/palm/frames/raw?top_kpa=-1", 422, "top_kpa = '-1'"),
        (
            "/sensors/palm/frames/raw?fromat=npy",
            422,
            "fromat: no such parameter: there are image, top, top_kpa, format",
        ),
        ("/sensors/palm/frames/raw?format=npy&format=npy", 422, "format: given 2 times: give it once"),
        ("/events?limit=1&limit=2", 422, "limit: given 2 times"),
        ("/events?wait=31", 422, "wait = '31'"),
        ("/events?wait=nan", 422, "wait = 'nan'"),
        ("/events?after=-1", 422, "after = '-1'"),
        ("/events?limit=0", 422, "limit = '0'"),
        ("/health?sensor=palm", 422, "sensor: no such parameter: there is none"),
        (f"/health?{'x' * 5000}=1", 422, f"{'x' * 80}: no such parameter"),
        *((f"/sensors/palm/frames?{name}={value}", 422, f"{name} = '{value}'") for name, value in WRONG_WINDOWS),
    ):
        assert detail in problem(client.get(path), status)


def test_a_token_is_allowed_in_every_address_and_the_pages_take_any_parameter(url):
    for path in ("/api/v1/health?token=x", "/api/v1/sensors/palm/frames?token=x&last=1s", "/?sensor=palm"):
        assert ask("GET", url + path).status_code == 200
    for path in ("/metrics?x=1", "/static/app.js?1", "/docs"):
        assert ask("GET", url + path).status_code == 200


def test_kernel_geometry_and_colour_map(client):
    kernel = client.get("/sensors/palm/kernel").json()
    q, gain = np.array(kernel["q_per_mm"]), np.array(kernel["gain"])
    r, g = np.array(kernel["r_mm"]), np.array(kernel["g_per_mm2"])
    assert (q[0], gain[0]) == pytest.approx((0, 1), abs=1e-6)
    assert np.interp(kernel["nyquist_per_mm"], q, gain) == pytest.approx(kernel["nyquist_gain"], abs=1e-3)
    assert np.trapezoid(2 * np.pi * r * g, r) == pytest.approx(1, abs=5e-3)  # all of the force gets through
    geometry = client.get("/sensors/palm/geometry").json()
    assert geometry["positions_mm"][9] == [1.0, 1.0]
    assert geometry["restored"] == {
        "rows": 8, "columns": 8, "cell_mm": 1.0, "origin_mm": [0.0, 0.0], "mask": None,
    }  # fmt: skip
    colormap = client.get("/colormap").json()
    assert (colormap["name"], len(colormap["colors"]), colormap["colors"][0]) == ("magma", 256, [0, 0, 4])


def test_taxels_that_do_not_work_noise_and_drift_are_served(live, client):
    live.show(pressed())
    before = client.get("/sensors/palm/health").json()
    assert (before["taxels"], before["faults"], before["drift_states"], before["creep"]) == (64, [], None, None)
    assert before["noise_counts"] == [None] * 64  # of one frame nothing is known
    health = live.sensor.pipeline.monitor._health
    health._scores[Fault.DEAD][17] = RULES[Fault.DEAD].threshold
    health._active[Fault.DEAD][17] = True
    client.post("/sensors/palm/tare?force=true")
    live.show_until_tared(pressed())
    after = client.get("/sensors/palm/health").json()
    (fault,) = after["faults"]
    since = fault.pop("since")
    assert fault == {"taxel": 17, "fault": "dead", "reason": "it feels no load, and its neighbours do"}
    assert 0 <= live.sensor.hub.latest().time - since < 10 * BUSY_S
    assert after["drift_counts"] == [0.0] * 64
    assert sum(after["drift_states"].values()) == after["drift_states"]["free"] == 64
    assert client.get("/sensors/palm").json()["references"] is None


TRACE = "/api/v1/sensors/palm/trace"
STAGES = ["first_message", "last_message", "assembled", "started", "calibrated", "restored", "checked"]


@pytest.fixture
def traced(rig, monkeypatch):
    """The rig with a sensor that stays live however busy the machine is."""
    monkeypatch.setattr(trace, "MAX_WAIT_S", BUSY_S)
    rig.stale_after(BUSY_S)
    rig.show(pressed())
    return rig


def test_a_trace_has_every_stage_of_the_next_frame_and_what_became_of_it(traced, url):
    with stream(url, "?kinds=restored") as client, ThreadPoolExecutor(1) as other:
        images(client, 1)
        listeners = len(traced.sensor.hub._listeners)
        answer = other.submit(ask, "GET", url + TRACE)
        until(lambda: len(traced.sensor.hub._listeners) > listeners)
        image = traced.show(pressed())
        got = answer.result().json()
    assert (got["sequence"], got["timestamp"], got["method"]) == (1, image.time, "wiener")
    assert (got["contacts"], got["sends"]) == (1, 1)
    ages = got["age_s"]
    assert [*ages] == [*STAGES, "published", "contacts", "sent_first", "sent_last"]
    assert [*ages.values()][:8] == sorted([*ages.values()][:8])
    assert ages["last_message"] == 0
    assert ages["first_message"] == pytest.approx(-traced.sensor.newest.skew, abs=1e-6)
    assert ages["checked"] - ages["started"] == pytest.approx(image.microseconds * 1e-6, abs=1e-6)
    assert ages["sent_last"] == ages["sent_first"] > 0


def test_a_sensor_that_is_not_live_has_no_trace(url):
    assert problem(ask("GET", url + TRACE), 503) == "sensor 'palm': no frame yet on can0"


def test_a_few_may_wait_for_a_trace_and_without_clients_none_is_sent(traced, monkeypatch):
    monkeypatch.setattr(events, "MAX_WAITING_PER_CLIENT", 1)
    with running(traced.service) as url, ThreadPoolExecutor(1) as other:
        first = other.submit(ask, "GET", url + TRACE)
        until(lambda: traced.sensor.hub._listeners)
        problem(ask("GET", url + TRACE), 429)
        traced.show(pressed())
        got = first.result().json()
    assert (got["sequence"], got["sends"], [*got["age_s"]]) == (1, 0, [*STAGES, "published", "contacts"])


SWAPPED = [20, 43]


def test_swapped_taxels_are_found_masked_and_logged_and_all_is_undone_when_they_are_put_right(rig, client):
    rig.stale_after(600)
    random, array, monitor = np.random.default_rng(1), rig.sensor.array, rig.sensor.pipeline.monitor
    sequence, sigma = 0, np.ones(rig.sensor.array.size, np.float32)

    def touch(*wrong):
        """Let the map see loads at ever other places, and offer unloaded frames."""
        nonlocal sequence
        for place in random.uniform(0, 7, (20, 1, 2)):
            sequence += 1
            load = contact(place, np.array([1.0]), array, width_mm=1.1)[0] / GAIN
            load[list(wrong)] = load[list(wrong)[::-1]]
            monitor.map.observe(sequence / 10, (load + random.normal(0, 1, array.size)).astype(np.float32), sigma)
            counts, flags = np.full(array.size, NO_LOAD, np.uint16), np.zeros(array.size, np.uint8)
            rig.sensor.restore(RawFrame(sequence, sequence / 10, 0.0, counts, flags, Loss(), sequence / 10))

    def kinds():
        return [(each.kind, each.text) for each in rig.service.events.after(0)]

    def health():
        answer = client.get("/sensors/palm/health")
        assert answer.status_code == 200, answer.text
        return answer.json()

    assert health()["map"] is None
    until(lambda: (touch(*SWAPPED), monitor.state.faults.any())[1])
    assert health()["map"] == "taxels 20 and 43 swapped"
    assert [(each["taxel"], each["fault"]) for each in health()["faults"]] == [(at, "swapped") for at in SWAPPED]
    assert {"faulty", "wrong_map"} <= {each.code for each in rig.sensor.hub.latest().warnings}
    until(lambda: [each for each in kinds() if each[0] == "warning_raised" and "20 and 43 swapped" in each[1]])
    until(lambda: any(kind == "taxel_faulty" and "taxels 20, 43 swapped" in text for kind, text in kinds()))
    until(lambda: (touch(), not monitor.map.wrong and not monitor.state.faults.any())[1])
    assert (health()["map"], health()["faults"]) == ("as configured", [])
    until(lambda: (touch(), any(kind == "taxel_healed" for kind, _ in kinds()))[1])
    until(lambda: any(kind == "warning_cleared" and "swapped" in text for kind, text in kinds()))
