"""The HTTP server of `run`, `demo`, tests and benchmarks."""

import errno
import logging
import math
import socket
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager
from functools import partial
from types import FrameType
from typing import TYPE_CHECKING, Any, cast

import uvicorn
from fastapi import FastAPI

from tactiled import logs, systemd
from tactiled.config import Server, tls_context
from tactiled.errors import TactileError
from tactiled.web.app import create
from tactiled.web.bridge import Bridge, Host
from tactiled.web.http import timeouts
from tactiled.web.http.connection import Connection
from tactiled.web.http.connection_limit import Places, limit
from tactiled.web.views import ServiceView
from tactiled.web.ws import session
from tactiled.web.ws.pacing import PacedWebSocket

if TYPE_CHECKING:  # which import python-can: `tactiled serve` needs none
    from tactiled.live.service import Service
    from tactiled.live.watchdog import Watchdog

SWITCH_INTERVAL_S = 5e-4  # between threads; with Python's 5 ms one thread delays images by as much
LOG_LIMIT = logs.LogLimit()
MAX_START_S = 10.0
EVERY_TICK = cast(int, -math.inf)  # once a second, although uvicorn goes by the wall clock, which may be set back
WHY_NOT_BOUND = {
    errno.EADDRINUSE: "in use: choose another port, or 0 for any free one",
    errno.EACCES: "not permitted: choose a port of 1024 or more",
    errno.EADDRNOTAVAIL: "not an address of this machine",
}


def _listen(config: Server) -> socket.socket:
    """Listen, so that clients wait from now on; TactileError, one line, where it cannot be had."""
    family, kind, address = _address(config)
    listener = socket.socket(family, kind)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind(address)
        listener.listen()
    except OSError as error:
        listener.close()
        why = WHY_NOT_BOUND.get(error.errno or 0, error.strerror)
        raise TactileError(f"address {config.host}:{config.port}: {why}") from error
    return _bounded(listener)


def need_address(config: Server) -> None:
    """TactileError, one line, where the address cannot be had: before what takes long is done for it."""
    _listen(config).close()


def _bounded(listener: socket.socket) -> socket.socket:
    """Bound the time that each of its connections, in TLS as well, may leave an answer unread."""
    if sys.platform == "linux":
        listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, round(1000 * timeouts.UNREAD_S))
    return listener


def _socket_of_unit(config: Server) -> socket.socket | None:
    """The socket of tactiled.socket, if there is one; TactileError unless it is at the configured address.

    Which tokens are needed depends on the address, so another one is refused.
    """
    if (listener := systemd.listen_socket()) is None:
        return None
    if (bound := listener.getsockname()) != _address(config)[2]:
        listener.close()
        where = f"{config.host}:{config.port}"
        raise TactileError(f"tactiled.socket: listens at {bound}, not at server.host and server.port, {where}")
    return _bounded(listener)


def _address(config: Server) -> tuple[socket.AddressFamily, socket.SocketKind, tuple[Any, ...]]:
    """Where to listen; TactileError, one line, where the host has no address."""
    try:
        family, kind, _, _, address = socket.getaddrinfo(config.host, config.port, type=socket.SOCK_STREAM)[0]
    except (socket.gaierror, ValueError) as error:  # ValueError: no possible name, such as one of 64 letters
        why = error.strerror if isinstance(error, OSError) else error
        raise TactileError(f"host {config.host}: {why}: give an address of this machine") from error
    return family, kind, address


def _renew(certified: "partial[Connection]", config: Server, before: list[bytes]) -> str | None:
    """Take TLS's files as they are now; gives the certificate's name if it is another than `before`."""
    assert config.tls_certificate is not None
    certified.keywords.update(tls=tls_context(config))
    former, before[0] = before[0], config.tls_certificate.read_bytes()
    return config.tls_certificate.name if before[0] != former else None


