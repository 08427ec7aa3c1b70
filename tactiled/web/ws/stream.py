"""WebSocket streams of one sensor or several: newest wins, nothing queues for a client that does not read."""

import asyncio
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from functools import partial
from urllib.parse import unquote

from fastapi import APIRouter, WebSocket, WebSocketDisconnect
from uvicorn.protocols.utils import ClientDisconnected

from tactiled.errors import NoShearError, UnknownSensorError
from tactiled.frames import SensorImage
from tactiled.live.events import Faults
from tactiled.web.http.problems import close_reason
from tactiled.web.ws.feed import TICK_S, ContactsFrame, Feed, Feeds, Format
from tactiled.web.ws.pacing import protocol
from tactiled.web.ws.query import SensorsQuery, StreamQuery, parse, parse_next
from tactiled.web.ws.session import NOT_FOUND, REMOVED, StreamEndError, receive, refuse, serve
from tactiled.wire import Kind

STATUS_S = 1.0  # longest time between two statuses; a tick sends one before it is over
CONTACTS_S = 0.05  # shortest time between two messages on contacts
CHANGE_S = 0.1  # shortest time between two statuses, if it changes
MAX_LATE_S = 0.02  # so late an image does not delay the next; more would let two go at once
MAX_TIMER_S = 60.0  # the longest, as nobody cancels a timer when its client leaves
TIMER_RESOLUTION_S = 1e-3  # uvloop's clock and timers count whole milliseconds
MAX_CREDIT = 2  # images of each kind that a client may request ahead


def make(feeds: Feeds, faults: Faults) -> APIRouter:
    """The streams of these sensors."""
    router = APIRouter(prefix="/api/v1")

    @router.websocket("/sensors/{name}/stream")
    async def _one(socket: WebSocket, name: str) -> None:
        def make_stream() -> Stream:
            query = parse(socket.query_params, StreamQuery)
            return Stream(
                socket, feeds, SensorsQuery(**dict(query), sensors=(unquote(name),)), faults, named=False
            )

        await _serve(socket, make_stream)

    @router.websocket("/stream")
    async def _several(socket: WebSocket) -> None:
        await _serve(socket, lambda: Stream(socket, feeds, parse(socket.query_params, SensorsQuery), faults))

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
        """Whether it is too early; then `wake` is called when it is time."""
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
        if "traction" in form.kinds:
            feed.sensor.need_traction()
        self.feed, self.form = feed, form
        self.wake: Callable[[], None] = lambda: None  # until the stream runs
        self.listening = ExitStack()
        self.image: SensorImage | None = None
        self.image_timer, self.status_timer, self.contacts_timer = _Timer(), _Timer(), _Timer()
        self.status_key: tuple[object, ...] = ()
        self.status_at = 0.0
        self.contacts_sequence = -1
        self.search: asyncio.Task[ContactsFrame | None] | None = None


def due_after(due: float, now: float, rate_hz: float) -> float:
    """When the next image is due (s), if the one due at `due` goes `now`: up to MAX_LATE_S late is no delay."""
    return max(due, now - min(MAX_LATE_S, 1 / rate_hz)) + 1 / rate_hz


