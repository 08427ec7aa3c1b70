"""The HTTP server: one door for `run`, `demo`, tests and benchmarks."""

import errno
import logging
import socket
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any, cast

import uvicorn
from fastapi import FastAPI

from tactiled.config import Server, tls
from tactiled.errors import TactileError
from tactiled.interop import foxglove
from tactiled.interop.foxglove_live import bridge
from tactiled.runtime.service import Service
from tactiled.web.app import create
from tactiled.web.http import bounds
from tactiled.web.http.connection import Connection
from tactiled.web.http.log_limit import LogLimit
from tactiled.web.http.places import Places, limit
from tactiled.web.http.protocols import WebSocket
from tactiled.web.ws import session, xela

SWITCH_S = 5e-4  # how long one thread may keep the others waiting: a tenth of Python's own, for the images' sake
LOG_LIMIT = LogLimit()
START_S = 10.0  # that a server may take to start


def _listen(at: Server) -> socket.socket:
    """Take the port; TactileError, one line, where it cannot be had."""
    host, port = at.host, at.port
    try:
        family, kind, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
    except (
        socket.gaierror,
        ValueError,
    ) as error:  # ValueError: a name that none can be, such as one of 64 letters
        why = error.strerror if isinstance(error, OSError) else error
        raise TactileError(f"host {host}: {why}: give an address of this machine") from error
    listener = socket.socket(family, kind)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    if sys.platform == "linux":  # of each connection, in TLS as well
        listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, round(1000 * bounds.UNREAD_S))
    try:
        listener.bind(address)
    except OSError as error:
        listener.close()
        advice = {
            errno.EADDRINUSE: "in use: choose another port, or 0 for any free one",
            errno.EACCES: "not permitted: choose a port of 1024 or more",
            errno.EADDRNOTAVAIL: "not an address of this machine",
        }.get(error.errno or 0, error.strerror)
        raise TactileError(f"address {host}:{port}: {advice}") from error
    return listener


def _server(app: FastAPI, at: Server) -> uvicorn.Server:
    sys.setswitchinterval(SWITCH_S)
    app.state.places = places = Places(limit(at.streams))
    protocol = partial(Connection, places=places, tls=tls.context(at))
    server = uvicorn.Server(
        uvicorn.Config(
            app,
            loop="asyncio" if at.tls_certificate else "auto",  # uvloop reads before `start_tls` can
            http=cast(Any, protocol),
            ws=WebSocket,
            h11_max_incomplete_event_size=bounds.MAX_HEAD,
            timeout_keep_alive=3600,  # State.IDLE has the bound
            ws_max_size=session.MAX_MESSAGE_BYTES,
            ws_ping_interval=session.PING_S,
            ws_ping_timeout=session.PING_S,
            ws_per_message_deflate=False,  # pressures hardly compress, and it costs more than it saves
            log_level="warning",
            access_log=False,
            timeout_graceful_shutdown=cast(int, bounds.SHUTDOWN_S),
            server_header=False,
        )
    )
    for log in (logging.getLogger("uvicorn.error"), logging.lastResort):  # all that clients can write to
        if log is not None:
            log.addFilter(LOG_LIMIT)
    return server


def _url(listener: socket.socket, at: Server) -> str:
    host, port = listener.getsockname()[:2]
    shown = {"0.0.0.0": "localhost", "::": "localhost"}.get(host, f"[{host}]" if ":" in host else host)
    return f"{'https' if at.tls_certificate else 'http'}://{shown}:{port}"


def ready(service: Service, at: Server) -> uvicorn.Server:
    """The server of a service, which listens nowhere yet; TactileError where it cannot be made."""
    if at.foxglove is not None:
        foxglove.need("server.foxglove")
    return _server(create(service, at), at)


def serve(service: Service, at: Server) -> None:
    """Serve until KeyboardInterrupt, which uvicorn raises again; TactileError where the address cannot be had."""
    listener = _listen(at)
    try:
        server = ready(service, at)
        with bridge(service, at.foxglove) as port, xelas(service, at) as address:
            also = "" if port is None else f", for Foxglove at ws://127.0.0.1:{port}"
            also += "" if address is None else f", for XELA's clients at {address}"
            print(
                f"tactiled: {', '.join(service.sensors)} live at {_url(listener, at)}/{also} (stop: Ctrl-C)",
                flush=True,
            )
            server.run(sockets=[listener])
    finally:
        listener.close()


@contextmanager
def running(service: Service, at: Server | None = None) -> Iterator[str]:
    """Serve on a thread meanwhile, by default on any free port of loopback; gives the server's URL."""
    at = at or Server(port=0)
    with _beside(create(service, at), at) as url:
        yield url


@contextmanager
def xelas(service: Service, at: Server) -> Iterator[str | None]:
    """Serve XELA's clients alone meanwhile, where a port is given: without a token or TLS; gives its address."""
    if at.xela is None:
        yield None
        return
    open_ = {"host": at.xela_host, "port": at.xela, "read_token": None, "control_token": None}
    plain = at.model_copy(update=open_ | {"tls_certificate": None, "tls_key": None})
    with _beside(xela.alone(service, plain), plain) as url:
        yield url.replace("http", "ws", 1)


@contextmanager
def _beside(app: FastAPI, at: Server) -> Iterator[str]:
    """Serve an application on a thread meanwhile; gives its URL."""
    listener = _listen(at)
    server = _server(app, at)
    thread = threading.Thread(target=server.run, args=([listener],), name="server", daemon=True)
    thread.start()
    end = time.monotonic() + START_S
    while not server.started:
        if not thread.is_alive() or time.monotonic() > end:
            raise TactileError(f"server at {_url(listener, at)} did not start")
        time.sleep(0.005)
    try:
        yield _url(listener, at)
    finally:
        server.should_exit = True
        thread.join()
        listener.close()
