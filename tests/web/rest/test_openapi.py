"""The OpenAPI description and the service agree."""

import jsonschema
import numpy as np
import pytest
import schemathesis
from hypothesis import strategies as st
from schemathesis.checks import CHECKS
from schemathesis.config import SchemathesisConfig
from schemathesis.engine import events, from_schema

from tactiled.config import Server
from tactiled.live.state_file import StateFile
from tactiled.web.server import running
from tests.calibrate.files import calibration_file
from tests.conftest import BUSY_S, CONTROL, Rig, ask, meanwhile, until
from tests.web.http.raw import npy

schemathesis.openapi.media_type(
    "application/x-npy", st.integers(0, 3).map(lambda frames: npy(np.full((frames, 8, 8), 10.0)))
)
schemathesis.openapi.media_type(
    "application/vnd.tactiled.calibration+json", st.just(calibration_file().text.encode())
)

# That most bytes are no recording, that `first` and `at` exclude each other, how many values a pushed frame has.
NOT_IN_A_SCHEMA = [
    {"include-name": route, "checks": {"positive_data_acceptance": {"enabled": False}}}
    for route in (
        "PUT /api/v1/recordings/{name}",
        "GET /api/v1/recordings/{name}/frames",
        "POST /api/v1/sensors/{name}/frames",
    )
]


@pytest.fixture
def url(rig, tmp_path):
    """A service with every resource, and frames that come all the time."""
    rig.stale_after(BUSY_S)
    rig.service.state = StateFile(tmp_path / "state.json")
    server = Server(port=0, recordings=tmp_path / "recordings", control_per_minute=0)
    with rig.playing(10), running(rig.service, server) as url:
        until(lambda: rig.sensor.hub.latest())
        yield url


@pytest.fixture(scope="module")
def openapi(tmp_path_factory):
    """The description of a service with every resource."""
    server = Server(port=0, recordings=tmp_path_factory.mktemp("recordings"))
    with meanwhile(Rig("openapi")) as rig, running(rig.service, server) as url:
        return ask("GET", url + "/api/v1/openapi.json").json()


def operations(openapi):
    for path, methods in openapi["paths"].items():
        for operation in methods.values():
            yield path, operation


def test_no_generated_request_finds_a_fault(url):
    config = SchemathesisConfig.from_dict(
        {
            "seed": 1,
            "request-timeout": BUSY_S,
            "generation": {"deterministic": True, "max-examples": 10, "database": "none"},
            "operations": NOT_IN_A_SCHEMA,
        }
    )
    schema = schemathesis.openapi.from_url(url + "/api/v1/openapi.json", config=config)
    checked, faults = set(), []
    for event in from_schema(schema).execute():
        if isinstance(event, events.ScenarioFinished):
            for case, check in ((case, each) for case, checks in event.recorder.checks.items() for each in checks):
                checked.add(check.name)
                if check.failure_info:
                    asked = event.recorder.cases[case].value.as_curl_command()
                    faults.append(f"{event.recorder.label}: {check.failure_info.failure}\n{asked}")
        elif isinstance(event, (events.NonFatalError, events.FatalError)):
            faults.append(str(getattr(event, "info", event)))
    assert not faults, "\n\n".join(faults)
    assert checked == {*CHECKS.get_all_names()}


def test_every_example_is_valid(openapi):
    """Of errors, of single fields and of parameters."""
    examples = []
    for path, operation in operations(openapi):
        for status, answer in operation["responses"].items():
            if status >= "400":
                content = answer["content"]["application/problem+json"]
                examples.append((f"{path} {status}", content["schema"], content["example"]))
                assert content["example"]["status"] == int(status)
        for each in operation.get("parameters", []):
            examples += [(path, each["schema"], example) for example in each["schema"].get("examples", [])]
    for name, schema in openapi["components"]["schemas"].items():
        for field, each in schema.get("properties", {}).items():
            examples += [(f"{name}.{field}", each, example) for example in each.get("examples", [])]
    assert len(examples) > 100
    for place, schema, example in examples:
        schema = schema | {"components": openapi["components"]}
        assert jsonschema.Draft202012Validator(schema).is_valid(example), (place, example)


def test_no_two_schemas_have_one_name(openapi):
    assert not [name for name in openapi["components"]["schemas"] if "__" in name]  # FastAPI's way out of two


VERBS = {
    "Add", "Apply", "Calibrate", "Delete", "End", "Forget", "Get", "Push", "Read", "Restore", "Select", "Start",
    "Stop", "Take", "Tare", "Undo", "Watch",
}  # fmt: skip


def test_summaries_are_sentences_that_begin_their_descriptions(openapi):
    summaries = [each["summary"] for _, each in operations(openapi)]
    assert {"Undo the last tare.", "Restore frames.", "Watch a region no longer."} <= {*summaries}
    for _, each in operations(openapi):
        description, summary = " ".join(each["description"].split()).replace("`", ""), each["summary"]
        assert description.startswith(summary[:-1])
        assert description[len(summary) - 1] in ".:;"
        assert summary.split()[0] in VERBS, summary


def test_answers_as_csv_are_described(openapi):
    csv = [
        operation["responses"]["200"]["content"]
        for _, operation in operations(openapi)
        if any(each["name"] == "format" and "csv" in str(each) for each in operation.get("parameters", []))
    ]
    assert len(csv) == 2
    assert all("text/csv" in each for each in csv)


def test_a_token_is_described_where_one_is_needed(rig, openapi):
    assert "security" not in openapi
    with running(rig.service, Server(port=0, control_token=CONTROL)) as url:
        guarded = ask("GET", f"{url}/api/v1/openapi.json?token={CONTROL}").json()
    assert guarded["security"] == [{"token": []}]
    assert guarded["components"]["securitySchemes"]["token"]["scheme"] == "bearer"
