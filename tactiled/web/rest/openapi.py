"""The OpenAPI description: FastAPI's, with a whole example of every JSON body and how tokens are shown."""

from collections.abc import Callable, Iterator
from http import HTTPStatus
from typing import Any

from fastapi import FastAPI

from tactiled.web import schemas as forms
from tactiled.web.ws.query import no_such

Json = dict[str, Any]
BEARER = {
    "type": "http",
    "scheme": "bearer",
    "description": "read_token sees, control_token changes as well",
}


def complete(app: FastAPI, guarded: bool) -> Callable[[], Json]:
    """Make an application's `openapi` method; `guarded`: whether a token is needed."""
    plain = app.openapi

    def openapi() -> Json:
        if app.openapi_schema is None:
            said = plain()
            said["components"]["schemas"]["Problem"] = forms.Problem.model_json_schema()
            if guarded:
                said["components"]["securitySchemes"] = {"token": BEARER}
                said["security"] = [{"token": []}]
            for content in _bodies(said):
                content["example"] = example(content["schema"], said["components"]["schemas"])
            for status, content, operation in _problems(said):
                there = [each["name"] for each in operation.get("parameters", ()) if each["in"] == "query"]
                detail = content["example"] or no_such("colour", there)
                problem = forms.Problem(title=HTTPStatus(status).phrase, status=status, detail=detail)
                content["example"] = problem.model_dump(exclude_none=True)
        return plain()

    return openapi


def _problems(said: Json) -> Iterator[tuple[int, Json, Json]]:
    """Every error by its status, and the operation that it is of."""
    for operations in said["paths"].values():
        for operation in operations.values():
            for status, answer in operation["responses"].items():
                if content := answer.get("content", {}).get("application/problem+json"):
                    yield int(status), content, operation


def _bodies(said: Json) -> Iterator[Json]:
    """What every JSON request and answer is described by."""
    for operations in said["paths"].values():
        for operation in operations.values():
            answers = (answer for status, answer in operation["responses"].items() if status < "400")
            for body in (operation.get("requestBody", {}), *answers):
                content = body.get("content", {}).get("application/json", {})
                if content.get("schema"):
                    yield content


def example(schema: Json, schemas: Json) -> Any:
    """Put the example of a schema together from those of its fields."""
    if "$ref" in schema:
        return example(schemas[schema["$ref"].rpartition("/")[2]], schemas)
    for key in ("examples", "enum"):
        if key in schema:
            return schema[key][0]
    if "const" in schema:
        return schema["const"]
    if "anyOf" in schema:
        return example(schema["anyOf"][0], schemas)
    if schema.get("type") == "array":
        return [example(schema["items"], schemas)]
    if "additionalProperties" in schema and "properties" not in schema:
        return {"palm": example(schema["additionalProperties"], schemas)}
    return {name: example(each, schemas) for name, each in schema.get("properties", {}).items()}
