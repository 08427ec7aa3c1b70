import socket
import struct
import time

import pytest
from websockets.frames import Frame, Opcode
from websockets.streams import StreamReader
from websockets.sync.client import connect

from tactiled.web.http.protocols import MARK, WebSocket, frame
from tests.conftest import BUSY_S, pressed, until

PONG = struct.pack("!BB4x8sQ", 0x80 | Opcode.PONG, 0x80 | 16, MARK, 0)  # masked with zeros


@pytest.mark.parametrize("size", [0, 125, 126, 65535, 65536])
@pytest.mark.parametrize(("of", "opcode"), [(b"x", Opcode.BINARY), ("x", Opcode.TEXT)])
def test_a_message_is_one_frame_as_a_client_reads_it(size, of, opcode):
    reader = StreamReader()
    reader.feed_data(frame(of * size))
    parsing = Frame.parse(reader.read_exact, mask=False)
    with pytest.raises(StopIteration) as parsed:
        next(parsing)
    assert (parsed.value.value.opcode, parsed.value.value.fin) == (opcode, True)
    assert parsed.value.value.data == b"x" * size
    assert not reader.buffer


def test_pongs_of_a_client_that_reads_need_no_parser(rig, url, monkeypatch):
    parsed, taken = [], []
    handle, take = WebSocket.handle_pong, WebSocket._take_pong
    monkeypatch.setattr(WebSocket, "handle_pong", lambda one, event: (parsed.append(event), handle(one, event)))
    monkeypatch.setattr(
        WebSocket, "_take_pong", lambda one, data: (data and taken.append(data), take(one, data))[1]
    )
    with connect(f"{url.replace('http', 'ws', 1)}/api/v1/sensors/palm/stream?kinds=raw") as client:
        for at in range(40):
            rig.show(pressed(at % 6))
            while isinstance(client.recv(timeout=BUSY_S), str):
                pass
        until(lambda: len(taken) >= 10)
    assert {data[: len(MARK)] for data in taken} == {MARK}
    assert len(parsed) < len(taken)  # some, where two come at once


def test_what_looks_like_a_pong_amid_a_message_is_the_message(url):
    host, port = url.removeprefix("http://").split(":")
    with socket.create_connection((host, int(port)), timeout=BUSY_S) as plug:
        plug.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        plug.sendall(
            f"GET /api/v1/sensors/palm/stream HTTP/1.1\r\nHost: {host}:{port}\r\nUpgrade: websocket\r\n"
            "Connection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
            "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n".encode()
        )
        assert plug.recv(1 << 16).startswith(b"HTTP/1.1 101")
        time.sleep(0.1)  # the service has read what came before
        for piece in struct.pack("!BB4x", 0x80 | Opcode.BINARY, 0x80 | len(PONG)), PONG:
            plug.sendall(piece)
            time.sleep(0.1)
        heard = b"".join(iter(lambda: plug.recv(1 << 16), b""))
    assert b"message of bytes" in heard[-130:]
