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
from collections.abc import AsyncIterator, Awaitable, Callable
from dataclasses import asdict, dataclass
from pathlib import Path

from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import WebSocketException

from tests.attack.service import CONTROL, Target, trusting
from tests.attack.wire import CONNECTION_ERRORS, HOST, STREAM, exchange, request

ADDRESS = "127.0.0.2"
PERIOD_S = 0.1
ANSWER_S = 90.0  # that it waits for one answer
MAX_OWN_S = 1.0  # that an answer may take, without the time that the machine is busy with other things


@dataclass
class Waits:
    """How long a bystander waited."""

    requests: int = 0
    failures: int = 0
    worst_s: float = 0.0  # by the clock
    own_s: float = 0.0  # without the time that the machine was busy with other things
    error: str = ""  # the last


def queued_s(pid: int) -> dict[str, float]:
    """How long each thread of a process has stood in line for a processor so far."""
    seconds = {}
    for thread in Path(f"/proc/{pid}/task").iterdir():
        with contextlib.suppress(OSError):
            seconds[thread.name] = int((thread / "schedstat").read_text().split()[1]) / 1e9
    return seconds


class Bystander:
    """Asks both ways until it is stopped."""

    def __init__(self, port: int, pid: int, tls: bool) -> None:
        self._port, self._pid, self._tls = port, pid, trusting() if tls else None
        self._stop, self.waits = asyncio.Event(), Waits()

    async def run(self) -> None:
        asyncio.get_running_loop().add_reader(sys.stdin, self._stop.set)  # at its end
        await asyncio.gather(self._repeat(self._health), self._repeat(self._stream))

    async def _repeat(self, ask: Callable[[], Awaitable[None]]) -> None:
        while not self._stop.is_set():
            with contextlib.suppress(ConnectionError):
                await ask()
            await asyncio.sleep(PERIOD_S)

    @contextlib.asynccontextmanager
    async def _timed(self) -> AsyncIterator[None]:
        """One request and its answer."""
        before, began, waits = self._queued(), time.monotonic(), self.waits
        waits.requests += 1
        try:
            async with asyncio.timeout(ANSWER_S):
                yield
        except (AssertionError, WebSocketException, *CONNECTION_ERRORS) as error:
            waits.failures += 1
            waits.error = f"{type(error).__name__} {error}"
            raise ConnectionError from error
        finally:
            seconds = time.monotonic() - began
            # two threads of the service may have waited for each other, and this one for them
            in_line = sorted(
                (now - before.get(thread, now) for thread, now in self._queued().items()), reverse=True
            )
            waits.worst_s, waits.own_s = max(waits.worst_s, seconds), max(waits.own_s, seconds - sum(in_line[:3]))

    def _queued(self) -> dict[str, float]:
        with contextlib.suppress(OSError):
            return queued_s(self._pid) | queued_s(os.getpid())
        return {}

    async def _health(self) -> None:
        data = request("GET /api/v1/health", "Connection: close", token=CONTROL)
        async with self._timed():
            ending = await exchange(self._port, [data], ANSWER_S, source=ADDRESS, tls=self._tls)
            assert ending.status == 200, f"{ending}: {ending.received[:200]}"

    async def _stream(self) -> None:
        """Ping on a stream."""
        options = {"local_addr": (ADDRESS, 0), "ping_interval": None, "open_timeout": None, "close_timeout": 0}
        headers = {"Authorization": f"Bearer {CONTROL}"}
        address = f"ws{'s' if self._tls else ''}://{HOST}:{self._port}{STREAM}"
        async with contextlib.AsyncExitStack() as stack:
            async with self._timed():
                connecting = connect(address, additional_headers=headers, ssl=self._tls, **options)
                stream = await stack.enter_async_context(connecting)
            reading = asyncio.create_task(_read(stream))
            stack.callback(reading.cancel)
            while not self._stop.is_set():
                async with self._timed():
                    await (await stream.ping())
                await asyncio.sleep(PERIOD_S)


async def _read(stream: ClientConnection) -> None:
    async for _ in stream:
        pass


@contextlib.contextmanager
def beside(target: Target):
    """A bystander's process meanwhile; gives what ends it and how long it waited."""
    options = [str(target.port), str(target.process.pid), *(["tls"] if target.tls else [])]
    command = [sys.executable, "-m", "tests.attack.bystander", *options]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    process.stdout.readline()  # it has begun
    try:
        yield lambda: Waits(**json.loads(process.communicate(timeout=ANSWER_S + 30)[0]))
    finally:
        process.kill()
        process.wait()


async def _main(port: str, pid: str, *tls: str) -> None:
    bystander = Bystander(int(port), int(pid), bool(tls))
    print("begun", flush=True)
    await bystander.run()
    print(json.dumps(asdict(bystander.waits)))


if __name__ == "__main__":
    asyncio.run(_main(*sys.argv[1:]))
