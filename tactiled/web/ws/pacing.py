"""A WebSocket that knows how far its client has read.

TCP hides a reader that has stopped behind megabytes of buffers, full of images that are old when they are read. So
a ping follows every few messages; a client answers when it has read that far. Until then `ready` waits, before a
stream takes the newest image. A client that answered late, or has not answered yet, gets a ping after every frame,
and the next frame after its answer.
"""

import asyncio
import time
from collections import deque
from collections.abc import Sequence
from typing import Any, cast

from fastapi import WebSocket as AcceptedSocket
from websockets.frames import Frame, Opcode

from tactiled.web.http.protocols import PROTOCOL, WebSocket

PING_EVERY = 4  # messages
REQUESTED = 1 / 8  # a message that the client requested counts as so many: its next request says that it reads
MAX_UNANSWERED = 2  # pings: at most PING_EVERY * MAX_UNANSWERED messages are on their way, and few more
LATE_S = 0.1  # an answer after so long is late: the client is slow, or far away
MARK = b"tactiled"  # of these pings
PING = bytes((0x80 | Opcode.PING, len(MARK) + 8)) + MARK  # the frame of such a ping, but for its number


def protocol(socket: AcceptedSocket) -> "PacedWebSocket":
    """The protocol below a socket."""
    return cast(PacedWebSocket, socket.scope["state"][PROTOCOL])


class PacedWebSocket(WebSocket):
    """Sends no faster than its client reads."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._unpinged = 0.0  # messages since the newest ping
        self._pings = 0
        self._unanswered: deque[float] = deque()  # when each of the last pings was sent
        self._quick = False  # the last answer was not late
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
        self._quick = self._quick and not (waiting and now > waiting[0] + LATE_S)
        strict = requested is False and not self._quick
        if strict or self._unpinged >= PING_EVERY:
            self._unpinged, self._pings = 0.0, self._pings + 1
            waiting.append(now)
            frames = [*frames, PING + self._pings.to_bytes(8, "big")]
            if strict or len(waiting) >= MAX_UNANSWERED:
                self._keeps_up.clear()
        self.transport.writelines(frames)

    def handle_pong(self, event: Frame) -> None:
        """Take note of how far the client has read."""
        data = bytes(event.data)
        if not data.startswith(MARK) or len(data) != len(MARK) + 8:
            super().handle_pong(event)
            return
        left = max(0, self._pings - int.from_bytes(data[len(MARK) :], "big"))
        while len(self._unanswered) > left:
            self._quick = time.monotonic() < self._unanswered.popleft() + LATE_S
        if len(self._unanswered) < (MAX_UNANSWERED if self._quick else 1):
            self._keeps_up.set()

    def connection_lost(self, exc: Exception | None) -> None:
        """End the wait of an application whose client has left."""
        self._keeps_up.set()
        super().connection_lost(exc)

    def shutdown(self) -> None:
        """Let an application that waits end when the server does."""
        self._keeps_up.set()
        super().shutdown()
