import json
import re
import struct
from contextlib import ExitStack
from pathlib import Path

import jsonschema
import pytest
from pydantic import SecretStr
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from tactiled.config import Server
from tactiled.web.server import running
from tactiled.web.ws.asyncapi import MESSAGES, XELA_MESSAGES
from tactiled.web.ws.feed import Feed
from tactiled.web.ws.session import CLOSES
from tactiled.wire import HEADER, unpack
from tests.conftest import BUSY_S, ask, pressed, until

GUIDE = Path(__file__).parents[3] / "tactiled/docs/streams.md"


@pytest.fixture
def document(url):
    return ask("GET", url + "/api/v1/asyncapi.json").raise_for_status().json()


def found(document, ref):
    here = document
    for part in ref.removeprefix("#/").split("/"):
        here = here[part]
    return here


def payload(document, message):
    """A validator of a message's payload."""
    schema = document["components"]["messages"][message]["payload"]
    return jsonschema.Draft202012Validator(schema | {"components": document["components"]})


def websocket(url, path):
    return connect(url.replace("http", "ws", 1) + path, compression=None)


def heard(client, true):
    """The messages up to the first that is so."""
    got = [client.recv(timeout=BUSY_S)]
    while not true(got[-1]):
        got.append(client.recv(timeout=BUSY_S))
    return got


def test_it_says_where_it_is_and_openapi_says_where_to_find_it(url, document):
    assert document["asyncapi"] == "3.0.0"
    assert document["servers"]["here"] == {"host": url.removeprefix("http://"), "protocol": "ws"}
    openapi = ask("GET", url + "/api/v1/openapi.json").json()
    assert "(asyncapi.json)" in openapi["info"]["description"]


def test_every_reference_leads_somewhere(document):
    refs = re.findall(r'"\$ref": "(#[^"]+)"', json.dumps(document))
    assert len(refs) > 20
    for ref in refs:
        assert found(document, ref)


def test_every_message_of_a_stream_is_described(document):
    described = {*document["components"]["messages"]} - {*XELA_MESSAGES}
    assert described == {*MESSAGES, "image", "next"} == {"status", "contacts", "frame", "shear", "image", "next"}


@pytest.mark.parametrize("path", ["/api/v1/sensors/palm/stream", "/api/v1/stream"])
def test_what_is_streamed_is_what_is_described(rig, url, document, path):
    rig.stale_after(600)
    with websocket(url, path + "?format=json&contacts=1") as client:
        told = heard(client, lambda text: '"silent"' in text)
        rig.show(pressed())
        told += heard(client, lambda text: json.loads(text)["type"] == "contacts")
        rig.send(pressed(), drop=[0])  # taxels missing: null in the raw image
        told += heard(client, lambda text: '"frame"' in text and "null" in text)
        told += heard(client, lambda text: '"live"' in text and '"status"' in text)
        rig.stale_after(0.3)
        told += heard(client, lambda text: '"stale"' in text)
    told = [json.loads(text) for text in told]
    assert {each["type"] for each in told} == {"frame", "status", "contacts"}
    assert {each["state"] for each in told if each["type"] == "status"} == {"silent", "live", "stale"}
    assert any(None in row for each in told if each["type"] == "frame" for row in each["values"])
    for each in told:
        payload(document, each["type"]).validate(each)
        spoilt = {key: value for key, value in each.items() if key != "state"}
        assert not payload(document, each["type"]).is_valid(spoilt)


@pytest.mark.parametrize(
    ("said", "good"),
    [
        ('{"type": "next"}', True),
        ('{"type": "next", "sensor": "palm"}', True),
        ('{"type": "more"}', False),
        ("{}", False),
    ],
)
def test_what_a_client_may_say_is_what_is_described(url, document, said, good):
    assert payload(document, "next").is_valid(json.loads(said)) == good
    with websocket(url, "/api/v1/stream") as client:
        client.send(said)
        if good:
            assert client.ping().wait(BUSY_S)  # it has been heard by then
            heard(client, lambda text: '"status"' in text)
            heard(client, lambda text: '"status"' in text)
        else:
            with pytest.raises(ConnectionClosed):
                heard(client, lambda _: False)


