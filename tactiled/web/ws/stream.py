"""WebSocket streams of one sensor or several: newest wins, nothing queues for a client that does not read."""

import asyncio
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from functools import partial

from fastapi import APIRouter, WebSocket, WebSocketDisconnect

from tactiled.errors import NoShearError, UnknownSensorError
from tactiled.frames import Image
from tactiled.runtime.events import Faults
from tactiled.web.http.close import fitting
from tactiled.web.http.protocols import GONE, protocol
from tactiled.web.ws.feed import TICK_S, Feed, Format, Found
from tactiled.web.ws.query import Wish, asked_for, next_of, once, sheared, wish
from tactiled.web.ws.session import NOT_FOUND, heard, refuse, serve
from tactiled.wire import Kind

STATUS_S = 1.0  # a client hears of the sensor's state at least this often, at ticks or between
CONTACTS_S = 0.05  # between two messages on contacts
CHANGE_S = 0.1  # and of a change no more often than this
LATE_S = 0.02  # that an image may come too late and make no other late: more would let two go at once
LONGEST_S = 60.0  # of an alarm, which outlives a client that leaves
EARLY_S = 1e-3  # that an alarm may come too soon: uvloop's clock and its timers count whole milliseconds
AHEAD = 2  # images of each kind that a client may have asked for and not been sent


def make(feeds: dict[str, Feed], faults: Faults) -> APIRouter:
    """The streams of these sensors."""
    router = APIRouter(prefix="/api/v1")

    @router.websocket("/sensors/{name}/stream")
    async def _one(socket: WebSocket, name: str) -> None:
        await socket.accept()
        try:
            asked = wish(once(socket.query_params))
            stream = Stream(socket, _found(feeds, [name], asked, [], named=False), asked, faults)
        except (UnknownSensorError, NoShearError, ValueError) as error:
            await refuse(socket, error)
        else:
            await stream.run()

    @router.websocket("/stream")
    async def _several(socket: WebSocket) -> None:
        await socket.accept()
        try:
            asked = wish(once(socket.query_params), ["sensors", "shear"])
            names = asked_for(socket.query_params, list(feeds))
            lines = _found(feeds, names, asked, sheared(socket.query_params, names), named=True)
            stream = Stream(socket, lines, asked, faults)
        except (UnknownSensorError, NoShearError, ValueError) as error:
            await refuse(socket, error)
        else:
            await stream.run()

    return router


def nowhere(told: str = "/api/v1/asyncapi.json tells which are") -> APIRouter:
    """The close of a WebSocket at any address that no other route has."""
    router = APIRouter()

    @router.websocket("/{path:path}")
    async def _nowhere(socket: WebSocket) -> None:
        await socket.accept()
        await socket.close(NOT_FOUND, fitting(f"{socket.url.path}: no stream is there: {told}"))

    return router


def _found(
    feeds: dict[str, Feed], names: Sequence[str], asked: Wish, too: Sequence[str], named: bool
) -> list["_Line"]:
    """These sensors, some with shear; UnknownSensorError, NoShearError name one that has not what is asked."""
    lines = []
    for name in names:
        if name not in feeds:
            raise UnknownSensorError.among(name, feeds)
        more: tuple[Kind, ...] = ("shear",) if name in too and "shear" not in asked.kinds else ()
        lines.append(_Line(feeds[name], Format(asked.kinds + more, asked.form, named, asked.together)))
        if "shear" in lines[-1].wanted.kinds:
            feeds[name].sensor.need_shear()
    return lines


def due_after(due: float, now: float, rate_hz: float) -> float:
    """When the next image is due (s), if one that was due at `due` is sent now: late, it makes no other late."""
    return max(due, now - min(LATE_S, 1 / rate_hz)) + 1 / rate_hz


class _Gate:
    """What is sent to a client once in a while only."""

    def __init__(self) -> None:
        self.due = 0.0  # when the next may be sent
        self._alarm = 0.0

    def shut(self, now: float, wake: Callable[[], None]) -> bool:
        """Whether it is too early; if so, `wake` is called when it no longer is."""
        if now >= self.due - EARLY_S:
            return False
        if self._alarm < min(self.due, now + LONGEST_S):
            self._alarm = min(self.due, now + LONGEST_S)
            asyncio.get_running_loop().call_at(self._alarm, wake)
        return True


