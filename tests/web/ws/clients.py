"""Clients of streams."""

import json
import time

import pytest
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from tactiled.wire import HEADER, KINDS, unpack
from tests.conftest import BUSY_S
from tests.web.http.raw import websocket_url

ONE = "/api/v1/sensors/palm/stream"
SEVERAL = "/api/v1/stream"
NEXT = '{"type": "next"}'


def stream(url, query="", path=ONE, **options):
    return connect(websocket_url(url, path + query), compression=None, **options)


def images(client, count, timeout=BUSY_S):
    """The next images; TimeoutError where one does not come, whatever text comes meanwhile."""
    got, end = [], time.monotonic() + timeout
    while len(got) < count:
        data = client.recv(timeout=max(0.0, end - time.monotonic()))
        if isinstance(data, bytes):
            got.append(unpack(data))
            end = time.monotonic() + timeout
    return got


def unpack_all(data):
    """The images that lie one behind the other."""
    got = []
    while data:
        _, _, kind, rows, columns, flags, name, *_ = HEADER.unpack_from(data)
        planes = 2 if KINDS[kind] == "shear" else 1
        size = HEADER.size + 4 * planes * rows * columns + flags + name
        got.append(unpack(data[:size]))
        data = data[size:]
    return got


def texts(client, seconds):
    """The text messages of the next seconds; no image comes."""
    got, end = [], time.monotonic() + seconds
    while (remaining := end - time.monotonic()) > 0:
        try:
            got.append(json.loads(client.recv(timeout=remaining)))
        except TimeoutError:
            break
    return got


def text(client, true=lambda _: True):
    """The next text message that is so."""
    while True:
        data = client.recv(timeout=BUSY_S)
        if isinstance(data, str) and true(message := json.loads(data)):
            return message


def text_of(client, kind):
    return text(client, lambda message: message["type"] == kind)


def closed(client):
    """Code and reason with which a stream is closed."""
    with pytest.raises(ConnectionClosed) as caught:
        [client.recv(timeout=BUSY_S) for _ in range(1000)]
    return caught.value.rcvd.code, caught.value.rcvd.reason
