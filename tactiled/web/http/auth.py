"""What a browser may do with the service: headers on every response, and no other site's page let in."""

import asyncio
import logging
import re
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial

from starlette.datastructures import Headers, MutableHeaders, QueryParams
from starlette.requests import ClientDisconnect
from starlette.responses import Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from tactiled.config import Server
from tactiled.config.schema import LOOPBACK
from tactiled.web.http import close, problems
from tactiled.web.http.body import Body
from tactiled.web.http.headers import HEADERS, STRICT_TRANSPORT_SECURITY
from tactiled.web.http.limits import Rates, Streams
from tactiled.web.http.log_limit import LogLimit
from tactiled.web.http.protocols import ENDS
from tactiled.web.http.tokens import COOKIE, Keys

Refusal = tuple[int, str]
LOG = logging.getLogger(__name__)
LOG.addFilter(LogLimit())
HOME = re.compile(
    rf"(?:{'|'.join(map(re.escape, sorted(LOOPBACK - {'::1'})))}|\[::1\])(?::[0-9]{{1,5}})?", re.IGNORECASE
)

SAFE = frozenset({"GET", "HEAD", "OPTIONS"})
ALONE = "; HttpOnly; SameSite=Strict; Path=/"


class Guard:
    """Refuses pages of another origin, a foreign host name on loopback (DNS rebinding), and a missing token."""

    def __init__(self, app: ASGIApp, server: Server, rates: Rates, streams: Streams) -> None:
        self._app, self._server, self._keys = app, server, Keys(server)
        self._rates, self._streams = rates, streams
        self._headers = HEADERS | (
            STRICT_TRANSPORT_SECURITY if server.tls_certificate and not server.loopback else {}
        )

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one connection."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        headers, query = Headers(scope=scope), QueryParams(scope["query_string"])
        refusal = self._stranger(scope, headers) or self._keyless(scope, headers, query)
        if scope["type"] == "http":
            await self._request(partial(self._answer, refusal, scope, query), scope, receive, send)
        else:
            await (_close(refusal, receive, send) if refusal else self._stream(scope, receive, send))

    async def _request(self, answer: Callable[[], ASGIApp], scope: Scope, receive: Receive, send: Send) -> None:
        """Have a request answered, once its body is in."""
        started, body = False, Body(scope, receive)

        async def guarded(message: Message) -> None:
            nonlocal started
            if message["type"] == "http.response.start":
                started = True
                headers = MutableHeaders(scope=message)
                for name, value in self._headers.items():
                    headers.setdefault(name, value)
                if not body.whole:  # it is not waited for
                    headers["Connection"] = "close"
            await send(message)

        try:
            app = answer()
            await app(scope, await body.taken(), guarded)
        except ClientDisconnect:  # amid its body: there is nobody left to tell
            return
        except (Exception, asyncio.CancelledError) as error:
            excuse = _excuse(error, scope)
            if not started:
                await excuse(scope, receive, guarded)
            elif isinstance(error, Exception):
                raise

    async def _stream(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve a WebSocket, if it is not one too many."""
        with ExitStack() as stack:
            try:
                stack.enter_context(self._streams.one(scope))
            except problems.Problem as error:
                await _close((error.status_code, error.detail), receive, send)
            else:
                await self._app(scope, receive, send)

    def _answer(self, refusal: Refusal | None, scope: Scope, query: QueryParams) -> ASGIApp:
        """Who answers a request; Problem where nobody does."""
        if refusal:
            raise problems.Problem(*refusal, {"WWW-Authenticate": "Bearer"} if refusal[0] == 401 else None)
        if scope["method"] not in SAFE:
            self._rates.count(scope)
        if scope["path"] == "/" and self._keys.scopes(query.get("token", "")):
            return self._welcome(query["token"])
        return self._app

    def _stranger(self, scope: Scope, headers: Headers) -> Refusal | None:
        """Why a request from elsewhere is refused."""
        hosts, host = headers.getlist("host"), headers.get("host", "")
        if self._server.loopback and (len(hosts) != 1 or not HOME.fullmatch(host)):
            return 403, f"Host: {host:.80}: this service answers to localhost only"
        origin = headers.get("origin")
        if origin is not None and origin not in (f"http://{host}", f"https://{host}"):
            return 403, f"Origin: {origin:.80}: pages of another site may not use this service"
        site = headers.get("sec-fetch-site", "none")
        link = headers.get("sec-fetch-mode") == "navigate" and scope.get("method") in SAFE
        if site not in ("none", "same-origin") and not link:
            return 403, f"Sec-Fetch-Site: {site:.80}: pages of another site may not use this service"
        return None

    def _keyless(self, scope: Scope, headers: Headers, query: QueryParams) -> Refusal | None:
        """Why a request without the token that it needs is refused."""
        allowed = self._keys.allowed(headers, query)
        if "read" not in allowed:
            return 401, "a token is needed: Authorization: Bearer TOKEN, or open /?token=TOKEN in a browser"
        if scope.get("method", "GET") not in SAFE and "control" not in allowed:
            return 403, "this token reads only: show the control token to change anything"
        return None

    def _welcome(self, token: str) -> Response:
        """Keep a token in a cookie that no script can read, and out of the address."""
        answer = Response(status_code=303, headers={"Location": "/", "Cache-Control": "no-store"})
        secure = "; Secure" if self._server.tls_certificate else ""
        answer.headers["Set-Cookie"] = f"{COOKIE}={token}{ALONE}{secure}"
        return answer


def _excuse(error: BaseException, scope: Scope) -> Response:
    """What a client is told of what went wrong; a fault of the service's own stands in its log."""
    if isinstance(error, problems.Problem):
        return problems.response(error.status_code, error.detail, error.headers)
    if isinstance(error, asyncio.CancelledError):
        return problems.response(503, ENDS)
    LOG.error("%s %s failed", scope["method"], scope["path"], exc_info=error)
    return problems.response(500, "the service failed at this: see its log")


async def _close(refusal: Refusal, receive: Receive, send: Send) -> None:
    """Accept, so that the client can be told why, and close."""
    status, reason = refusal
    await receive()
    await send({"type": "websocket.accept"})
    await send({"type": "websocket.close", "code": close.code(status), "reason": close.fitting(reason)})
