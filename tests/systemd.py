"""systemd's end of the notifications, imitated."""

import socket
import time

from tests.conftest import BUSY_S


class Manager(socket.socket):
    """Receives what is sent to NOTIFY_SOCKET at `address`, a path or an abstract @name."""

    def __init__(self, address):
        super().__init__(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.bind(address.replace("@", "\0"))
        self.settimeout(BUSY_S)

    def receive(self, key=""):
        """The states of the next datagram, or of the next that has this one."""
        end = time.monotonic() + BUSY_S
        while key not in (text := self.recv(4096).decode()):
            assert time.monotonic() < end, f"{key} was not sent"
        return dict(line.split("=", 1) for line in text.split("\n"))
