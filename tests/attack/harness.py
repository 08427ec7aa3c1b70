"""An attack, what must hold while it runs, and its report."""

import asyncio
import time
from collections import Counter
from collections.abc import Awaitable, Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path

from tests.attack.bystander import MAX_OWN_S, Waits, beside
from tests.attack.service import HTTP, Kind, Target
from tests.attack.wire import HOST, Ending, exchange

PEAK_MB = 256.0  # of memory, while an attack runs
MORE_DESCRIPTORS = 4  # that may be open after it: of what the service itself opens late
ATTACK_S = 300.0  # that an attack may take on a busy machine, besides the fuzzer's own time
RECOVERY_S = 30.0  # until memory and descriptors are back
MAX_LOG_BYTES = 16 << 10  # that an attack may have the service write

# What the service promises of every connection (s): when it ends at the latest in that state.
DEADLINES_S = {
    "head": 10.0,  # an incomplete head of a request, or TLS handshake
    "body": 60.0,
    "refused": 2.0,  # after a last answer that the client goes on sending behind
    "idle": 5.0,  # kept alive after a complete request
    "websocket": 45.0,  # a stream whose client answers no ping: 20 to the ping, 20 to its answer, 5 to read
}


def late_s(state):
    """When a connection is late that a deadline ends, on a busy machine."""
    return 1.25 * DEADLINES_S[state] + 5.0


@dataclass(frozen=True)
class Size:
    """How large the fuzzer is: as in continuous integration, or larger by hand."""

    connections: int = 2000
    seconds: float = 20.0  # that it may take for new connections
    seed: int = 1


@dataclass
class Findings:
    """How the connections of an attack ended, and what the service needed."""

    outcomes: Counter[str] = field(default_factory=Counter)
    failures: list[str] = field(default_factory=list)
    seconds: float = 0.0
    waits: Waits = field(default_factory=Waits)
    descriptors: tuple[int, ...] = ()  # before and after
    rss_mb: tuple[int, ...] = ()  # before, at most, after

    def check(self, true, why):
        """Fail once unless it is true."""
        if not true and why not in self.failures:
            self.failures.append(why)

    def report(self, name):
        """An attack in a line, and under it how its connections ended and what did not hold."""
        first = (
            f"{name}: {'FAILED' if self.failures else 'held'}: {self.outcomes.total()} attempts in"
            f" {self.seconds:.0f} s; {self.waits}; descriptors before and after {self.descriptors};"
            f" memory before, at most and after {self.rss_mb} MB"
        )
        endings = [f"{number:>7} {ending}" for ending, number in self.outcomes.most_common()]
        return "\n    ".join([first, *endings, *self.failures])


@dataclass(frozen=True)
class Try:
    """One connection: what it sends, and how it must end."""

    name: str
    pieces: Iterable[bytes]
    wait_s: float = late_s("head")
    pause_s: float = 0.0  # after each piece
    send_s: float = 60.0  # that it may take to send
    ends: bool = True  # by the service, within that time
    expect: Callable[[Ending], bool] = lambda _: True
    port: str = "port"  # of the service, or xela or foxglove
    source: str = HOST
    tls: bool = False


def each(table, times, **options):
    """Every row of a table so many times."""
    rows = ((name, [data] if isinstance(data, bytes) else data) for name, data in table.items())
    tries = [Try(name, pieces, **options) for name, pieces in rows]
    return lambda _: tries * times


@dataclass(frozen=True)
class Attack:
    """Connections of a table (`tries`), `at_once` at a time, or `run`; and the kind of service that it needs."""

    tries: Callable[[Target], Iterable[Try]] = lambda _: ()
    run: Callable[[Target, Size, Findings], Awaitable[None]] | None = None
    at_once: int = 1000
    kind: Kind = HTTP
    grown_mb: float = 64.0  # of memory after it, which the allocator keeps for the next
    more_descriptors: int = MORE_DESCRIPTORS
    alone: bool = False  # on a service of its own, which it ends: nobody stands by

    async def go(self, target, size, findings):
        """Run it, but not for ever."""
        places = asyncio.Semaphore(self.at_once)

        async def play(one):
            options = {"source": one.source, "tls": target.tls if one.tls else None}
            times_s = {"pause_s": one.pause_s, "send_s": one.send_s}
            async with places:
                ending = await exchange(getattr(target, one.port), one.pieces, one.wait_s, **options, **times_s)
            findings.outcomes[f"{one.name}: {ending}"] += 1
            open_, wrong = ending.how == "open" and one.ends, ending.status == 500 or not one.expect(ending)
            findings.check(not (open_ or wrong), f"{one.name}: {ending}")

        try:
            async with asyncio.timeout(ATTACK_S + size.seconds):
                if self.run:
                    await self.run(target, size, findings)
                await asyncio.gather(*map(play, self.tries(target)))
        except TimeoutError:
            findings.check(False, "took too long")


def attack(one, pool, size):
    """Run an attack on a service and judge it."""
    began, findings = time.monotonic(), Findings()
    target = Target(one.kind) if one.alone else pool[one.kind]
    try:
        target.ready()
        if one.alone:
            asyncio.run(one.go(target, size, findings))
        else:
            _watch(one, target, size, findings)
    finally:
        findings.seconds = time.monotonic() - began
        if one.alone:
            target.close()
        elif findings.failures or target.process.poll() is not None:
            pool.pop(one.kind).close()
    return findings


def _watch(one, target, size, findings):
    """Run an attack beside a bystander, and measure the service."""
    descriptors, rss_mb, log = target.descriptors(), target.rss_mb(), target.log.stat().st_size
    Path(f"/proc/{target.process.pid}/clear_refs").write_text("5")  # measure the peak of memory from now on
    with beside(target) as end:
        asyncio.run(one.go(target, size, findings))
        findings.waits = waits = end()
    if target.process.poll() is not None:
        findings.check(False, f"the service ended with {target.process.returncode}")
        return
    peak_mb = target.rss_mb("VmHWM")
    max_descriptors, max_mb = descriptors + one.more_descriptors, rss_mb + one.grown_mb
    deadline = time.monotonic() + RECOVERY_S
    while time.monotonic() < deadline and (target.descriptors() > max_descriptors or target.rss_mb() > max_mb):
        time.sleep(0.1)
    findings.descriptors = descriptors, target.descriptors()
    findings.rss_mb = rss_mb, peak_mb, target.rss_mb()
    logged = target.log.stat().st_size - log
    findings.check(not waits.error, f"another client, at request {waits.requests}: {waits.error}")
    findings.check(waits.own_s <= MAX_OWN_S, f"another client waited for {waits.own_s:.1f} s")
    findings.check(findings.descriptors[-1] <= max_descriptors, f"descriptors: {findings.descriptors}")
    findings.check(peak_mb <= rss_mb + PEAK_MB and findings.rss_mb[-1] <= max_mb, f"memory: {findings.rss_mb} MB")
    findings.check(logged <= MAX_LOG_BYTES, f"log: {logged >> 10} KiB were written")
