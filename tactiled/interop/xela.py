"""`WS /xela`, and `/`, where XELA's clients look: the XELA modules here in the JSON of XELA's own server.

Sources of the format, whose fields docs/interop.md describes: a public capture of what that server sends (1.8.0);
the public clients that parse it, XELA's ROS nodes among them; and page 37 of its manual as the documentation of
one quotes it. `calibrated` is left out where forces are unknown, as by a server without force calibration: some
clients drop a message in which it is null. No public client sends that server a message: any is ignored here.
"""

import asyncio
import json
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import cast

import numpy as np
from fastapi import APIRouter, FastAPI, WebSocket

from tactiled.bus.codecs.xela import REST, Xela
from tactiled.config import Server
from tactiled.frames import MISSING, RawFrame
from tactiled.live.sensor import Sensor
from tactiled.live.service import Service
from tactiled.web.bridge import Bridge, Host
from tactiled.web.http import problems
from tactiled.web.http.auth import AccessControl
from tactiled.web.http.limits import ConcurrencyLimit, RateLimit
from tactiled.web.server import on_thread
from tactiled.web.ws.asyncapi import TOKEN, Json, channel, operation
from tactiled.web.ws.feed import Feed, Feeds, ticking
from tactiled.web.ws.pacing import protocol
from tactiled.web.ws.session import BAD_REQUEST, NOT_FOUND, RESTART, StreamEndError, receive, serve
from tactiled.web.ws.stream import no_stream

ABOUT = "A welcome, then the newest frame of every live module with the codec xela, in the JSON of XELA's server"
NO_MODULE = "no sensor here has the codec xela"
DECIMALS = 5  # of a force in N, as that server gives them
SPECIAL_TAIL = [0.0, 0, 0, 0, 0.0, 0, 0, 0, 0.0]  # of unknown meaning; a public note has that server send these
WELCOME = '{"message": "Welcome"}'


def make(feeds: Feeds) -> APIRouter:
    """The WebSocket of those sensors that are XELA's, numbered from 1 in the configuration's order."""
    modules = _modules(feeds, [])
    router = APIRouter()

    @router.websocket("/")
    @router.websocket("/xela")
    async def _xela(socket: WebSocket) -> None:
        nonlocal modules
        await socket.accept()
        feeds.follow()
        modules = _modules(feeds, modules)
        if modules:
            await _Client(socket, feeds, modules).run()
        else:
            await socket.close(NOT_FOUND, NO_MODULE)

    return router


def _modules(feeds: Feeds, before: list["_Module"]) -> list["_Module"]:
    """The modules that there are now: the same objects where nothing has changed."""
    ours = [(feed, getattr(feed.sensor, "codec", None)) for feed in feeds.values()]
    xelas = [(feed, codec.model_name) for feed, codec in ours if isinstance(codec, Xela)]
    if [feed for feed, _ in xelas] == [each.feed for each in before]:
        return before
    return [_Module(str(number), feed, model) for number, (feed, model) in enumerate(xelas, 1)]


def alone(service: Service, server: Server) -> FastAPI:
    """An application that has nothing but this WebSocket, for a port of its own."""
    feeds = Feeds(service)
    app = FastAPI(lifespan=lambda _: ticking(feeds), openapi_url=None, docs_url=None, redoc_url=None)
    problems.install(app)
    app.include_router(make(feeds))
    app.include_router(no_stream("see /xela"))
    streams = ConcurrencyLimit(server.streams_per_client, server.streams)
    app.add_middleware(AccessControl, server=server, rates=RateLimit(server.control_per_minute), streams=streams)
    return app


