"""A connection from its first byte to its last: which state it is in, and that it keeps to that state's bound.

uvicorn's own protocols parse and answer; they write to a `ProxyTransport` and know nothing of this. The state is
read off h11's and websockets' own machines after every step, so no step can be forgotten here.
"""

import asyncio
import logging
import ssl
from collections.abc import Iterable
from time import perf_counter
from typing import Any, cast

import h11
from starlette.types import Scope
from uvicorn.config import Config
from uvicorn.server import ServerState

from tactiled.web.http import timeouts
from tactiled.web.http.body import is_recording
from tactiled.web.http.connection_limit import Place, Places
from tactiled.web.http.limits import network
from tactiled.web.http.protocols import Http, WebSocket, refusal
from tactiled.web.http.timeouts import BOUNDS, Phase

LOG = logging.getLogger(__name__)
FULL = "every connection is taken: come again later"


class _ClosedTransport(asyncio.Transport):
    """Takes the place of a lost connection's transport, which with TLS holds 256 kB."""

    def is_closing(self) -> bool:
        return True

    def abort(self) -> None:
        return


class Connection(asyncio.Protocol):
    """One client's connection; takes a place of `places` while it is open, and speaks TLS where it is given."""

    def __init__(
        self,
        config: Config,
        server_state: ServerState,
        app_state: dict[str, Any],
        _loop: asyncio.AbstractEventLoop | None = None,
        *,
        places: Places,
        tls: ssl.SSLContext | None = None,
    ) -> None:
        self._loop = _loop or asyncio.get_running_loop()
        self._places, self._tls = places, tls
        self._inner: Http | WebSocket = Http(config, server_state, app_state, self._loop)
        self._opened = False  # the inner protocol has its transport
        self.half_closed = False
        self.state = Phase.HEAD
        self._bound = BOUNDS[self.state]
        self._received = 0  # bytes in this state
        self._deadline: asyncio.TimerHandle | None = None
        self._backlog = bytearray()  # received, and not yet handed on
        self._paused = False  # the inner protocol wants nothing more now
        self._unread = False  # the client does not read what it is sent
        self._turn: asyncio.TimerHandle | None = None  # when the backlog has its next
        self._busy_s = self._busy_at = 0.0  # the event loop's time that the client's bytes have taken of late

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Take a place, and begin with the handshake of TLS or the first request."""
        self.transport = transport
        peer = transport.get_extra_info("peername")
        self._place = Place(network(peer[0]) if peer else "", lambda: self._bound.evictable, self._expire)
        if not self._places.take(self._place):
            self.half_closed = True
            if self._tls is None:  # a handshake only to say this would cost a place
                transport.write(refusal(503, FULL))
            transport.close()
        elif self._tls is None:
            self._open(transport)
        else:
            transport.pause_reading()  # until the handshake reads
            self._enter(Phase.TLS)
            self._handshake = self._loop.create_task(self._shake_hands(transport, self._tls))

    def connection_lost(self, exc: Exception | None) -> None:
        """Give the place back."""
        self._places.free(self._place)
        self._cancel()
        self._backlog.clear()
        self.half_closed = True
        if self._opened:
            self._inner.connection_lost(exc)
        self.transport = _ClosedTransport()

    def data_received(self, data: bytes) -> None:
        """Hand bytes on, in pieces if they are many."""
        if not self._opened:
            if self.state is Phase.TLS:  # right behind the handshake
                self._backlog += data
            return
        if self._backlog or self._turn or self._must_wait() or len(data) > self._bound.piece:
            self._backlog += data
        else:
            self._take(data)
        self._arrange_reading()

    def pause_writing(self) -> None:
        """Read no more from a client that does not read: what it sends may ask for answers."""
        self._unread = True
        self._inner.pause_writing()
        self._arrange_reading()

    def resume_writing(self) -> None:
        """Read on."""
        self._unread = False
        self._inner.resume_writing()
        self._arrange_reading()

    def update(self) -> None:
        """Read the state off the inner protocol, which may have gone on."""
        state = self._find_state()
        if state is not self.state and not self.transport.is_closing():
            self._enter(state)
            self._arrange_reading()

    def upgrade(self, protocol: WebSocket) -> None:
        """Go on as a WebSocket; what came right behind its handshake waits for the answer."""
        assert isinstance(self._inner, Http)
        self._backlog[:0] = self._inner.conn.trailing_data[0]
        self._inner = protocol
        self.update()

    def pause(self, paused: bool) -> None:
        """Hand no more on while the inner protocol wants nothing."""
        self._paused = paused
        self._arrange_reading()

    def close(self) -> None:
        """Close; while the client still sends, let it read its answer first: else the system takes that back."""
        if self.half_closed or self.transport.is_closing():
            return
        if not self._inner.sending():
            self.transport.close()
            return
        self.half_closed = True
        self._enter(Phase.CLOSING)
        if self.transport.can_write_eof():
            self.transport.write_eof()
        self._arrange_reading()

    def _open(self, transport: asyncio.Transport) -> None:
        self.transport, self._opened = transport, True
        self._enter(Phase.HEAD)
        self._inner.connection_made(ProxyTransport(self))
        self._arrange_reading()

    async def _shake_hands(self, raw: asyncio.Transport, context: ssl.SSLContext) -> None:
        """Go on in TLS; a client that speaks none, or none in time, is cut off."""
        made: asyncio.Transport | None = None
        try:
            made = await self._loop.start_tls(
                raw,
                self,
                context,
                server_side=True,
                ssl_handshake_timeout=BOUNDS[Phase.TLS].seconds,
                ssl_shutdown_timeout=BOUNDS[Phase.CLOSING].seconds,
            )
        except (OSError, asyncio.CancelledError):
            raw.abort()
        finally:
            if made is None or made.is_closing():
                self._places.free(self._place)
                self._cancel()
        if made is not None and not made.is_closing():
            self._open(made)

    def _find_state(self) -> Phase:
        inner = self._inner
        if self.half_closed:
            return Phase.CLOSING
        if isinstance(inner, WebSocket):
            if not inner.handshake_complete:
                return Phase.UPGRADING
            return Phase.CLOSING if inner.close_sent else Phase.STREAMING
        theirs = inner.conn.their_state
        if theirs is h11.IDLE:
            return Phase.HEAD if self.state is Phase.HEAD else Phase.IDLE
        if theirs is not h11.SEND_BODY:
            return Phase.ANSWERING
        return Phase.UPLOAD if is_recording(cast(Scope, inner.scope)) else Phase.BODY

    def _enter(self, state: Phase) -> None:
        self.state, self._bound, self._received = state, BOUNDS[state], 0
        if self._deadline is not None:
            self._deadline.cancel()
        seconds = self._bound.seconds
        self._deadline = None if seconds is None else self._loop.call_later(seconds, self._expire)

    def _expire(self) -> None:
        """End a connection whose state has lasted too long; between two requests the last answer is still sent."""
        if self.state is Phase.IDLE:
            self.transport.close()
        else:
            self.transport.abort()

    def _take(self, piece: bytes) -> None:
        """Hand one piece on, and take note of what it cost."""
        began = perf_counter()
        if self.state is Phase.IDLE:
            self._enter(Phase.HEAD)
        bound = self._bound
        self._received += len(piece)
        if bound.bytes is not None and self._received > bound.bytes:
            self.transport.abort()
            return
        unused = self.state is Phase.CLOSING and self._received > timeouts.MAX_CLOSING_PARSED
        if not (self.half_closed or unused):
            try:
                self._inner.data_received(piece)
            except Exception:
                LOG.exception("a connection failed, and is closed")
                self.transport.abort()
            self.update()
        now = perf_counter()
        self._busy_s = max(0.0, self._busy_s - (now - self._busy_at) * bound.share) + now - began
        self._busy_at = now

    def _pause_s(self) -> float:
        """How long (s) the client's bytes must wait until they have had no more than their share."""
        share = self._bound.share
        if share == 1.0 or self._busy_s <= timeouts.BURST_S:
            return 0.0
        return max(0.0, self._busy_at - perf_counter() + (self._busy_s - timeouts.BURST_S) / share)

    def _arrange_reading(self) -> None:
        """Read on, or have the next piece's turn come; cut off who sends much behind a request that waits."""
        if self.state is Phase.ANSWERING and len(self._backlog) > timeouts.MAX_HEAD:
            self.transport.abort()
        if not self._opened or self.transport.is_closing():
            self._backlog.clear()
            return
        must_wait, pause_s = self._must_wait(), self._pause_s()
        if not must_wait and self._turn is None and (self._backlog or pause_s):
            self._turn = self._loop.call_later(pause_s, self._take_turn)
        if must_wait or self._backlog or self._turn:
            self.transport.pause_reading()
        else:
            self.transport.resume_reading()

    def _take_turn(self) -> None:
        self._turn = None
        size = self._bound.piece
        if self._backlog and not self._must_wait() and not self.transport.is_closing():
            piece = bytes(self._backlog[:size])
            del self._backlog[:size]
            self._take(piece)
        self._arrange_reading()

    def _must_wait(self) -> bool:
        """Whether the inner protocol must not have more now: it said so, or its handshake or client is behind."""
        if self.half_closed:
            return False
        inner = self._inner
        behind = isinstance(inner, WebSocket) and (self._unread or not inner.handshake_complete)
        return self._paused or behind

    def _cancel(self) -> None:
        for timer in (self._deadline, self._turn):
            if timer is not None:
                timer.cancel()
        self._deadline = self._turn = None


