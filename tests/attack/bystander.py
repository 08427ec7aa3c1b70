"""Another client, in a process of its own: how long it waits for answers while the service is attacked.

It asks for the health, each time on a new connection, and pings on a WebSocket; both with the control token and
from another address than the attackers. A busy machine is no fault of the service: from every wait the time is
subtracted that the service and this process stood in line for a processor, as the kernel counts it.
"""

import asyncio
import contextlib
import json
import os
import subprocess
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from tests.attack.service import CONTROL, Target, trusting
from tests.attack.wire import CLOSE, LOST, PING, PONG, Connection, frame, frames, request, upgrade

ADDRESS = "127.0.0.2"
PERIOD_S = 0.1
MOST_S = 90.0  # that it waits for one answer
MOST_OWN_S = 1.0  # of the service, in which it must answer


@dataclass
class Seen:
    """How a bystander was served."""

    asked: int = 0
    failed: int = 0
    worst_s: float = 0.0  # as the clock has it
    own_s: float = 0.0  # without the time that the machine was busy with other things
    why: str = ""  # of the last failure


def queued_s(pid: int) -> dict[str, float]:
    """How long each thread of a process has stood in line for a processor so far."""
    found = {}
    for thread in Path(f"/proc/{pid}/task").iterdir():
        with contextlib.suppress(OSError):
            found[thread.name] = int((thread / "schedstat").read_text().split()[1]) / 1e9
    return found


class Bystander:
    """Asks until it is told to stop."""

    def __init__(self, port: int, pid: int, tls: bool) -> None:
        self._port, self._pid, self._tls = port, pid, trusting() if tls else None
        self.seen = Seen()

    async def go(self, stop: asyncio.Event) -> None:
        """Ask both ways."""
        ways = [asyncio.create_task(self._ask(stop)), asyncio.create_task(self._ping(stop))]
        await asyncio.gather(*ways)

    async def _timed(self, asking: Any) -> None:
        """One question and its answer."""
        before, began = self._queued(), time.monotonic()
        self.seen.asked += 1
        try:
            async with asyncio.timeout(MOST_S):
                await asking
        except (TimeoutError, AssertionError, *LOST) as error:
            self.seen.failed += 1
            self.seen.why = f"{type(error).__name__} {error}"
            raise ConnectionError from error
        finally:
            took = time.monotonic() - began
            own = took - self._waited(before)
            self.seen.worst_s, self.seen.own_s = max(self.seen.worst_s, took), max(self.seen.own_s, own)

    def _queued(self) -> dict[str, float]:
        with contextlib.suppress(OSError):
            return queued_s(self._pid) | queued_s(os.getpid())
        return {}

    def _waited(self, before: dict[str, float]) -> float:
        """Time in line since then: two threads of the service may have waited for each other, and this one."""
        longest = sorted((now - before.get(thread, now) for thread, now in self._queued().items()), reverse=True)
        return sum(longest[:3])

    async def _ask(self, stop: asyncio.Event) -> None:
        while not stop.is_set():
            with contextlib.suppress(ConnectionError):
                await self._timed(self._health())
            await asyncio.sleep(PERIOD_S)

    async def _health(self) -> None:
        one = await Connection.to(self._port, source=ADDRESS, tls=self._tls, seconds=MOST_S)
        try:
            await one.send([request("GET /api/v1/health", "Connection: close", token=CONTROL)])
            ending = await one.ending(MOST_S)
            assert ending.status == 200, ending.heard[:200]
        finally:
            one.cut()

    async def _ping(self, stop: asyncio.Event) -> None:
        while not stop.is_set():
            with contextlib.suppress(ConnectionError):
                await self._stream(stop)
            await asyncio.sleep(PERIOD_S)

    async def _stream(self, stop: asyncio.Event) -> None:
        """Keep a stream, and answer its pings."""
        one: Connection | None = None

        async def begin() -> None:
            nonlocal one
            one = await Connection.to(self._port, source=ADDRESS, tls=self._tls, seconds=MOST_S)
            await one.send([upgrade(token=CONTROL)])
            assert await one.until(b"\r\n\r\n", MOST_S), "no handshake"
            assert b" 101 " in one.heard, one.heard[:200]
            one.heard = one.heard.partition(b"\r\n\r\n")[2]

        try:
            await self._timed(begin())
            while not stop.is_set():
                await self._timed(_pong(one))
                await asyncio.sleep(PERIOD_S)
        finally:
            if one is not None:
                one.cut()


async def _pong(one: Connection) -> None:
    """Ping, and read until the answer."""
    await one.send([frame(PING, b"here")])
    while True:
        found, one.heard = frames(one.heard)
        for opcode, data in found:
            assert opcode != CLOSE, f"closed: {data!r}"
            if opcode == PING:
                await one.send([frame(PONG, data)])
        if (PONG, b"here") in found:
            return
        piece = await one.reader.read(1 << 16)
        assert piece, "the stream ended"
        one.heard += piece


class Beside:
    """A bystander's process."""

    def __init__(self, target: Target) -> None:
        at = [str(target.port), str(target.process.pid), *(["tls"] if target.kind.tls else [])]
        command = [sys.executable, "-m", "tests.attack.bystander", *at]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self._process.stdout.readline()  # it has begun

    def end(self) -> Seen:
        """Let it finish; gives what it saw."""
        try:
            told, _ = self._process.communicate(timeout=MOST_S + 30)
            return Seen(**json.loads(told))
        finally:
            self.kill()

    def kill(self) -> None:
        """End it, whatever it does."""
        self._process.kill()
        self._process.wait()


async def _main(port: str, pid: str, *tls: str) -> None:
    bystander, stop = Bystander(int(port), int(pid), bool(tls)), asyncio.Event()
    asyncio.get_running_loop().add_reader(sys.stdin, stop.set)  # its end
    print("begun", flush=True)
    await bystander.go(stop)
    print(json.dumps(asdict(bystander.seen)))


if __name__ == "__main__":
    asyncio.run(_main(*sys.argv[1:]))
