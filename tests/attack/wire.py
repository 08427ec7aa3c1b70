"""Bytes of HTTP and WebSocket as a client sends them, valid or not, and connections that send them."""

import asyncio
import contextlib
import ssl
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

STREAM = "/api/v1/stream"
KEY = ("Upgrade: websocket", "Connection: Upgrade", "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==")
VERSION = "Sec-WebSocket-Version: 13"
TEXT, BINARY, CLOSE, PING, PONG = 1, 2, 8, 9, 10
MOST_HEARD = 1 << 16  # bytes of an answer that are kept
LOST = OSError, asyncio.IncompleteReadError, ssl.SSLError


def request(line: str, *headers: str, token: str = "", body: bytes = b"") -> bytes:
    """A request; its headers say what they say, whatever its body is."""
    shown = [f"Authorization: Bearer {token}"] if token else []
    host = [] if any(each.lower().startswith("host:") for each in headers) else ["Host: localhost"]
    return "\r\n".join([f"{line} HTTP/1.1", *host, *shown, *headers, "", ""]).encode("latin-1") + body


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
    """What became of a connection."""

    heard: bytes  # the first of what the service said
    how: str  # closed, reset, open, refused (not accepted at all)
    seconds: float  # from the last byte sent until it ended

    @property
    def status(self) -> int:
        """Of the last answer; 0 where there was none."""
        answers = [part for part in self.heard.split(b"HTTP/1.1 ")[1:] if part[:3].isdigit()]
        return int(answers[-1][:3]) if answers else 0

    @property
    def told(self) -> str:
        """In two words."""
        return f"{self.status or 'no answer'}, {self.how}"


class Connection:
    """One connection of an asyncio client that may do as it likes."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader, self.writer = reader, writer
        self.heard, self.sent_at, self.broken = b"", time.monotonic(), False

    @classmethod
    async def to(
        cls, port: int, *, source: str = "127.0.0.1", tls: ssl.SSLContext | None = None, seconds: float = 30.0
    ) -> "Connection":
        """Connect from an address of loopback; TimeoutError or OSError where it is not taken."""
        async with asyncio.timeout(seconds):
            ends = await asyncio.open_connection("127.0.0.1", port, local_addr=(source, 0), ssl=tls, limit=1 << 18)
        return cls(*ends)

    async def send(self, pieces: Iterable[bytes], pause_s: float = 0.0, seconds: float = 60.0) -> int:
        """Send what there is, at most for so long; gives how many bytes went before the service ended it."""
        sent, end = 0, time.monotonic() + seconds
        try:
            async with asyncio.timeout(seconds):
                for piece in pieces:
                    self.writer.write(piece)
                    await self.writer.drain()
                    sent, self.sent_at = sent + len(piece), time.monotonic()
                    await asyncio.sleep(pause_s)
                    if self.reader.at_eof() or self.sent_at > end:
                        break
        except TimeoutError:
            pass
        except LOST:
            self.broken = True
        return sent

    async def ending(self, seconds: float) -> Ending:
        """Read until the service ends it, at most for so long."""
        how = "open"
        try:
            async with asyncio.timeout(seconds):
                while piece := await self.reader.read(1 << 16):
                    self.heard = (self.heard + piece)[:MOST_HEARD]
                how = "closed"
        except TimeoutError:  # an OSError, too
            pass
        except LOST:
            how = "reset"
        return Ending(self.heard, how, time.monotonic() - self.sent_at)

    async def until(self, mark: bytes, seconds: float = 30.0) -> bool:
        """Read until the service has said something; False where it does not."""
        with contextlib.suppress(TimeoutError, *LOST):
            async with asyncio.timeout(seconds):
                while mark not in self.heard:
                    piece = await self.reader.read(1 << 16)
                    if not piece:
                        return False
                    self.heard += piece
                return True
        return False

    def cut(self) -> None:
        """End it at once, as a client that is gone."""
        self.writer.transport.abort()


async def talk(
    port: int,
    pieces: Sequence[bytes],
    wait_s: float,
    *,
    pause_s: float = 0.0,
    source: str = "127.0.0.1",
    tls: ssl.SSLContext | None = None,
) -> Ending:
    """Connect, send, wait for the end."""
    began = time.monotonic()
    try:
        one = await Connection.to(port, source=source, tls=tls)
    except (TimeoutError, *LOST):
        return Ending(b"", "refused", time.monotonic() - began)
    try:
        await one.send(pieces, pause_s)
        return await one.ending(wait_s)
    finally:
        one.cut()


def frames(data: bytes) -> tuple[list[tuple[int, bytes]], bytes]:
    """The whole frames (opcode, data) that a service's bytes begin with, and the rest."""
    found = []
    while len(data) >= 2:
        size, begin = data[1] & 0x7F, 2
        if size > 125:
            begin = 4 if size == 126 else 10
            if len(data) < begin:
                break
            size = int.from_bytes(data[2:begin], "big")
        if len(data) < begin + size:
            break
        found.append((data[0] & 0xF, data[begin : begin + size]))
        data = data[begin + size :]
    return found, data
