"""An attack, what must hold while it runs, and the table of its outcomes."""

import asyncio
import time
from collections import Counter
from collections.abc import Awaitable, Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from tests.attack.bystander import MAX_OWN_S, Waits, beside
from tests.attack.service import HTTP, Kind, Pool, Target
from tests.attack.wire import HOST, Ending, exchange

PEAK_MB = 256.0  # of memory, while an attack runs
MORE_DESCRIPTORS = 4  # that may be open after it: of what the service itself opens late
ATTACK_S = 120.0  # that an attack may take, besides the fuzzer's own time
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


def late_s(state: str) -> float:
    """When a connection is late that a deadline ends, on a busy machine."""
    return 1.25 * DEADLINES_S[state] + 5.0


@dataclass(frozen=True)
class Size:
    """How large an attack is: as in continuous integration, or larger by hand."""

    factor: int = 1  # how often tables are played
    connections: int = 2000  # of the fuzzer
    seconds: float = 20.0  # that the fuzzer may take for new connections
    seed: int = 1


@dataclass
class Findings:
    """The outcomes of an attack."""

    outcomes: Counter[str] = field(default_factory=Counter)
    failures: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def add(self, name: str, ending: Ending, *, ends: bool = True) -> None:
        """Count how a connection ended; one that is still open fails, unless it was not waited for."""
        self.outcomes[f"{name}: {ending}"] += 1
        self.check(ending.how != "open" or not ends, f"{name}: still open after {ending.seconds:.0f} s")
        self.check(ending.status != 500, f"{name}: 500")

    def check(self, true: bool, why: str) -> None:
        """Fail once unless it is true."""
        if not true and why not in self.failures:
            self.failures.append(why)


@dataclass(frozen=True)
class Try:
    """One connection: what it sends, and how it must end."""

    name: str
    pieces: Iterable[bytes]
    wait_s: float = late_s("head")
    pause_s: float = 0.0  # after each piece
    ends: bool = True  # by the service, within that time
    expect: Callable[[Ending], bool] = lambda _: True
    port: str = "port"  # of the service, or xela or foxglove
    source: str = HOST
    tls: bool = False


Table = Mapping[str, bytes | Sequence[bytes]]


def each(table: Table, times: int, **options: Any) -> Callable[[Target], list[Try]]:
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
    alone: bool = False  # on a service of its own, which it ends: nobody stands by

    async def go(self, target: Target, size: Size, findings: Findings) -> None:
        """Run it."""
        if self.run:
            await self.run(target, size, findings)
            return
        places = asyncio.Semaphore(self.at_once)

        async def play(one: Try) -> None:
            tls = target.tls if one.tls else None
            port = getattr(target, one.port)
            async with places:
                ending = await exchange(
                    port, one.pieces, one.wait_s, pause_s=one.pause_s, source=one.source, tls=tls
                )
            findings.add(one.name, ending, ends=one.ends)
            findings.check(one.expect(ending), f"{one.name}: {ending}")

        await asyncio.gather(*map(play, [*self.tries(target)] * size.factor))


@dataclass
class Outcome:
    """One row of the table."""

    name: str
    findings: Findings = field(default_factory=Findings)
    seconds: float = 0.0
    waits: Waits = field(default_factory=Waits)
    descriptors: tuple[int, ...] = ()  # before and after
    rss_mb: tuple[float, ...] = ()  # before, at most, after


def attack(name: str, one: Attack, pool: Pool, size: Size) -> Outcome:
    """Run an attack on a service and judge it."""
    began, outcome = time.monotonic(), Outcome(name)
    target = Target(one.kind) if one.alone else pool.take(one.kind)
    try:
        target.ready()
        if one.alone:
            asyncio.run(_bounded(one, target, size, outcome.findings))
        else:
            _watched(one, target, size, outcome)
    finally:
        outcome.seconds = time.monotonic() - began
        if one.alone:
            target.close()
        elif outcome.findings.failures or target.process.poll() is not None:
            pool.drop(one.kind)
    return outcome


async def _bounded(one: Attack, target: Target, size: Size, findings: Findings) -> None:
    """Run an attack, but not for ever."""
    try:
        async with asyncio.timeout(size.factor * ATTACK_S + size.seconds):
            await one.go(target, size, findings)
    except TimeoutError:
        findings.check(False, "took too long")


def _watched(one: Attack, target: Target, size: Size, outcome: Outcome) -> None:
    """Run an attack beside a bystander, and measure the service."""
    findings = outcome.findings
    descriptors, rss_mb, log = target.descriptors(), target.rss_mb(), target.log.stat().st_size
    target.forget_peak()
    with beside(target) as end:
        asyncio.run(_bounded(one, target, size, findings))
        outcome.waits = waits = end()
    if target.process.poll() is not None:
        findings.check(False, f"the service ended with {target.process.returncode}")
        return
    peak_mb = target.rss_mb("VmHWM")
    max_descriptors, max_mb = descriptors + MORE_DESCRIPTORS, rss_mb + one.grown_mb
    deadline = time.monotonic() + RECOVERY_S
    while time.monotonic() < deadline and (target.descriptors() > max_descriptors or target.rss_mb() > max_mb):
        time.sleep(0.1)
    outcome.descriptors = descriptors, target.descriptors()
    outcome.rss_mb = rss_mb, peak_mb, target.rss_mb()
    logged = target.log.stat().st_size - log
    findings.check(not waits.failures, f"another client: {waits.failures} of {waits.requests}: {waits.error[:80]}")
    findings.check(waits.own_s <= MAX_OWN_S, f"another client waited for {waits.own_s:.1f} s")
    findings.check(outcome.descriptors[-1] <= max_descriptors, f"descriptors: {outcome.descriptors}")
    findings.check(peak_mb <= rss_mb + PEAK_MB and outcome.rss_mb[-1] <= max_mb, f"memory: {outcome.rss_mb} MB")
    findings.check(logged <= MAX_LOG_BYTES, f"log: {logged >> 10} KiB were written")


def report(outcome: Outcome) -> str:
    """An attack in a line, and under it how its attempts ended and what did not hold."""
    findings, waits = outcome.findings, outcome.waits
    verdict = "FAILED" if findings.failures else "held"
    rss_mb = "/".join(f"{each:.0f}" for each in outcome.rss_mb)
    descriptors = "/".join(map(str, outcome.descriptors))
    lines = [
        f"{outcome.name}: {verdict}: {findings.outcomes.total()} attempts in {outcome.seconds:.0f} s; another"
        f" client waits {waits.worst_s:.2f} s, {waits.own_s:.2f} s for the service; descriptors before/after"
        f" {descriptors}; memory before/at most/after {rss_mb} MB"
    ]
    lines += [f"    {number:>7} {what}" for what, number in findings.outcomes.most_common()]
    return "\n".join(lines + [f"    {note}" for note in (*findings.notes, *findings.failures)])
