"""systemd's end of the notifications, imitated."""

import socket
from contextlib import contextmanager, suppress

from tests.conftest import BUSY_S


class Manager:
    """Receives what a service sends to NOTIFY_SOCKET."""

    def __init__(self, folder, abstract=False):
        self.address = f"@{folder}" if abstract else str(folder / "notify")
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind(self.address.replace("@", "\0", 1) if abstract else self.address)
        self._socket.settimeout(BUSY_S)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._socket.close()

    def receive(self):
        """The states of the next datagram."""
        return dict(line.split("=", 1) for line in self._socket.recv(4096).decode().split("\n"))

    def receive_until(self, key):
        """The states of the first datagram that has this one."""
        while key not in (states := self.receive()):
            pass
        return states

    def pending(self):
        """The datagrams that nobody has received."""
        self._socket.setblocking(False)
        with suppress(BlockingIOError):
            return [self._socket.recv(4096)]
        return []


@contextmanager
def activated(*command):
    """A command behind a socket that it inherits as systemd hands it on, and that socket."""
    start = 'LISTEN_PID=$$ exec "$@" 3<&{}'
    with socket.create_server(("127.0.0.1", 0)) as listener:
        yield ["bash", "-c", start.format(listener.fileno()), "-", *map(str, command)], listener
