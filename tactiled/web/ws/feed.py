"""From a sensor's worker thread to the event loop: each message is made once for all clients of a sensor."""

import asyncio
import time
from collections.abc import AsyncIterator, Callable, Iterator, Mapping
from contextlib import asynccontextmanager, contextmanager
from threading import Lock
from typing import NamedTuple

from tactiled.frames import SensorImage
from tactiled.threads import FRAME_LOCK
from tactiled.web import answers, schemas
from tactiled.web.http.protocols import frame
from tactiled.web.views import SensorView, ServiceView
from tactiled.wire import Kind, pack

TICK_S = 0.5  # how often streams check a sensor's state when no frame comes


class Format(NamedTuple):
    """How a client wants images."""

    kinds: tuple[Kind, ...]
    json: bool
    named: bool  # binary messages bear the sensor's name
    together: bool  # all kinds in one binary message
    cells: schemas.ImageCells  # of the restored image


class ContactsFrame(NamedTuple):
    """The contacts of an image as a WebSocket frame."""

    sequence: int  # of the image
    frame: bytes


class Feed:
    """Wakes the clients of one sensor when there is something new; lives on one event loop."""

    def __init__(self, sensor: SensorView, images: "_NewImages") -> None:
        self.sensor = sensor
        self._images = images
        self.image: SensorImage | None = None
        self._frames: dict[Format, list[bytes]] = {}
        self._status: schemas.StreamStatus | None = None
        self._status_key: tuple[object, ...] | None = None
        self._status_frame: bytes | None = None
        self._contacts: asyncio.Task[ContactsFrame | None] | None = None
        self._clients: set[Callable[[], None]] = set()

    @contextmanager
    def listen(self, wake: Callable[[], None]) -> Iterator[None]:
        """Call `wake` now, and whenever there may be a newer image or another state."""
        if not self._clients:
            self.renew(self.sensor.hub.latest())
            loop = asyncio.get_running_loop()
            self._stop = self.sensor.hub.subscribe(lambda image: self._images.hand_over(loop, self, image))
        self._clients.add(wake)
        wake()
        try:
            yield
        finally:
            self._clients.discard(wake)
            if not self._clients:
                self._stop()

    def forget_status(self) -> None:
        """Look at the sensor's state anew."""
        self._status = self._status_key = self._status_frame = None

    def tick(self) -> None:
        """Wake every client."""
        self.forget_status()
        for wake in self._clients:
            wake()

    def frames(self, image: SensorImage, form: Format) -> list[bytes]:
        """The newest image as WebSocket frames, made once for all who want it so."""
        frames = self._frames.get(form)
        if frames is None:
            if form.json:
                frames = [frame(self._text(image, kind, form.cells)) for kind in form.kinds]
            else:
                if form.cells == "taxels":
                    image = answers.on_taxels(self.sensor, image)
                messages = [self.binary(image, kind, form.named) for kind in form.kinds]
                frames = [frame(each) for each in ([b"".join(messages)] if form.together else messages)]
            self._frames[form] = frames
        return frames

    def binary(self, image: SensorImage, kind: Kind, named: bool) -> bytes:
        """An image's bytes, its sensor's name in them if `named`."""
        return pack(image, kind, time.time(), self.sensor.name if named else "")

    def _text(self, image: SensorImage, kind: Kind, cells: schemas.ImageCells) -> str:
        if kind == "shear":
            return answers.shear(self.sensor, image).model_dump_json()
        if kind == "traction":
            image = image if cells == "raster" else answers.on_taxels(self.sensor, image)
            return answers.traction(self.sensor, image).model_dump_json()
        return answers.frame(self.sensor, image, kind, cells).model_dump_json()

    def status(self) -> schemas.StreamStatus:
        """The sensor's state when the clients were last woken."""
        if self._status is None:
            self._status = answers.stream_status(self.sensor, self.image, self.sensor.status())
        return self._status

    def status_key(self) -> tuple[object, ...]:
        """The part of `status` whose changes are sent at once."""
        if self._status_key is None:
            image = (self.image.method, self.image.warnings) if self.image else ()
            self._status_key = self.sensor.state, self.sensor.method, *image
        return self._status_key

    def status_frame(self) -> bytes:
        """`status` as a WebSocket frame."""
        if self._status_frame is None:
            self._status_frame = frame(self.status().model_dump_json())
        return self._status_frame

    def contacts(self) -> asyncio.Task[ContactsFrame | None]:
        """The search for contacts in the newest image, one for all clients, on another thread; never cancel it."""
        if self._contacts is None:
            self._contacts = asyncio.create_task(asyncio.to_thread(self._find_contacts))
        return self._contacts

    def _find_contacts(self) -> ContactsFrame | None:
        contacts = answers.contacts(self.sensor)
        return None if contacts is None else ContactsFrame(contacts.sequence, frame(contacts.model_dump_json()))

    def renew(self, image: SensorImage | None) -> None:
        """Wake every client for a new image."""
        self.image = image
        self._frames.clear()
        self._contacts = None
        self.tick()


class _NewImages:
    """Images on their way from worker threads to the event loop, of each feed the newest.

    The loop takes all of them in one turn of FRAME_LOCK: every switch between threads in the middle of a frame
    costs time.
    """

    def __init__(self) -> None:
        self._lock = Lock()
        self._images: dict[Feed, SensorImage] = {}

    def hand_over(self, loop: asyncio.AbstractEventLoop, feed: Feed, image: SensorImage) -> None:
        """Have the loop take an image; a closed loop has no clients. Any thread."""
        with self._lock:
            is_first = not self._images
            self._images[feed] = image
        if not is_first:
            return
        try:
            loop.call_soon_threadsafe(self._take, loop)
        except RuntimeError:
            if not loop.is_closed():
                raise

    def _take(self, loop: asyncio.AbstractEventLoop) -> None:
        with FRAME_LOCK:
            with self._lock:
                images, self._images = self._images, {}
            for feed, image in images.items():
                try:
                    feed.renew(image)
                except Exception as error:  # must not disturb clients of other sensors
                    loop.call_exception_handler({"message": f"stream of {feed.sensor.name}", "exception": error})


class Feeds(dict[str, Feed]):
    """The feed of every sensor of a service, also after a reload; lives on one event loop."""

    def __init__(self, service: ServiceView) -> None:
        super().__init__()
        self._service = service
        self._sensors: Mapping[str, SensorView] = {}
        self._images = _NewImages()
        self._listeners: set[Callable[[], None]] = set()
        self.follow()

    @contextmanager
    def listen(self, changed: Callable[[], None]) -> Iterator[None]:
        """Call `changed` whenever a sensor was added, removed or restarted."""
        self._listeners.add(changed)
        try:
            yield
        finally:
            self._listeners.discard(changed)

    def follow(self) -> None:
        """Take the sensors that the service has now."""
        sensors = self._service.sensors
        if sensors is self._sensors:
            return
        now = {
            name: self[name] if name in self and self[name].sensor is sensor else Feed(sensor, self._images)
            for name, sensor in sensors.items()
        }
        self._sensors = sensors
        self.clear()
        self.update(now)
        for changed in tuple(self._listeners):
            changed()


@asynccontextmanager
async def ticking(feeds: Feeds) -> AsyncIterator[None]:
    """Wake every client of these feeds twice a second meanwhile, and follow what sensors there are."""

    async def tick() -> None:
        while True:
            await asyncio.sleep(TICK_S)
            feeds.follow()
            for feed in feeds.values():
                feed.tick()

    task = asyncio.create_task(tick())
    try:
        yield
    finally:
        task.cancel()
