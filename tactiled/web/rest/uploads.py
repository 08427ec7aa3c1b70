"""What an upload may take: its room on the disk is reserved, and work for it ends with its client."""

import asyncio
from collections.abc import Callable, Iterator
from concurrent.futures import Executor
from contextlib import contextmanager
from pathlib import Path
from shutil import disk_usage
from typing import TypeVar

from starlette.requests import ClientDisconnect, Request

from tactiled.web.http.problems import Problem

Outcome = TypeVar("Outcome")


class DiskReserve:
    """Room of a folder's disk for the uploads that are under way, beside what is to be left; on one event loop."""

    def __init__(self, folder: Path, leave_mb: float) -> None:
        self._folder, self._leave_mb = folder, leave_mb
        self._expected: dict[object, int] = {}  # bytes that are still to come, by upload

    @contextmanager
    def reserved(self, what: str, size: int) -> Iterator[Callable[[int], None]]:
        """Reserve bytes meanwhile; gives what counts those that came. Problem 503 where there is no room."""
        self._need(what, sum(self._expected.values()) + size)
        upload = object()
        self._expected[upload] = size

        def count(size: int) -> None:
            self._expected[upload] -= size
            self._need(what, 0)

        try:
            yield count
        finally:
            del self._expected[upload]

    def _need(self, what: str, size: int) -> None:
        if disk_usage(self._folder).free < self._leave_mb * 1e6 + size:
            leave = f"{self._leave_mb:g} MB of its disk (recordings_leave_mb)"
            raise Problem(503, f"{what}: would leave less than {leave} free")


async def while_connected(
    request: Request, executor: Executor | None, work: Callable[[], Outcome], cancel: Callable[[], None]
) -> Outcome:
    """What `work` gives on a thread. Where the client leaves or the service ends, `cancel` is to end it at once.

    The body must have been read. ClientDisconnect where the client leaves.
    """
    running = asyncio.get_running_loop().run_in_executor(executor, work)
    leaving = asyncio.ensure_future(_disconnected(request))
    try:
        await asyncio.wait((running, leaving), return_when=asyncio.FIRST_COMPLETED)
        if not running.done():
            raise ClientDisconnect
    finally:
        leaving.cancel()
        if not running.done():
            cancel()
            await asyncio.wait((running,))
            running.exception()  # marks it as seen
    return await running


async def _disconnected(request: Request) -> None:
    while (await request.receive())["type"] != "http.disconnect":
        pass
