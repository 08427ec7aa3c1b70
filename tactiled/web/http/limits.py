"""What one client may take of the service: how often what changes it or costs it much, and how many streams."""

import asyncio
import ipaddress
import math
import threading
import time
from collections import Counter, OrderedDict, deque
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from statistics import fmean
from typing import NoReturn

from starlette.requests import Request
from starlette.responses import Response
from starlette.types import Scope

from tactiled.web.http.problems import Problem

CLIENTS = 1024  # that are remembered; who is forgotten begins with a full bucket
MOST_WAITING = 64  # costly answers of one kind
EACH_WAITING = 16  # of them, of one client
MEASURED = 16  # turns, by which the next are foretold
BURST_S = 10.0  # of the rate, at once


class Rates:
    """Lets a client ask `per_minute` times a minute (0: as often as it likes), a sixth of that at once."""

    def __init__(self, per_minute: int, clock: Callable[[], float] = time.monotonic) -> None:
        self._rate, self._clock = per_minute / 60, clock
        self._most = max(1.0, self._rate * BURST_S)
        self._buckets: OrderedDict[str, tuple[float, float]] = OrderedDict()  # tokens, and when they were counted
        self._lock = threading.Lock()

    def count(self, scope: Scope) -> None:
        """Count one request; Problem 429 where it is one too many."""
        wait = self.take(client(scope))
        if wait:
            raise Problem(
                429, f"more than {60 * self._rate:g} a minute: wait", {"Retry-After": str(math.ceil(wait))}
            )

    def take(self, who: str) -> float:
        """Take a token; gives the time (s) until there is one where there is none, else 0."""
        if not self._rate:
            return 0.0
        now = self._clock()
        with self._lock:
            tokens, counted = self._buckets.pop(who, (self._most, now))
            tokens = min(self._most, tokens + (now - counted) * self._rate)
            if len(self._buckets) >= CLIENTS:
                self._buckets.popitem(last=False)
            self._buckets[who] = (tokens - 1 if tokens >= 1 else tokens), now
        return 0.0 if tokens >= 1 else (1 - tokens) / self._rate


class Streams:
    """Lets a client have `each` of a kind open at a time, and all clients together `most` (0: no bound)."""

    def __init__(self, each: int, most: int, kind: str = "streams") -> None:
        self._each, self._most = each, most
        self._bounds = f"{kind}_per_client", kind
        self._open: Counter[str] = Counter()
        self.refused = dict.fromkeys(self._bounds, 0)  # so far, by the bound

    @property
    def open(self) -> int:
        """How many there are now."""
        return self._open.total()

    @contextmanager
    def one(self, scope: Scope) -> Iterator[None]:
        """Count one while it is open; Problem 429 or 503 where it is one too many."""
        who = client(scope)
        if self._each and self._open[who] >= self._each:
            self._refuse(429, self._bounds[0], f"{self._each}: {who or 'this client'} has as many open: close one")
        if self._most and self.open >= self._most:
            self._refuse(503, self._bounds[1], f"{self._most}: as many are open: come again later")
        self._open[who] += 1
        try:
            yield
        finally:
            self._open -= Counter((who,))  # which forgets who has none

    def _refuse(self, status: int, bound: str, why: str) -> NoReturn:
        self.refused[bound] += 1
        raise Problem(status, f"{bound} = {why}", {"Retry-After": "1"})


class Turns:
    """Costly answers of one kind, counted by `rates`, made one at a time while a few wait; on one event loop.

    They are all made on one thread: for each thread that ever draws, matplotlib keeps its fonts open.
    """

    def __init__(self, rates: Rates, clock: Callable[[], float] = time.monotonic) -> None:
        self._rates, self._clock, self._lock = rates, clock, asyncio.Lock()
        self._waiting: Counter[str] = Counter()
        self._took: deque[float] = deque(maxlen=MEASURED)  # s, of the last turns
        self._began = 0.0  # the newest turn
        self._thread = ThreadPoolExecutor(1, "turns")

    async def one(self, request: Request, make: Callable[[], Response]) -> Response:
        """Make one in its turn, unless its client has left; Problem 429 where it is one too many.

        One that finds the queue full is not counted.
        """
        who = client(request.scope)
        if self._waiting[who] >= EACH_WAITING:
            raise self._full(f"{EACH_WAITING} such answers are waited for by {who or 'this client'} already")
        if self._waiting.total() >= MOST_WAITING:
            raise self._full(f"{MOST_WAITING} such answers are waited for already")
        self._rates.count(request.scope)
        self._waiting[who] += 1
        try:
            come = await self._come(request)
        finally:
            self._waiting -= Counter((who,))
        if not come:
            return Response()  # to nobody
        try:
            self._began = self._clock()
            if await request.is_disconnected():
                return Response()
            made = await asyncio.get_running_loop().run_in_executor(self._thread, make)
            self._took.append(self._clock() - self._began)
            return made
        finally:
            self._lock.release()

    async def _come(self, request: Request) -> bool:
        """Wait for a turn, which holds the lock; False, and it does not, where the client leaves before."""
        if not self._lock.locked() and self._waiting.total() == 1:  # nor is anyone else about to take it
            return await self._lock.acquire()
        turn, left = asyncio.ensure_future(self._lock.acquire()), asyncio.ensure_future(_left(request))
        try:
            await asyncio.wait((turn, left), return_when=asyncio.FIRST_COMPLETED)
        except asyncio.CancelledError:
            if not turn.cancel():
                self._lock.release()
            raise
        finally:
            left.cancel()
        if turn.cancel():
            left.result()  # raises what is wrong with the request's body, if anything is
            return False
        return True

    def _full(self, why: str) -> Problem:
        """A refusal that tells how long all who wait will take: by the last turns, or by this one if longer."""
        turn_s = max(self._clock() - self._began, fmean(self._took) if self._took else 0.0)
        wait = max(1, math.ceil((1 + self._waiting.total()) * turn_s))
        return Problem(429, f"{why}: wait", {"Retry-After": str(wait)})


async def _left(request: Request) -> None:
    """Wait until the client of a request has left."""
    while (await request.receive())["type"] != "http.disconnect":
        pass


def client(scope: Scope) -> str:
    """Whose request it is: an IPv4 address, the 64 bits of an IPv6 address that one network has, or ""."""
    return network(scope["client"][0] if scope.get("client") else "")


def network(host: str) -> str:
    """An IPv4 address as it is, the network of an IPv6 address, "" for what is none."""
    try:
        address = ipaddress.ip_address(host.partition("%")[0])
    except ValueError:  # a socket without one, or what a proxy's header says
        return ""
    return str(ipaddress.ip_network((address, 64), strict=False)) if address.version == 6 else host
