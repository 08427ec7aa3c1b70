"""A WebSocket that knows how far its client has read.

TCP hides a reader that has stopped behind megabytes of buffers, full of images that are old when they are read. So
a ping follows every few messages, and each frame that nobody requested. A client answers when it has read that
far. Until then `ready` waits, before a stream takes the newest image. A client that answered late, or has not
answered yet, gets the next frame after its answer.

Python's `websockets` answers pings before the program has read what came before them. But it reads no further
ahead than QUEUE WebSocket frames. So the images of a frame that nobody requested go in as many frames as fill that
queue, unless they would be too many: the program may become slow at any time. A ping that comes with them is
answered before the queue is found full. So its answer gets a second ping, to whose answer the next frame waits.
The library answers that one when the program takes the last image that it had, and the program is busy with that
for a while yet. So the next frame comes HOLD of the time later that the second ping's answer took.
A client far away, to which each way takes long, gets the images whole as long as it is quick, and one more than
come in that time: it may only seem far away, on a busy machine.
"""

import asyncio
import time
from collections import deque
from collections.abc import Sequence
from math import ceil
from typing import Any, NamedTuple, cast

from fastapi import WebSocket as AcceptedSocket
from websockets.frames import Frame, Opcode

from tactiled.web.http.protocols import PROTOCOL, WebSocket

PING_EVERY = 4  # messages
REQUESTED = 1 / 8  # a message that the client requested counts as so many: its next request says that it reads
MAX_UNANSWERED = 2  # pings: at most PING_EVERY * MAX_UNANSWERED messages are on their way, and few more
LATE_S = 0.1  # an answer after so long is late: the client is slow, or far away
NEAR_S = 0.005  # the quickest answer of a client that is not far away
ANSWERS = 16  # of the newest of which it is the quickest
QUEUE = 16  # frames
HOLD, MAX_HOLD_S = 1 / 3, 0.25
MAX_RATE_HZ = 4000.0  # of frames
SHARE = 1 / 8  # of the newest period in the mean one
CONTINUED, LAST = b"\x00\x00", b"\x80\x00"  # frames of a message, without data
MARK = b"tactiled"  # of these pings
PING = bytes((0x80 | Opcode.PING, len(MARK) + 8)) + MARK  # the frame of such a ping, but for its number


class Ping(NamedTuple):
    """One that is not answered yet."""

    number: int
    sent: float  # s, monotonic
    again: bool  # another follows its answer
    second: bool = False  # it followed the answer of another


def in_parts(frame: bytes, parts: int) -> bytes:
    """The frame of a message as so many of them: the others are empty."""
    return bytes((frame[0] & 0x7F,)) + frame[1:] + (parts - 2) * CONTINUED + LAST if parts > 1 else frame


def protocol(socket: AcceptedSocket) -> "PacedWebSocket":
    """The protocol below a socket."""
    return cast(PacedWebSocket, socket.scope["state"][PROTOCOL])


class PacedWebSocket(WebSocket):
    """Sends no faster than its client reads."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._unpinged = 0.0  # messages since the newest ping
        self._sent_at, self._period_s = 0.0, 1.0  # of images that nobody requested
        self._pings = 0
        self._unanswered: deque[Ping] = deque()
        self._most = MAX_UNANSWERED  # of them, at which the client does not keep up
        self._quick = False  # the last answer was not late
        self._answers: deque[float] = deque(maxlen=ANSWERS)  # s, that the last ones took
        self._keeps_up = asyncio.Event()
        self._keeps_up.set()

    def keeps_up(self) -> bool:
        """Whether the client has read what it was sent, but for the last few messages."""
        return self._keeps_up.is_set() and self.writable.is_set()

    async def ready(self) -> None:
        """Wait until the client keeps up."""
        await self._keeps_up.wait()
        await self.writable.wait()

    def send_frames(self, frames: Sequence[bytes], requested: bool | None = None) -> None:
        """Send messages, one a frame, and a ping after every few; ClientDisconnected after the end.

        `requested` says whether the client requested these images; None: they are none.
        """
        self.need_open()
        self._unpinged += len(frames) * (REQUESTED if requested else 1)
        now, waiting = time.monotonic(), self._unanswered
        self._quick = self._quick and not (waiting and now > waiting[0].sent + LATE_S)
        parts = self._parts(len(frames), now) if frames and requested is False else 1
        messages = [in_parts(each, parts) for each in frames]
        newest, fills = requested is False, parts * len(frames) > QUEUE
        strict = newest and (fills or not self._quick)
        if newest or self._unpinged >= PING_EVERY:
            self._unpinged = 0.0
            messages.append(self._ping(again=newest and fills))  # in the same write: it must arrive with them
            self._most = 1 if strict else self._underway() if newest else MAX_UNANSWERED
            if len(waiting) >= self._most:
                self._keeps_up.clear()
        self.transport.writelines(messages)

    def _underway(self) -> int:
        """How many images may be on their way to a client far away."""
        return min(ceil(min(self._answers, default=0.0) / self._period_s) + 1, PING_EVERY * MAX_UNANSWERED)

    def _ping(self, again: bool, second: bool = False) -> bytes:
        self._pings += 1
        self._unanswered.append(Ping(self._pings, time.monotonic(), again, second))
        return PING + self._pings.to_bytes(8, "big")

    def _parts(self, images: int, now: float) -> int:
        """In how many frames each of so many images goes now."""
        period = min((now - self._sent_at) / images, 1.0)
        self._sent_at = now
        self._period_s += SHARE * (period - self._period_s)
        if self._quick and min(self._answers, default=0.0) > NEAR_S:
            return 1
        return min(ceil(MAX_RATE_HZ * self._period_s), ceil((QUEUE + 1) / images))

    def handle_pong(self, event: Frame) -> None:
        """Take note of how far the client has read."""
        data = bytes(event.data)
        if not data.startswith(MARK) or len(data) != len(MARK) + 8:
            super().handle_pong(event)
            return
        number, waiting, hold_s = int.from_bytes(data[len(MARK) :], "big"), self._unanswered, 0.0
        while waiting and waiting[0].number <= number:
            ping = waiting.popleft()
            self._answers.append(time.monotonic() - ping.sent)
            self._quick = self._answers[-1] < LATE_S
            if ping.second and not self._quick:
                hold_s = min(HOLD * self._answers[-1], MAX_HOLD_S)
            if ping.again and not self.transport.is_closing():
                self.transport.write(self._ping(again=False, second=True))
        if len(waiting) < (self._most if self._quick else 1):
            if hold_s:
                self.loop.call_later(hold_s, self._keeps_up.set)
            else:
                self._keeps_up.set()

    def connection_lost(self, exc: Exception | None) -> None:
        """End the wait of an application whose client has left."""
        self._keeps_up.set()
        super().connection_lost(exc)

    def shutdown(self) -> None:
        """Let an application that waits end when the server does."""
        self._keeps_up.set()
        super().shutdown()
