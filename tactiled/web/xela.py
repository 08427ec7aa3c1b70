"""`WS /xela`, and `/`, where XELA's clients look: the XELA modules here in the JSON of XELA's own server.

Sources of the format: XELA's public ROS node for its server 1.7.6, which parses it, and page 37 of that server's
manual as the documentation of a public client quotes it; `type` is what another such client goes by. What none of
them says is left out: commands to the server, and forces in N, so `calibrated` is null, as without a calibration.
"""

import asyncio
import json
from collections.abc import Iterator
from contextlib import ExitStack

import numpy as np
from fastapi import APIRouter, WebSocket

from tactiled.bus.codecs.xela import REST
from tactiled.frames import MISSING, RawFrame
from tactiled.web.feed import Feed
from tactiled.web.flow import room
from tactiled.web.session import NOT_FOUND, heard, serve

MODELS = {16: "XR1944", 24: "XR1946"}  # by taxels, as clients' tables have them
NONE_HERE = "no sensor here has the codec xela"


def make(feeds: dict[str, Feed]) -> APIRouter:
    """The WebSocket of those sensors that are XELA's, numbered from 1 in the configuration's order."""
    skins = [feed for feed in feeds.values() if feed.sensor.codec_name == "xela"]
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


class _Client:
    """One client; newest wins, as on every stream."""

    def __init__(self, socket: WebSocket, skins: list[Feed]) -> None:
        self._socket, self._skins = socket, skins
        self._wake = asyncio.Event()
        self._sent: dict[str, RawFrame] = {}

    async def run(self) -> None:
        """Serve until the client leaves."""
        with ExitStack() as stack:
            for feed in self._skins:
                stack.enter_context(feed.listen(self._wake))
            await serve(self._socket, self._listen(), self._talk())

    async def _listen(self) -> None:
        while True:
            await heard(self._socket)

    async def _talk(self) -> None:
        number = 0
        await self._socket.send_text(json.dumps({"message": "Welcome"}))
        while True:
            await self._wake.wait()
            self._wake.clear()
            await room(self._socket).wait()
            frames = dict(self._frames())
            if any(frame is not self._sent.get(key) for key, frame in frames.items()):
                self._sent, number = frames, number + 1
                await self._socket.send_text(json.dumps(message(number, frames)))

    def _frames(self) -> Iterator[tuple[str, RawFrame]]:
        """The newest frames of live modules, by number; the format cannot say that taxels are missing."""
        for number, feed in enumerate(self._skins, 1):
            frame = feed.sensor.newest
            if frame is None or frame.shear is None or feed.status().state != "live":
                continue
            if not (frame.flags & MISSING).any():
                yield str(number), frame


def message(number: int, frames: dict[str, RawFrame]) -> dict[str, object]:
    """One message of the server: every module's counts as they came, X, Y and Z of a taxel after another's."""
    told = {key: _module(key, frame) for key, frame in frames.items()}
    newest = max(frame.time for frame in frames.values())
    return {"message": number, "type": "routine", "time": newest, "sensors": len(told), **told}


def _module(key: str, frame: RawFrame) -> dict[str, object]:
    counts = np.vstack([np.asarray(frame.shear) + REST, frame.counts]).T.astype(int)
    return {
        "sensor": key,
        "time": frame.time,
        "model": MODELS.get(len(counts), "unknown"),
        "taxels": len(counts),
        "data": ",".join(f"{each:04X}" for each in counts.ravel()),
        "calibrated": None,
    }
