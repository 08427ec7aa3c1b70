"""uvicorn's protocols: errors become problems."""

import sys
from collections.abc import Callable, Sequence
from http import HTTPStatus
from typing import Any, cast

import h11
from starlette.responses import Response
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.utils import ClientDisconnected
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol
from websockets.datastructures import Headers
from websockets.frames import CloseCode, Frame, Opcode
from websockets.http11 import Request
from websockets.http11 import Response as Handshake
from websockets.protocol import OPEN

from tactiled.web.http import problems
from tactiled.web.http.headers import HEADERS
from tactiled.web.http.timeouts import MAX_FRAGMENTS, SHUTDOWN_S

FEW_BYTES = 256  # what clients that keep up send at once: some ten messages
PROTOCOL = "tactiled.protocol"
ENDS = "the service ends"


def frame(message: bytes | str) -> bytes:
    """A message as one WebSocket frame; a server's bear no mask, so all clients get the same bytes."""
    opcode, data = (Opcode.TEXT, message.encode()) if isinstance(message, str) else (Opcode.BINARY, message)
    return Frame(opcode, data).serialize(mask=False)


def _problem(status: int, detail: str) -> Response:
    return problems.response(status, detail, HEADERS | {"Connection": "close"})


def refusal(status: int, detail: str) -> bytes:
    """The whole answer to a client whose bytes make no request."""
    answer = _problem(status, detail)
    first = f"HTTP/1.1 {status} {HTTPStatus(status).phrase}".encode()
    lines = (name + b": " + value for name, value in answer.raw_headers)
    return b"\r\n".join((first, *lines, b"", bytes(answer.body)))


class Http(H11Protocol):
    """uvicorn's HTTP/1.1."""

    def sending(self) -> bool:
        """Whether more of a request may come."""
        return self.conn.their_state in (h11.SEND_BODY, h11.ERROR)

    def send_400_response(self, msg: str) -> None:
        """Answer, while what the parser raised is handled, and close; amid another answer close alone."""
        if self.conn.our_state in (h11.IDLE, h11.SEND_RESPONSE):
            error = sys.exception()
            status = error.error_status_hint if isinstance(error, h11.RemoteProtocolError) else 400
            self.transport.write(refusal(status, f"no HTTP request: {error or msg}"))
        self.transport.close()

    def shutdown(self) -> None:
        """Close, behind the answer that is under way."""
        if self.cycle is None or self.cycle.response_complete:
            self.transport.close()
        else:
            self.cycle.keep_alive = False
            self.loop.call_later(SHUTDOWN_S / 2, self.transport.abort)


class WebSocket(WebSocketsSansIOProtocol):
    """uvicorn's WebSocket."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.conn.reject = _reject  # type: ignore[method-assign]
        self._few_bytes = False  # came at once
        self.take_text: Callable[[str], bool] = lambda _: False

    def sending(self) -> bool:
        """Whether more may come."""
        return self.conn.close_rcvd is None

    def data_received(self, data: bytes) -> None:
        """Take bytes in; a handshake that the library cannot read is refused, which it leaves to its user."""
        self._few_bytes = len(data) <= FEW_BYTES
        super().data_received(data)
        if self.conn.handshake_exc is not None and not self.handshake_initiated:
            answer = b"".join(self.conn.data_to_send())
            why = self.conn.handshake_exc.__cause__ or self.conn.handshake_exc
            self.transport.write(answer or refusal(400, f"no WebSocket handshake: {why}"))
            self.transport.close()

    def handle_connect(self, event: Request) -> None:
        """Hand the event to the application, which runs with the next turn of the loop."""
        super().handle_connect(event)
        if self.response.status_code == 101:
            self.scope["state"][PROTOCOL] = self

    async def send(self, message: Any) -> None:
        """Send one ASGI message; to a client that was closed meanwhile, nothing."""
        if message["type"] == "websocket.send":
            await self.writable.wait()
            text, data = message.get("text"), message.get("bytes")
            self.send_frames([frame(text if data is None else data)])
        elif not (self.close_sent and message["type"] == "websocket.close"):
            await super().send(message)
            cast(Any, self.transport).update()

    def send_frames(self, frames: Sequence[bytes]) -> None:
        """Send messages, one a frame; ClientDisconnected after the end."""
        self.need_open()
        self.transport.writelines(frames)

    def need_open(self) -> None:
        """ClientDisconnected after the end."""
        if self.disconnected or self.close_sent or self.conn.state is not OPEN:
            raise ClientDisconnected

    def handle_cont(self, event: Frame) -> None:
        """Take one frame more of a message; close a client that sends too many, empty ones too."""
        if len(self.frames) >= MAX_FRAGMENTS:
            self._fail(CloseCode.MESSAGE_TOO_BIG, f"a message of more than {MAX_FRAGMENTS} frames")
        else:
            super().handle_cont(event)

    def send_receive_event_to_app(self) -> None:
        """Close a client whose text is not UTF-8: uvicorn would log a failure of the service.

        A few short messages are handed over at once: a task's turn for each costs as much as an image does.
        A client that sends many waits.
        """
        if self.curr_msg_data_type == "text":
            try:
                text = b"".join(self.frames).decode()
            except UnicodeDecodeError:
                self._fail(CloseCode.INVALID_DATA, "text that is not UTF-8")
                return
            if self._few_bytes and not self.close_sent and self.take_text(text):
                self.frames = []
                return
        super().send_receive_event_to_app()

    def shutdown(self) -> None:
        """End with the server, and tell the client why, which may not read."""
        if not self.handshake_complete or self.transport.is_closing():
            self.transport.abort()
            return
        if not self.close_sent:
            self.queue.put_nowait({"type": "websocket.disconnect", "code": int(CloseCode.SERVICE_RESTART)})
            self._fail(CloseCode.SERVICE_RESTART, ENDS)
        self.loop.call_later(SHUTDOWN_S / 2, self.transport.abort)

    def _fail(self, code: CloseCode, why: str) -> None:
        if not self.close_sent:
            self.frames = []
            self.conn.fail(code, why)
            self.handle_parser_exception()


def _reject(status: int, text: str) -> Handshake:
    """The handshake's answer to a client that is refused."""
    answer = _problem(status, text.partition("\n")[0])
    return Handshake(int(status), HTTPStatus(status).phrase, Headers(answer.headers.items()), bytes(answer.body))
