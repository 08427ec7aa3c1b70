"""HEAD wherever there is GET (RFC 9110, 9.1), to which FastAPI answers 405 (fastapi/fastapi#1773)."""

from starlette.types import ASGIApp, Message, Receive, Scope, Send


class Head:
    """Answers HEAD as GET, without the body."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one connection."""
        if scope["type"] != "http" or scope["method"] != "HEAD":
            await self._app(scope, receive, send)
            return
        ended = False

        async def send_without_body(message: Message) -> None:
            nonlocal ended
            if message["type"] != "http.response.body":
                await send(message)
            elif not ended:  # the server then reports a disconnection, at which no more of a file is read
                ended = True
                await send({"type": "http.response.body"})

        headers = [each for each in scope["headers"] if each[0] != b"range"]  # RFC 9110, 14.2: GET only
        await self._app({**scope, "method": "GET", "headers": headers}, receive, send_without_body)
