"""Every error of the API in one form: RFC 9457 problem details."""

from collections.abc import Mapping, Sequence
from http import HTTPStatus
from typing import Any, cast

from fastapi import FastAPI, Request, Response
from fastapi.exceptions import RequestValidationError
from starlette.exceptions import HTTPException
from starlette.routing import Match

from tactiled.bounds import place, reason, shown
from tactiled.errors import (
    CalibrationStateError,
    ConfigError,
    LoadedError,
    NoCalibrationError,
    NoShearError,
    NotLiveError,
    NotPushedError,
    ReaderAnswerError,
    ReaderError,
    ReadOnlyError,
    ReloadError,
    TactileError,
    TareStateError,
    UnknownSensorError,
)
from tactiled.web import schemas

STATUSES: dict[type[TactileError], int] = {
    ConfigError: 422, UnknownSensorError: 404, NoShearError: 404, NoCalibrationError: 404, NotLiveError: 409,
    LoadedError: 409, CalibrationStateError: 409, TareStateError: 409, ReloadError: 409, ReaderError: 503,
    ReaderAnswerError: 502, ReadOnlyError: 403, NotPushedError: 409,
}  # fmt: skip
SOON = {"Retry-After": "1"}
VERBS = ("DELETE", "GET", "PATCH", "POST", "PUT")
ELLIPSIS = " …"
MAX_REASON_BYTES = 123  # of a WebSocket's close frame (RFC 6455, 5.5)


class Problem(HTTPException):
    """An error with a text for the client."""


def response(status: int, detail: str, headers: Mapping[str, str] | None = None, **more: Any) -> Response:
    """The response of a problem; `more` of its fields where it has them."""
    text = _encoded(detail).decode()
    body = schemas.Problem(title=HTTPStatus(status).phrase, status=status, detail=text, **more)
    return Response(
        body.model_dump_json(exclude_none=True), status, dict(headers or {}), "application/problem+json"
    )


def _encoded(text: str) -> bytes:
    """UTF-8, which has no half of a pair as JSON may: it is written out."""
    return text.encode(errors="backslashreplace")


def close_reason(reason: str) -> str:
    """A reason, or as many of its words as a close frame holds, with an ellipsis."""
    text = _encoded(reason)
    if len(text) <= MAX_REASON_BYTES:
        return text.decode()
    return text[: MAX_REASON_BYTES - len(ELLIPSIS.encode())].decode(errors="ignore").rsplit(" ", 1)[0] + ELLIPSIS


def refused(error: TactileError) -> Response:
    """The answer to an error of STATUSES."""
    status = next(status for kind, status in STATUSES.items() if isinstance(error, kind))
    loaded: dict[str, Any] = {"code": "loaded", "seen": error.seen} if isinstance(error, LoadedError) else {}
    return response(status, str(error), SOON if status == 503 else None, **loaded)


def install(app: FastAPI) -> None:
    """Answer every error of an application in this form."""

    @app.exception_handler(HTTPException)
    async def _http(request: Request, error: HTTPException) -> Response:
        detail, headers = str(error.detail), dict(error.headers or {})
        if error.status_code == 405:  # Starlette's Allow has the methods of one of several routes
            headers["Allow"] = ", ".join(_methods(app, request))
        if isinstance(error.__cause__, UnicodeDecodeError | RecursionError):
            detail = f"body: {error.__cause__}"
        elif not isinstance(error, Problem) and detail == HTTPStatus(error.status_code).phrase:
            detail = f"{request.method} {request.url.path:.200}: {detail.lower()}"
        return response(error.status_code, detail, headers)

    for kind in STATUSES:
        app.add_exception_handler(kind, _refused)

    @app.exception_handler(RequestValidationError)
    async def _invalid(request: Request, error: RequestValidationError) -> Response:
        wrong = error.errors()
        if any(each["loc"] == ("body",) and isinstance(each["input"], bytes) for each in wrong):
            kind = request.headers.get("content-type", "none")
            return response(415, f"Content-Type: {kind:.80}: give application/json")
        status = 400 if any(each["type"] == "json_invalid" for each in wrong) else 422
        return response(status, "; ".join(_describe(each) for each in wrong if not _follows(each, wrong)))


async def _refused(_: Request, error: Exception) -> Response:
    return refused(cast(TactileError, error))


def _methods(app: FastAPI, request: Request) -> list[str]:
    """Every method that the path of a request has; a path in a folder of files has no route of its own."""

    def exists(verb: str) -> bool:
        scope = {**request.scope, "method": verb}
        return any(route.matches(scope)[0] is Match.FULL for route in app.routes)

    methods = list(filter(exists, VERBS)) or ["GET"]
    return sorted([*methods, "HEAD"]) if "GET" in methods else methods


def _follows(error: Mapping[str, Any], errors: Sequence[Mapping[str, Any]]) -> bool:
    """Whether a list is only too short because items of it are wrong, which pydantic does not count.

    Or whether a default cannot be made of them.
    """
    outer = error["loc"]
    inside = (each["loc"] for each in errors if each is not error)
    return error["type"] == "default_factory_not_called" or (
        error["type"] == "too_short" and any(each[: len(outer)] == outer for each in inside)
    )


def _describe(error: Any) -> str:
    """One validation error in a line."""
    source, *path = error["loc"]
    at = place(path)
    if error["type"] == "json_invalid":
        return f"body: no JSON at character {path[0]}: {error['ctx']['error']}"
    if error["type"].startswith("union_tag"):
        tags = error["ctx"]
        key = tags["discriminator"].strip("'")
        return f"{key} = {tags.get('tag')!r}: give {tags.get('expected_tags', 'it')}"
    value = error.get("input")
    if source == "body" and not at:
        return f"body{'' if value is None else f' = {shown(value)}'}: give a JSON object"
    if error["type"] == "missing":  # its input is all that stands beside it, a token as well
        return f"{at}: {reason(error)}"
    return f"{at or source} = {shown(value)}: {reason(error)}"
