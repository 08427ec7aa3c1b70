"""What a server of other processes' sensors forwards to their readers, and how a reader answers."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any
from urllib.parse import parse_qsl, quote, unquote, urlencode

from anyio.from_thread import start_blocking_portal
from fastapi import APIRouter, FastAPI, Request
from fastapi.responses import JSONResponse
from starlette.concurrency import run_in_threadpool
from starlette.datastructures import Headers
from starlette.responses import Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from tactiled.config import Server, Zenoh
from tactiled.errors import ReaderError, TactileError
from tactiled.interop import zenoh_session
from tactiled.interop.zenoh_fleet import Fleet
from tactiled.interop.zenoh_publisher import Publisher
from tactiled.interop.zenoh_session import REQUEST_S, Answer
from tactiled.runtime.sensor import Sensor
from tactiled.web import answers
from tactiled.web.http import problems
from tactiled.web.http.auth import token_of
from tactiled.web.http.body import SAFE_METHODS
from tactiled.web.rest import openapi
from tactiled.web.rest.config import Config, server_settings

ROOT, SENSORS = "/api/v1", "/api/v1/sensors/"
LOCAL = {"", "stream", "contacts", "frames", "frames/raw", "frames/restored", "frames/deviation", "frames/shear"}
ANSWER_HEADERS = {
    "content-type", "content-disposition", "cache-control", "etag", "vary", "retry-after",
    "www-authenticate", "allow",
}  # fmt: skip
NO_TOKEN = (
    "this sensor's reader has no server.control_token, and its network reaches beyond its machine: nothing may be "
    "changed from here"
)


class Forward:
    """Joins robot and sensor of a path to one name, and forwards what is not here to the sensor's reader."""

    def __init__(self, app: ASGIApp, fleet: Fleet) -> None:
        self._app, self._fleet = app, fleet

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one connection."""
        if scope["type"] not in ("http", "websocket") or not scope["path"].startswith(SENSORS):
            await self._app(scope, receive, send)
            return
        robot, *rest = scope["path"].removeprefix(SENSORS).split("/", 2)
        name, resource = "/".join((robot, *rest[:1])), "/".join(rest[1:])
        if scope["type"] == "websocket" or resource in LOCAL or name not in self._fleet.sensors:
            path = f"{SENSORS}{quote(name, safe='')}{f'/{resource}' if resource else ''}"
            await self._app({**scope, "path": path}, receive, send)
        else:
            response = await self._forward(Request(scope, receive), name, resource)
            await response(scope, receive, send)

    async def _forward(self, request: Request, name: str, resource: str) -> Response:
        headers = {each: value for each in ("accept", "content-type") if (value := request.headers.get(each))}
        if token := token_of(request.headers, request.query_params):
            headers["authorization"] = f"Bearer {token}"
        query = [each for each in parse_qsl(request.url.query, keep_blank_values=True) if each[0] != "token"]
        forwarded = zenoh_session.Request(
            request.method, resource, urlencode(query), headers, await request.body()
        )
        try:
            answer = await run_in_threadpool(self._fleet.request, name, forwarded)
        except ReaderError as error:  # the application's handlers do not see it
            return problems.response(503, str(error), problems.SOON)
        return Response(_renamed(answer, name), answer.status, answer.headers)


def _renamed(answer: Answer, name: str) -> bytes:
    """The body of an answer, its sensor by the name that it has here."""
    if answer.headers.get("content-type") != "application/json":
        return answer.body
    content = json.loads(answer.body)
    if not isinstance(content, dict) or "sensor" not in content:
        return answer.body
    return json.dumps(content | {"sensor": name}).encode()


def config_of(fleet: Fleet) -> APIRouter:
    """`/api/v1/config` of a fleet: the server's own, and what the readers run with."""
    router = APIRouter(prefix=ROOT, tags=["service"], responses=openapi.problems(*openapi.EVERY_RESOURCE))

    @router.get("/config", responses={200: {"model": Config}})
    def config(request: Request) -> JSONResponse:
        """The configurations of this server and of every reader that answers, without secrets."""
        merged: dict[str, Any] = {"bus": {}, "sensor": {}, "overrides": []}
        for name in fleet.sensors:
            robot, own = name.split("/")
            try:
                settings = json.loads(fleet.request(name, zenoh_session.Request("GET", "config")).body)
            except TactileError:
                continue
            merged["sensor"][name] = settings["sensor"][own] | {"bus": f"{robot}/{settings['sensor'][own]['bus']}"}
            merged["bus"] |= {f"{robot}/{bus}": table for bus, table in settings["bus"].items()}
            overrides = (each for each in settings["overrides"] if each["sensor"] == own)
            merged["overrides"] += [each | {"sensor": name} for each in overrides]
        return JSONResponse({"server": server_settings(request.app.state.server, False)} | merged)

    return router


class Requests:
    """An application that answers requests which come another way than by HTTP; on an event loop of its own."""

    def __init__(self, app: FastAPI, server: Server, settings: Zenoh) -> None:
        token = server.control_token
        self._app, self._token = app, token and token.get_secret_value()
        self._open = self._token is not None or settings.loopback  # to changes

    @contextmanager
    def running(self) -> Iterator[None]:
        """Answer meanwhile."""
        lifespan = self._app.router.lifespan_context(self._app)
        with start_blocking_portal() as self._portal:
            self._portal.call(lifespan.__aenter__)
            try:
                yield
            finally:
                self._portal.call(lifespan.__aexit__, None, None, None)

    def __call__(self, request: zenoh_session.Request) -> Answer:
        """Answer one request; whoever is on the network may read, and changes need the control token."""
        headers = dict(request.headers)
        if request.method in SAFE_METHODS:
            headers |= {"authorization": f"Bearer {self._token}"} if self._token else {}
        elif not self._open:
            refused = problems.response(403, NO_TOKEN)
            return Answer(403, {"content-type": str(refused.media_type)}, bytes(refused.body))
        headers |= {"host": "localhost", "content-length": str(len(request.body))}
        return self._portal.start_task_soon(self._answer, request, headers).result(REQUEST_S)

    async def _answer(self, request: zenoh_session.Request, headers: dict[str, str]) -> Answer:
        messages: list[Message] = []
        bodies: list[Message] = [{"type": "http.request", "body": request.body, "more_body": False}]

        async def receive() -> Message:
            return bodies.pop() if bodies else {"type": "http.disconnect"}

        async def send(message: Message) -> None:
            messages.append(message)

        raw_path = f"{ROOT}{request.path}"
        scope: Scope = {
            "type": "http", "asgi": {"version": "3.0"}, "http_version": "1.1", "method": request.method,
            "scheme": "http", "path": unquote(raw_path), "raw_path": raw_path.encode(), "root_path": "",
            "query_string": request.query.encode(), "client": ("127.0.0.1", 0), "server": ("localhost", 0),
            "headers": [(name.lower().encode(), value.encode()) for name, value in headers.items()],
        }  # fmt: skip
        await self._app(scope, receive, send)
        start = Headers(raw=messages[0]["headers"])
        kept = {name: value for name, value in start.items() if name in ANSWER_HEADERS}
        return Answer(messages[0]["status"], kept, b"".join(each.get("body", b"") for each in messages[1:]))


def publisher(service: Any, settings: Zenoh, requests: Requests) -> Publisher:
    """The publisher of a service's sensors, whose states are as of the REST API."""

    def describe(sensor: Sensor) -> dict[str, Any]:
        return answers.sensor_state(sensor).model_dump(mode="json")

    return Publisher(service, settings, describe, requests)
