"""WebSocket streams of one sensor or several: newest wins, nothing queues for a client that does not read."""

import asyncio
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from functools import partial

from fastapi import APIRouter, WebSocket, WebSocketDisconnect
from uvicorn.protocols.utils import ClientDisconnected

from tactiled.errors import NoShearError, UnknownSensorError
from tactiled.frames import Image
from tactiled.runtime.events import Faults
from tactiled.web.http.problems import close_reason
from tactiled.web.http.protocols import protocol
from tactiled.web.ws.feed import TICK_S, ContactsFrame, Feed, Format
from tactiled.web.ws.query import SensorsQuery, StreamQuery, parse, parse_next
from tactiled.web.ws.session import NOT_FOUND, receive, refuse, serve

STATUS_S = 1.0  # between two statuses at most, sent at ticks or between
CONTACTS_S = 0.05  # between two messages on contacts at least
CHANGE_S = 0.1  # between two changes of the status at least
MAX_LATE_S = 0.02  # that an image may be late and delay no other: with more, two would be sent at once
MAX_TIMER_S = 60.0  # a timer outlives a client that leaves
TIMER_RESOLUTION_S = 1e-3  # uvloop's clock and timers count whole milliseconds
MAX_CREDIT = 2  # images of each kind that a client may request ahead


def make(feeds: dict[str, Feed], faults: Faults) -> APIRouter:
    """The streams of these sensors."""
    router = APIRouter(prefix="/api/v1")

    @router.websocket("/sensors/{name}/stream")
    async def _one(socket: WebSocket, name: str) -> None:
        await _serve(socket, lambda: Stream(socket, *_one_sensor(socket, feeds, name), faults))

    @router.websocket("/stream")
    async def _several(socket: WebSocket) -> None:
        await _serve(socket, lambda: Stream(socket, *_several_sensors(socket, feeds), faults))

    return router


async def _serve(socket: WebSocket, make_stream: Callable[[], "Stream"]) -> None:
    """Accept, and stream or tell why not."""
    await socket.accept()
    try:
        stream = make_stream()
    except (UnknownSensorError, NoShearError, ValueError) as error:
        await refuse(socket, error)
    else:
        await stream.run()


def no_stream(hint: str = "see /api/v1/asyncapi.json") -> APIRouter:
    """The close of a WebSocket at any address that no other route has."""
    router = APIRouter()

    @router.websocket("/{path:path}")
    async def _no_stream(socket: WebSocket) -> None:
        await socket.accept()
        await socket.close(NOT_FOUND, close_reason(f"{socket.url.path}: no stream: {hint}"))

    return router


class _Timer:
    """Limits how often something is sent."""

    def __init__(self) -> None:
        self.due = 0.0  # event loop's time (s) at which the next may be sent
        self._alarm = 0.0

    def waits(self, now: float, wake: Callable[[], None]) -> bool:
        """Whether it is too early; `wake` is then called in time."""
        if now >= self.due - TIMER_RESOLUTION_S:
            return False
        alarm = min(self.due, now + MAX_TIMER_S)
        if self._alarm < alarm:
            self._alarm = alarm
            asyncio.get_running_loop().call_at(alarm, wake)
        return True


class _Line:
    """One sensor for one client: what it was sent, and when more may be."""

    def __init__(self, feed: Feed, form: Format) -> None:
        if "shear" in form.kinds:
            feed.sensor.need_shear()
        self.feed, self.form = feed, form
        self.wake: Callable[[], None] = lambda: None  # until the stream runs
        self.credit = 0  # images of each kind that the client has requested
        self.image: Image | None = None
        self.image_timer, self.status_timer, self.contacts_timer = _Timer(), _Timer(), _Timer()
        self.status_key: tuple[object, ...] = ()
        self.status_at = 0.0
        self.contacts_sequence = -1
        self.search: asyncio.Task[ContactsFrame | None] | None = None


def _line(feeds: dict[str, Feed], name: str, query: StreamQuery, *, shear: bool = False, named: bool) -> _Line:
    if name not in feeds:
        raise UnknownSensorError.among(name, feeds)
    kinds = (*query.kinds, "shear") if shear and "shear" not in query.kinds else query.kinds
    return _Line(feeds[name], Format(kinds, query.format == "json", named, query.together == "1"))


def _one_sensor(socket: WebSocket, feeds: dict[str, Feed], name: str) -> tuple[list[_Line], StreamQuery]:
    query = parse(socket.query_params, StreamQuery)
    return [_line(feeds, name, query, named=False)], query