class _Line:
    """One sensor as one client sees it: what it has been sent and told, and when more may be."""

    def __init__(self, feed: Feed, wanted: Format) -> None:
        self.feed, self.wanted = feed, wanted
        self.wake: Callable[[], None] = lambda: None  # until the stream runs
        self.credit = 0  # images of each kind that it has asked for
        self.sent: Image | None = None
        self.images, self.changes, self.searches = _Gate(), _Gate(), _Gate()
        self.told: tuple[object, ...] = ()
        self.told_at = 0.0
        self.touched = -1
        self.looking: asyncio.Task[Found | None] | None = None


class Stream:
    """One client of one sensor or several.

    What fails at one of several sensors stops no other; at a single one it ends the stream.
    """

    def __init__(self, socket: WebSocket, lines: Sequence[_Line], asked: Wish, faults: Faults) -> None:
        self._socket, self._wish, self._faults = socket, asked, faults
        self._protocol, self._loop = protocol(socket), asyncio.get_running_loop()
        self._lines = {line.feed.sensor.name: line for line in lines}
        self._names = list(self._lines)
        self._due: dict[_Line, None] = {}  # lines of which something may have to be sent
        self._wake = asyncio.Event()

    async def run(self) -> None:
        """Serve until the client leaves, or says something that means nothing."""
        with ExitStack() as stack:
            for line in self._lines.values():
                line.wake = partial(self._look_at, line)
                stack.enter_context(line.feed.listen(line.wake))
            await serve(self._socket, self._listen(), self._talk())

    def _look_at(self, line: _Line) -> None:
        self._due[line] = None
        self._wake.set()

    async def _listen(self) -> None:
        while True:
            for name in next_of(await heard(self._socket), self._names):
                line = self._lines[name]
                line.credit = min(line.credit + 1, AHEAD)
                line.wake()

    async def _talk(self) -> None:
        while True:
            await self._wake.wait()
            self._wake.clear()
            due, self._due = self._due, {}
            for line in due:
                await self._protocol.ready()
                if len(self._lines) == 1:
                    self._send(line)
                    continue
                with self._faults.turn(f"streams of {line.feed.sensor.name}", (WebSocketDisconnect, GONE)):
                    self._send(line)

    def _send(self, line: _Line) -> None:
        """Send what is new of a line."""
        self._send_status(line)  # before the image, which may be an old one
        self._send_image(line)
        if self._wish.contacts:
            self._send_contacts(line)

    def _send_image(self, line: _Line) -> None:
        image = line.feed.image
        if image is None or image is line.sent or (self._wish.credit and not line.credit):
            return
        if self._wish.rate_hz:
            now = self._loop.time()
            if line.images.shut(now, line.wake):
                return
            line.images.due = due_after(line.images.due, now, self._wish.rate_hz)
        frames = line.feed.frames(line.wanted)
        line.sent, line.credit = image, max(0, line.credit - 1)
        self._protocol.send_frames(frames)

    def _send_status(self, line: _Line) -> None:
        state, now = line.feed.state(), self._loop.time()
        if state == line.told and now - line.told_at < STATUS_S - TICK_S:
            return
        if line.changes.shut(now, line.wake):
            return
        frame = line.feed.status_frame()
        line.told, line.told_at, line.changes.due = state, now, now + CHANGE_S
        self._protocol.send_frames([frame])

    def _send_contacts(self, line: _Line) -> None:
        image, now = line.feed.image, self._loop.time()
        if image is None or image.sequence == line.touched or line.searches.shut(now, line.wake):
            return
        if line.looking is None:  # for longer than an image may wait
            line.looking = line.feed.contacts()
            if not line.looking.done():  # of one that is, the wake would come at once, and at every turn again
                line.looking.add_done_callback(lambda _: line.wake())
        if not line.looking.done():
            return
        looked, line.looking = line.looking, None  # before it may raise: a search that failed is not kept
        found = looked.result()
        if found is not None and found.sequence != line.touched:
            line.touched, line.searches.due = found.sequence, now + CONTACTS_S
            self._protocol.send_frames([found.frame])