@pytest.mark.parametrize("path", ["/api/v1/sensors/palm/stream", "/api/v1/stream"])
def test_bytes_lie_where_the_layout_says(rig, url, document, path):
    image = rig.show(pressed())
    with websocket(url, path + "?kinds=raw") as client:
        data = heard(client, lambda each: isinstance(each, bytes))[-1]
    described = document["components"]["messages"]["image"]["x-layout"]
    layout = {re.split("[,;:]", each["meaning"])[0]: each for each in described}

    def at(meaning):
        form = {"u8": "B", "u16": "<H", "u32": "<I", "u64": "<Q", "f32": "<f", "f64": "<d"}[
            layout[meaning]["type"]
        ]
        return struct.unpack_from(form, data, layout[meaning]["offset"])[0]

    part = unpack(data)
    rows, columns = at("rows"), at("columns")
    assert (rows, columns, at("sequence number of the frame")) == (8, 8, image.sequence)
    assert at("time of the frame's first CAN message") == image.time
    assert at("noise") == image.noise_kpa
    flagged, named = at("F"), at("N")
    assert (flagged, named) == (64, len(part.sensor))
    assert layout["pressure in kPa"]["offset"] == HEADER.size
    assert len(data) == HEADER.size + 4 * rows * columns + flagged + named
    assert data[len(data) - named :].decode() == part.sensor == ("palm" if path.endswith("v1/stream") else "")


def closed(client):
    """The code that a stream is closed with."""
    with pytest.raises(ConnectionClosed) as caught:
        heard(client, lambda _: False)
    return caught.value.rcvd.code


def test_every_close_code_described_is_the_one_used(rig, document, monkeypatch):
    seen = {}
    with ExitStack() as stack:
        with running(rig.service) as url:
            address = url.replace("http", "ws", 1) + "/api/v1/stream"
            for name, query, origin in (
                ("4400", "?kinds=x", None),
                ("4404", "?sensors=plam", None),
                ("4403", "", "http://x"),
            ):
                with connect(address + query, origin=origin) as client:
                    seen[name] = closed(client)
            with connect(address) as client:
                client.send("x" * 70_000)
                seen["1009"] = closed(client)
            for name, raw in ("1002", b"\x81\x00"), ("1007", b"\x81\x81\0\0\0\0\xff"):  # not masked; not UTF-8
                with connect(address) as client:
                    client.socket.sendall(raw)
                    seen[name] = closed(client)
            ending = stack.enter_context(connect(address))
            ending.recv(timeout=BUSY_S)
        seen["1012"] = closed(ending)
    for bound, name in (("streams_per_client", "4429"), ("streams", "4503")):
        with ExitStack() as stack:
            url = stack.enter_context(running(rig.service, Server(port=0).model_copy(update={bound: 1})))
            _, second = (stack.enter_context(websocket(url, "/api/v1/stream")) for _ in range(2))
            seen[name] = closed(second)
    guarded = Server(port=0, control_token=SecretStr("c" * 16))
    with running(rig.service, guarded) as url, websocket(url, "/api/v1/stream") as client:
        seen["4401"] = closed(client)
    monkeypatch.setattr(Feed, "status", lambda _: 1 / 0)
    with running(rig.service) as url, websocket(url, "/api/v1/stream") as client:
        seen["1011"] = closed(client)
    until(lambda: not rig.sensor.hub._listeners)
    assert {int(name) for name in seen} == set(seen.values())
    for name, channel in document["channels"].items():
        without = {4400} if name == "xela" else set()  # there nothing that a client says is wrong
        assert {each["code"] for each in channel["x-close-codes"]} == set(seen.values()) - without


def test_the_guide_has_the_same_codes():
    assert dict(re.findall(r"^\| (\d{4}) \| (.+) \|$", GUIDE.read_text(), re.M)) == {
        str(code): why for code, why in CLOSES.items()
    }
