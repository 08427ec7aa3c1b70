import can
import pytest
from prometheus_client.parser import text_string_to_metric_families

from tactiled.bus.error_frames import KINDS
from tactiled.web.rest.metrics import _family
from tests.conftest import ask, pressed, until


@pytest.fixture
def scrape(url):
    """What Prometheus's own parser reads: {(name, labels): value}."""

    def scraped():
        answer = ask("GET", url + "/metrics")
        assert answer.status_code == 200
        assert answer.headers["content-type"] == "text/plain; version=0.0.4; charset=utf-8"
        return samples(answer.text)

    return scraped


def samples(text):
    return {
        (each.name, *sorted(each.labels.items())): each.value
        for family in text_string_to_metric_families(text)
        for each in family.samples
    }


def palm(name, **labels):
    return (f"tactiled_{name}", *sorted({"sensor": "palm", **labels}.items()))


def test_a_sensors_health_and_counts_are_those_of_the_api(rig, scrape, url):
    for _ in range(3):
        rig.show(pressed())
    rig.send(pressed(), drop=(1,))
    rig.bus._bus.send(can.Message(is_error_frame=True))
    until(lambda: rig.sensor.status().loss.lost and rig.sensor.status().loss.errors)
    told, state = scrape(), ask("GET", url + "/api/v1/sensors/palm").json()
    for kind, count in state["loss"].items():
        assert told[palm("loss_total", kind=kind)] == count
    assert told[palm("loss_total", kind="lost")] == 1
    for kind in KINDS:
        expected = state["error_kinds"][kind]
        assert (
            told["tactiled_error_frames_total", ("bus", "can0"), ("kind", kind)] == expected == (kind == "other")
        )
    assert told[palm("skew_seconds")] == pytest.approx(state["skew_s"])


def test_a_silent_sensor_has_a_state_and_no_age(scrape):
    told = scrape()
    states = {state: told[palm("state", state=state)] for state in ("live", "stale", "silent", "down")}
    assert states == {"live": 0, "stale": 0, "silent": 1, "down": 0}
    assert palm("age_seconds") not in told
    assert palm("jitter_seconds") not in told
    assert told[palm("rate_hertz")] == 0


def test_labels_are_escaped():
    name = 'a "b"\\nc\nd'
    text = "\n".join(_family("x", "gauge", "says", [({"sensor": name}, 2.5)])) + "\n"
    assert samples(text) == {("tactiled_x", ("sensor", name)): 2.5}
