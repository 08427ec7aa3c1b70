"""The HTTP server: one door for `run`, `demo`, tests and benchmarks."""

import errno
import logging
import socket
import ssl
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any, cast

import uvicorn
from fastapi import FastAPI

from tactiled.config import Server
from tactiled.errors import TactileError
from tactiled.service import Service
from tactiled.web import session, xela
from tactiled.web.app import create
from tactiled.web.bridge import bridge
from tactiled.web.http import bounds
from tactiled.web.http.connection import Connection
from tactiled.web.http.log_limit import LogLimit
from tactiled.web.http.places import Places, limit
from tactiled.web.http.protocols import WebSocket

SWITCH_S = 5e-4  # how long one thread may keep the others waiting: a tenth of Python's own, for the images' sake
START_S = 10.0  # that a server may take to start


def _listen(at: Server) -> socket.socket:
    """Take the port; TactileError, one line, where it cannot be had."""
    host, port = at.host, at.port
    try:
        family, kind, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
    except socket.gaierror as error:
        raise TactileError(f"host {host}: {error.strerror}: give an address of this machine") from error
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
    protocol = partial(Connection, places=places, tls=_tls(at))
    server = uvicorn.Server(
        uvicorn.Config(
            app,
            loop="asyncio" if at.tls_certificate else "auto",  # uvloop reads before `start_tls` can
            http=cast(Any, protocol),
            ws=WebSocket,
            h11_max_incomplete_event_size=bounds.MAX_HEAD,
            timeout_keep_alive=3600,  # State.IDLE has the bound
            ws_max_size=session.MOST,
            ws_ping_interval=session.PING_S,
            ws_ping_timeout=session.PING_S,
            ws_per_message_deflate=False,  # pressures hardly compress, and it costs more than it saves
            log_level="warning",
            access_log=False,
            timeout_graceful_shutdown=cast(int, bounds.SHUTDOWN_S),
            server_header=False,
        )
    )
    logging.getLogger("uvicorn.error").addFilter(LogLimit())
    return server


def _tls(at: Server) -> ssl.SSLContext | None:
    """The server's side of TLS, None where it has none; TactileError where its files cannot be used."""
    if at.tls_certificate is None:
        return None
    for path in (at.tls_certificate, at.tls_key):
        if path is not None and not path.is_file():
            raise TactileError(f"{path}: no such file: give the PEM files of tls_certificate and tls_key")
    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    try:
        context.load_cert_chain(at.tls_certificate, at.tls_key)
    except (OSError, ssl.SSLError) as error:
        raise TactileError(
            f"{at.tls_certificate}, {at.tls_key}: {error}: give a certificate and its key"
        ) from error
    return context


def _url(listener: socket.socket, at: Server) -> str:
    host, port = listener.getsockname()[:2]
    shown = {"0.0.0.0": "localhost", "::": "localhost"}.get(host, f"[{host}]" if ":" in host else host)
    return f"{'https' if at.tls_certificate else 'http'}://{shown}:{port}"


def serve(service: Service, at: Server) -> None:
    """Serve until KeyboardInterrupt, which uvicorn raises again; TactileError where the address cannot be had."""
    listener = _listen(at)
    try:
        server = _server(create(service, at), at)
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
