"""The OpenAPI description: FastAPI's, with problems and how tokens are shown."""

from collections.abc import Callable
from typing import Any

from fastapi import FastAPI

from tactiled.web import schemas

Json = dict[str, Any]
BEARER = {
    "type": "http",
    "scheme": "bearer",
    "description": "read_token sees, control_token changes as well",
}


def complete(app: FastAPI, guarded: bool) -> Callable[[], Json]:
    """Make an application's `openapi` method; `guarded`: whether a token is needed."""
    fastapi_openapi = app.openapi

    def openapi() -> Json:
        description = fastapi_openapi()  # the same object each time
        description["components"]["schemas"]["Problem"] = schemas.Problem.model_json_schema()
        if guarded:
            description["components"]["securitySchemes"] = {"token": BEARER}
            description["security"] = [{"token": []}]
        return description

    return openapi
