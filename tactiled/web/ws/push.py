"""`WS /api/v1/sensors/{name}/push`: frames that a program pushes, as JSON or as bytes; nothing is answered."""

from struct import Struct
from typing import TYPE_CHECKING, Any
from urllib.parse import unquote

import numpy as np
from fastapi import APIRouter, WebSocket, WebSocketDisconnect
from numpy.typing import NDArray
from pydantic import ValidationError
from starlette.concurrency import run_in_threadpool
from starlette.types import Message

from tactiled.bounds import place, reason
from tactiled.config import Server
from tactiled.errors import BusError, ConfigError, TactileError
from tactiled.web.http.auth import READ_ONLY, Tokens
from tactiled.web.http.problems import close_reason
from tactiled.web.schemas import MAX_TIME_S, PushedFrame
from tactiled.web.ws.session import FAILED, FORBIDDEN, refuse

if TYPE_CHECKING:
    from tactiled.live.service import Service

HEADER = Struct("<dII")
LAYOUT = (
    (0, "f64", "Unix time of the frame, s; 0: when it comes"),
    (8, "u32", "number of the frame"),
    (12, "u32", "1: the number holds; 0: one more than the frame before"),
    (16, "f32[N]", "values, row by row; NaN: unknown"),
)


def make(service: "Service", server: Server) -> APIRouter:
    """The WebSocket that takes frames."""
    router, tokens = APIRouter(prefix="/api/v1"), Tokens(server)

    @router.websocket("/sensors/{name}/push")
    async def _push(socket: WebSocket, name: str) -> None:
        await socket.accept()
        if "control" not in tokens.allowed(socket.headers, socket.query_params):
            await socket.close(FORBIDDEN, READ_ONLY)
            return
        try:
            if unknown := set(socket.query_params) - {"token"}:
                raise ValueError(f"{min(unknown)}: no such parameter: there is token")
            service.need_pushed(unquote(name))
            while True:
                values, sequence, time_s = _frame(await socket.receive())
                await run_in_threadpool(service.push_frame, unquote(name), values, sequence, time_s)
        except WebSocketDisconnect:
            return
        except BusError as error:
            await socket.close(FAILED, close_reason(str(error)))
        except (TactileError, ValueError) as error:
            await refuse(socket, error)

    return router


def as_array(values: Any) -> NDArray[np.float64]:
    """Numbers of JSON as an array, null as NaN; ConfigError where rows differ in length."""
    try:
        return np.array(values, np.float64)
    except ValueError as error:
        raise ConfigError("values: rows of different lengths") from error


def _frame(message: Message) -> tuple[NDArray[np.float32 | np.float64], int | None, float | None]:
    """Values, number and time (s) in a message; ValueError if it is no frame, WebSocketDisconnect at the end."""
    if message["type"] == "websocket.disconnect":
        raise WebSocketDisconnect(message["code"], message.get("reason"))
    data: bytes | None = message.get("bytes")
    if data is None:
        return _of_text(message["text"])
    if len(data) < HEADER.size or len(data) % 4:
        raise ValueError(f"{len(data)} bytes: give {HEADER.size} and four for each taxel")
    time_s, number, numbered = HEADER.unpack_from(data)
    if not (0 <= time_s <= MAX_TIME_S and numbered in (0, 1)):
        raise ValueError(f"time = {time_s:g}, numbered = {numbered}: give a Unix time in s or 0, and 0 or 1")
    return np.frombuffer(data, "<f4", offset=HEADER.size), number if numbered else None, time_s or None


def _of_text(text: str) -> tuple[NDArray[np.float64], int | None, float | None]:
    try:
        frame = PushedFrame.model_validate_json(text)
    except ValidationError as error:
        first = error.errors()[0]
        raise ValueError(f"{place(first['loc']) or 'message'}: {reason(first)}") from error
    return as_array(frame.values), frame.sequence, frame.time
