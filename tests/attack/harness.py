"""An attack, what must hold while it runs, and the table of what became of it."""

import asyncio
import time
from collections import Counter
from collections.abc import Awaitable, Callable, Iterable
from dataclasses import dataclass, field

from tests.attack.bystander import MOST_OWN_S, Beside, Seen
from tests.attack.service import PLAIN, Kind, Pool, Target, Watch
from tests.attack.wire import Ending

PEAK_MB = 256.0  # of memory, while an attack runs
MORE_DESCRIPTORS = 4  # that may be open after it: of what the service itself opens late
MOST_S = 120.0  # that an attack may take, besides the fuzzer's own time
BACK_S = 30.0  # until memory and descriptors are back
MOST_LOG = 16 << 10  # bytes that an attack may have the service write

# What the service promises of every connection (s): when it ends at the latest in that state.
DEADLINES = {
    "head": 10.0,  # a request's line and headers that do not come whole, a TLS handshake likewise
    "body": 60.0,  # its body
    "refused": 2.0,  # after a last answer that the client goes on sending behind
    "idle": 5.0,  # kept alive after a whole request
    "websocket": 45.0,  # a stream whose client answers no ping: 20 to the ping, 20 to its answer, 5 to read
    "unread": 20.0,  # an answer of which the client takes nothing
}


def late_s(state: str) -> float:
    """When a connection is late that a deadline ends, on a busy machine."""
    return 1.25 * DEADLINES[state] + 5.0


@dataclass(frozen=True)
class Size:
    """How large an attack is: 1 in continuous integration, more by hand."""

    factor: int = 1
    connections: int = 2000  # of the fuzzer
    seconds: float = 20.0  # that the fuzzer may take for new connections
    seed: int = 1

    def many(self, count: int) -> int:
        """A count, at this size."""
        return count * self.factor


@dataclass
class Findings:
    """What an attack came to."""

    outcomes: Counter[str] = field(default_factory=Counter)
    failures: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def add(self, what: str, endings: Iterable[Ending], *, may_live: bool = False) -> None:
        """Count how connections ended; one that is still open fails, unless it was not waited for."""
        for ending in endings:
            self.outcomes[f"{what}: {ending.told}"] += 1
            if ending.how == "open" and not may_live:
                self.fail(f"{what}: still open after {ending.seconds:.0f} s")
            if ending.status == 500:
                self.fail(f"{what}: 500")

    def fail(self, why: str) -> None:
        """Say once what does not hold."""
        if why not in self.failures:
            self.failures.append(why)

    def check(self, true: bool, why: str) -> None:
        """Fail unless it is true."""
        if not true:
            self.fail(why)


Run = Callable[[Target, Size, Findings], Awaitable[None]]


@dataclass(frozen=True)
class Attack:
    """One attack, and the kind of service that it needs."""

    run: Run
    kind: Kind = PLAIN
    grown_mb: float = 64.0  # of memory after it, which the allocator keeps for the next
    alone: bool = False  # on a service of its own, which it ends: nobody stands by

    @property
    def name(self) -> str:
        """As on the command line."""
        return self.run.__name__.replace("_", "-")


@dataclass
class Outcome:
    """One row of the table."""

    name: str
    findings: Findings
    seconds: float = 0.0
    seen: Seen = field(default_factory=Seen)
    descriptors: tuple[int, int, int] = (0, 0, 0)  # before, at most, after
    rss_mb: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def failures(self) -> list[str]:
        """All that does not hold."""
        return self.findings.failures


def held(attack: Attack, pool: Pool, size: Size) -> Outcome:
    """Run an attack on a service and judge it."""
    began, outcome = time.monotonic(), Outcome(attack.name, Findings())
    target = Target(attack.kind) if attack.alone else pool.take(attack.kind)
    try:
        target.ready()
        if attack.alone:
            asyncio.run(_run(attack, target, size, outcome.findings))
        else:
            _watched(attack, target, size, outcome)
    finally:
        outcome.seconds = time.monotonic() - began
        if attack.alone:
            target.close()
        elif outcome.failures or target.process.poll() is not None:
            pool.drop(attack.kind)
    return outcome


