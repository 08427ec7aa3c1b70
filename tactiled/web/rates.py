"""How often a client may ask for what changes the service or costs it much: a bucket of tokens for each."""

import ipaddress
import math
import threading
import time
from collections import OrderedDict
from collections.abc import Callable

from starlette.types import Scope

from tactiled.web.problems import Problem

CLIENTS = 1024  # that are remembered; who is forgotten begins with a full bucket
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


def client(scope: Scope) -> str:
    """Whose request it is: an IPv4 address, the 64 bits of an IPv6 address that one network has, or ""."""
    host = scope["client"][0] if scope.get("client") else ""
    try:
        address = ipaddress.ip_address(host.partition("%")[0])
    except ValueError:  # a socket without one, or what a proxy's header says
        return ""
    return str(ipaddress.ip_network((address, 64), strict=False)) if address.version == 6 else host
