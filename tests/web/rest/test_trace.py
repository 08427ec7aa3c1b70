from concurrent.futures import ThreadPoolExecutor

import pytest

from tactiled.web.rest import events, trace
from tactiled.web.server import running
from tests.conftest import BUSY_S, ask, pressed, problem, until
from tests.web.ws.clients import images, stream

PATH = "/api/v1/sensors/palm/trace"
STAGES = ["first_message", "last_message", "assembled", "started", "calibrated", "restored", "checked"]


@pytest.fixture
def live(rig, monkeypatch):
    """The rig with a sensor that stays live however busy the machine is."""
    monkeypatch.setattr(trace, "MAX_WAIT_S", BUSY_S)
    rig.stale_after(BUSY_S)
    rig.show(pressed())
    return rig


def test_a_trace_has_every_stage_of_the_next_frame_and_what_became_of_it(live, url):
    with stream(url, "?kinds=restored") as client, ThreadPoolExecutor(1) as other:
        images(client, 1)
        listeners = len(live.sensor.hub._listeners)
        answer = other.submit(ask, "GET", url + PATH)
        until(lambda: len(live.sensor.hub._listeners) > listeners)
        image = live.show(pressed())
        got = answer.result().json()
    assert (got["sequence"], got["timestamp"], got["method"]) == (1, image.time, "wiener")
    assert (got["contacts"], got["sends"]) == (1, 1)
    ages = got["age_s"]
    assert [*ages] == [*STAGES, "published", "contacts", "sent_first", "sent_last"]
    assert [*ages.values()][:8] == sorted([*ages.values()][:8])
    assert ages["last_message"] == 0
    assert ages["first_message"] == pytest.approx(-live.sensor.newest.skew, abs=1e-6)
    assert ages["checked"] - ages["started"] == pytest.approx(image.microseconds * 1e-6, abs=1e-6)
    assert ages["sent_last"] == ages["sent_first"] > 0


def test_a_sensor_that_is_not_live_has_no_trace(url):
    assert problem(ask("GET", url + PATH), 503) == "sensor 'palm': no frame yet on can0"


def test_a_few_may_wait_for_a_trace_and_without_clients_none_is_sent(live, monkeypatch):
    monkeypatch.setattr(events, "MAX_WAITING_PER_CLIENT", 1)
    with running(live.service) as url, ThreadPoolExecutor(1) as other:
        first = other.submit(ask, "GET", url + PATH)
        until(lambda: live.sensor.hub._listeners)
        problem(ask("GET", url + PATH), 429)
        live.show(pressed())
        got = first.result().json()
    assert (got["sequence"], got["sends"], [*got["age_s"]]) == (1, 0, [*STAGES, "published", "contacts"])
