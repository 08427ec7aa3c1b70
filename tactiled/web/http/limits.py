"""What one client may take of the service: how often what changes it or costs it much, and how many streams."""

import asyncio
import ipaddress
import math
import time
from collections import Counter, OrderedDict
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import NoReturn

from starlette.requests import Request
from starlette.responses import Response
from starlette.types import Scope

from tactiled.web.http.problems import SOON, Problem

MAX_CLIENTS = 1024  # that are remembered; who is forgotten begins with a full bucket
MAX_WAITING = 64  # costly answers of one kind
MAX_WAITING_PER_CLIENT = 16
BURST_S = 10.0  # of the rate, at once


class RateLimit:
    """Lets a client ask `per_minute` times a minute (0: no limit), a sixth of that at once; on one event loop."""

    def __init__(self, per_minute: int, clock: Callable[[], float] = time.monotonic) -> None:
        self._rate, self._clock = per_minute / 60, clock
        self._burst = max(1.0, self._rate * BURST_S)
        self._buckets: OrderedDict[str, tuple[float, float]] = OrderedDict()  # tokens, and when they were counted

    def count(self, scope: Scope) -> None:
        """Count one request; Problem 429 where it is one too many."""
        if wait_s := self.take(client_of(scope)):
            retry = {"Retry-After": str(math.ceil(wait_s))}
            raise Problem(
                429, f"more than {int(self._burst)} at once, or {60 * self._rate:g} a minute: wait", retry
            )

    def take(self, client: str) -> float:
        """Take a token and return 0, or return the time (s) until there is one."""
        if not self._rate:
            return 0.0
        now = self._clock()
        tokens, counted = self._buckets.pop(client, (self._burst, now))
        tokens = min(self._burst, tokens + (now - counted) * self._rate)
        if len(self._buckets) >= MAX_CLIENTS:
            self._buckets.popitem(last=False)
        self._buckets[client] = (tokens - 1 if tokens >= 1 else tokens), now
        return 0.0 if tokens >= 1 else (1 - tokens) / self._rate


class ConcurrencyLimit:
    """Lets a client have `per_client` of a kind open at a time, and all clients `total` (0: no limit)."""

    def __init__(self, per_client: int, total: int, kind: str = "streams") -> None:
        self._per_client, self._total, self._kind = per_client, total, kind
        self._open: Counter[str] = Counter()
        self.refused = {f"{kind}_per_client": 0, kind: 0}  # so far, by the limit

    @property
    def open(self) -> int:
        """How many there are now."""
        return self._open.total()

    @contextmanager
    def one(self, scope: Scope) -> Iterator[None]:
        """Count one while it is open; Problem 429 or 503 where it is one too many."""
        client = client_of(scope)
        if self._per_client and self._open[client] >= self._per_client:
            why = f"{self._per_client}: {client or 'this client'} has as many open: close one"
            self._refuse(429, f"{self._kind}_per_client", why)
        if self._total and self.open >= self._total:
            self._refuse(503, self._kind, f"{self._total}: as many are open: come again later")
        self._open[client] += 1
        try:
            yield
        finally:
            self._open -= Counter((client,))  # which forgets who has none

    def _refuse(self, status: int, limit: str, why: str) -> NoReturn:
        self.refused[limit] += 1
        raise Problem(status, f"{limit} = {why}", SOON)


class Turns:
    """Costly answers of one kind, counted by `rates`, made one at a time while a few wait; on one event loop."""

    def __init__(self, rates: RateLimit) -> None:
        self._rates, self._lock = rates, asyncio.Lock()
        self._waiting: Counter[str] = Counter()
        self._thread = ThreadPoolExecutor(1, "turns")

    async def one(self, request: Request, make: Callable[[], Response]) -> Response:
        """Make one in its turn, unless its client has left by then; Problem 429 where it is one too many.

        One that finds the queue full is not counted by `rates`.
        """
        client = client_of(request.scope)
        if self._waiting[client] >= MAX_WAITING_PER_CLIENT:
            who = client or "this client"
            raise busy(f"{MAX_WAITING_PER_CLIENT} such answers are waited for by {who} already")
        if self._waiting.total() >= MAX_WAITING:
            raise busy(f"{MAX_WAITING} such answers are waited for already")
        self._rates.count(request.scope)
        self._waiting[client] += 1
        try:
            await self._lock.acquire()
        finally:
            self._waiting -= Counter((client,))
        try:
            if await request.is_disconnected():
                return Response()  # the client has left
            return await asyncio.get_running_loop().run_in_executor(self._thread, make)
        finally:
            self._lock.release()


def busy(why: str) -> Problem:
    """A refusal of what can be had as soon as others are done."""
    return Problem(429, f"{why}: wait", SOON)


def client_of(scope: Scope) -> str:
    """Whose request it is: an IPv4 address, the 64 bits of an IPv6 address that one network has, or ""."""
    return network(scope["client"][0] if scope.get("client") else "")


def network(host: str) -> str:
    """An IPv4 address, as it is or mapped to IPv6; ::1; else the network of an IPv6 address, or ""."""
    try:
        address = ipaddress.ip_address(host.partition("%")[0])
    except ValueError:  # a socket without one, or what a proxy's header says
        return ""
    if isinstance(address, ipaddress.IPv6Address):
        if address.ipv4_mapped:
            return str(address.ipv4_mapped)
        if not address.is_loopback:
            return str(ipaddress.ip_network((address, 64), strict=False))
    return str(address)
