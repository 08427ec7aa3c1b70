"""Streams of several sensors, also while they are reloaded, and what every stream refuses."""

import asyncio
import re
import time
from io import BytesIO
from types import SimpleNamespace

import httpx
import numpy as np
import pytest
from websockets.sync.client import connect as connect_socket

from tactiled.client import connect
from tactiled.live.hub import Hub
from tactiled.web import answers
from tactiled.web.ws.feed import Feed, Feeds
from tests.conftest import CONFIG, NO_LOAD, Rig, meanwhile, pressed, run_apart, running, until
from tests.skin import TIP
from tests.web.http.raw import websocket_url
from tests.web.ws.clients import NEXT, ONE, SEVERAL, closed, images, stream, text, text_of, texts


@pytest.fixture
def rig(request):
    made = Rig(re.sub(r"\W", "-", request.node.name), TIP)
    made.tip = made.service.sensor("tip")
    with meanwhile(made):
        yield made


def show(rig, name):
    """Send a frame of a sensor and wait for its image."""
    sensor = rig.service.sensor(name)
    before = sensor.hub.latest()
    counts = np.full(sensor.codec.size, NO_LOAD + 20, np.uint16)
    for message in sensor.codec.encode(counts, before.sequence + 1 if before else 0, time.time()):
        rig.bus.send(message)
    until(lambda: sensor.hub.latest() is not before)


def streams(url, query="", **options):
    return stream(url, query, SEVERAL, **options)


@pytest.mark.parametrize("query", ["", "?sensors=palm,tip", "?sensors=tip,palm&kinds=restored"])
def test_one_socket_has_images_and_states_of_several_sensors(rig, url, query):
    rig.show(pressed())
    show(rig, "tip")
    kinds = ["restored"] if "kinds" in query else ["raw", "restored"]
    with streams(url, query) as client:
        got = images(client, 2 * len(kinds))
        assert {text_of(client, "status")["sensor"] for _ in range(4)} == {"palm", "tip"}
    assert {(each.sensor, each.kind) for each in got} == {(n, k) for n in ("palm", "tip") for k in kinds}
    assert {each.sensor: each.values.shape for each in got} == {"palm": (8, 8), "tip": (4, 4)}
    assert next(each.values for each in got if each.sensor == "tip").tolist() == [[10.0] * 4] * 4


@pytest.mark.parametrize("method", ["status", "binary"])
def test_an_error_at_one_sensor_is_a_fault_and_stops_no_other(rig, url, monkeypatch, caplog, method):
    original = getattr(Feed, method)
    with monkeypatch.context() as broken:
        broken.setattr(Feed, method, lambda one, *a: original(one, *a) if one.sensor is not rig.tip else 1 / 0)
        with streams(url, "?flow=credit&kinds=raw") as client:
            rig.show(pressed())
            show(rig, "tip")
            client.send(NEXT)
            (image,) = images(client, 1)
            assert (image.sensor, image.sequence) == ("palm", 0)
            until(lambda: rig.service.faults.now == {"streams of tip": "ZeroDivisionError: division by zero"})
            assert "tip" not in {each["sensor"] for each in texts(client, 0.3)} or method == "binary"
            broken.undo()
            if method == "binary":
                assert images(client, 1)[0].sensor == "tip"
            else:
                text(client, lambda message: message["sensor"] == "tip")
            until(lambda: not rig.service.faults.now)
    assert "ZeroDivisionError" in caplog.text


def test_a_failed_search_for_contacts_is_repeated_with_the_next_image(rig, url, monkeypatch):
    monkeypatch.setattr(answers, "contacts", lambda _: 1 / 0)
    with streams(url, "?kinds=raw&contacts=1", max_queue=None) as client:  # reads ahead, however much
        rig.show(pressed())
        until(lambda: "streams of palm" in rig.service.faults.now)
        monkeypatch.undo()
        rig.show(pressed())
        contacts = {"type": "contacts", "sensor": "palm", "sequence": 1}
        text(client, lambda message: contacts.items() <= message.items())
        show(rig, "tip")
        until(lambda: not rig.service.faults.now)


def test_a_fault_ends_when_its_clients_have_left(rig, url, monkeypatch):
    monkeypatch.setattr(Feed, "status", lambda _: 1 / 0)
    with streams(url):
        until(lambda: len(rig.service.faults.now) == 2)
    until(lambda: not rig.service.faults.now)


def test_credit_is_for_one_sensor_or_for_all(rig, url):
    rig.show(pressed())
    show(rig, "tip")
    with streams(url, "?flow=credit&kinds=raw") as client:
        texts(client, 0.3)
        client.send('{"type": "next", "sensor": "tip"}')
        assert images(client, 1)[0].sensor == "tip"
        texts(client, 0.3)
        rig.show(pressed(4))
        show(rig, "tip")
        client.send(NEXT)
        assert {each.sensor for each in images(client, 2)} == {"palm", "tip"}
        texts(client, 0.3)


