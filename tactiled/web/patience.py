"""Connections that waste the service's time are cut off: slow handshakes, slow or endless heads, late bodies."""

import asyncio
from functools import partial
from typing import Any

from uvicorn.loops.auto import auto_loop_factory
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol, RequestResponseCycle

HEAD_S = 10.0  # that a request line and its headers may take, and a TLS handshake before them
MOST_HEAD = 64 << 10  # bytes of them
GRACE_S = 2.0  # that a client has to read an answer which it got amid its request's body
MOST_LATE = 1 << 20  # bytes that it may go on sending meanwhile


def tls_loop() -> asyncio.AbstractEventLoop:
    """The event loop that uvicorn itself takes, but one that waits no longer for a handshake than for a head."""
    loop = auto_loop_factory()()
    loop.create_server = partial(loop.create_server, ssl_handshake_timeout=HEAD_S)  # type: ignore[method-assign]
    return loop


class PatientHttp(HttpToolsProtocol):
    """uvicorn's protocol, which itself waits for ever for the end of a head."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._late: asyncio.TimerHandle | None = None
        self._head = 0  # bytes of it that came after those with which it began
        self._over: int | None = None  # bytes that came after the last answer

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Wait for the first head."""
        super().connection_made(transport)
        self._wait()

    def connection_lost(self, exc: Exception | None) -> None:
        """Wait for nothing."""
        self._come()
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Take bytes in, and cut off a head that has grown too long, or what comes after the last answer."""
        if self._over is not None:
            self._over += len(data)
            if self._over > MOST_LATE:
                self.transport.abort()
            return
        waited = self._late
        super().data_received(data)
        if self._late is not None and self._late is waited:  # else these bytes are of the request before, too
            self._head += len(data)
            if self._head > MOST_HEAD:
                self.transport.abort()
        elif self._late is None and self._idle():  # blank lines, which are no request yet
            self._wait()

    def _idle(self) -> bool:
        """Whether no request is under way: bytes end uvicorn's own wait for the next."""
        answered = self.cycle is None or self.cycle.response_complete
        return answered and self.transport.get_protocol() is self and not self.transport.is_closing()

    def on_message_begin(self) -> None:
        """Wait for the head of one request more."""
        super().on_message_begin()
        if self._late is None:
            self._wait()

    def on_headers_complete(self) -> None:
        """Take note that a head has come."""
        self._come()
        super().on_headers_complete()
        if self.cycle is not None:
            self.cycle.transport = _Answered(self, self.cycle)

    def end(self) -> None:
        """Close, but let the client, which still sends, read its answer before."""
        self._over = 0
        if self.transport.can_write_eof():
            self.transport.write_eof()
        self.loop.call_later(GRACE_S, self.transport.abort)

    def _wait(self) -> None:
        self._head = 0
        self._late = self.loop.call_later(HEAD_S, self._end)

    def _end(self) -> None:
        """Cut a head off that is late; not where it is the service that reads nothing until it has answered."""
        if self.flow.read_paused:
            self._late = self.loop.call_later(HEAD_S, self._end)
        else:
            self.transport.abort()

    def _come(self) -> None:
        if self._late is not None:
            self._late.cancel()
            self._late = None


class _Answered(asyncio.Transport):
    """A transport as the answer to one request sees it."""

    def __init__(self, connection: PatientHttp, cycle: RequestResponseCycle) -> None:
        self._connection, self._cycle = connection, cycle
        self.write, self.is_closing = connection.transport.write, connection.transport.is_closing  # type: ignore

    def close(self) -> None:
        """Close, at once if the whole request has come: else the system would take the answer back."""
        if self._cycle.more_body and not self.is_closing():
            self._connection.end()
        else:
            self._connection.transport.close()
