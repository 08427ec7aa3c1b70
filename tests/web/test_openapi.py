"""What the OpenAPI description says is what the service does."""

import io
import threading

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
from tactiled.state import State
from tactiled.web.server import running
from tests.conftest import BUSY_S, ask, until

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
    rig.service.state = State(tmp_path / "state.json")
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
    return httpx.get(whole + "/api/v1/openapi.json", timeout=BUSY_S).json()


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
    with httpx.Client(base_url=whole, timeout=BUSY_S) as client:
        for path, method, operation in sorted(operations(said), key=lambda each: ORDER.index(each[1])):
            body = operation.get("requestBody", {}).get("content", {}).get("application/json", {}).get("example")
            place = path.format(name="grasp.log" if "recordings" in path else "palm", kind="raw")
            answer = client.request(method, place, json=body) if body else client.request(method, place)
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