class XelaClients(Bridge):
    """Serves XELA's clients, on a port of their own, too, where one is given: without a token or TLS."""

    @contextmanager
    def running(self, host: Host) -> Iterator[str | None]:
        """Serve that port meanwhile."""
        if host.server.xela is None:
            yield None
            return
        secrets = dict.fromkeys(("read_token", "control_token", "tls_certificate", "tls_key"))
        address = {"host": host.server.xela_host, "port": host.server.xela}
        config = host.server.model_copy(update=secrets | address)
        with on_thread(alone(host.service, config), config, host.beside) as url:
            yield f"XELA's clients at {url.replace('http', 'ws', 1)}"

    def routes(self, feeds: Feeds) -> APIRouter:
        """`WS /xela`, and `/`."""
        return make(feeds)

    def described(self) -> dict[str, Json]:
        """That WebSocket, whose clients' messages are ignored."""
        about = "The JSON of XELA's own server, at / as well; messages of a client are ignored"
        xela = channel("/xela", about, TOKEN, ("xela",))
        codes = [each for each in xela["x-close-codes"] if each["code"] != BAD_REQUEST]
        return {
            "channels": {"xela": xela | {"x-close-codes": codes}},
            "operations": {"showXela": operation("send", "xela", ["xela"])},
            "messages": {"xela": {"title": "xela", "summary": ABOUT, "payload": {"type": "object"}}},
        }


class _Module:
    """A module and its part of the messages, made once a frame for all clients; lives on one event loop."""

    def __init__(self, key: str, feed: Feed, model: str) -> None:
        self.key, self.feed, self._model = key, feed, model
        self._sensor = cast(Sensor, feed.sensor)
        self._cache: tuple[RawFrame, str] | None = None

    def newest(self) -> RawFrame | None:
        """The newest frame of a live module; None of one with taxels missing, which the format cannot express."""
        frame = self._sensor.newest
        if frame is None or frame.shear is None or self.feed.status().state != "live":
            return None
        return None if (frame.flags & MISSING).any() else frame

    def text(self, frame: RawFrame) -> str:
        """A frame as JSON."""
        if self._cache is None or self._cache[0] is not frame:
            self._cache = frame, json.dumps(self._part(frame))
        return self._cache[1]

    def _part(self, frame: RawFrame) -> dict[str, object]:
        """Counts as they came, X, Y and Z of a taxel after another's, and its forces where known."""
        counts = np.vstack([np.asarray(frame.shear) + REST, frame.counts]).T.astype(int)
        forces = self._sensor.pipeline.forces(frame)
        size = len(counts)
        return {
            "sensor": self.key,
            "time": frame.time,
            "model": self._model,
            "taxels": size,
            "data": counts.astype(">u2").tobytes().hex(",", 2).upper(),
            "integer": counts.ravel().tolist(),
            "temp": [0.0] * size,
            "ups": [round(self.feed.status().rate_hz, 2)] * size,
            "special": [taxel + SPECIAL_TAIL for taxel in counts.tolist()],
        } | ({} if forces is None else {"calibrated": forces.round(DECIMALS).ravel().tolist()})


class _Client:
    """One client; newest wins, as on every stream."""

    def __init__(self, socket: WebSocket, feeds: Feeds, modules: list[_Module]) -> None:
        self._socket, self._feeds, self._modules = socket, feeds, modules
        self._wake = asyncio.Event()
        self._frames: dict[_Module, RawFrame] = {}  # of the newest message

    async def run(self) -> None:
        """Serve until the client leaves."""
        with ExitStack() as stack:
            stack.enter_context(self._feeds.listen(self._wake.set))
            for module in self._modules:
                stack.enter_context(module.feed.listen(self._wake.set))
            await serve(self._socket, self._listen(), self._send())

    async def _listen(self) -> None:
        while True:
            await receive(self._socket)

    async def _send(self) -> None:
        number = 0
        await self._socket.send_text(WELCOME)
        while True:
            await self._wake.wait()
            self._wake.clear()
            if _modules(self._feeds, self._modules) is not self._modules:
                raise StreamEndError(RESTART, "the configuration has other modules now")
            await protocol(self._socket).ready()
            frames = {module: frame for module in self._modules if (frame := module.newest()) is not None}
            if any(frame is not self._frames.get(module) for module, frame in frames.items()):
                self._frames, number = frames, number + 1
                await self._socket.send_text(_routine(number, frames))


def _routine(number: int, frames: dict[_Module, RawFrame]) -> str:
    """One message: every live module under its number, from 1 in the configuration's order."""
    newest = max(frame.time for frame in frames.values())
    head = {"message": number, "time": newest, "sensors": len(frames), "type": "routine", "sendtime": time.time()}
    modules = "".join(f',"{module.key}":{module.text(frame)}' for module, frame in frames.items())
    return json.dumps(head).removesuffix("}") + modules + "}"
