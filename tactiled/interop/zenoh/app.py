"""The application of a server of other processes' sensors: what it forwards to their readers."""

import asyncio
import re
from collections.abc import Sequence
from contextlib import suppress
from typing import Any
from urllib.parse import parse_qsl, quote, urlencode

from fastapi import APIRouter, FastAPI, Request
from fastapi.responses import JSONResponse
from fastapi.routing import APIRoute
from pydantic import TypeAdapter, ValidationError
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response
from starlette.routing import BaseRoute, Match
from starlette.types import ASGIApp, Receive, Scope, Send

from tactiled.calibrate.calibration_file import read as read_calibration
from tactiled.config import Server
from tactiled.errors import ConfigError, ReaderAnswerError, TactileError
from tactiled.interop.zenoh import session as zenoh_session
from tactiled.interop.zenoh.fleet import Fleet
from tactiled.interop.zenoh.messages import MAX_JSON_BYTES, Settings, first_fault, read
from tactiled.interop.zenoh.session import Answer
from tactiled.web import schemas
from tactiled.web.app import RESOURCES, begin, complete
from tactiled.web.http import problems
from tactiled.web.rest import openapi
from tactiled.web.rest.config import Config, server_settings
from tactiled.web.rest.openapi import MEDIA

ROOT, SENSORS = "/api/v1", "/api/v1/sensors/"
LOCAL = {"", "stream", "geometry", "contacts", "frames"}  # and what is below
FORWARDED = "accept", "content-type"  # headers of a request; a reader never sees who asks
PROBLEM = "application/problem+json"
READER_PROBLEMS = frozenset(openapi.PROBLEMS) - {401}
RETRIED = {429, 503}
MAX_TEXT = 1000  # characters of a problem
CSV = re.compile(rb"[A-Za-z0-9_,/]*\n(?:[-+.0-9einfa,]*\n)*")  # numbers under their names
CONFIG_S = 3.0  # that every reader together may take to give its configuration


def create(fleet: Fleet, server: Server) -> FastAPI:
    """Make the application of the sensors of other processes, by names `robot/sensor`."""
    app, _ = begin(fleet, server)
    app.include_router(_config_of(fleet))
    app.add_middleware(
        Forward, fleet=fleet, resources=[route for each in RESOURCES for route in each.router.routes]
    )
    return complete(app, server)


class Forward:
    """Joins robot and sensor of a path to one name, and forwards what is not here to the sensor's reader."""

    def __init__(self, app: ASGIApp, fleet: Fleet, resources: Sequence[BaseRoute]) -> None:
        self._app, self._fleet = app, fleet
        self._routes = [each for each in resources if isinstance(each, APIRoute)]

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one connection."""
        if scope["type"] not in ("http", "websocket") or not scope["path"].startswith(SENSORS):
            await self._app(scope, receive, send)
            return
        robot, *rest = scope["path"].removeprefix(SENSORS).split("/", 2)
        name, resource = "/".join((robot, *rest[:1])), "/".join(rest[1:])
        path = f"{SENSORS}{quote(name, safe='')}{f'/{resource}' if resource else ''}"
        local: Scope = {**scope, "path": path}
        is_here = (
            scope["type"] == "websocket" or resource.partition("/")[0] in LOCAL or name not in self._fleet.sensors
        )
        route = None if is_here else self._route(local)
        if route is None:  # the application says what is wrong with it
            await self._app(local, receive, send)
            return
        try:
            response = await self._forward(Request(scope, receive), name, resource, route)
        except TactileError as error:  # the application's handlers do not see it
            response = problems.refused(error)
        await response(scope, receive, send)

    def _route(self, scope: Scope) -> APIRoute | None:
        return next((each for each in self._routes if each.matches(scope)[0] is Match.FULL), None)

    async def _forward(self, request: Request, name: str, resource: str, route: APIRoute) -> Response:
        """A reader's answer, made here of what a client may get; nothing but the request goes there."""
        headers = {each: value for each in FORWARDED if (value := request.headers.get(each))}
        query = [each for each in parse_qsl(request.url.query, keep_blank_values=True) if each[0] != "token"]
        forwarded = zenoh_session.Request(
            request.method, quote(resource), urlencode(query), headers, await request.body()
        )
        answer = await self._fleet.answer(name, forwarded)
        try:
            return await run_in_threadpool(_checked, answer, name, route)
        except (ValueError, ConfigError) as error:
            why = first_fault(error) if isinstance(error, ValidationError) else f"{error}"
            raise ReaderAnswerError(
                f"sensor {name!r}: its reader answers wrongly: {resource}: {why:.300}"
            ) from None


