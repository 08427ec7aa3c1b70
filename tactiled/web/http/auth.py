"""Who may use the service: holders of a token, and no page of another site."""

import asyncio
import logging
import re
import secrets
from collections.abc import Mapping
from contextlib import ExitStack
from typing import Literal

from pydantic import SecretStr
from starlette.datastructures import Headers, MutableHeaders, QueryParams
from starlette.requests import ClientDisconnect, cookie_parser
from starlette.responses import Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from tactiled.config import Server
from tactiled.config.schema import LOOPBACK
from tactiled.web.http import problems, sign_in
from tactiled.web.http.body import Body, HeldBodies
from tactiled.web.http.headers import HEADERS, OPENER_POLICY, SAFE_METHODS, STRICT_TRANSPORT_SECURITY
from tactiled.web.http.limits import ConcurrencyLimit, RateLimit
from tactiled.web.http.problems import Problem
from tactiled.web.http.protocols import ENDS

Right = Literal["read", "control"]
LOG = logging.getLogger(__name__)
PORT = re.compile(r":([0-9]{1,5})$")  # at the end of a Host header
COOKIE_ATTRIBUTES = "; HttpOnly; SameSite=Strict; Path=/"
LOOPBACK_HOST = re.compile(
    rf"(?:{'|'.join(map(re.escape, sorted(LOOPBACK - {'::1'})))}|\[::1\])(?::[0-9]{{1,5}})?", re.IGNORECASE
)
HOW = "Authorization: Bearer TOKEN, or open / in a browser"
PREFLIGHT = {
    "Access-Control-Allow-Methods": "GET, POST, PUT, PATCH, DELETE",
    "Access-Control-Allow-Headers": "Authorization, Content-Type, Accept, If-None-Match, Range",
    "Access-Control-Allow-Private-Network": "true",
    "Access-Control-Max-Age": "600",
}
UNAUTHORIZED = f"a token is needed: {HOW}"
UNKNOWN = f"this token is unknown, give another: {HOW}"
READ_ONLY = "this token reads only: show the control token to change anything"


class Tokens:
    """What the token of a request allows: `Authorization: Bearer`, the viewer's cookie, or `?token=`."""

    def __init__(self, server: Server) -> None:
        tokens: dict[Right, SecretStr | None] = {"read": server.read_token, "control": server.control_token}
        self._tokens = {right: each.get_secret_value().encode() for right, each in tokens.items() if each}

    @property
    def required(self) -> bool:
        """Whether a request needs a token at all."""
        return bool(self._tokens)

    def rights(self, token: str) -> frozenset[Right]:
        """What a token allows; each is compared in constant time."""
        data = token.encode()
        equal = {right for right, value in self._tokens.items() if secrets.compare_digest(data, value)}
        return frozenset({"read", "control"} if "control" in equal else equal)

    def allowed(self, headers: Headers, query: QueryParams) -> frozenset[Right]:
        """What a request may do."""
        return self.rights(token_of(headers, query)) if self.required else frozenset({"read", "control"})


def token_of(headers: Headers, query: QueryParams) -> str:
    """The token of a request, or ""."""
    scheme, _, token = headers.get("authorization", "").partition(" ")
    if scheme.lower() == "bearer":
        return token.strip()
    if "token" in query:
        return query["token"]
    return cookie_parser(headers.get("cookie", "")).get(cookie_name(headers), "")


def cookie_name(headers: Headers) -> str:
    """That of the viewer's cookie, with the port: a browser sends the cookies of a host to all of its ports."""
    port = PORT.search(headers.get("host", ""))
    return f"tactiled-{port[1]}" if port else "tactiled"


class _Answer:
    """Sends the answer to a request with the headers of all; a body that does not belong turns a success down."""

    def __init__(self, scope: Scope, receive: Receive, send: Send, body: Body, headers: Mapping[str, str]) -> None:
        self._scope, self._receive, self._send, self._body, self._headers = scope, receive, send, body, headers
        self.started = self._refused = False

    async def __call__(self, message: Message) -> None:
        """Send a message of the application's."""
        unwanted = self._body.unwanted
        if unwanted and message["type"] == "http.response.start" and message["status"] < 400:
            await self.refuse(unwanted)
        elif not self._refused:
            await self._secured(message)

    async def refuse(self, error: BaseException) -> None:
        """Send an error in place of all that the application says."""
        self._refused = True
        await _error_response(error, self._scope)(self._scope, self._receive, self._secured)

    async def _secured(self, message: Message) -> None:
        if message["type"] == "http.response.start":
            self.started = True
            headers = MutableHeaders(scope=message)
            for name, value in self._headers.items():
                if name == "Vary":
                    headers.add_vary_header(value)
                else:
                    headers.setdefault(name, value)
            if not self._body.complete:  # the rest is not waited for
                headers["Connection"] = "close"
        await self._send(message)