REFUSED = {
    f"{SEVERAL}?sensors=palm,plam": (4404, "sensor 'plam': no such sensor: there are palm, tip"),
    f"{SEVERAL}?sensors=": (4404, "sensor '': no such sensor: there are palm, tip"),
    "/api/v1/sensors/plam/stream": (4404, "sensor 'plam': no such sensor: there are palm, tip"),
    f"{SEVERAL}?shear=tip": (4404, "sensor 'tip': its codec packed carries no shear"),
    "/xela": (4404, "no sensor here has the codec xela"),
    f"{ONE}?kinds=shear": (4404, "sensor 'palm': its codec packed carries no shear"),
    f"{SEVERAL}?sensors=tip,tip": (4400, "sensors=tip,tip: give each name once"),
    f"{SEVERAL}?sensors=tip&shear=palm": (4400, "shear=palm: give some of tip"),
    f"{SEVERAL}?kinds=raw,raw": (4400, "kinds=raw,raw: give each name once"),
    f"{SEVERAL}?sensor=tip": (4400, "sensor: no such parameter: there are kinds, rate_hz, format, flow, contacts"),
    f"{ONE}?sensors=tip": (4400, "sensors: no such parameter"),
    f"{ONE}?kinds=raw,blurred": (4400, "kinds=raw,blurred: "),
    f"{ONE}?kinds=": (4400, "kinds=: "),
    f"{ONE}?kinds=raw&kinds=restored": (4400, "kinds: given 2 times"),
    f"{ONE}?kinds={'ü' * 200}": (4400, f"kinds={'ü' * 30}…: Input should be 'raw'"),  # all fits a close frame
    f"{ONE}?rate_hz={'9' * 200}": (4400, f"rate_hz={'9' * 30}…: Input should be less than or equal to 10000"),
    f"{ONE}?rate_hz=nan": (4400, "rate_hz=nan: "),
    f"{ONE}?rate_hz=fast": (4400, "rate_hz=fast: "),
    f"{ONE}?rate_hz=-1": (4400, "rate_hz=-1: "),
    f"{ONE}?rate_hz=10001": (4400, "rate_hz=10001: "),
    f"{ONE}?format=xml": (4400, "format=xml: "),
    f"{ONE}?flow=all": (4400, "flow=all: "),
    f"{ONE}?contacts=yes": (4400, "contacts=yes: "),
    f"{ONE}?together=yes": (4400, "together=yes: "),
    f"{ONE}?together=1&format=json": (4400, "together=1 needs format=binary"),
} | {
    path: (4404, f"{path}: no stream")
    for path in ("/api/v1/streams", f"{SEVERAL}/", "/xela/", "/static/app.js", "/metrics")
}


def test_a_wrong_address_is_refused_with_the_reason(url):
    for path, (code, reason) in REFUSED.items():
        with connect_socket(websocket_url(url, path)) as client:
            got = closed(client)
        assert (got[0], got[1][: len(reason)]) == (code, reason), path


def test_a_wrong_message_is_refused_with_the_reason(url):
    more = '{"type": "more"}', '{"type": "next", "sensor": "x"}', '{"type": "next", "n": 2}'
    for message in (b"next", "", "[]", "{}", *more):
        with streams(url) as client:
            client.send(message)
            code, reason = closed(client)
        start = f"message {'of bytes' if isinstance(message, bytes) else repr(message)}"
        assert (code, reason[: len(start)]) == (4400, start)


HEXAGONS = [[x + y % 2 / 2, 0.866 * y] for y in range(4) for x in range(4)]