async def _run(attack: Attack, target: Target, size: Size, findings: Findings) -> None:
    """Run an attack, but not for ever."""
    most_s = size.factor * MOST_S + size.seconds
    try:
        async with asyncio.timeout(most_s):
            await attack.run(target, size, findings)
    except TimeoutError:
        findings.fail(f"took more than {most_s:.0f} s")


def _watched(attack: Attack, target: Target, size: Size, outcome: Outcome) -> None:
    """Run an attack while a bystander asks, and measure the service."""
    descriptors, rss, log = target.descriptors(), target.rss_mb(), target.log.stat().st_size
    watch, beside = Watch(target), Beside(target)
    try:
        asyncio.run(_run(attack, target, size, outcome.findings))
        outcome.seen = beside.end()
    finally:
        beside.kill()
        watch.stop()
    if target.process.poll() is not None:
        outcome.findings.fail(f"the service ended with {target.process.returncode}")
        return
    _come_back(target, descriptors + MORE_DESCRIPTORS, rss + attack.grown_mb)
    outcome.descriptors = descriptors, watch.descriptors, target.descriptors()
    outcome.rss_mb = rss, watch.rss_mb, target.rss_mb()
    _judge(attack, outcome, target.log.stat().st_size - log)


def _come_back(target: Target, descriptors: int, rss_mb: float) -> None:
    end = time.monotonic() + BACK_S
    while time.monotonic() < end and (target.descriptors() > descriptors or target.rss_mb() > rss_mb):
        time.sleep(0.1)


def _judge(attack: Attack, outcome: Outcome, logged: int) -> None:
    """What must hold of every attack."""
    findings, seen = outcome.findings, outcome.seen
    findings.check(not seen.failed, f"another client: {seen.failed} of {seen.asked} failed: {seen.why[:80]}")
    findings.check(seen.own_s <= MOST_OWN_S, f"another client waited for {seen.own_s:.1f} s")
    before, _, after = outcome.descriptors
    findings.check(after <= before + MORE_DESCRIPTORS, f"descriptors: {before} before, {after} after")
    start, peak, end = outcome.rss_mb
    findings.check(peak <= start + PEAK_MB, f"memory: {start:.0f} MB before, {peak:.0f} MB at most")
    findings.check(end <= start + attack.grown_mb, f"memory: {start:.0f} MB before, {end:.0f} MB after")
    findings.check(logged <= MOST_LOG, f"log: {logged >> 10} KiB were written")


def table(outcomes: Iterable[Outcome]) -> str:
    """A line for each attack, and under it how its attempts ended and what did not hold."""
    columns = f"{'descriptors':>16}{'RSS (MB)':>18}  verdict"
    lines = [f"{'attack':<18}{'attempts':>9}{'time':>7}{'other client waits':>24}{columns}"]
    for each in outcomes:
        waits = f"{each.seen.worst_s:.2f} s, own {each.seen.own_s:.2f} s" if each.seen.asked else "-"
        opened = "/".join(map(str, each.descriptors))
        memory = "/".join(f"{one:.0f}" for one in each.rss_mb)
        count, verdict = each.findings.outcomes.total(), "FAILED" if each.failures else "held"
        lines.append(
            f"{each.name:<18}{count:>9}{each.seconds:>6.0f}s{waits:>24}{opened:>16}{memory:>18}  {verdict}"
        )
        lines += [f"    {number:>7} {what}" for what, number in each.findings.outcomes.most_common()]
        lines += [f"    {note}" for note in each.findings.notes]
        lines += [f"    FAILED: {why}" for why in each.failures]
    return "\n".join((*lines, "descriptors and RSS: before/at most/after"))
