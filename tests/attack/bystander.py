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

from websockets.asyncio.client import connect

from tests.attack.service import CONTROL, trusting
from tests.attack.wire import HOST, STREAM, exchange, request

ADDRESS = "127.0.0.2"
PERIOD_S = 0.1
ANSWER_S = 90.0  # that it waits for one answer
MAX_OWN_S = 1.0  # that an answer may take, without the time that the machine is busy with other things


@dataclass
class Waits:
    """How long a bystander waited."""

    requests: int = 0
    worst_s: float = 0.0  # by the clock
    own_s: float = 0.0  # without the time that the machine was busy with other things
    error: str = ""  # at which it ended


def queued_s(pid):
    """How long each thread of a process and of this one has stood in line for a processor so far."""
    seconds = {}
    for process in (pid, os.getpid()):
        for file in Path(f"/proc/{process}/task").glob("*/schedstat"):
            with contextlib.suppress(OSError):
                seconds[file.parent.name] = int(file.read_text().split()[1]) / 1e9
    return seconds


def in_line_s(before, now):
    """How long three threads, which may have waited for each other, stood in line between two `queued_s`."""
    return sum(sorted(seconds - before.get(thread, seconds) for thread, seconds in now.items())[-3:])


def stolen_s():
    """How long the processors were another machine's so far."""
    return int(Path("/proc/stat").read_text().split(maxsplit=9)[8]) / os.sysconf("SC_CLK_TCK")


class Bystander:
    """Asks both ways until its standard input ends."""

    def __init__(self, port, pid, *tls):
        self._port, self._pid, self._tls = int(port), int(pid), trusting() if tls else None
        self._stop, self._waits = asyncio.Event(), Waits()

    async def run(self):
        asyncio.get_running_loop().add_reader(sys.stdin, self._stop.set)
        print("begun", flush=True)
        try:
            async with asyncio.TaskGroup() as group:
                group.create_task(self._health())
                group.create_task(self._ping())
        except* Exception as errors:
            self._waits.error = repr(errors.exceptions[0])[:300]
        return self._waits

    @contextlib.asynccontextmanager
    async def _timed(self):
        """One request and its answer."""
        before, stolen, began, waits = queued_s(self._pid), stolen_s(), time.monotonic(), self._waits
        waits.requests += 1
        async with asyncio.timeout(ANSWER_S):
            yield
        seconds = time.monotonic() - began
        waits.worst_s = max(waits.worst_s, seconds)
        waits.own_s = max(waits.own_s, seconds - in_line_s(before, queued_s(self._pid)) - (stolen_s() - stolen))

    async def _health(self):
        data = request("GET /api/v1/health", "Connection: close", token=CONTROL)
        while not self._stop.is_set():
            async with self._timed():
                ending = await exchange(self._port, [data], ANSWER_S, source=ADDRESS, tls=self._tls)
                assert ending.status == 200, f"{ending}: {ending.received[:200]}"
            await asyncio.sleep(PERIOD_S)

    async def _ping(self):
        options = {"local_addr": (ADDRESS, 0), "ping_interval": None, "open_timeout": None, "close_timeout": 0}
        headers = {"Authorization": f"Bearer {CONTROL}"}
        address = f"ws{'s' if self._tls else ''}://{HOST}:{self._port}{STREAM}"
        async with self._timed():
            stream = await connect(address, additional_headers=headers, ssl=self._tls, max_queue=None, **options)
        async with stream:
            while not self._stop.is_set():
                async with self._timed():
                    await (await stream.ping())
                await asyncio.sleep(PERIOD_S)


@contextlib.contextmanager
def beside(target):
    """A bystander's process meanwhile; gives what ends it and how long it waited."""
    options = [str(target.port), str(target.process.pid), *(["tls"] if target.tls else [])]
    command = [sys.executable, "-m", "tests.attack.bystander", *options]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        process.stdout.readline()  # it has begun
        try:
            yield lambda: Waits(**json.loads(process.communicate(timeout=ANSWER_S + 30)[0]))
        finally:
            process.kill()


if __name__ == "__main__":
    print(json.dumps(asdict(asyncio.run(Bystander(*sys.argv[1:]).run()))))
