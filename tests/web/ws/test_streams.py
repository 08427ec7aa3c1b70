import asyncio
import json
import re
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

import tactiled
from tactiled.errors import TactileError
from tactiled.web import answers
from tactiled.web.server import running
from tactiled.web.ws import feed
from tactiled.web.ws.feed import Feed
from tactiled.web.ws.stream import Stream
from tactiled.wire import unpack, unpack_all
from tests.conftest import BUSY_S, NO_LOAD, Rig, meanwhile, pressed, until

TIP = """
[sensor.tip]
bus = "can0"
method = "raw"
codec = { name = "packed", bits = 12, fd = true, array_id = 1 }
array = { rows = 4, columns = 4, pitch_mm = 1.0 }
cover = { thickness_mm = 0.8, young_mpa = 0.6, poisson = 0.48 }
kernel = { model = "layered" }
calibration = { kpa_per_count = 0.5, no_load = 100, noise_kpa = 0.5 }
"""


@pytest.fixture
def rig(request):
    made = Rig(re.sub(r"\W", "-", request.node.name), TIP)
    made.tip = made.service.sensor("tip")
    with meanwhile(made):
        yield made


def touch_tip(rig, sequence, counts=NO_LOAD + 20):
    for message in rig.tip.codec.encode(np.full(16, counts, np.uint16), sequence, time.time()):
        rig.bus.send(message)
    until(lambda: (image := rig.tip.hub.latest()) and image.sequence == sequence)


def streams(url, query=""):
    return connect(f"{url.replace('http', 'ws', 1)}/api/v1/stream{query}", compression=None)


def heard(client, enough):
    """The messages until they are `enough` and none follows at once, images unpacked."""
    got, end = [], time.monotonic() + BUSY_S
    while True:
        try:
            data = client.recv(timeout=0.3)
        except TimeoutError:
            if enough(got):
                return got
            assert time.monotonic() < end, got
        else:
            got.append(json.loads(data) if isinstance(data, str) else unpack(data))


def numbered(message):
    return None if isinstance(message, dict) else (message.sensor, message.sequence)


def pictures(got):
    return [each for each in got if not isinstance(each, dict)]


@pytest.mark.parametrize("query", ["", "?sensors=palm,tip", "?sensors=tip,palm&kinds=restored"])
def test_one_socket_has_the_images_and_states_of_several_sensors(rig, url, query):
    rig.show(pressed())
    touch_tip(rig, 0)
    with streams(url, query) as client:
        kinds = ["restored"] if "kinds" in query else ["raw", "restored"]
        got = heard(client, lambda got: len(pictures(got)) == 2 * len(kinds) and len(got) >= 2 * len(kinds) + 2)
    images = pictures(got)
    assert sorted((each.sensor, each.kind) for each in images) == sorted(
        (n, k) for n in ("palm", "tip") for k in kinds
    )
    shapes = {each.sensor: each.values.shape for each in images}
    assert shapes == {"palm": (8, 8), "tip": (4, 4)}
    assert next(each.values for each in images if each.sensor == "tip").tolist() == [[10.0] * 4] * 4
    assert {each["sensor"] for each in got if isinstance(each, dict)} == {"palm", "tip"}


def test_a_busy_sensor_does_not_hold_another_back(rig, url):
    stop = threading.Event()
    with streams(url, "?kinds=raw&rate_hz=5") as client:
        began = time.monotonic()
        sender = rig.play(100, stop)
        for sequence in range(5):
            touch_tip(rig, sequence)
            time.sleep(0.2)
        stop.set()
        sender.join()
        got = pictures(heard(client, lambda got: ("tip", 4) in map(numbered, got)))
        seconds = time.monotonic() - began
    sequences = {name: [each.sequence for each in got if each.sensor == name] for name in ("palm", "tip")}
    assert 1 < len(sequences["palm"]) <= 5 * seconds + 1  # of 100 a second
    assert sequences["tip"][-1] == 4
    for of_one in sequences.values():
        assert of_one == sorted(set(of_one))


@pytest.mark.parametrize("at", ["status", "binary"])
def test_a_fault_at_one_sensor_is_told_and_stops_no_other(rig, url, monkeypatch, caplog, at):
    works = getattr(Feed, at)

    def is_it(message):
        """Whether it is what fails."""
        if isinstance(message, dict):
            return (at, message["sensor"]) == ("status", "tip")
        return (at, message.sensor) == ("binary", "tip")

    monkeypatch.setattr(Feed, at, lambda feed, *of: works(feed, *of) if feed.sensor is not rig.tip else 1 / 0)
    with streams(url, "?flow=credit&kinds=raw") as client:
        rig.show(pressed())
        touch_tip(rig, 0)
        client.send('{"type": "next"}')
        got = heard(client, lambda got: ("palm", 0) in map(numbered, got))
        assert not any(map(is_it, got))
        assert rig.service.faults.now == {"streams of tip": "ZeroDivisionError: division by zero"}
        monkeypatch.undo()
        heard(client, lambda got: any(map(is_it, got)))
        until(lambda: not rig.service.faults.now)
    assert "ZeroDivisionError" in caplog.text


def test_a_search_for_contacts_that_failed_is_done_again_with_the_next_image(rig, url, monkeypatch):
    monkeypatch.setattr(answers, "contacts", lambda _: 1 / 0)
    with streams(url, "?kinds=raw&contacts=1") as client:
        rig.show(pressed())
        until(lambda: "streams of palm" in rig.service.faults.now)
        monkeypatch.undo()
        rig.show(pressed())
        found = {"type": "contacts", "sensor": "palm", "sequence": 1}
        heard(client, lambda got: any(found.items() <= each.items() for each in got if isinstance(each, dict)))
        touch_tip(rig, 0)
        until(lambda: not rig.service.faults.now)


