"""A reader on a Zenoh network: it publishes its sensors, and answers the requests that come over it."""

import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any
from urllib.parse import unquote

from anyio.from_thread import start_blocking_portal
from fastapi import FastAPI
from starlette.datastructures import Headers
from starlette.types import Message, Scope

from tactiled import __version__, logs
from tactiled.config import Server, Zenoh
from tactiled.interop.zenoh.publisher import ReaderPublisher
from tactiled.interop.zenoh.session import REQUEST_S, Answer, Request, need
from tactiled.live.sensor import Sensor
from tactiled.live.service import Service
from tactiled.web import answers
from tactiled.web.app import create
from tactiled.web.bridge import Bridge, Host
from tactiled.web.http import problems
from tactiled.web.http.headers import SAFE_METHODS
from tactiled.web.server import SWITCH_INTERVAL_S, bridged, watchdog

ROOT = "/api/v1"
ROS_REFUSED = (
    "a request of ROS 2 carries no claim: it may tare only where the reader has neither zenoh.control_key nor "
    "server.control_token, and all endpoints of its network are on loopback: tare by the REST API"
)


def publish(service: Service, config: Server, settings: Zenoh, bridges: Sequence[Bridge] = ()) -> None:
    """Publish on a Zenoh network until KeyboardInterrupt; no HTTP, but what a reader has in bridges."""
    need("zenoh", ros=settings.ros_domain is not None)
    where = f"{settings.prefix}/{settings.robot}"
    supervisor = watchdog(service, where)
    with bridged([*bridges, ZenohReader(settings)], Host(service, config, [])):
        rights = "" if settings.control_key else ", read-only without zenoh.control_key"
        logs.announce(f"{', '.join(service.sensors)} published as {where}{rights} (stop: Ctrl-C)")
        while True:
            if supervisor:
                supervisor.look()
            time.sleep(1.0)


class ZenohReader(Bridge):
    """Publishes on a Zenoh network, and in ROS 2 where that is configured."""

    def __init__(self, settings: Zenoh) -> None:
        self._settings = settings

    @contextmanager
    def running(self, host: Host) -> Iterator[None]:
        """Publish meanwhile, and answer the requests that come over the network."""
        sys.setswitchinterval(SWITCH_INTERVAL_S)
        app = create(host.service, host.server.model_copy(update={"recordings": None}))
        requests = Requests(app, host.server, self._settings)
        with requests.running(), publisher(host.service, self._settings, requests).running():
            yield


class Requests:
    """An application that answers requests which come another way than by HTTP; on an event loop of its own."""

    def __init__(self, app: FastAPI, server: Server, settings: Zenoh) -> None:
        token = server.control_token
        self._app, self._token = app, token and token.get_secret_value()
        is_open = settings.loopback and token is None and settings.control_key is None
        self._ros_refusal = "" if is_open else ROS_REFUSED

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

    def __call__(self, request: Request) -> Answer:
        """Answer one request; whoever is on the network may read, and changes need a claim."""
        refusal = self._ros_refusal if request.refusal is None else request.refusal
        if request.method not in SAFE_METHODS and refusal:
            refused = problems.response(403, refusal)
            return Answer(403, {"content-type": str(refused.media_type)}, bytes(refused.body))
        headers = request.headers | {"host": "localhost", "content-length": str(len(request.body))}
        headers |= {"authorization": f"Bearer {self._token}"} if self._token else {}
        return self._portal.start_task_soon(self._answer, request, headers).result(REQUEST_S)

    async def _answer(self, request: Request, headers: dict[str, str]) -> Answer:
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
        media = {"content-type": start["content-type"]} if "content-type" in start else {}
        return Answer(messages[0]["status"], media, b"".join(each.get("body", b"") for each in messages[1:]))


def publisher(service: Service, settings: Zenoh, requests: Requests) -> ReaderPublisher:
    """The publisher of a service's sensors, whose states are as of the REST API."""

    def describe(sensor: Sensor) -> dict[str, Any]:
        return answers.sensor_state(sensor).model_dump(mode="json") | {"release": __version__}

    return ReaderPublisher(service, settings, describe, requests)