class _Server(uvicorn.Server):
    """uvicorn's, which tells systemd when it begins to stop, and the servers beside it."""

    def __init__(self, config: uvicorn.Config) -> None:
        super().__init__(config)
        self.beside: list[uvicorn.Server] = []

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        """Begin to end; another signal changes nothing: uvicorn's own would leave its parts unfinished."""
        if not self.should_exit:
            super().handle_exit(sig, frame)

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Close every connection, those of the servers beside this one meanwhile."""
        systemd.notify(STOPPING="1", STATUS="stopping")
        for each in self.beside:
            each.should_exit = True
        await super().shutdown(sockets)


def _server(app: FastAPI, config: Server, supervisor: "Watchdog | None" = None) -> _Server:
    """A server whose event loop looks at the watchdog once a second."""

    async def look() -> None:
        if supervisor:
            supervisor.look()

    sys.setswitchinterval(SWITCH_INTERVAL_S)
    app.state.places = Places(limit(config.streams))
    certified = partial(Connection, places=app.state.places, tls=tls_context(config))
    if config.tls_certificate:
        app.state.service.renew_tls = partial(_renew, certified, config, [config.tls_certificate.read_bytes()])
    server = _Server(
        uvicorn.Config(
            app,
            loop="asyncio" if config.tls_certificate else "auto",  # uvloop reads before `start_tls` can
            http=cast(Any, certified),
            ws=PacedWebSocket,
            h11_max_incomplete_event_size=timeouts.MAX_HEAD,
            timeout_keep_alive=3600,  # Phase.IDLE has the bound
            ws_max_size=session.MAX_MESSAGE_BYTES,
            ws_ping_interval=session.PING_S,
            ws_ping_timeout=session.PING_S,
            ws_per_message_deflate=False,  # pressures hardly compress, and it costs more than it saves
            log_config=None,  # whoever started the process configures logs
            log_level="warning",
            access_log=False,
            timeout_graceful_shutdown=cast(int, timeouts.SHUTDOWN_S),
            server_header=False,
            callback_notify=look if supervisor else None,
            timeout_notify=EVERY_TICK,
        )
    )
    if logging.lastResort is not None:  # which logs where nothing is configured
        logging.lastResort.addFilter(LOG_LIMIT)
    return server


def _url(listener: socket.socket, config: Server) -> str:
    host, port = listener.getsockname()[:2]
    if host in ("0.0.0.0", "::"):
        host = "localhost"
    return f"{'https' if config.tls_certificate else 'http'}://{f'[{host}]' if ':' in host else host}:{port}"


def watchdog(service: ServiceView, url: str) -> "Watchdog | None":
    """What keeps systemd's watchdog quiet, where that started this process."""
    if not systemd.supervises():
        return None
    from tactiled.live.watchdog import Watchdog

    return Watchdog(service, url)


def serve(app: FastAPI, config: Server, names: str | None = None) -> None:
    """Serve until KeyboardInterrupt, which uvicorn raises again; TactileError where the address cannot be had.

    The application's bridges run meanwhile. `names` is what is served, in words; by default the sensors.
    """
    service = app.state.service
    listener = _socket_of_unit(config) or _listen(config)
    try:
        url = _url(listener, config)
        server = _server(app, config, watchdog(service, url))
        with bridged(app.state.bridges, Host(service, config, server.beside)) as places:
            also = "".join(f", for {each}" for each in places)
            logs.announce(f"{names or ', '.join(service.sensors)} served at {url}/{also} (stop: Ctrl-C)")
            server.run(sockets=[listener])
    finally:
        listener.close()


@contextmanager
def bridged(bridges: Sequence[Bridge], host: Host) -> Iterator[list[str]]:
    """Run bridges meanwhile; gives where they are, in words."""
    with ExitStack() as stack:
        places = [stack.enter_context(each.running(host)) for each in bridges]
        yield [each for each in places if each]


def running(
    service: "Service", config: Server | None = None, bridges: Sequence[Bridge] = ()
) -> AbstractContextManager[str]:
    """Serve on a thread meanwhile, by default on any free port of loopback; gives the server's URL.

    Of the bridges there is what they serve at that address.
    """
    config = config or Server(port=0)
    return on_thread(create(service, config, bridges), config)


@contextmanager
def on_thread(app: FastAPI, config: Server, beside: list[uvicorn.Server] | None = None) -> Iterator[str]:
    """Serve an application on a thread meanwhile; gives its URL."""
    listener = _listen(config)
    server = _server(app, config)
    if beside is not None:
        beside.append(server)
    thread = threading.Thread(target=server.run, args=([listener],), name="server", daemon=True)
    thread.start()
    end = time.monotonic() + MAX_START_S
    while not server.started:
        if not thread.is_alive() or time.monotonic() > end:
            raise TactileError(f"server at {_url(listener, config)} did not start")
        time.sleep(0.005)
    try:
        yield _url(listener, config)
    finally:
        server.should_exit = True
        thread.join()
        listener.close()