def _checked(answer: Answer, name: str, route: APIRoute) -> Response:
    """What a client gets for an answer; ValueError or ConfigError where no reader of this release answers so."""
    media = answer.headers.get("content-type", "").partition(";")[0]
    if media == PROBLEM and answer.status in READER_PROBLEMS:
        problem = schemas.Problem.model_validate_json(answer.body)
        later = problems.SOON if answer.status in RETRIED else None
        more = {"code": problem.code, "seen": problem.seen and problem.seen[:MAX_TEXT]}
        return problems.response(answer.status, problem.detail[:MAX_TEXT], later, **more)
    if answer.status != (route.status_code or 200):
        raise ValueError(f"status {answer.status} of {media!a:.80}")
    if answer.status == 204:
        return Response(status_code=204)
    formats = route.responses.get(200, {}).get("content", {})
    if media == MEDIA["json"] and route.response_model:
        return _json(answer, name, route)
    if media == MEDIA["csv"] and media in formats and CSV.fullmatch(answer.body):
        return Response(answer.body, media_type=media)
    if media == MEDIA["calibration"] and media in formats:
        own = name.partition("/")[2]
        download = {"Content-Disposition": f'attachment; filename="{own}.json"', "Cache-Control": "no-cache"}
        return Response(read_calibration(answer.body).text, media_type=media, headers=download)
    raise ValueError(f"{len(answer.body)} bytes of {media!a:.80}")


def _json(answer: Answer, name: str, route: APIRoute) -> Response:
    """A JSON answer with the fields that it has by our schema, its sensor by the name that it has here."""
    adapter: TypeAdapter[Any] = TypeAdapter(route.response_model)
    value = adapter.validate_json(answer.body)
    if hasattr(value, "sensor"):
        value = value.model_copy(update={"sensor": name})
    return Response(adapter.dump_json(value), answer.status, media_type=MEDIA["json"])


def _config_of(fleet: Fleet) -> APIRouter:
    """`/api/v1/config` of a fleet: the server's own, and what the readers run with."""
    router = APIRouter(prefix=ROOT, tags=["service"], responses=openapi.problems(*openapi.EVERY_RESOURCE))

    @router.get("/config", responses={200: {"model": Config}})
    async def config(request: Request) -> JSONResponse:
        """The configurations of this server and of every reader that answers, without secrets."""
        merged: dict[str, Any] = {"bus": {}, "sensor": {}, "overrides": []}
        names = {name.partition("/")[0]: name for name in fleet.sensors}  # one of each robot
        for robot, settings in zip(names, await asyncio.gather(*map(settings_of, names.values())), strict=True):
            if settings is None:
                continue
            for own, table in settings.sensor.items():
                if f"{robot}/{own}" in fleet.sensors:
                    merged["sensor"][f"{robot}/{own}"] = table | {"bus": f"{robot}/{table.get('bus', '')!s:.64}"}
            merged["bus"] |= {f"{robot}/{bus}": table for bus, table in settings.bus.items()}
            merged["overrides"] += [
                each.model_dump() | {"sensor": f"{robot}/{each.sensor}"} for each in settings.overrides
            ]
        return JSONResponse({"server": server_settings(request.app.state.server, False)} | merged)

    async def settings_of(name: str) -> Settings | None:
        with suppress(TactileError, ValueError):
            answer = await fleet.answer(name, zenoh_session.Request("GET", "config"), CONFIG_S)
            return await run_in_threadpool(read, Settings, answer.body, MAX_JSON_BYTES)
        return None

    return router
