"""Answers that stay the same until a restart: made, packed and named once, however often they are asked for."""

import gzip
import hashlib
import json
from collections.abc import Callable
from functools import cached_property
from typing import Any

from fastapi import Request, Response
from starlette.concurrency import run_in_threadpool

from tactiled.web.http.negotiation import named
from tactiled.web.rest.common import Responses, documented

TOLD = documented({"ETag": "for If-None-Match: it stays the same until a restart"})
RESPONSES: Responses = {200: {"headers": TOLD}, 304: {"description": "If-None-Match names it", "headers": TOLD}}


class Constant:
    """A JSON text."""

    def __init__(self, text: bytes) -> None:
        self._plain = text
        self._tag = f'W/"{hashlib.sha256(text).hexdigest()[:16]}"'

    @cached_property
    def _packed(self) -> bytes:
        return gzip.compress(self._plain, mtime=0)

    def answer(self, request: Request) -> Response:
        """The answer to one request."""
        headers = {"ETag": self._tag, "Cache-Control": "no-cache", "Vary": "Accept-Encoding"}
        if named(self._tag, request.headers.get("if-none-match", "")):
            return Response(status_code=304, headers=headers)
        packed = "gzip" in request.headers.get("accept-encoding", "")
        if packed:
            headers["Content-Encoding"] = "gzip"
        return Response(self._packed if packed else self._plain, headers=headers, media_type="application/json")


def text(value: Any) -> bytes:
    """A value as JSON without blanks."""
    return json.dumps(value, ensure_ascii=False, separators=(",", ":")).encode()


async def constant(request: Request, make: Callable[[], bytes]) -> Response:
    """Answer a request with the JSON that `make` makes the first time that its path is asked for."""
    made: dict[str, Constant] = request.app.state.constants
    path = request.scope["path"]
    if path not in made:
        made[path] = Constant(await run_in_threadpool(make))
    return made[path].answer(request)
