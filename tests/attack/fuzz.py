"""The fuzzer of connections: thousands by chance, hundreds at once, each of which must end within its deadline.

What a bystander waits for, and that descriptors and memory come back, is seen by whoever runs it.
"""

import asyncio
import random
import time
from collections import Counter

from tests.attack.grammar import Script, script
from tests.attack.harness import DEADLINES, Findings, Size, late_s
from tests.attack.service import Target
from tests.attack.wire import LOST, Connection, Ending

AT_ONCE, ADDRESSES = 200, 16
PATIENT = 0.03  # of the connections wait until the service ends them, the others leave
MOST_PATIENT = 2000  # of them
PATIENT_AT_ONCE = 100
SHORT = 10_000  # connections: below, nobody waits for a deadline of a minute
LEAVE_S = 2.0  # that an impatient one waits for its first answer
AFTER_S, EARLY_S = 0.3, 0.1  # it leaves so long after at most; one that leaves earlier does not wait for it


class Fuzzer:
    """Plays scripts."""

    def __init__(self, target: Target, size: Size, findings: Findings) -> None:
        self._target, self._findings, self._rng = target, findings, random.Random(size.seed)
        self._size, self._seconds = size, 0.0
        self._few, self._waiting = asyncio.Semaphore(AT_ONCE), asyncio.Semaphore(PATIENT_AT_ONCE)
        self._longest: Counter[str] = Counter()

    async def go(self) -> None:
        """Play all, or as many as the time allows; then let the patient ones end."""
        began, playing = time.monotonic(), set()
        share = min(PATIENT, MOST_PATIENT / self._size.connections)
        for number in range(self._size.connections):
            if time.monotonic() - began > self._size.seconds:
                break
            one, patient = script(self._rng), self._rng.random() < share
            leave_s = self._rng.random() * AFTER_S
            await self._few.acquire()
            task = asyncio.create_task(self._play(number, one, patient, leave_s))
            playing.add(task)
            task.add_done_callback(playing.discard)
        self._seconds = time.monotonic() - began
        await asyncio.gather(*playing)
        self._told()

    async def _play(self, number: int, one: Script, patient: bool, leave_s: float) -> None:
        """Play one script; a patient one gives its place to another while it waits."""
        source, held = f"127.0.1.{1 + number % ADDRESSES}", True
        try:
            connection = await Connection.to(self._target.port, source=source)
        except LOST:
            self._findings.outcomes["not accepted"] += 1
            self._few.release()
            return
        try:
            await connection.send(one.pieces, one.pause_s)
            if patient and self._waits_for(one):
                self._few.release()
                held = False
                async with self._waiting:
                    ending = await connection.ending(late_s("body") + 1)
                self._judge(one, ending)
            else:
                if leave_s > EARLY_S:
                    await connection.until(b"\r\n\r\n", LEAVE_S)
                ending = await connection.ending(leave_s)
            self._count(one, ending)
        finally:
            connection.cut()
            if held:
                self._few.release()

    def _waits_for(self, one: Script) -> bool:
        return DEADLINES[one.state] <= DEADLINES["head"] or self._size.connections >= SHORT

    def _judge(self, one: Script, ending: Ending) -> None:
        """A connection that was waited for ended in time; a stream that was accepted has longer than a head."""
        state = "websocket" if b" 101 " in ending.heard else one.state
        self._longest[state] = max(self._longest[state], ending.seconds)
        late = ending.how == "open" or ending.seconds > late_s(state)
        if late:
            sent = b"".join(one.pieces)
            shown = sent if len(sent) < 200 else sent[:100] + b" ... " + sent[-100:]
            self._findings.fail(f"{state}: {ending.how} after {ending.seconds:.0f} s: {shown!r}")

    def _count(self, one: Script, ending: Ending) -> None:
        self._findings.outcomes[ending.told] += 1
        if ending.status == 500:
            self._findings.fail(f"500 to {b''.join(one.pieces)[:200]!r}")

    def _told(self) -> None:
        played = self._findings.outcomes.total()
        rate = played / max(self._seconds, 1e-9)
        self._findings.notes.append(f"{played} connections in {self._seconds:.0f} s: {rate:.0f} a second")
        for state, seconds in self._longest.items():
            self._findings.notes.append(f"longest {state}: {seconds:.1f} s of {DEADLINES[state]:g} s")
        wanted = min(self._size.connections, 1000)
        self._findings.check(played >= wanted, f"{played} connections in {self._seconds:.0f} s: too few to tell")


async def fuzz(target: Target, size: Size, findings: Findings) -> None:
    """Valid and invalid pieces of HTTP/1.1 and WebSocket in any order, cut anywhere, slow or at once."""
    await Fuzzer(target, size, findings).go()
