"""Requests byte for byte, and connections whose states have other bounds."""

import io
import socket
from dataclasses import replace

import numpy as np

from tactiled.web.http.timeouts import BOUNDS
from tests.attack.wire import request
from tests.conftest import BUSY_S

UPGRADE = (
    "GET /api/v1/stream HTTP/1.1\r\nHost: localhost\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n"
    "Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: MDEyMzQ1Njc4OWFiY2RlZg==\r\n"
)


def bound(monkeypatch, state, **changed):
    """Give a state of a connection another bound."""
    monkeypatch.setitem(BOUNDS, state, replace(BOUNDS[state], **changed))


def plug(url):
    """Connect to a service."""
    host, port = url.split("/")[2].split(":")
    return socket.create_connection((host, int(port)), timeout=BUSY_S)


def read_all(end):
    """All bytes until the service closes."""
    data = b""
    try:
        while piece := end.recv(1 << 16):
            data += piece
    except ConnectionResetError:
        pass
    return data


def send_raw(url, line, *headers, data=b""):
    """Send a request; gives status and body."""
    with plug(url) as end:
        end.sendall(request(line, *headers, "Connection: close", body=data))
        answer = read_all(end)
    head, _, content = answer.partition(b"\r\n\r\n")
    return int(head.split()[1]), content


def websocket_url(url, path="/api/v1/stream"):
    return url.replace("http", "ws", 1) + path


def npy(array, **options):
    """The bytes of an .npy file."""
    out = io.BytesIO()
    np.save(out, array, **options)
    return out.getvalue()
