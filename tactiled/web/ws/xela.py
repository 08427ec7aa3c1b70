"""`WS /xela`, and `/`, where XELA's clients look: the XELA modules here in the JSON of XELA's own server.

Sources of the format: a public capture of what that server sends (1.8.0); the public clients that parse it, XELA's
ROS nodes among them; and page 37 of its manual as the documentation of one quotes it. `calibrated` is left out
where forces are not known, as by a server without force calibration: some clients drop a message in which it is
null. No public client says anything to that server, so what one says here is not heard.
"""

import asyncio
import time
from contextlib import ExitStack
from typing import Literal

import numpy as np
from fastapi import APIRouter, FastAPI, WebSocket
from pydantic import ConfigDict, Field

from tactiled.bus.codecs.xela import REST, Xela
from tactiled.config import Server
from tactiled.frames import MISSING, RawFrame
from tactiled.runtime.service import Service
from tactiled.web.http import problems
from tactiled.web.http.auth import AccessControl
from tactiled.web.http.limits import ConcurrencyLimit, RateLimit
from tactiled.web.http.protocols import protocol
from tactiled.web.schemas import Schema
from tactiled.web.ws.feed import Feed, ticking
from tactiled.web.ws.session import NOT_FOUND, receive, serve
from tactiled.web.ws.stream import no_stream

NONE_HERE = "no sensor here has the codec xela"
DECIMALS = 5  # of a force in N, as that server gives them
SPECIAL_TAIL = (0.0, 0, 0, 0, 0.0, 0, 0, 0, 0.0)  # a public note has that server send these


class Module(Schema):
    """One module: the newest frame, taxel by taxel, row by row from the top left."""

    sensor: str = Field(description="its number, which is also its key")
    time: float = Field(description="s, of the frame's first CAN message")
    model: str = Field(description="by XELA's name; unknown where neither its ids nor the configuration say")
    taxels: int
    data: str = Field(description="counts of X, Y and Z as they came, four hexadecimal digits each, with commas")
    integer: list[int] = Field(description="the same counts")
    calibrated: list[float] | None = Field(
        None,
        description="N along x and y and into the skin, as sensed under the cover; left out unless "
        "shear_n_per_count and kpa_per_count are configured, the sensor was tared and every taxel works",
    )
    temp: list[float] = Field(description="K; always 0: the CAN messages tell none")
    ups: list[float] = Field(description="frames a second")
    special: list[tuple[int | float, ...]] = Field(
        description="of each taxel X, Y, Z and nine that are always 0: what they say is not known"
    )


class Routine(Schema):
    """One message of XELA's server: every live module under its number, from 1 in the configuration's order."""

    model_config = ConfigDict(
        frozen=True,
        extra="allow",
        json_schema_extra={
            "examples": [
                {
                    "message": 786,
                    "time": 1763712000.25,
                    "sensors": 1,
                    "type": "routine",
                    "sendtime": 1763712000.255,
                    "1": {
                        "sensor": "1",
                        "time": 1763712000.25,
                        "model": "uSPa11",
                        "taxels": 1,
                        "data": "4098,3F0C,9151",
                        "integer": [16536, 16140, 37201],
                        "calibrated": [0.09405, -0.15298, 0.45],
                        "temp": [0.0],
                        "ups": [83.0],
                        "special": [[16536, 16140, 37201, *SPECIAL_TAIL]],
                    },
                }
            ]
        },
    )
    __pydantic_extra__: dict[str, Module]

    message: int = Field(description="number of the message to this client")
    time: float = Field(description="s, of the newest frame in it")
    sensors: int = Field(description="modules in it")
    type: Literal["routine"] = "routine"
    sendtime: float = Field(description="s, when it was sent")


class Welcome(Schema):
    """The first message."""

    message: Literal["Welcome"] = "Welcome"


def make(feeds: dict[str, Feed]) -> APIRouter:
    """The WebSocket of those sensors that are XELA's, numbered from 1 in the configuration's order."""
    codecs = ((feed, feed.sensor.codec) for feed in feeds.values())
    ours = [(feed, codec.model_name) for feed, codec in codecs if isinstance(codec, Xela)]
    skins = [_Skin(str(number), feed, model) for number, (feed, model) in enumerate(ours, 1)]
    router = APIRouter()

    @router.websocket("/")
    @router.websocket("/xela")
    async def _xela(socket: WebSocket) -> None:
        await socket.accept()
        if skins:
            await _Client(socket, skins).run()
        else:
            await socket.close(NOT_FOUND, NONE_HERE)

    return router