def test_a_layout_that_is_no_grid_has_a_raster_everywhere_and_one_value_a_taxel_on_request(request):
    tip = TIP.replace("rows = 4, columns = 4, pitch_mm = 1.0", f"positions_mm = {HEXAGONS}")
    rig = Rig(re.sub(r"\W", "-", request.node.name), tip)
    with meanwhile(rig), running(rig.service) as url, httpx.Client(base_url=f"{url}/api/v1/sensors/tip") as client:
        show(rig, "tip")
        cells, image = rig.service.sensor("tip").cells, rig.service.sensor("tip").hub.latest()
        geometry = client.get("/geometry").json()
        assert geometry["restored"] == {
            "rows": 8, "columns": 9, "cell_mm": cells.side, "origin_mm": cells.corner.tolist(),
            "mask": cells.felt.tolist(),
        }  # fmt: skip
        assert image.restored.shape == (8, 9)
        np.testing.assert_array_equal(np.isfinite(image.restored), cells.felt)
        means = cells.at_taxels(image.restored, 16)
        for kind in ("restored", "deviation"):
            whole, by_taxel = (
                np.load(BytesIO(client.get(f"/frames/{kind}?format=npy&image={each}").content))
                for each in ("raster", "taxels")
            )
            np.testing.assert_array_equal(np.isfinite(whole), cells.felt)
            np.testing.assert_array_equal(by_taxel, cells.at_taxels(whole, 16))
        page = client.get("/frames?image=taxels").json()
        assert page["frames"][-1]["values"] == pytest.approx(means.tolist(), abs=1e-4)
        for query, expected in (("", image.restored), ("&image=taxels", means[None])):
            with streams(url, f"?sensors=tip{query}") as stream:
                raw, restored = images(stream, 2)
                assert raw.values.shape == (1, 16)
                np.testing.assert_array_equal(restored.values, expected)
        with streams(url, "?sensors=tip&image=taxels&format=json&kinds=restored") as stream:
            assert text_of(stream, "frame")["values"] == pytest.approx(means.tolist(), abs=1e-4)
        assert connect(url).snapshot("tip").force == pytest.approx(
            np.nansum(image.restored) * cells.side**2 * 1e-3
        )


THUMB = TIP.replace("tip", "thumb").replace("array_id = 1", "array_id = 2")
REMOVED = "is no longer in the configuration"


@pytest.fixture
def reload(rig, tmp_path):
    rig.service.path = tmp_path / "rig.toml"

    def write(*others, change=("", "")):
        palm = CONFIG.format(channel=rig.config.bus["can0"].channel).replace(*change)
        rig.service.path.write_text(palm + "".join(others))
        return rig.service.reload()

    return write


def test_a_stream_of_all_goes_on_with_the_sensors_that_there_are(rig, url, reload):
    with stream(url, "?flow=credit&kinds=raw", SEVERAL) as client:
        text(client, lambda each: each["sensor"] == "tip")
        client.send(NEXT)
        reload(THUMB)
        last = text(client, lambda each: (each["sensor"], each["state"]) == ("tip", "down"))
        assert last["detail"] == REMOVED
        text(client, lambda each: each["sensor"] == "thumb")
        client.send('{"type": "next", "sensor": "thumb"}')
        client.send('{"type": "next", "sensor": "tip"}')  # under way when it was removed
        for name in ("palm", "thumb"):
            show(rig, name)
            assert [each.sensor for each in images(client, 1)] == [name]
        reload(THUMB, TIP)
        text(client, lambda each: (each["sensor"], each["state"]) == ("tip", "silent"))
        show(rig, "tip")
        assert images(client, 1)[0].sensor == "tip"  # what was requested of it before comes


def test_a_stream_of_sensors_that_are_all_removed_is_closed(rig, url, reload):
    with (
        stream(url, path=ONE.replace("palm", "tip")) as one,
        stream(url, "?sensors=tip", SEVERAL) as named,
        stream(url, "?sensors=palm,tip&kinds=raw", SEVERAL) as both,
    ):
        text(one)
        reload()
        assert closed(one) == closed(named) == (4410, "tip: no longer in the configuration")
        rig.show(pressed())
        assert images(both, 1)[0].sensor == "palm"


def test_a_stream_of_a_sensor_that_restarts_goes_on_in_its_new_shape(rig, url, reload):
    with stream(url, "?kinds=restored") as client:
        rig.show(pressed())
        assert images(client, 1)[0].values.shape == (8, 8)
        reload(TIP, change=('method = "wiener"', 'method = "raw"\nrefine = 2'))
        text(client, lambda each: each["state"] == "silent")
        show(rig, "palm")
        image = images(client, 1)[0]
        assert (image.sequence, image.values.shape) == (0, (16, 16))


def test_the_loop_takes_the_newest_image_of_each_sensor_in_one_turn_and_an_error_of_one_stops_no_other():
    sensors = {name: SimpleNamespace(name=name, hub=Hub()) for name in ("broken", "sound")}
    seen, errors, divisor = [], [], [1]

    async def main():
        asyncio.get_running_loop().set_exception_handler(lambda _, context: errors.append(context["message"]))
        feeds = Feeds(SimpleNamespace(sensors=sensors))
        sound = feeds["sound"]
        with feeds["broken"].listen(lambda: 1 / divisor[0]), sound.listen(lambda: seen.append(sound.image)):
            divisor[0] = 0
            for image in (1, 2, 3):
                for each in sensors.values():
                    each.hub.publish(image)
            await asyncio.sleep(0.01)

    run_apart(main())
    assert seen == [None, 3]
    assert errors == ["stream of broken"]
