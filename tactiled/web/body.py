"""How large a request's body may be, and how long it may take to come."""

import asyncio

from starlette.datastructures import Headers
from starlette.types import Message, Receive, Scope

from tactiled.web.problems import Problem

MOST = 64 << 10  # bytes; no request but a film needs as much
MOST_FILM = 64 << 20  # bytes
IN_TIME_S = 60.0
FILM = "/api/v1/restore"


def bounded(scope: Scope, receive: Receive) -> Receive:
    """The same body, but Problem 413 once it is too large and 408 once it is too late."""
    most = MOST_FILM if scope["path"] == FILM else MOST
    told = Headers(scope=scope).get("content-length", "0")
    size, whole, end = 0, False, asyncio.get_running_loop().time() + IN_TIME_S

    async def counted() -> Message:
        nonlocal size, whole
        if whole:  # what comes now is the end of the connection, which may be far
            return await receive()
        if told.isdecimal() and int(told) > most:
            raise _too_large(most)
        try:
            async with asyncio.timeout_at(end):
                message = await receive()
        except TimeoutError as error:
            raise Problem(408, f"the body did not come within {IN_TIME_S:g} s", {"Connection": "close"}) from error
        size += len(message.get("body", b""))
        whole = not message.get("more_body", False)
        if size > most:
            raise _too_large(most)
        return message

    return counted


def _too_large(most: int) -> Problem:
    return Problem(413, f"a body of more than {most >> 10} KiB: send it in parts", {"Connection": "close"})