def alone(service: Service, server: Server) -> FastAPI:
    """An application that has nothing but this WebSocket, for a port of its own."""
    feeds = {name: Feed(sensor) for name, sensor in service.sensors.items()}
    app = FastAPI(lifespan=lambda _: ticking(feeds), openapi_url=None, docs_url=None, redoc_url=None)
    problems.install(app)
    app.include_router(make(feeds))
    app.include_router(no_stream("see /xela"))
    streams = ConcurrencyLimit(server.streams_per_client, server.streams)
    app.add_middleware(AccessControl, server=server, rates=RateLimit(server.control_per_minute), streams=streams)
    return app


class _Skin:
    """A module and its part of the messages, made once a frame for all clients; lives on one event loop."""

    def __init__(self, key: str, feed: Feed, model: str) -> None:
        self.key, self.feed, self._model = key, feed, model
        self._told: tuple[RawFrame, str] | None = None

    def newest(self) -> RawFrame | None:
        """The newest frame of a live module; None of one with taxels missing, as the format cannot say so."""
        frame = self.feed.sensor.newest
        if frame is None or frame.shear is None or self.feed.status().state != "live":
            return None
        return None if (frame.flags & MISSING).any() else frame

    def text(self, frame: RawFrame) -> str:
        """A frame as JSON."""
        if self._told is None or self._told[0] is not frame:
            self._told = frame, self._module(frame).model_dump_json(exclude_none=True)
        return self._told[1]

    def _module(self, frame: RawFrame) -> Module:
        """Counts as they came, X, Y and Z of a taxel after another's, and its forces where known."""
        counts = np.vstack([np.asarray(frame.shear) + REST, frame.counts]).T.astype(int)
        forces = self.feed.sensor.pipeline.forces(frame)
        size = len(counts)
        return Module(
            sensor=self.key,
            time=frame.time,
            model=self._model,
            taxels=size,
            data=counts.astype(">u2").tobytes().hex(",", 2).upper(),
            integer=counts.ravel().tolist(),
            calibrated=None if forces is None else forces.round(DECIMALS).ravel().tolist(),
            temp=[0.0] * size,
            ups=[round(self.feed.status().rate_hz, 2)] * size,
            special=[(*taxel, *SPECIAL_TAIL) for taxel in counts.tolist()],
        )


class _Client:
    """One client; newest wins, as on every stream."""

    def __init__(self, socket: WebSocket, skins: list[_Skin]) -> None:
        self._socket, self._skins = socket, skins
        self._wake = asyncio.Event()
        self._sent: dict[_Skin, RawFrame] = {}

    async def run(self) -> None:
        """Serve until the client leaves."""
        with ExitStack() as stack:
            for skin in self._skins:
                stack.enter_context(skin.feed.listen(self._wake.set))
            await serve(self._socket, self._listen(), self._send())

    async def _listen(self) -> None:
        while True:
            await receive(self._socket)

    async def _send(self) -> None:
        number = 0
        await self._socket.send_text(Welcome().model_dump_json())
        while True:
            await self._wake.wait()
            self._wake.clear()
            await protocol(self._socket).ready()
            frames = {skin: frame for skin in self._skins if (frame := skin.newest()) is not None}
            if any(frame is not self._sent.get(skin) for skin, frame in frames.items()):
                self._sent, number = frames, number + 1
                await self._socket.send_text(_routine(number, frames))


def _routine(number: int, frames: dict[_Skin, RawFrame]) -> str:
    """`Routine` as JSON, put together from its modules'."""
    newest = max(frame.time for frame in frames.values())
    told = Routine(message=number, time=newest, sensors=len(frames), sendtime=time.time())
    modules = "".join(f',"{skin.key}":{skin.text(frame)}' for skin, frame in frames.items())
    return told.model_dump_json().removesuffix("}") + modules + "}"
