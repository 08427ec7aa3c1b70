"""Bytes of HTTP and WebSocket as a client sends them, valid or not, and connections that send them."""

import asyncio
import contextlib
import ssl
import time
from collections.abc import Iterable
from dataclasses import dataclass

HOST = "127.0.0.1"
STREAM = "/api/v1/stream"
UPGRADE = ("Upgrade: websocket", "Connection: Upgrade")
KEY = (*UPGRADE, "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==")
VERSION = "Sec-WebSocket-Version: 13"
TEXT, BINARY, CLOSE, PING, PONG = 1, 2, 8, 9, 10
MAX_RECEIVED_BYTES = 1 << 16  # of an answer that are kept
CONNECTION_ERRORS = OSError, asyncio.IncompleteReadError, ssl.SSLError


def request(line: str, *headers: str, token: str = "", body: bytes = b"") -> bytes:
    """A request with these headers, whatever its body is."""
    bearer = [f"Authorization: Bearer {token}"] if token else []
    host = [] if any(each.lower().startswith("host:") for each in headers) else ["Host: localhost"]
    return "\r\n".join([f"{line} HTTP/1.1", *host, *bearer, *headers, "", ""]).encode("latin-1") + body


def upgrade(*headers: str, path: str = STREAM, token: str = "", body: bytes = b"") -> bytes:
    """The handshake of a WebSocket."""
    return request(f"GET {path}", *KEY, VERSION, *headers, token=token, body=body)


def frame(opcode: int, data: bytes = b"", *, last: bool = True, masked: bool = True, reserved: int = 0) -> bytes:
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
    def status(self) -> int:
        """Of the last answer; 0 where there was none."""
        answers = [part for part in self.received.split(b"HTTP/1.1 ")[1:] if part[:3].isdigit()]
        return int(answers[-1][:3]) if answers else 0

    def __str__(self) -> str:
        return f"{self.status or 'no answer'}, {self.how}"


class Connection:
    """One connection of an asyncio client, which may send anything."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader, self.writer = reader, writer
        self.received, self.sent_at = b"", time.monotonic()

    @classmethod
    async def to(
        cls, port: int, *, source: str = HOST, tls: ssl.SSLContext | None = None, seconds: float = 60.0
    ) -> "Connection":
        """Connect from an address of loopback; TimeoutError or OSError where it is not accepted."""
        async with asyncio.timeout(seconds):
            ends = await asyncio.open_connection(HOST, port, local_addr=(source, 0), ssl=tls, limit=1 << 18)
        return cls(*ends)

    async def send(self, pieces: Iterable[bytes], pause_s: float = 0.0, seconds: float = 60.0) -> int:
        """Send, for so long at most; gives the bytes that went before the service ended it."""
        count, end = 0, time.monotonic() + seconds
        with contextlib.suppress(TimeoutError, *CONNECTION_ERRORS):
            async with asyncio.timeout(seconds):
                for piece in pieces:
                    self.writer.write(piece)
                    await self.writer.drain()
                    count, self.sent_at = count + len(piece), time.monotonic()
                    await asyncio.sleep(pause_s)
                    if self.reader.at_eof() or self.sent_at > end:
                        break
        return count

    async def ending(self, seconds: float) -> Ending:
        """Read until the service ends it, for so long at most."""
        how = "open"
        try:
            async with asyncio.timeout(seconds):
                while piece := await self.reader.read(1 << 16):
                    self.received = (self.received + piece)[:MAX_RECEIVED_BYTES]
                how = "closed"
        except TimeoutError:  # an OSError, too
            pass
        except CONNECTION_ERRORS:
            how = "reset"
        return Ending(self.received, how, time.monotonic() - self.sent_at)

    async def until(self, mark: bytes, seconds: float = 60.0) -> bool:
        """Read until the service has sent `mark`; False where it does not."""
        with contextlib.suppress(TimeoutError, *CONNECTION_ERRORS):
            async with asyncio.timeout(seconds):
                while mark not in self.received:
                    piece = await self.reader.read(1 << 16)
                    if not piece:
                        return False
                    self.received += piece
                return True
        return False

    def cut(self) -> None:
        """End it at once, as a client that crashed."""
        self.writer.transport.abort()


async def exchange(
    port: int,
    pieces: Iterable[bytes],
    wait_s: float,
    *,
    pause_s: float = 0.0,
    source: str = HOST,
    tls: ssl.SSLContext | None = None,
) -> Ending:
    """Connect, send, wait for the end."""
    began = time.monotonic()
    try:
        connection = await Connection.to(port, source=source, tls=tls, seconds=30.0)
    except CONNECTION_ERRORS:
        return Ending(b"", "refused", time.monotonic() - began)
    try:
        await connection.send(pieces, pause_s)
        return await connection.ending(wait_s)
    finally:
        connection.cut()
