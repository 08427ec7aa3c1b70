"""systemd's side of a service: what it is told (sd_notify), and the socket that it holds (sd_listen_fds)."""

import os
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from tactiled.errors import TactileError

FIRST_LISTEN_FD = 3  # SD_LISTEN_FDS_START


def supervises() -> bool:
    """Whether systemd started this process and wants to know how it is (`Type=notify`)."""
    return "NOTIFY_SOCKET" in os.environ


def notify(**states: str) -> None:
    """Send states such as READY="1" to systemd; nothing happens where it did not start this process."""
    address = os.environ.get("NOTIFY_SOCKET", "")
    if not address:
        return
    lines = "\n".join(f"{key}={value}" for key, value in states.items())
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sender, suppress(OSError):  # it may be restarting
        sender.sendto(lines.encode(), "\0" + address[1:] if address[0] == "@" else address)


@contextmanager
def reloading() -> Iterator[None]:
    """Have `systemctl status` show meanwhile that the service reloads its configuration."""
    notify(RELOADING="1", MONOTONIC_USEC=str(time.monotonic_ns() // 1000))
    try:
        yield
    finally:
        notify(READY="1")


def listen_socket() -> socket.socket | None:
    """The socket of the service's `.socket` unit; None without one, TactileError where there are several."""
    if os.environ.get("LISTEN_PID") != str(os.getpid()):
        return None
    if (count := os.environ.get("LISTEN_FDS", "")) != "1":
        raise TactileError(f"LISTEN_FDS = {count!r}: tactiled.socket must hold one socket")
    os.set_inheritable(FIRST_LISTEN_FD, False)
    return socket.socket(fileno=FIRST_LISTEN_FD)
