"""Bytes of HTTP and WebSocket as a client sends them, valid or not, and connections that send them."""

import asyncio
import contextlib
import ssl
import time
from dataclasses import dataclass

HOST = "127.0.0.1"
STREAM = "/api/v1/stream"
UPGRADE = ("Upgrade: websocket", "Connection: Upgrade")
KEY = (*UPGRADE, "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==")
VERSION = "Sec-WebSocket-Version: 13"
TEXT, BINARY, CLOSE, PING, PONG = 1, 2, 8, 9, 10
MAX_RECEIVED_BYTES = 1 << 16  # of an answer that are kept
CONNECTION_ERRORS = OSError, asyncio.IncompleteReadError, ssl.SSLError


def request(line, *headers, token="", body=b""):
    """A request with these headers, whatever its body is."""
    bearer = [f"Authorization: Bearer {token}"] if token else []
    host = [] if any(each.lower().startswith("host:") for each in headers) else ["Host: localhost"]
    return "\r\n".join([f"{line} HTTP/1.1", *host, *bearer, *headers, "", ""]).encode("latin-1") + body


def upgrade(*headers, path=STREAM, token="", body=b""):
    """The handshake of a WebSocket."""
    return request(f"GET {path}", *KEY, VERSION, *headers, token=token, body=body)


def frame(opcode, data=b"", *, last=True, masked=True, reserved=0):
    """One frame of a WebSocket, masked with zeros."""
    size, mask = len(data), 0x80 if masked else 0
    first = bytes([(0x80 if last else 0) | reserved | opcode])
    if size < 126:
        length = bytes([mask | size])
    elif size < 1 << 16:
        length = bytes([mask | 126]) + size.to_bytes(2, "big")
    else:
        length = bytes([mask | 127]) + size.to_bytes(8, "big")
    return first + length + (bytes(4) if masked else b"") + data


@dataclass
class Ending:
    """How a connection ended."""

    received: bytes  # the first bytes of the service
    how: str  # closed, reset, open, refused (not accepted at all)
    seconds: float  # from the last byte sent until it ended

    @property
    def status(self):
        """Of the last answer; 0 where there was none."""
        answers = [part for part in self.received.split(b"HTTP/1.1 ")[1:] if part[:3].isdigit()]
        return int(answers[-1][:3]) if answers else 0

    def __str__(self):
        return f"{self.status or 'no answer'}, {self.how}"


class Connection:
    """One connection of an asyncio client, which may send anything."""

    def __init__(self, reader, writer):
        self.reader, self.writer = reader, writer
        self.received, self.sent_at = b"", time.monotonic()

    @classmethod
    async def to(cls, port, *, source=HOST, tls=None, seconds=60.0):
        """Connect from an address of loopback; TimeoutError or OSError where it is not accepted."""
        async with asyncio.timeout(seconds):
            ends = await asyncio.open_connection(HOST, port, local_addr=(source, 0), ssl=tls, limit=1 << 18)
        return cls(*ends)

    async def send(self, pieces, pause_s=0.0, seconds=60.0):
        """Send until the service ends it, for so long at most."""
        end = time.monotonic() + seconds
        with contextlib.suppress(TimeoutError, *CONNECTION_ERRORS):
            async with asyncio.timeout(seconds):
                for piece in pieces:
                    self.writer.write(piece)
                    await self.writer.drain()
                    self.sent_at = time.monotonic()
                    await asyncio.sleep(pause_s)
                    if self.reader.at_eof() or self.sent_at > end:
                        break

    async def ending(self, seconds, mark=None):
        """Read until the service ends it, or has sent `mark`, for so long at most."""
        how = "open"
        try:
            async with asyncio.timeout(seconds):
                while mark is None or mark not in self.received:
                    if not (piece := await self.reader.read(1 << 16)):
                        how = "closed"
                        break
                    self.received = (self.received + piece)[:MAX_RECEIVED_BYTES]
        except TimeoutError:  # an OSError, too
            pass
        except CONNECTION_ERRORS:
            how = "reset"
        return Ending(self.received, how, time.monotonic() - self.sent_at)

    def cut(self):
        """End it at once, as a client that crashed."""
        self.writer.transport.abort()


async def exchange(port, pieces, wait_s, *, pause_s=0.0, send_s=60.0, source=HOST, tls=None):
    """Connect, send, wait for the end."""
    began = time.monotonic()
    try:
        connection = await Connection.to(port, source=source, tls=tls, seconds=30.0)
    except CONNECTION_ERRORS:
        return Ending(b"", "refused", time.monotonic() - began)
    try:
        await connection.send(pieces, pause_s, send_s)
        return await connection.ending(wait_s)
    finally:
        connection.cut()