class Stream:
    """One client of one sensor or several.

    With several sensors, an error at one does not stop the others; with a single one it ends the stream. After a
    reload the stream goes on with the sensors of the same names. A stream of all sensors gets new ones, too.
    """

    def __init__(
        self, socket: WebSocket, feeds: Feeds, query: SensorsQuery, faults: Faults, named: bool = True
    ) -> None:
        feeds.follow()
        self._socket, self._feeds, self._query, self._faults, self._named = socket, feeds, query, faults, named
        self._protocol, self._loop = protocol(socket), asyncio.get_running_loop()
        names = tuple(feeds) if query.sensors is None else query.sensors
        for key, some in (("shear", query.shear), ("traction", query.traction)):
            if not set(some) <= set(names):
                raise ValueError(f"{key}={','.join(some)}: give some of {','.join(names)}")
        self._lines = {name: self._line(name) for name in names}
        self._credit = dict.fromkeys(names, 0)  # images of each kind that the client has requested
        self._due: dict[_Line, None] = {}  # lines that may have something to send
        self._error: Exception | None = None  # raised outside the task `_send`, which raises it again
        self._wake = asyncio.Event()

    def _line(self, name: str) -> _Line:
        """The line of a sensor; UnknownSensorError or NoShearError where there is none."""
        if name not in self._feeds:
            raise UnknownSensorError.among(name, self._feeds)
        query = self._query
        more: dict[Kind, tuple[str, ...]] = {"shear": query.shear, "traction": query.traction}
        wanted = (kind for kind, names in more.items() if name in names and kind not in query.kinds)
        kinds = *query.kinds, *wanted
        form = Format(kinds, query.format == "json", self._named, query.together == "1", query.image)
        return _Line(self._feeds[name], form)

    async def run(self) -> None:
        """Serve until the client leaves or sends a wrong message."""
        with self._feeds.listen(self._follow):
            try:
                for line in self._lines.values():
                    self._listen_to(line)
                self._protocol.take_text = self._take_text
                await serve(self._socket, self._listen(), self._send())
            finally:
                for line in self._lines.values():
                    line.listening.close()

    def _listen_to(self, line: _Line) -> None:
        line.wake = partial(self._add, line)
        line.listening.enter_context(line.feed.listen(line.wake))

    def _follow(self) -> None:
        """Go on with the sensors that there are now; without any the stream ends."""
        try:
            for name, line in list(self._lines.items()):
                if self._feeds.get(name) is not line.feed:
                    self._leave(name, line)
            for name in self._feeds if self._query.sensors is None else self._query.sensors:
                if name in self._feeds and name not in self._lines:
                    self._enter(name)
            if not self._lines:
                raise StreamEndError(REMOVED, f"{', '.join(self._credit)}: no longer in the configuration")
        except Exception as error:  # the task that serves the client ends with it
            self._error = error
            self._wake.set()

    def _leave(self, name: str, line: _Line) -> None:
        """Send a sensor's last status, that it is down for good, and nothing of it any more."""
        del self._lines[name]
        self._due.pop(line, None)
        line.listening.close()
        line.feed.forget_status()
        self._protocol.send_frames([line.feed.status_frame()])

    def _enter(self, name: str) -> None:
        """Begin to send a sensor; NoShearError if it lacks the shear that the client wants."""
        self._credit.setdefault(name, 0)
        self._lines[name] = line = self._line(name)
        self._listen_to(line)

    def _add(self, line: _Line) -> None:
        """Send new messages of a sensor at once if the client keeps up: waking a task would double the cost."""
        if self._lines.get(line.feed.sensor.name) is not line or self._has_nothing(line):
            return
        self._due[line] = None
        if self._error is None:
            try:
                self._send_due()
            except Exception as error:  # the task that serves the client ends with it
                self._error = error
        if self._due or self._error:
            self._wake.set()

    def _has_nothing(self, line: _Line) -> bool:
        """Whether `_send_line` would send nothing; with flow=credit that is so at every second call."""
        feed, query = line.feed, self._query
        waits = query.flow == "credit" and not self._credit[feed.sensor.name]
        if query.contacts == "1" or not (waits or feed.image is line.image):
            return False
        is_known = feed.status_key() == line.status_key
        return is_known and self._loop.time() - line.status_at < STATUS_S - TICK_S

    async def _listen(self) -> None:
        while True:
            self._take_request(parse_next(await receive(self._socket), list(self._credit)))

    def _take_text(self, text: str) -> bool:
        """Take a text at once if it is a request; else False: then `_listen` gets it, and ends the stream."""
        try:
            names = parse_next(text, list(self._credit))
        except ValueError:
            return False
        self._take_request(names)
        return True

    def _take_request(self, names: Sequence[str]) -> None:
        """Grant the client one more image of each sensor; it is sent later, as taking messages must be quick."""
        for name in names:
            self._credit[name] = min(self._credit[name] + 1, MAX_CREDIT)
            if name in self._lines and not self._has_nothing(self._lines[name]):
                self._loop.call_soon(self._lines[name].wake)

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
            if len(self._credit) == 1:
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
        image, name = line.feed.image, line.feed.sensor.name
        if image is None or image is line.image or (self._query.flow == "credit" and not self._credit[name]):
            return
        if rate_hz := self._query.rate_hz:
            now = self._loop.time()
            if line.image_timer.waits(now, line.wake):
                return
            line.image_timer.due = due_after(line.image_timer.due, now, rate_hz)
        frames = line.feed.frames(image, line.form)
        line.image, self._credit[name] = image, max(0, self._credit[name] - 1)
        self._protocol.send_frames(frames, requested=self._query.flow == "credit" and len(self._credit) == 1)
        line.feed.sensor.note_send(image)

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
            if not line.search.done():  # a finished search would call back at once, again and again
                line.search.add_done_callback(lambda _: line.wake())
        if not line.search.done():
            return
        search, line.search = line.search, None  # before `result` may raise: a failed search is made anew
        contacts = search.result()
        if contacts is not None and contacts.sequence != line.contacts_sequence:
            line.contacts_sequence, line.contacts_timer.due = contacts.sequence, now + CONTACTS_S
            self._protocol.send_frames([contacts.frame])
