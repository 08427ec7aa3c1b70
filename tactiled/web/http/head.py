"""HEAD wherever there is GET (RFC 9110, 9.1): the same headers, and no body."""

from starlette.types import ASGIApp, Message, Receive, Scope, Send


class Head:
    """Has an application answer HEAD as it does GET, and keeps the body back."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one connection."""
        if scope["type"] != "http" or scope["method"] != "HEAD":
            await self._app(scope, receive, send)
            return
        ended = False

        async def bare(message: Message) -> None:
            nonlocal ended
            if message["type"] != "http.response.body":
                await send(message)
            elif not ended:  # a file is read no further once the server has told that the answer is complete
                ended = True
                await send({"type": "http.response.body"})

        headers = [(name, value) for name, value in scope["headers"] if name != b"range"]  # which is GET's alone
        await self._app({**scope, "method": "GET", "headers": headers}, receive, bare)
