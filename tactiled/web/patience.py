"""HTTP connections that waste the service's time: a request whose head is slow or endless is cut off."""

import asyncio
from typing import Any

from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol

HEAD_S = 10.0  # that a request line and its headers may take
MOST_HEAD = 64 << 10  # bytes of them


class PatientHttp(HttpToolsProtocol):
    """uvicorn's protocol, which itself waits for ever for the end of a head."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._late: asyncio.TimerHandle | None = None
        self._head = 0  # bytes of it that came after those with which it began

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Wait for the first head."""
        super().connection_made(transport)
        self._wait()

    def connection_lost(self, exc: Exception | None) -> None:
        """Wait for nothing."""
        self._come()
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Take bytes in, and cut off a head that has grown too long."""
        waited = self._late
        super().data_received(data)
        if self._late is not None and self._late is waited:  # else these bytes are of the request before, too
            self._head += len(data)
            if self._head > MOST_HEAD:
                self.transport.abort()

    def on_message_begin(self) -> None:
        """Wait for the head of one request more."""
        super().on_message_begin()
        if self._late is None:
            self._wait()

    def on_headers_complete(self) -> None:
        """Take note that a head has come."""
        self._come()
        super().on_headers_complete()

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