class AccessControl:
    """Refuses pages of another origin, a foreign host name on loopback (DNS rebinding), and a missing token."""

    def __init__(self, app: ASGIApp, server: Server, rates: RateLimit, streams: ConcurrencyLimit) -> None:
        self._app, self._server, self._tokens = app, server, Tokens(server)
        self._rates, self._streams = rates, streams
        self._bodies = HeldBodies()
        tls, near = bool(server.tls_certificate), server.loopback
        self._headers = HEADERS | (OPENER_POLICY if tls or near else {})
        self._headers |= STRICT_TRANSPORT_SECURITY if tls and not near else {}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one connection."""
        if scope["type"] == "http":
            await self._request(scope, receive, send)
        elif scope["type"] == "websocket":
            await self._websocket(scope, receive, send)
        else:
            await self._app(scope, receive, send)

    async def _request(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request once its body is in."""
        body = Body(scope, receive, self._bodies)
        origin = self._allowed_origin(Headers(scope=scope))
        cross = {"Access-Control-Allow-Origin": origin, "Access-Control-Expose-Headers": "*"} if origin else {}
        vary = {"Vary": "Origin"} if self._server.allowed_origins else {}
        answer = _Answer(scope, receive, send, body, self._headers | cross | vary)
        try:
            app = self._route(scope)
            await app(scope, await body.receiver(), answer)
        except ClientDisconnect:  # during its body: there is no client to answer
            return
        except (Exception, asyncio.CancelledError) as error:
            if not answer.started:
                await answer.refuse(error)
            elif isinstance(error, Exception):
                raise
        finally:
            self._bodies.free(body)

    async def _websocket(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve a WebSocket; one that is refused is accepted first, so that the client learns why."""
        with ExitStack() as stack:
            try:
                self._authorize(scope)
                stack.enter_context(self._streams.one(scope))
            except Problem as error:
                await receive()
                await send({"type": "websocket.accept"})
                code, reason = 4000 + error.status_code, problems.close_reason(error.detail)
                await send({"type": "websocket.close", "code": code, "reason": reason})
            else:
                await self._app(scope, receive, send)

    def _route(self, scope: Scope) -> ASGIApp:
        """The application that answers a request; Problem where it is refused."""
        if self._is_preflight(scope):
            return Response(status_code=204, headers=PREFLIGHT)
        if self._tokens.required and sign_in.is_sent(scope):
            self._check_origin(scope, Headers(scope=scope))
            self._rates.count(scope)
            return self._sign_in
        try:
            self._authorize(scope)
        except Problem as error:
            if error.status_code != 401 or not sign_in.is_wanted(scope):
                raise
            return sign_in.page(unknown=error.detail == UNKNOWN)
        if scope["method"] not in SAFE_METHODS:
            self._rates.count(scope)
        token = QueryParams(scope["query_string"]).get("token", "")
        if scope["path"] == "/" and self._tokens.rights(token):
            return self._set_cookie(scope, token)
        return self._app

    async def _sign_in(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Take the token of the page that asks for one."""
        token = await sign_in.token(receive)
        known = bool(self._tokens.rights(token))
        answer = self._set_cookie(scope, token) if known else sign_in.page(unknown=True)
        await answer(scope, receive, send)

    def _allowed_origin(self, headers: Headers) -> str:
        """The origin of the page that makes a request, where the configuration allows it; else ""."""
        origin = headers.get("origin", "")
        return origin if origin in self._server.allowed_origins else ""

    def _is_preflight(self, scope: Scope) -> bool:
        """Whether a browser asks for a page of an allowed origin what it may request; that bears no token."""
        headers = Headers(scope=scope)
        asks = scope["method"] == "OPTIONS" and "access-control-request-method" in headers
        return asks and bool(self._allowed_origin(headers))

    def _authorize(self, scope: Scope) -> None:
        """Problem 401 or 403 where a request may not be made."""
        headers, query = Headers(scope=scope), QueryParams(scope["query_string"])
        self._check_origin(scope, headers)
        allowed = self._tokens.allowed(headers, query)
        if "read" not in allowed:
            reason = UNKNOWN if token_of(headers, query) else UNAUTHORIZED
            raise Problem(401, reason, {"WWW-Authenticate": "Bearer"})
        if scope.get("method", "GET") not in SAFE_METHODS and "control" not in allowed:
            raise Problem(403, READ_ONLY)

    def _check_origin(self, scope: Scope, headers: Headers) -> None:
        """Problem 403 where a request comes from a page of another site."""
        hosts, host = headers.getlist("host"), headers.get("host", "")
        rebinding = self._server.loopback and not self._tokens.required  # a page that rebinds has no token
        if rebinding and (len(hosts) != 1 or not LOOPBACK_HOST.fullmatch(host)):
            raise Problem(403, f"Host: {host:.80}: this service answers to localhost only")
        origin = headers.get("origin")
        if self._allowed_origin(headers):
            return
        if origin is not None and origin not in (f"http://{host}", f"https://{host}"):
            raise Problem(403, f"Origin: {origin:.60}: pages of another site may not use this service")
        site = headers.get("sec-fetch-site", "none")
        link = headers.get("sec-fetch-mode") == "navigate" and scope.get("method") in SAFE_METHODS
        if site not in ("none", "same-origin") and not link:
            raise Problem(403, f"Sec-Fetch-Site: {site:.60}: pages of another site may not use this service")

    def _set_cookie(self, scope: Scope, token: str) -> Response:
        """Keep a token in a cookie that no script can read, and out of the address."""
        name = cookie_name(Headers(scope=scope))
        response = Response(status_code=303, headers={"Location": scope["path"], "Cache-Control": "no-store"})
        secure = "; Secure" if self._server.tls_certificate else ""
        response.headers["Set-Cookie"] = f"{name}={token}{COOKIE_ATTRIBUTES}{secure}"
        return response


def _error_response(error: BaseException, scope: Scope) -> Response:
    """What a client reads of an error; the log has a fault of the service's own."""
    if isinstance(error, Problem):
        return problems.response(error.status_code, error.detail, error.headers)
    if isinstance(error, asyncio.CancelledError):
        return problems.response(503, ENDS)
    LOG.error("%s %s failed", scope["method"], scope["path"], exc_info=error)
    return problems.response(500, "the service failed at this: see its log")
