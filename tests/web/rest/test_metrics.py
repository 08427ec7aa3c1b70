import cProfile

import can
import pytest
from prometheus_client.parser import text_string_to_metric_families

from tactiled.bus.socketcan import KINDS
from tactiled.live.timings import Histogram
from tactiled.web.http.connection_limit import Places
from tactiled.web.http.limits import ConcurrencyLimit
from tactiled.web.rest import metrics as prometheus
from tests.conftest import ask, pressed, until
from tests.web.ws.clients import images, stream


def samples(text):
    """What Prometheus's own parser reads: {(name, labels): value}."""
    return {
        (each.name, *sorted(each.labels.items())): each.value
        for family in text_string_to_metric_families(text)
        for each in family.samples
    }


def scrape(url):
    answer = ask("GET", url + "/metrics")
    assert answer.status_code == 200
    assert answer.headers["content-type"] == "text/plain; version=0.0.4; charset=utf-8"
    return samples(answer.text)


def palm(name, **labels):
    return (f"tactiled_{name}", *sorted({"sensor": "palm", **labels}.items()))


def test_metrics_are_those_of_the_api(rig, url):
    silent = scrape(url)
    assert palm("warning", code="missing") not in silent
    states = {state: silent[palm("state", state=state)] for state in ("live", "stale", "silent", "down")}
    assert states == {"live": 0, "stale": 0, "silent": 1, "down": 0}
    assert not silent.keys() & {palm("age_seconds"), palm("jitter_seconds"), palm("skew_seconds")}
    assert silent[palm("rate_hertz")] == 0
    for _ in range(3):
        rig.show(pressed())
    rig.send(pressed(), drop=(1,))
    rig.bus._bus.send(can.Message(is_error_frame=True))
    until(lambda: rig.sensor.status().loss.incomplete and rig.sensor.status().loss.errors)
    metrics, state = scrape(url), ask("GET", url + "/api/v1/sensors/palm").json()
    assert {kind: metrics[palm("loss_total", kind=kind)] for kind in state["loss"]} == state["loss"]
    assert state["loss"]["lost"] == state["loss"]["errors"] == 1
    assert state["error_kinds"] == dict.fromkeys(KINDS, 0) | {"other": 1}
    for kind, count in state["error_kinds"].items():
        assert metrics["tactiled_error_frames_total", ("bus", "can0"), ("kind", kind)] == count
    assert metrics[palm("skew_seconds")] == pytest.approx(state["skew_s"])
    until(lambda: scrape(url).get(palm("warning", code="missing")) == 1)
    assert metrics["process_cpu_seconds_total",] > 0
    assert metrics["process_resident_memory_bytes",] > 1e6
    assert metrics["tactiled_streams",] == 0
    assert metrics["tactiled_connections",] >= 1


def test_histograms_count_every_image_that_was_restored_and_sent(rig, url):
    stages = ("assemble", "wait", "calibrate", "restore", "check", "publish")
    with stream(url, "?kinds=restored") as client:
        until(lambda: scrape(url)["tactiled_streams",] == 1)
        for method in ("wiener", "rl", "rl"):
            rig.service.set_method("palm", method)
            assert rig.show(pressed()).method == method
            images(client, 1)
        until(lambda: scrape(url).get(palm("frame_age_seconds_count", at="publish")) == 3)
        until(lambda: scrape(url).get(palm("frame_age_seconds_count", at="send")) == 3)
    metrics = scrape(url)
    assert {metrics[palm("stage_seconds_count", stage=stage)] for stage in stages} == {3}
    counts = {method: metrics[palm("restore_seconds_count", method=method)] for method in ("wiener", "rl")}
    assert counts == {"wiener": 1, "rl": 2}
    for at in ("publish", "send"):
        bucket = "tactiled_frame_age_seconds_bucket", ("at", at)
        below = {float(dict(name[1:])["le"]): each for name, each in metrics.items() if name[:2] == bucket}
        assert sorted(below)[:2] + sorted(below)[-2:] == [1e-5, 2e-5, 1.0, float("inf")]
        assert list(below.values()) == sorted(below.values())
        assert below[float("inf")] == metrics[palm("frame_age_seconds_count", at=at)] == 3
    stages_s = sum(metrics[palm("stage_seconds_sum", stage=stage)] for stage in stages)
    assert metrics[palm("frame_age_seconds_sum", at="publish")] == pytest.approx(stages_s)
    assert metrics[palm("frame_age_seconds_sum", at="send")] > 0


def test_a_line_of_a_histogram_takes_few_calls_and_any_name(rig):
    rig.sensor.name = 'pa"l\\m'
    rig.sensor.timings.methods.update({f"m{n}": Histogram() for n in range(500)})
    profile = cProfile.Profile()
    text = profile.runcall(prometheus.text, rig.service, ConcurrencyLimit(1, 1), Places(1)).decode()
    assert samples(text)["tactiled_restore_seconds_count", ("method", "m0"), ("sensor", 'pa"l\\m')] == 0
    assert sum(each.callcount for each in profile.getstats()) < 5 * text.count("\n")
