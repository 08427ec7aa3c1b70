"""The HTTP server of `run`, `demo`, tests and benchmarks."""

import errno
import logging
import math
import socket
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from typing import TYPE_CHECKING, Any, cast

import uvicorn
from fastapi import FastAPI

from tactiled import logs, systemd
from tactiled.config import Server, Zenoh, tls
from tactiled.errors import TactileError
from tactiled.interop import foxglove
from tactiled.interop.foxglove_live import bridge
from tactiled.interop.zenoh_fleet import Fleet
from tactiled.interop.zenoh_session import need
from tactiled.web.answers import ServiceView
from tactiled.web.app import create, create_for_fleet
from tactiled.web.forward import Requests, publisher
from tactiled.web.http import timeouts
from tactiled.web.http.connection import Connection
from tactiled.web.http.connection_limit import Places, limit
from tactiled.web.ws import session, xela
from tactiled.web.ws.pacing import PacedWebSocket

if TYPE_CHECKING:  # which import python-can: `tactiled serve` needs none
    from tactiled.live.service import Service
    from tactiled.live.watchdog import Watchdog

SWITCH_INTERVAL_S = 5e-4  # between threads; with Python's 5 ms one thread delays images by as much
LOG_LIMIT = logs.LogLimit()
MAX_START_S = 10.0
EVERY_TICK = cast(int, -math.inf)  # of 1 s: uvicorn compares this with the wall clock, which may be set back
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
    certified.keywords.update(tls=tls.context(config))
    former, before[0] = before[0], config.tls_certificate.read_bytes()
    return config.tls_certificate.name if before[0] != former else None


class _Server(uvicorn.Server):
    """uvicorn's, which tells systemd when it begins to stop, and the servers beside it."""

    def __init__(self, config: uvicorn.Config) -> None:
        super().__init__(config)
        self.beside: list[uvicorn.Server] = []

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Close every connection, those of the servers beside this one meanwhile."""
        systemd.notify(STOPPING="1", STATUS="stopping")
        for each in self.beside:
            each.should_exit = True
        await super().shutdown(sockets)


def _server(app: FastAPI, config: Server, watchdog: "Watchdog | None" = None) -> _Server:
    """A server whose event loop looks at the watchdog once a second."""

    async def look() -> None:
        if watchdog:
            watchdog.look()

    sys.setswitchinterval(SWITCH_INTERVAL_S)
    app.state.places = Places(limit(config.streams))
    certified = partial(Connection, places=app.state.places, tls=tls.context(config))
    if config.tls_certificate:
        app.state.service.renew_tls = partial(_renew, certified, config, [config.tls_certificate.read_bytes()])
    server = _Server(
        uvicorn.Config(
            app,
            loop="asyncio" if config.tls_certificate else "auto",  # uvloop reads before `start_tls` can
            http=cast(Any, certified),
            ws=PacedWebSocket,
            h11_max_incomplete_event_size=timeouts.MAX_HEAD,
            timeout_keep_alive=3600,  # State.IDLE has the bound
            ws_max_size=session.MAX_MESSAGE_BYTES,
            ws_ping_interval=session.PING_S,
            ws_ping_timeout=session.PING_S,
            ws_per_message_deflate=False,  # pressures hardly compress, and it costs more than it saves
            log_config=None,  # whoever started the process configures logs
            log_level="warning",
            access_log=False,
            timeout_graceful_shutdown=cast(int, timeouts.SHUTDOWN_S),
            server_header=False,
            callback_notify=look if watchdog else None,
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


def _application(service: ServiceView, config: Server) -> FastAPI:
    return create_for_fleet(service, config) if isinstance(service, Fleet) else create(service, config)


def _watchdog(service: ServiceView, url: str) -> "Watchdog | None":
    """What keeps systemd's watchdog quiet, where that started this process."""
    if not systemd.supervises():
        return None
    from tactiled.live.watchdog import Watchdog

    return Watchdog(service, url)


def serve(service: ServiceView, config: Server) -> None:
    """Serve until KeyboardInterrupt, which uvicorn raises again; TactileError where the address cannot be had."""
    listener = _socket_of_unit(config) or _listen(config)
    try:
        if config.foxglove is not None:
            foxglove.need("server.foxglove")
        server = _server(_application(service, config), config, _watchdog(service, _url(listener, config)))
        with (
            bridge(cast("Service", service), config.foxglove) as port,
            xela_clients(service, config, server.beside) as address,
        ):
            also = "" if port is None else f", for Foxglove at ws://127.0.0.1:{port}"
            also += "" if address is None else f", for XELA's clients at {address}"
            names = "sensors of all robots" if isinstance(service, Fleet) else ", ".join(service.sensors)
            logs.announce(f"{names} served at {_url(listener, config)}/{also} (stop: Ctrl-C)")
            server.run(sockets=[listener])
    finally:
        listener.close()


def publish(service: "Service", config: Server, settings: Zenoh) -> None:
    """Publish on a Zenoh network until KeyboardInterrupt; no HTTP, but what a reader has for Foxglove and XELA."""
    need("zenoh", ros=settings.ros_domain is not None)
    where = f"{settings.prefix}/{settings.robot}"
    watchdog = _watchdog(service, where)
    with bridge(service, config.foxglove), xela_clients(service, config), publishing(service, config, settings):
        rights = "" if settings.control_key else ", read-only without zenoh.control_key"
        logs.announce(f"{', '.join(service.sensors)} published as {where}{rights} (stop: Ctrl-C)")
        while True:
            if watchdog:
                watchdog.look()
            time.sleep(1.0)


@contextmanager
def publishing(service: "Service", config: Server, settings: Zenoh) -> Iterator[None]:
    """Publish on a Zenoh network meanwhile, and answer the requests that come over it."""
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    requests = Requests(create(service, config.model_copy(update={"recordings": None})), config, settings)
    with requests.running(), publisher(service, settings, requests).running():
        yield


def running(service: ServiceView, config: Server | None = None) -> AbstractContextManager[str]:
    """Serve on a thread meanwhile, by default on any free port of loopback; gives the server's URL."""
    config = config or Server(port=0)
    return _on_thread(_application(service, config), config)


@contextmanager
def xela_clients(
    service: ServiceView, config: Server, beside: list[uvicorn.Server] | None = None
) -> Iterator[str | None]:
    """Serve XELA's clients alone meanwhile, where a port is given: without a token or TLS; gives its address.

    The server is added to those `beside` another, which ends them.
    """
    if config.xela is None:
        yield None
        return
    secrets = dict.fromkeys(("read_token", "control_token", "tls_certificate", "tls_key"))
    config = config.model_copy(update=secrets | {"host": config.xela_host, "port": config.xela})
    with _on_thread(xela.alone(service, config), config, beside) as url:
        yield url.replace("http", "ws", 1)


@contextmanager
def _on_thread(app: FastAPI, config: Server, beside: list[uvicorn.Server] | None = None) -> Iterator[str]:
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