def test_a_fault_ends_when_the_clients_that_met_it_have_left(rig, url, monkeypatch):
    monkeypatch.setattr(Feed, "status", lambda _: 1 / 0)
    with streams(url):
        until(lambda: len(rig.service.faults.now) == 2)
    until(lambda: not rig.service.faults.now)


def test_a_sensor_without_news_costs_the_others_nothing(rig, monkeypatch):
    turns, send = [], Stream._send_line
    monkeypatch.setattr(feed, "TICK_S", 10 * BUSY_S)
    monkeypatch.setattr(
        Stream, "_send_line", lambda one, line: (turns.append(line.feed.sensor.name), send(one, line))
    )
    with running(rig.service) as url, streams(url, "?kinds=raw") as client:
        for at in range(20):
            rig.show(pressed(at % 6))
            while isinstance(client.recv(timeout=BUSY_S), str):
                pass
    assert turns.count("palm") >= 20
    assert turns.count("tip") < 5


def test_together_names_the_sensor_in_every_image(rig, url):
    with streams(url, "?sensors=tip&together=1") as client:
        touch_tip(rig, 0)
        data = next(each for each in client if isinstance(each, bytes))
    assert [(one.kind, one.sensor) for one in unpack_all(data)] == [("raw", "tip"), ("restored", "tip")]


def test_json_names_the_sensor_too(rig, url):
    touch_tip(rig, 0)
    with streams(url, "?sensors=tip&format=json&kinds=raw&contacts=1") as client:
        got = heard(client, lambda got: {each["type"] for each in got} >= {"frame", "status", "contacts"})
    assert [(each["type"], each["sensor"]) for each in got][:2] == [("status", "tip"), ("frame", "tip")]
    assert {each["type"] for each in got} == {"frame", "status", "contacts"}
    assert {each["sensor"] for each in got} == {"tip"}


def test_credit_may_be_given_to_one_sensor_or_to_all(rig, url):
    rig.show(pressed())
    touch_tip(rig, 0)

    def images(client, count):
        return [each.sensor for each in pictures(heard(client, lambda got: len(pictures(got)) >= count))]

    with streams(url, "?flow=credit&kinds=raw") as client:
        assert images(client, 0) == []
        client.send('{"type": "next", "sensor": "tip"}')
        assert images(client, 1) == ["tip"]
        rig.show(pressed(4))
        touch_tip(rig, 1)
        client.send('{"type": "next"}')
        assert sorted(images(client, 2)) == ["palm", "tip"]
        assert images(client, 0) == []


@pytest.mark.parametrize(
    ("query", "code", "reason"),
    [
        ("?sensors=palm,plam", 4404, "sensor 'plam': no such sensor: there are palm, tip"),
        ("?sensors=", 4404, "sensor '': no such sensor: there are palm, tip"),
        ("?sensors=tip,tip", 4400, "sensors=tip,tip: give each name once"),
        (
            "?sensor=tip",
            4400,
            "sensor: no such parameter: "
            "there are kinds, rate_hz, format, flow, contacts, together, sensors, shear",
        ),
        ("?sensors=tip&shear=palm", 4400, "shear=palm: give some of tip"),
        ("?shear=tip", 4404, "sensor 'tip': its codec packed carries no shear"),
        ("?kinds=raw,raw", 4400, "kinds=raw,raw: give each name once"),
    ],
)
def test_a_wrong_address_is_refused_with_the_reason(url, query, code, reason):
    with streams(url, query) as client:
        with pytest.raises(ConnectionClosed) as caught:
            client.recv(timeout=BUSY_S)
        assert (caught.value.rcvd.code, caught.value.rcvd.reason) == (code, reason)


def test_a_stream_of_one_sensor_takes_no_list(url):
    with connect(f"{url.replace('http', 'ws', 1)}/api/v1/sensors/palm/stream?sensors=tip") as client:
        with pytest.raises(ConnectionClosed) as caught:
            client.recv(timeout=BUSY_S)
        assert caught.value.rcvd.reason.startswith("sensors: no such parameter")


@pytest.fixture
def playing(rig):
    rig.show(pressed())
    touch_tip(rig, 0)
    return rig


@pytest.mark.usefixtures("playing")
def test_the_client_streams_several_sensors(url):
    stream = tactiled.connect(url).stream(["palm", "tip"], patience_s=BUSY_S)
    seen = [next(stream), next(stream)]
    assert {each.sensor: each.restored.shape for each in seen} == {"palm": (8, 8), "tip": (4, 4)}
    stream.close()


@pytest.mark.usefixtures("playing")
def test_the_client_streams_several_for_asyncio(url):
    async def two():
        stream = tactiled.connect(url).astream(["palm", "tip"], patience_s=BUSY_S)
        return {(await anext(stream)).sensor, (await anext(stream)).sensor}

    with ThreadPoolExecutor(1) as other:  # on this thread a browser's loop may be running
        assert other.submit(asyncio.run, two()).result() == {"palm", "tip"}


def test_the_client_names_the_sensors_it_waited_for(rig, url):
    del rig
    with pytest.raises(TactileError, match=f"sensors palm, tip at {url}: no image for 0.1 s"):
        next(tactiled.connect(url).stream(("palm", "tip"), patience_s=0.1))
    with pytest.raises(TactileError, match="sensor 'plam': no such sensor: there are palm, tip"):
        next(tactiled.connect(url).stream(["plam"]))
