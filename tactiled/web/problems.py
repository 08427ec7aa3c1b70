"""Every error of the API in one form: RFC 9457 problem details."""

from collections.abc import Mapping
from http import HTTPStatus

from fastapi import FastAPI, Request, Response
from fastapi.exceptions import RequestValidationError
from starlette.exceptions import HTTPException

from tactiled.errors import ConfigError, UnknownSensorError
from tactiled.web import forms


class Problem(HTTPException):
    """An error with a text for the client."""

    def __init__(self, status: int, detail: str, headers: Mapping[str, str] | None = None) -> None:
        super().__init__(status, detail, dict(headers or {}))


def response(status: int, detail: str, headers: Mapping[str, str] | None = None) -> Response:
    """The response of a problem."""
    body = forms.Problem(title=HTTPStatus(status).phrase, status=status, detail=detail)
    return Response(body.model_dump_json(), status, dict(headers or {}), "application/problem+json")


def install(app: FastAPI) -> None:
    """Answer every error of an application in this form."""

    @app.exception_handler(HTTPException)
    async def _http(_: Request, error: HTTPException) -> Response:
        return response(error.status_code, str(error.detail), error.headers)

    @app.exception_handler(UnknownSensorError)
    async def _unknown(_: Request, error: UnknownSensorError) -> Response:
        return response(404, str(error))

    @app.exception_handler(ConfigError)
    async def _config(_: Request, error: ConfigError) -> Response:
        return response(422, str(error))

    @app.exception_handler(RequestValidationError)
    async def _invalid(_: Request, error: RequestValidationError) -> Response:
        return response(422, "; ".join(_say(each) for each in error.errors()))

    @app.exception_handler(Exception)
    async def _unforeseen(_: Request, error: Exception) -> Response:
        return response(500, f"{type(error).__name__}: see the service's log")


def _say(error: Mapping[str, object]) -> str:
    place = error["loc"]
    name = ".".join(str(each) for each in place[1:]) if isinstance(place, tuple) and len(place) > 1 else str(place)
    return f"{name} = {error.get('input')!r:.80}: {error['msg']}"
