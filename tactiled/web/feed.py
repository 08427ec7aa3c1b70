"""From a sensor's worker thread to the event loop: the newest image, packed once for all who stream it."""

import asyncio
import time
from collections.abc import Iterator
from contextlib import contextmanager

from tactiled.frames import Image
from tactiled.service import Sensor
from tactiled.web.wire import Kind, pack


class Feed:
    """Wakes the clients of one sensor when there is something new; lives on one event loop."""

    def __init__(self, sensor: Sensor) -> None:
        self.sensor = sensor
        self.image: Image | None = None
        self._packed: dict[Kind, bytes] = {}
        self._clients: set[asyncio.Event] = set()

    @contextmanager
    def listen(self) -> Iterator[asyncio.Event]:
        """An event that is set whenever a newer image or another state is there."""
        wake = asyncio.Event()
        wake.set()
        if not self._clients:
            self._take(self.sensor.hub.latest())
            loop = asyncio.get_running_loop()
            self._stop = self.sensor.hub.subscribe(lambda image: _later(loop, self, image))
        self._clients.add(wake)
        try:
            yield wake
        finally:
            self._clients.discard(wake)
            if not self._clients:
                self._stop()

    def wake(self) -> None:
        """Let every client look again."""
        for client in self._clients:
            client.set()

    def message(self, kind: Kind) -> bytes:
        """Bytes of the newest image, the same for every client; call it only when there is one."""
        if kind not in self._packed:
            if self.image is None:
                raise LookupError(f"no image of {self.sensor.name} yet")
            self._packed[kind] = pack(self.image, kind, time.time())
        return self._packed[kind]

    def _take(self, image: Image | None) -> None:
        self.image = image
        self._packed.clear()
        self.wake()


def _later(loop: asyncio.AbstractEventLoop, feed: Feed, image: Image) -> None:
    """Hand an image over from the worker thread; a loop that has ended has no clients left to tell."""
    try:
        loop.call_soon_threadsafe(feed._take, image)
    except RuntimeError:
        if not loop.is_closed():
            raise
