"""Parts of a file (RFC 9110, 14): what cannot be had is a problem as every other, and nonsense is not heard."""

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from tactiled.web.http import problems


class Ranges:
    """Lets an application answer Range, but for what it refuses in plain text."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one connection."""
        if scope["type"] != "http" or (asked := Headers(scope=scope).get("range")) is None:
            await self._app(scope, receive, send)
            return
        refused: Headers | None = None
        status = 0

        async def heard(message: Message) -> None:
            nonlocal refused, status
            if message["type"] == "http.response.start" and message["status"] in (400, 416):
                told = Headers(raw=message["headers"])
                if told.get("content-type", "").startswith("text/plain"):
                    refused, status = told, message["status"]
            if refused is None:
                await send(message)

        await self._app({**scope}, receive, heard)  # which a mounted folder changes
        if refused is None:
            return
        if status == 400:
            headers = [each for each in scope["headers"] if each[0] != b"range"]
            await self._app({**scope, "headers": headers}, receive, send)
            return
        there = refused["content-range"]
        detail = f"Range: {asked:.80}: the file has {there.removeprefix('bytes */')} bytes"
        await problems.response(416, detail, {"Content-Range": there})(scope, receive, send)
