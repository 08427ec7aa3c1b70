"""From a sensor's worker thread to the event loop: what is new, made into messages once for all who stream it."""

import asyncio
import time
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager, contextmanager
from typing import Literal, NamedTuple

from tactiled.frames import Image
from tactiled.runtime.sensor import Sensor
from tactiled.web import answers, schemas
from tactiled.web.http.protocols import frame
from tactiled.web.rest import shear
from tactiled.wire import Kind, pack

TICK_S = 0.5  # how often streams look whether a sensor's state has changed though no frame came


class Format(NamedTuple):
    """How a client wants images."""

    kinds: tuple[Kind, ...]
    form: Literal["binary", "json"]
    named: bool  # binary messages bear the sensor's name
    together: bool  # all kinds in one binary message


class Found(NamedTuple):
    """A search for contacts that has ended."""

    sequence: int  # of the image that was searched
    frame: bytes


class Feed:
    """Wakes the clients of one sensor when there is something new; lives on one event loop."""

    def __init__(self, sensor: Sensor) -> None:
        self.sensor = sensor
        self.image: Image | None = None
        self._binary: dict[tuple[Kind, bool], bytes] = {}
        self._text: dict[Kind, str] = {}
        self._frames: dict[Format, list[bytes]] = {}
        self._state: tuple[object, ...] | None = None
        self._status: schemas.StreamStatus | None = None
        self._status_frame: bytes | None = None
        self._contacts: asyncio.Task[Found | None] | None = None
        self._clients: set[Callable[[], None]] = set()

    @contextmanager
    def listen(self, wake: Callable[[], None]) -> Iterator[None]:
        """Call `wake` now, and whenever a newer image or another state may be there."""
        if not self._clients:
            self._take(self.sensor.hub.latest())
            loop = asyncio.get_running_loop()
            self._stop = self.sensor.hub.subscribe(lambda image: _later(loop, self, image))
        self._clients.add(wake)
        wake()
        try:
            yield
        finally:
            self._clients.discard(wake)
            if not self._clients:
                self._stop()

    def tick(self) -> None:
        """Let every client look again."""
        self._state = self._status = self._status_frame = None
        for wake in self._clients:
            wake()

    def frames(self, wanted: Format) -> list[bytes]:
        """The newest image as WebSocket frames, made once for all who want it so; LookupError before the first."""
        frames = self._frames.get(wanted)
        if frames is None:
            if wanted.form == "json":
                frames = [frame(self.text(kind)) for kind in wanted.kinds]
            else:
                messages = [self.binary(kind, wanted.named) for kind in wanted.kinds]
                frames = [frame(each) for each in ([b"".join(messages)] if wanted.together else messages)]
            self._frames[wanted] = frames
        return frames

    def binary(self, kind: Kind, named: bool) -> bytes:
        """The newest image's bytes, its sensor's name in them if `named`; LookupError before the first."""
        key = kind, named
        if key not in self._binary:
            self._binary[key] = pack(self._newest(), kind, time.time(), self.sensor.name if named else "")
        return self._binary[key]

    def text(self, kind: Kind) -> str:
        """The newest image as JSON; LookupError before the first."""
        if kind not in self._text:
            image = self._newest()
            if kind == "shear":
                told: schemas.Form = shear.told(self.sensor, image, self.sensor.status().state)
            else:
                told = answers.frame(self.sensor, image, kind)
            self._text[kind] = told.model_dump_json()
        return self._text[kind]

    def status(self) -> schemas.StreamStatus:
        """The sensor's state, as it was when the clients were last woken."""
        if self._status is None:
            self._status = answers.stream_status(self.sensor, self.image, self.sensor.status())
        return self._status

    def state(self) -> tuple[object, ...]:
        """What of the sensor's state is told as soon as it changes, as it was when the clients were last woken."""
        if self._state is None:
            made = (self.image.method, self.image.warnings) if self.image else ()
            self._state = (self.sensor.state, self.sensor.method, *made)
        return self._state

    def status_frame(self) -> bytes:
        """`status` as a WebSocket frame."""
        if self._status_frame is None:
            self._status_frame = frame(self.status().model_dump_json())
        return self._status_frame

    def contacts(self) -> asyncio.Task[Found | None]:
        """The contacts in the newest image, looked for once, on another thread; None before the first.

        It belongs to all who ask: wait for it in a shield, or look whether it is done.
        """
        if self._contacts is None:
            self._contacts = asyncio.create_task(asyncio.to_thread(self._find))
        return self._contacts

    def _find(self) -> Found | None:
        found = answers.contacts(self.sensor)
        return None if found is None else Found(found.sequence, frame(found.model_dump_json()))

    def _newest(self) -> Image:
        if self.image is None:
            raise LookupError(f"no image of {self.sensor.name} yet")
        return self.image

    def _take(self, image: Image | None) -> None:
        self.image = image
        self._binary.clear()
        self._text.clear()
        self._frames.clear()
        self._contacts = None
        self.tick()


@asynccontextmanager
async def ticking(feeds: dict[str, Feed]) -> AsyncIterator[None]:
    """Have every client of these feeds look again twice a second meanwhile."""

    async def tick() -> None:
        while True:
            await asyncio.sleep(TICK_S)
            for feed in feeds.values():
                feed.tick()

    task = asyncio.create_task(tick())
    try:
        yield
    finally:
        task.cancel()


def _later(loop: asyncio.AbstractEventLoop, feed: Feed, image: Image) -> None:
    """Hand an image over from the worker thread; a loop that has ended has no clients left to tell."""
    try:
        loop.call_soon_threadsafe(feed._take, image)
    except RuntimeError:
        if not loop.is_closed():
            raise
