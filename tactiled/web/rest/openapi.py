"""The OpenAPI description: answers, and one description and one real `detail` for each status of an error."""

import re
from collections.abc import Callable, Mapping
from http import HTTPStatus
from typing import Any

from fastapi import FastAPI

from tactiled.web import schemas
from tactiled.web.http.body import BODY_TIMEOUT_S, MAX_BODY_BYTES

Json = dict[str, Any]
Responses = dict[int | str, Json]
MEDIA = {
    "json": "application/json",
    "npy": "application/x-npy",
    "npz": "application/x-npz",
    "png": "image/png",
    "file": "application/octet-stream",
    "csv": "text/csv",
    "calibration": "application/vnd.tactiled.calibration+json",
}
PROBLEMS = {
    400: (
        "the body is no JSON text or only a part of a file, or Range no range of bytes",
        "body: no JSON at character 0: Expecting value",
    ),
    401: (
        "no token, where one is needed",
        "a token is needed: Authorization: Bearer TOKEN, or open / in a browser",
    ),
    403: (
        "a token that reads only; a page of another site; on loopback, another host name than loopback's",
        "this token reads only: show the control token to change anything",
    ),
    404: (
        "no such sensor, bus or recording; or shear of a sensor without it",
        "sensor 'plam': no such sensor: there are palm",
    ),
    406: ("Accept names no format of this resource", "Accept: text/html: there are application/json, image/png"),
    408: ("the body did not come in time", f"the body did not come within {BODY_TIMEOUT_S:g} s"),
    409: (
        "not possible now: the sensor is not live, shows a load (code = loaded: force=true tares anyway), or has "
        "no tare to undo; the recording runs or exists already; this service keeps no state, or has no "
        "configuration file",
        "sensor 'palm': stale, no frame for 0.6 s: a tare needs frames",
    ),
    413: (
        "the body, or the answer to it, is too large",
        f"a body of more than {MAX_BODY_BYTES >> 10} KiB: send it in parts",
    ),
    415: ("the body is not declared as JSON", "Content-Type: text/plain: give application/json"),
    416: ("Range is not within the file", "Range: bytes=48231-: is not within the file"),
    422: ("a parameter or the body is wrong", "colour: no such parameter: there is none"),
    429: (
        "too many requests: Retry-After gives the time to wait, s",
        "more than 100 at once, or 600 a minute: wait",
    ),
    503: (
        "not available now: no frame yet, the bus or the file cannot be opened, the disk is full",
        "sensor 'palm': no frame yet on can0",
    ),
}
SUMMARY_END = re.compile(r"(?<=[\w`)])[.:;](?:\s|$)")  # of the part of a description that heads it in /docs
BEARER = {"type": "http", "scheme": "bearer", "description": "read_token reads, control_token changes as well"}
JSON_BODY = (400, 408, 413, 415)
CONTROL = (403, 429)  # what changes something
EVERY_RESOURCE = (401, 403, 422)


def problems(*statuses: int) -> Responses:
    """The errors of a resource."""
    return {status: _problem(status) for status in statuses}


def _problem(status: int) -> Json:
    description, detail = PROBLEMS[status]
    example = schemas.Problem(title=HTTPStatus(status).phrase, status=status, detail=detail)
    schema = {"$ref": "#/components/schemas/Problem"}
    content = {"schema": schema, "example": example.model_dump(exclude_none=True)}
    return {"description": description, "content": {"application/problem+json": content}}


def success(
    description: str, *formats: str, status: int = 200, headers: Mapping[str, str] | None = None
) -> Responses:
    """An answer in formats beside JSON; `headers` by name with their meaning."""
    binary = {"schema": {"type": "string", "format": "binary"}}
    documented = {
        name: {"description": text, "schema": {"type": "string"}} for name, text in (headers or {}).items()
    }
    content = {MEDIA[each]: binary for each in formats}
    return {status: {"description": description, "content": content, "headers": documented}}


def complete(app: FastAPI, guarded: bool) -> Callable[[], Json]:
    """Make an application's `openapi` method; `guarded`: whether a token is needed."""
    fastapi_openapi = app.openapi

    def openapi() -> Json:
        description = fastapi_openapi()  # the same object each time
        description["components"]["schemas"]["Problem"] = schemas.Problem.model_json_schema()
        for operation in (each for methods in description["paths"].values() for each in methods.values()):
            summary = SUMMARY_END.split(" ".join(operation["description"].split()), 1)[0]
            operation["summary"] = f"{summary.replace('`', '')}."
        if guarded:
            description["components"]["securitySchemes"] = {"token": BEARER}
            description["security"] = [{"token": []}]
        return description

    return openapi