class ProxyTransport(asyncio.Transport):
    """A connection's transport as the inner protocols see it."""

    def __init__(self, connection: Connection) -> None:
        self._connection, self.update = connection, connection.update
        self._loop = asyncio.get_running_loop()

    def get_extra_info(self, name: str, default: Any = None) -> Any:
        """What is known of the client."""
        return self._connection.transport.get_extra_info(name, default)

    def abort(self) -> None:
        """Close at once."""
        self._connection.transport.abort()

    def write(self, data: Any) -> None:
        """Send bytes; those of an HTTP answer may have been its last."""
        if not self.is_closing():
            self._connection.transport.write(data)
            if self._connection.state is not Phase.STREAMING:
                self._loop.call_soon(self.update)

    def writelines(self, list_of_data: Iterable[Any]) -> None:
        """Send the frames of a WebSocket, copied into one only where the transport cannot send them together."""
        if not self.is_closing():
            self._connection.transport.writelines(list_of_data)

    def is_closing(self) -> bool:
        """Whether nothing more can be sent."""
        return self._connection.transport.is_closing() or self._connection.half_closed

    def close(self) -> None:
        """Close once all is sent."""
        self._connection.close()

    def set_protocol(self, protocol: asyncio.BaseProtocol) -> None:
        """Hand the connection over to a WebSocket."""
        assert isinstance(protocol, WebSocket)
        self._connection.upgrade(protocol)

    def pause_reading(self) -> None:
        """Hand no more on."""
        self._connection.pause(True)

    def resume_reading(self) -> None:
        """Hand on again."""
        self._connection.pause(False)
