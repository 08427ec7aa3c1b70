"""What the OpenAPI description says is what the service does."""

import io
import re
import threading
from itertools import product

import httpx
import jsonschema
import numpy as np
import pytest
import schemathesis
from hypothesis import strategies as st
from pydantic import SecretStr
from schemathesis.checks import CHECKS
from schemathesis.config import SchemathesisConfig
from schemathesis.engine import events, from_schema

from tactiled.config import Server
from tactiled.restore.methods import METHODS
from tactiled.runtime.state import StateFile
from tactiled.web.server import running
from tests.conftest import BUSY_S, HTTP, ask, pressed, until

ELSEWHERE = {"/api/v1/sensors/{name}/frames/shear"}  # of other skins than this one
ORDER = ("post", "put", "get", "delete")


def film(frames):
    """A film as .npy, of the rig's shape."""
    out = io.BytesIO()
    np.save(out, np.full((frames, 8, 8), 10.0))
    return out.getvalue()


schemathesis.openapi.media_type("application/x-npy", st.integers(0, 3).map(film))


@pytest.fixture
def whole(rig, tmp_path):
    """The URL of a service that has all that a service can have, with frames that come all the time."""
    stop = threading.Event()
    rig.stale_after(BUSY_S)
    player = rig.play(50, stop)
    until(lambda: rig.sensor.hub.latest())
    rig.service.state = StateFile(tmp_path / "state.json")
    with running(rig.service, Server(port=0, recordings=tmp_path / "recordings", control_per_minute=0)) as url:
        yield url
    stop.set()
    player.join()


def test_no_generated_request_finds_a_fault(whole):
    config = SchemathesisConfig.from_dict(
        {
            "seed": 1,
            "request-timeout": BUSY_S,
            "generation": {"deterministic": True, "max-examples": 10, "database": "none"},
        }
    )
    schema = schemathesis.openapi.from_url(whole + "/api/v1/openapi.json", config=config)
    checked, faults = set(), []
    for event in from_schema(schema).execute():
        if isinstance(event, events.ScenarioFinished):
            for check in (each for checks in event.recorder.checks.values() for each in checks):
                checked.add(check.name)
                if check.failure_info:
                    faults.append(f"{event.recorder.label}: {check.failure_info.failure}")
        elif isinstance(event, (events.NonFatalError, events.FatalError)):
            faults.append(str(getattr(event, "info", event)))
    assert not faults, "\n\n".join(faults)
    assert checked == {*CHECKS.get_all_names()}


@pytest.fixture
def said(whole):
    return ask("GET", whole + "/api/v1/openapi.json").json()


def test_every_example_is_valid(said):
    """Of whole bodies, of single fields and of parameters."""
    examples = [(path, content["schema"], content["example"]) for path, content in contents(said)]
    for name, schema in said["components"]["schemas"].items():
        for field, each in schema.get("properties", {}).items():
            examples += [(f"{name}.{field}", each, example) for example in each.get("examples", [])]
    for path, _, operation in operations(said):
        for each in operation.get("parameters", []):
            examples += [(path, each["schema"], example) for example in each["schema"].get("examples", [])]
    assert len(examples) > 100
    for place, schema, example in examples:
        whole_schema = schema | {"components": said["components"]}
        assert jsonschema.Draft202012Validator(whole_schema).is_valid(example), (place, example)


def test_every_example_has_the_shape_of_what_the_service_gives(whole, said):
    asked = 0
    with httpx.Client(**HTTP, base_url=whole) as client:
        for path, method, operation in sorted(operations(said), key=lambda each: ORDER.index(each[1])):
            body = operation.get("requestBody", {}).get("content", {}).get("application/json", {}).get("example")
            place = path.format(name="grasp.log" if "recordings" in path else "palm", kind="raw")
            forced = {"force": True} if path.endswith("/tare") else {}  # the contact moves all the time
            answer = client.request(method, place, json=body or None, params=forced)
            if path in ("/api/v1/restore", "/api/v1/recordings/{name}"):
                continue  # bytes, or nothing
            if path in ELSEWHERE:
                assert answer.status_code == 404
                continue
            assert answer.is_success, answer.text
            example = operation["responses"][str(answer.status_code)]["content"]["application/json"]["example"]
            compare(example, answer.json(), path)
            asked += 1
    assert asked == 18


def compare(example, given, place):
    """The same keys and kinds of value all the way down; null stands for anything, and so does a key left out."""
    if example is None or given is None:
        return
    kind = (int, float) if isinstance(example, (int, float)) and not isinstance(example, bool) else type(example)
    assert isinstance(given, kind), (place, example, given)
    if isinstance(example, dict):
        assert example.keys() | {key for key in given if given[key] is None} == given.keys(), place
        for key in example:
            compare(example[key], given[key], f"{place}.{key}")
    if isinstance(example, list) and example and given:
        compare(example[0], given[0], f"{place}[0]")


def operations(said):
    for path, methods in said["paths"].items():
        for method, operation in methods.items():
            yield path, method, operation


