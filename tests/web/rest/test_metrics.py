import can
import pytest
from prometheus_client.parser import text_string_to_metric_families

from tactiled.bus.error_frames import KINDS
from tactiled.web.rest.metrics import _family
from tests.conftest import ask, pressed, until


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
    states = {state: silent[palm("state", state=state)] for state in ("live", "stale", "silent", "down")}
    assert states == {"live": 0, "stale": 0, "silent": 1, "down": 0}
    assert not silent.keys() & {palm("age_seconds"), palm("jitter_seconds"), palm("skew_seconds")}
    assert silent[palm("rate_hertz")] == 0
    for _ in range(3):
        rig.show(pressed())
    rig.send(pressed(), drop=(1,))
    rig.bus._bus.send(can.Message(is_error_frame=True))
    until(lambda: rig.sensor.status().loss.lost and rig.sensor.status().loss.errors)
    metrics, state = scrape(url), ask("GET", url + "/api/v1/sensors/palm").json()
    assert {kind: metrics[palm("loss_total", kind=kind)] for kind in state["loss"]} == state["loss"]
    assert state["loss"]["lost"] == state["loss"]["errors"] == 1
    assert state["error_kinds"] == dict.fromkeys(KINDS, 0) | {"other": 1}
    for kind, count in state["error_kinds"].items():
        assert metrics["tactiled_error_frames_total", ("bus", "can0"), ("kind", kind)] == count
    assert metrics[palm("skew_seconds")] == pytest.approx(state["skew_s"])
    assert metrics["tactiled_streams",] == 0
    assert metrics["tactiled_connections",] >= 1


def test_labels_are_escaped():
    name = 'a "b"\\nc\nd'
    text = "\n".join(_family("x", "gauge", "meaning", [({"sensor": name}, 2.5)])) + "\n"
    assert samples(text) == {("tactiled_x", ("sensor", name)): 2.5}
