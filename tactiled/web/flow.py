"""A WebSocket that knows how far its client has read, so that a slow one is never sent what it cannot take.

TCP hides a reader that has stopped behind megabytes of buffers, full of images that are old when they are read.
Here a ping follows every few messages; a client answers when it has read that far. Until then `room` is not set,
and whoever streams waits for it before it takes the newest image.
"""

import asyncio
from typing import Any

from fastapi import WebSocket
from uvicorn.protocols.utils import ClientDisconnected
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol
from websockets.frames import CloseCode, Frame
from websockets.http11 import Request

EVERY = 4  # messages a ping
WINDOW = 2  # pings that may be unanswered: at most EVERY * WINDOW messages are on their way, and the next few
MARK = b"tactiled"
ROOM = "tactiled.room"
ENDS = "the service ends"
CLOSE_S = 5.0  # that a client has left to read what is on its way when it is closed for answering no ping


def room(socket: WebSocket) -> asyncio.Event:
    """Set while the client keeps up."""
    found: asyncio.Event = socket.scope["state"][ROOM]
    return found


class PacedWebSocket(WebSocketsSansIOProtocol):
    """uvicorn's protocol, which tells the application whether the client is more than a few messages behind."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._sent = 0
        self._pinged = 0
        self._answered = 0
        self._room = asyncio.Event()
        self._room.set()

    def handle_connect(self, event: Request) -> None:
        """Hand the event to the application, which runs with the next turn of the loop."""
        super().handle_connect(event)
        if self.response.status_code == 101:
            self.scope["state"][ROOM] = self._room

    async def send(self, message: Any) -> None:
        """Send one ASGI message, and a ping after every few; to a client that was closed meanwhile, nothing."""
        if self.close_sent and message["type"] == "websocket.close":
            return
        if self.close_sent and message["type"] == "websocket.send":
            raise ClientDisconnected
        await super().send(message)
        if message["type"] != "websocket.send":
            return
        self._sent += 1
        if self._sent % EVERY == 0 and not self.close_sent and not self.transport.is_closing():
            self._pinged += 1
            self.conn.send_ping(MARK + self._pinged.to_bytes(8, "big"))
            self.transport.write(b"".join(self.conn.data_to_send()))
            if self._pinged - self._answered >= WINDOW:
                self._room.clear()

    def handle_pong(self, event: Frame) -> None:
        """Take note of how far the client has read."""
        data = bytes(event.data)
        if not data.startswith(MARK) or len(data) != len(MARK) + 8:
            super().handle_pong(event)
            return
        self._answered = max(self._answered, min(int.from_bytes(data[len(MARK) :], "big"), self._pinged))
        if self._pinged - self._answered < WINDOW:
            self._room.set()

    def send_receive_event_to_app(self) -> None:
        """Close a client whose text is none: uvicorn would log it as a failure of its own."""
        if self.curr_msg_data_type == "text":
            try:
                b"".join(self.frames).decode()
            except UnicodeDecodeError:
                self.frames = []
                self.conn.fail(CloseCode.INVALID_DATA, "text that is not UTF-8")
                self.handle_parser_exception()
                return
        super().send_receive_event_to_app()

    def keepalive_timeout(self) -> None:
        """Close, and wait CLOSE_S at most for a client that reads nothing: uvicorn itself waits for ever."""
        super().keepalive_timeout()
        self.loop.call_later(CLOSE_S, self.transport.abort)

    def connection_lost(self, exc: Exception | None) -> None:
        """Let an application that waits see that there is nobody left."""
        self._room.set()
        super().connection_lost(exc)

    def shutdown(self) -> None:
        """Let an application that waits end when the server does, and tell the client why."""
        self._room.set()
        if self.handshake_complete and not self.close_sent and not self.transport.is_closing():
            self.queue.put_nowait({"type": "websocket.disconnect", "code": int(CloseCode.SERVICE_RESTART)})
            self.conn.fail(CloseCode.SERVICE_RESTART, ENDS)
            self.transport.write(b"".join(self.conn.data_to_send()))
            self.close_sent = True
        super().shutdown()