def _several_sensors(socket: WebSocket, feeds: dict[str, Feed]) -> tuple[list[_Line], StreamQuery]:
    query = parse(socket.query_params, SensorsQuery)
    names = list(feeds) if query.sensors is None else query.sensors
    if not set(query.shear) <= set(names):
        raise ValueError(f"shear={','.join(query.shear)}: give some of {','.join(names)}")
    return [_line(feeds, name, query, shear=name in query.shear, named=True) for name in names], query


def due_after(due: float, now: float, rate_hz: float) -> float:
    """When the next image is due (s), if one due at `due` is sent now: a late one delays no other."""
    return max(due, now - min(MAX_LATE_S, 1 / rate_hz)) + 1 / rate_hz


class Stream:
    """One client of one sensor or several.

    An error at one of several sensors stops no other; at a single one it ends the stream.
    """

    def __init__(self, socket: WebSocket, lines: Sequence[_Line], query: StreamQuery, faults: Faults) -> None:
        self._socket, self._query, self._faults = socket, query, faults
        self._protocol, self._loop = protocol(socket), asyncio.get_running_loop()
        self._lines = {line.feed.sensor.name: line for line in lines}
        self._due: dict[_Line, None] = {}  # lines that may have something to send
        self._error: Exception | None = None  # that a line raised where no task could
        self._wake = asyncio.Event()

    async def run(self) -> None:
        """Serve until the client leaves or sends a wrong message."""
        with ExitStack() as stack:
            for line in self._lines.values():
                line.wake = partial(self._add, line)
                stack.enter_context(line.feed.listen(line.wake))
            await serve(self._socket, self._listen(), self._send())

    def _add(self, line: _Line) -> None:
        """Send what is new of a sensor at once to a client that keeps up: a task's turn costs as much as that."""
        self._due[line] = None
        if self._error is None and self._protocol.keeps_up():
            try:
                self._send_due()
            except Exception as error:  # the task that serves the client ends with it
                self._error = error
        if self._due or self._error:
            self._wake.set()

    async def _listen(self) -> None:
        while True:
            for name in parse_next(await receive(self._socket), list(self._lines)):
                line = self._lines[name]
                line.credit = min(line.credit + 1, MAX_CREDIT)
                line.wake()

    async def _send(self) -> None:
        while True:
            await self._wake.wait()
            self._wake.clear()
            if self._error is not None:
                raise self._error
            await self._protocol.ready()
            self._send_due()
            if self._due:
                self._wake.set()

    def _send_due(self) -> None:
        """Send what is new of every line that is due, while the client keeps up."""
        while self._due and self._protocol.keeps_up():
            line = next(iter(self._due))
            del self._due[line]
            if len(self._lines) == 1:
                self._send_line(line)
                continue
            with self._faults.turn(
                f"streams of {line.feed.sensor.name}", (WebSocketDisconnect, ClientDisconnected)
            ):
                self._send_line(line)

    def _send_line(self, line: _Line) -> None:
        """Send what is new of a sensor."""
        self._send_status(line)  # before the image, which may be an old one
        self._send_image(line)
        if self._query.contacts == "1":
            self._send_contacts(line)

    def _send_image(self, line: _Line) -> None:
        image = line.feed.image
        if image is None or image is line.image or (self._query.flow == "credit" and not line.credit):
            return
        if rate_hz := self._query.rate_hz:
            now = self._loop.time()
            if line.image_timer.waits(now, line.wake):
                return
            line.image_timer.due = due_after(line.image_timer.due, now, rate_hz)
        frames = line.feed.frames(image, line.form)
        line.image, line.credit = image, max(0, line.credit - 1)
        self._protocol.send_frames(frames)
        line.feed.sensor.timings.add_send(image, time.monotonic())

    def _send_status(self, line: _Line) -> None:
        key, now = line.feed.status_key(), self._loop.time()
        if key == line.status_key and now - line.status_at < STATUS_S - TICK_S:
            return
        if line.status_timer.waits(now, line.wake):
            return
        frame = line.feed.status_frame()
        line.status_key, line.status_at, line.status_timer.due = key, now, now + CHANGE_S
        self._protocol.send_frames([frame])

    def _send_contacts(self, line: _Line) -> None:
        image, now = line.feed.image, self._loop.time()
        if image is None or image.sequence == line.contacts_sequence or line.contacts_timer.waits(now, line.wake):
            return
        if line.search is None:
            line.search = line.feed.contacts()
            if not line.search.done():  # a callback of one that is done would wake at every turn again
                line.search.add_done_callback(lambda _: line.wake())
        if not line.search.done():
            return
        search, line.search = line.search, None  # before it may raise: a failed search is not kept
        contacts = search.result()
        if contacts is not None and contacts.sequence != line.contacts_sequence:
            line.contacts_sequence, line.contacts_timer.due = contacts.sequence, now + CONTACTS_S
            self._protocol.send_frames([contacts.frame])