def contents(said):
    """Every JSON body, asked or answered."""
    for path, _, operation in operations(said):
        for body in (operation.get("requestBody", {}), *operation["responses"].values()):
            for media, content in body.get("content", {}).items():
                if media in ("application/json", "application/problem+json"):
                    yield path, content
                    assert "example" in content, path


def test_a_token_is_described_where_one_is_needed(rig, said):
    assert "security" not in said
    with running(rig.service, Server(port=0, control_token=SecretStr("c" * 16))) as url:
        told = ask("GET", url + "/api/v1/openapi.json", headers={"Authorization": "Bearer " + "c" * 16}).json()
    assert told["security"] == [{"token": []}]
    assert told["components"]["securitySchemes"]["token"]["scheme"] == "bearer"


TOKENS = {"read_token": SecretStr("r" * 16), "control_token": SecretStr("c" * 16)}
READ, CONTROL = ({"Authorization": f"Bearer {16 * each}"} for each in "rc")
JSON = {"Content-Type": "application/json"}
WRONG = (  # error, of which operations, and what is asked beside a control token
    (401, ".*", {"headers": {"Authorization": ""}}),
    (403, "get .*", {"headers": {"Origin": "https://elsewhere.example"}}),
    (403, "(put|post|delete) .*", {"headers": READ}),
    (404, ".* /sensors/plam(?!/frames$|/frames/shear$).*", {}),
    (404, "get /sensors/palm/frames$", {"params": {"kind": "shear"}}),
    (404, "get /sensors/palm/frames/shear$", {}),
    (404, "post /restore", {"params": {"sensor": "plam"}}),
    (404, "post /recordings$", {"json": {"bus": "can9"}}),
    (404, ".* /recordings/grasp.log.*", {}),
    (406, "get /sensors/palm/frames(/raw)?$", {"headers": {"Accept": "text/html"}}),
    (409, "put /sensors/palm/method", {"json": {"method": "raw", "keep": True}}),
    (400, "put /sensors/palm/method|post /recordings$", {"headers": JSON, "content": b"x"}),
    (413, "put /sensors/palm/method|post /recordings$", {"headers": JSON, "content": bytes(65 << 10)}),
    (
        415,
        "put /sensors/palm/method|post /recordings$",
        {"headers": {"Content-Type": "text/plain"}, "content": b"{}"},
    ),
    (422, "(?!post /restore).*", {"params": {"colour": "red"}}),
    (422, "post /restore", {"params": {"sensor": "palm"}, "content": b"x"}),
    (503, "get /sensors/palm/(contacts|frames/raw)", {}),
)
LATER = (  # when a frame has come and no other, and grasp.log is being recorded
    (409, "post /sensors/palm/tare", {}),
    (409, "post /recordings$", {"json": {"bus": "can0"}}),
    (409, "(get|delete) /recordings/grasp.log", {}),
)
SELDOM = {"408", "413", "416", "422", "429", "503"}  # some are provoked elsewhere; 416 is no problem


def test_the_example_of_an_error_is_what_comes(rig, tmp_path):
    (tmp_path / "whole.log").write_bytes(bytes(10))
    with (
        running(rig.service, Server(port=0, recordings=tmp_path, **TOKENS)) as url,
        httpx.Client(**HTTP, base_url=url + "/api/v1", headers=CONTROL) as client,
    ):
        said = client.get("/openapi.json").json()
        seen = compared(client, said, WRONG)
        rig.show(pressed())
        until(lambda: rig.sensor.status().state == "stale")
        client.post("/recordings", json={"bus": "can0", "name": "grasp.log"})
        seen |= compared(client, said, LATER)
    every = {(path, method, status) for path, method, each in operations(said) for status in each["responses"]}
    assert {status for path, _, status in every - seen if status >= "400" and path not in ELSEWHERE} <= SELDOM
    assert len(seen) > 70


def compared(client, said, rows):
    """Ask for these errors, and compare what comes with its example; gives path, method and status of each."""
    seen = set()
    for (path, method, operation), (status, which, asked) in product(operations(said), rows):
        for name in ("grasp.log", "whole.log") if "/recordings/" in path else ("palm", "plam"):
            place = path.removeprefix("/api/v1").format(name=name, kind="raw")
            if re.fullmatch(which, f"{method} {place}"):
                answer = client.request(method, place, **asked)
                content = operation["responses"][str(status)]["content"]["application/problem+json"]
                assert (method, place, told(answer.json())) == (method, place, told(content["example"]))
                seen.add((path, method, str(status)))
    return seen


def told(problem):
    """A problem without the numbers in its detail, which may be others."""
    return problem | {"detail": re.sub(r"[0-9]+(\.[0-9]+)?", "#", problem["detail"])}


def test_every_parameter_of_a_path_or_a_query_says_what_it_is(said):
    for path, method, operation in operations(said):
        for each in operation.get("parameters", []):
            assert each.get("description") or "enum" in each["schema"], (method, path, each["name"])
            if each["in"] == "path" and "sensors" in path and each["name"] == "name":
                assert each["schema"]["examples"] == ["palm"]
    (methods,) = said["components"]["schemas"]["SensorState"]["properties"]["methods"]["examples"]
    assert methods == list(METHODS)
