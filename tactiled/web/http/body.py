"""How large a request's body may be, and how long it may take to come."""

import asyncio

from starlette.datastructures import Headers
from starlette.requests import ClientDisconnect
from starlette.types import Message, Receive, Scope

from tactiled.web.http.problems import Problem

MOST = 64 << 10  # bytes; no request but a film needs as much
MOST_FILM = 64 << 20  # bytes
IN_TIME_S = 60.0
FILM = "/api/v1/restore"


class Body:
    """A request's body, of which no more comes in than it may have: Problem 413, or 408 where it is too late."""

    def __init__(self, scope: Scope, receive: Receive) -> None:
        headers = Headers(scope=scope)
        self._receive, self._film = receive, scope["path"] == FILM
        self._most = MOST_FILM if self._film else MOST
        self._told, self._size = headers.get("content-length", "0"), 0
        self._end = asyncio.get_running_loop().time() + IN_TIME_S
        self.whole = self._told == "0" and "transfer-encoding" not in headers

    async def taken(self) -> Receive:
        """Take it in, unless it is a film; gives what it is read from. ClientDisconnect if it ends before."""
        if self.whole or self._film:
            return self._next
        body, more = bytearray(), True
        while more:
            message = await self._next()
            if message["type"] == "http.disconnect":
                raise ClientDisconnect
            body += message["body"]
            more = message["more_body"]
        waiting: list[Message] = [{"type": "http.request", "body": bytes(body), "more_body": False}]

        async def again() -> Message:
            return waiting.pop() if waiting else await self._receive()

        return again

    async def _next(self) -> Message:
        """The next piece; behind the last, the end of the connection, which may be far."""
        if self.whole:
            return await self._receive()
        if self._told.isdecimal() and int(self._told) > self._most:
            raise self._too_large()
        try:
            async with asyncio.timeout_at(self._end):
                message = await self._receive()
        except TimeoutError as error:
            raise Problem(408, f"the body did not come within {IN_TIME_S:g} s") from error
        self._size += len(message.get("body", b""))
        if self._size > self._most:
            raise self._too_large()
        self.whole = not message.get("more_body", False)
        return message

    def _too_large(self) -> Problem:
        return Problem(413, f"a body of more than {self._most >> 10} KiB: send it in parts")
