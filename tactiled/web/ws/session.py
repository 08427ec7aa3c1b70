"""One client on a WebSocket, until it leaves or is closed; close codes are HTTP's + 4000, or the protocol's."""

import asyncio
from collections.abc import Coroutine
from contextlib import suppress
from typing import Any

from fastapi import WebSocket, WebSocketDisconnect
from uvicorn.protocols.utils import ClientDisconnected

from tactiled.errors import NoShearError, UnknownSensorError
from tactiled.web.http.problems import close_reason
from tactiled.web.http.protocols import ENDS
from tactiled.web.http.timeouts import MAX_FRAGMENTS

BAD_REQUEST, UNAUTHORIZED, FORBIDDEN, NOT_FOUND, REMOVED = 4400, 4401, 4403, 4404, 4410
TOO_MANY, FULL = 4429, 4503
PROTOCOL, NOT_UTF8, TOO_BIG, FAILED, RESTART = 1002, 1007, 1009, 1011, 1012
PING_S = 20.0  # between two pings of the service, and until one must be answered
MAX_MESSAGE_BYTES = 64 << 10  # of a client's message
CLOSES = {
    PROTOCOL: "the bytes are not a WebSocket frame",
    NOT_UTF8: "a text message is not UTF-8",
    TOO_BIG: f"a message has more than 64 KiB, or more than {MAX_FRAGMENTS} frames",
    FAILED: "the service failed, see its log; or the client answered no ping for "
    f"{PING_S:g} s (`keepalive ping timeout`)",
    RESTART: f"{ENDS}; or the configuration has changed in a way that needs a new connection",
    BAD_REQUEST: "a parameter or a message is wrong; the reason names it and its value",
    UNAUTHORIZED: "the token is missing or unknown",
    FORBIDDEN: "the page belongs to another site, or the host name is not one of loopback's",
    NOT_FOUND: "there is no stream at this address, no such sensor, or no shear; the reason names it",
    REMOVED: "no sensor of the stream is in the configuration any more; the reason names them",
    TOO_MANY: "this client has too many streams (`streams_per_client`)",
    FULL: "all clients together have too many streams (`streams`)",
}


class StreamEndError(Exception):
    """The service closes a stream, with this code and reason."""

    def __init__(self, code: int, reason: str) -> None:
        self.code, self.reason = code, reason


async def refuse(socket: WebSocket, error: Exception) -> None:
    """Close after an error of the client, with the reason."""
    code = NOT_FOUND if isinstance(error, UnknownSensorError | NoShearError) else BAD_REQUEST
    await socket.close(code, close_reason(str(error)))


async def receive(socket: WebSocket) -> str | None:
    """The client's next message, None for one of bytes; WebSocketDisconnect when it has left."""
    message = await socket.receive()
    if message["type"] == "websocket.disconnect":
        raise WebSocketDisconnect(message["code"], message.get("reason"))
    text: str | None = message.get("text")
    return text


async def serve(socket: WebSocket, listen: Coroutine[Any, Any, None], send: Coroutine[Any, Any, None]) -> None:
    """Listen and send until the client leaves; a ValueError of `listen` is an error of the client."""
    tasks = listening, _ = asyncio.create_task(listen), asyncio.create_task(send)
    try:
        done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
    for task in done:
        error = task.exception()
        if isinstance(error, StreamEndError):
            with suppress(WebSocketDisconnect):  # it has left already
                await socket.close(error.code, close_reason(error.reason))
        elif isinstance(error, NoShearError) or (task is listening and isinstance(error, ValueError)):
            await refuse(socket, error)
        elif error is not None and not isinstance(error, WebSocketDisconnect | ClientDisconnected):
            await socket.close(FAILED, "the service failed: see its log")
            raise error
