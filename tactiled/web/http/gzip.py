"""Large text, packed for who takes it so."""

from starlette.datastructures import MutableHeaders
from starlette.middleware.gzip import GZipMiddleware
from starlette.types import Receive, Scope, Send

from tactiled.web.http.negotiation import like


class Gzip(GZipMiddleware):
    """Starlette's, which takes `gzip;q=0` for a wish."""

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one connection."""
        if scope["type"] == "http":
            headers = MutableHeaders(raw=[*scope["headers"]])
            likes = [like(part) for part in headers.get("accept-encoding", "").split(",")]
            if (0.0, "gzip") in likes:
                del headers["accept-encoding"]
                scope = {**scope, "headers": headers.raw}
        await super().__call__(scope, receive, send)
