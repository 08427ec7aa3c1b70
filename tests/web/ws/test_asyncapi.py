import json
import re
from contextlib import ExitStack

import jsonschema
import pytest
from starlette.datastructures import QueryParams

from tactiled.web.http.protocols import ENDS
from tactiled.web.ws import session
from tactiled.web.ws.asyncapi import MESSAGES, parameters
from tactiled.web.ws.feed import Feed
from tactiled.web.ws.query import SensorsQuery, StreamQuery, parse
from tests.conftest import BUSY_S, ask, pressed, running
from tests.web.http.raw import UPGRADE, plug, read_all
from tests.web.ws.clients import NEXT, ONE, SEVERAL, closed, stream, text


@pytest.fixture
def document(url):
    return ask("GET", url + "/api/v1/asyncapi.json").raise_for_status().json()


def payload(document, message):
    """A validator of a message's payload."""
    schema = document["components"]["messages"][message]["payload"]
    return jsonschema.Draft202012Validator(schema | {"components": document["components"]})


def test_its_server_is_the_service_openapi_names_it_and_every_message_and_reference_is_there(url, document):
    assert document["asyncapi"] == "3.0.0"
    assert document["servers"]["here"] == {"host": url.removeprefix("http://"), "protocol": "ws"}
    assert "(asyncapi.json)" in ask("GET", url + "/api/v1/openapi.json").json()["info"]["description"]
    assert {*document["components"]["messages"]} == {*MESSAGES, "image", "next", "xela", "pushed", "pushedBytes"}
    references = re.findall(r'"\$ref": "#/([^"]+)"', json.dumps(document))
    assert len(references) > 20
    for reference in references:
        part = document
        for key in reference.split("/"):
            part = part[key]
        assert part


@pytest.mark.parametrize("path", [ONE, SEVERAL])
def test_messages_are_as_described(rig, url, document, path):
    rig.stale_after(600)
    with stream(url, "?format=json&contacts=1", path) as client:
        messages = [text(client, lambda each: each["state"] == "silent")]
        rig.show(pressed())
        messages += [text(client, lambda each: each["type"] == "contacts")]
        rig.send(pressed(), drop=[0])  # taxels missing: null in the raw image
        messages += [text(client, lambda each: each["type"] == "frame" and None in each["values"][0])]
        messages += [text(client, lambda each: each["type"] == "status" and each["state"] == "live")]
        rig.stale_after(0.3)
        messages += [text(client, lambda each: each["state"] == "stale")]
    assert [each["type"] for each in messages] == ["status", "contacts", "frame", "status", "status"]
    for each in messages:
        payload(document, each["type"]).validate(each)
        incomplete = {key: value for key, value in each.items() if key != "state"}
        assert not payload(document, each["type"]).is_valid(incomplete)
    for message, valid in ((NEXT, True), ('{"type": "next", "sensor": "palm"}', True), ("{}", False)):
        assert payload(document, "next").is_valid(json.loads(message)) == valid


def test_every_described_parameter_is_accepted(document):
    for form, channel in ((StreamQuery, "sensor"), (SensorsQuery, "sensors")):
        described = document["channels"][channel]["bindings"]["ws"]["query"]["properties"]
        assert described == parameters(form)
        defaults = {name: each["default"] for name, each in described.items() if "default" in each}
        assert parse(QueryParams(defaults), form) == form()
        for name, each in described.items():
            for value in each.get("enum", [each[key] for key in ("minimum", "maximum") if key in each]):
                parse(QueryParams({name: value}), form)


def test_every_close_code_is_described(document):
    for name, channel in document["channels"].items():
        ignored = {4400} if name == "xela" else set()  # there no message of a client is wrong
        assert {each["code"] for each in channel["x-close-codes"]} == set(session.CLOSES) - ignored


FRAMES = {
    1002: b"\x81\x00",  # not masked
    1007: b"\x81\x81\0\0\0\0\xff",  # not UTF-8
    1009: b"\x81\xff" + (session.MAX_MESSAGE_BYTES + 1).to_bytes(8, "big") + bytes(4),
}


@pytest.mark.parametrize("code", FRAMES)
def test_a_wrong_frame_closes_a_stream(url, code):
    with plug(url) as end:
        end.sendall(f"{UPGRADE}\r\n".encode())
        end.recv(1 << 16)
        end.sendall(FRAMES[code])
        assert int.from_bytes(read_all(end)[-200:].rpartition(b"\x88")[2][1:3], "big") == code


def test_a_failure_and_the_end_of_the_service_close_a_stream(rig, monkeypatch):
    with ExitStack() as stack:
        with running(rig.service) as url:
            client = stack.enter_context(stream(url))
            client.recv(timeout=BUSY_S)
        assert closed(client) == (1012, ENDS)
    monkeypatch.setattr(Feed, "status", lambda _: 1 / 0)
    with running(rig.service) as url, stream(url) as client:
        assert closed(client) == (1011, "the service failed: see its log")
