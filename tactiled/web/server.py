"""The HTTP server: one door for `run`, `demo`, tests and benchmarks."""

import errno
import socket
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

import uvicorn

from tactiled.errors import TactileError
from tactiled.service import Service
from tactiled.web.app import create
from tactiled.web.flow import PacedWebSocket
from tactiled.web.guard import LOOPBACK

SWITCH_S = 5e-4  # how long one thread may keep the others waiting: a tenth of Python's own, for the images' sake
START_S = 10.0  # that a server may take to start


def _listen(host: str, port: int) -> socket.socket:
    """Take the port; TactileError, one line, where it cannot be had."""
    try:
        family, kind, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
    except socket.gaierror as error:
        raise TactileError(f"host {host}: {error.strerror}: give an address of this machine") from error
    listener = socket.socket(family, kind)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
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


def _server(service: Service, loopback: bool) -> uvicorn.Server:
    sys.setswitchinterval(SWITCH_S)
    return uvicorn.Server(
        uvicorn.Config(
            create(service, loopback),
            ws=PacedWebSocket,
            ws_per_message_deflate=False,  # pressures hardly compress, and it costs more than it saves
            log_level="warning",
            access_log=False,
            timeout_graceful_shutdown=2,
            server_header=False,
        )
    )


def _url(listener: socket.socket) -> str:
    host, port = listener.getsockname()[:2]
    shown = {"0.0.0.0": "localhost", "::": "localhost"}.get(host, f"[{host}]" if ":" in host else host)
    return f"http://{shown}:{port}"


def serve(service: Service, host: str, port: int) -> None:
    """Serve until interrupted; TactileError where the address cannot be had."""
    listener = _listen(host, port)
    print(f"tactiled: {', '.join(service.sensors)} live at {_url(listener)}/ (stop: Ctrl-C)", flush=True)
    try:
        _server(service, host in LOOPBACK).run(sockets=[listener])
    except KeyboardInterrupt:
        return
    finally:
        listener.close()


@contextmanager
def running(service: Service, host: str = "127.0.0.1", port: int = 0) -> Iterator[str]:
    """Serve on a thread meanwhile; gives the server's URL."""
    listener = _listen(host, port)
    server = _server(service, host in LOOPBACK)
    thread = threading.Thread(target=server.run, args=([listener],), name="server", daemon=True)
    thread.start()
    end = time.monotonic() + START_S
    while not server.started:
        if not thread.is_alive() or time.monotonic() > end:
            raise TactileError(f"server at {_url(listener)} did not start")
        time.sleep(0.005)
    try:
        yield _url(listener)
    finally:
        server.should_exit = True
        thread.join()
        listener.close()
