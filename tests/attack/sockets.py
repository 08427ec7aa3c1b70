"""Handshakes of WebSocket and TLS that no library finishes, and frames that break the protocol."""

import asyncio
import contextlib
import ssl
from collections.abc import Iterator

from tests.attack.harness import Findings, Size, Try, late_s
from tests.attack.requests import JSON, METHOD
from tests.attack.service import CONTROL, Target, trusting
from tests.attack.wire import BINARY, CLOSE, KEY, PING, STREAM, TEXT, UPGRADE, Connection, frame, request, upgrade

MANY_HEADERS = tuple(f"X-{number}: x" for number in range(140))
CHUNKED = "Transfer-Encoding: chunked"
UPGRADES = {
    "Content-Length": upgrade("Content-Length: 5"),
    "Content-Length and body": upgrade("Content-Length: 5", body=b"hello"),
    "Transfer-Encoding": upgrade(CHUNKED),
    "140 headers": upgrade(*MANY_HEADERS),
    "head of 9 KB": upgrade("X: " + "x" * 9000),
    "target of 9 KB": upgrade(path=f"{STREAM}?x={'x' * 9000}"),
}
BAD_UPGRADES = {
    "no key": request(f"GET {STREAM}", *UPGRADE),
    "version": request(f"GET {STREAM}", *UPGRADE, "Sec-WebSocket-Version: 7"),
    "two keys": upgrade("Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA=="),
    "POST": upgrade().replace(b"GET", b"POST", 1),
    "no version": request(f"GET {STREAM}", *KEY),
    "protocol": upgrade("Sec-WebSocket-Protocol: \x01\x02"),
    "extension": upgrade("Sec-WebSocket-Extensions: ;;;"),
    "HTTP/1.0": upgrade().replace(b"HTTP/1.1", b"HTTP/1.0", 1),
    "frame": upgrade() + frame(15, b"x", reserved=0x70),
    "garbage": bytes(range(256)),
    "no HTTP": b"GET / HTTP/9\r\n\r\n",
    "wrong chunk": request("GET /", CHUNKED, body=b"zz\r\n"),
    "to HTTP/2": request("GET /", "Upgrade: h2c", "Connection: Upgrade, HTTP2-Settings", "HTTP2-Settings: AAMA"),
    "to TLS": request("OPTIONS *", "Upgrade: TLS/1.0", "Connection: Upgrade"),
}
PATHS = (STREAM, "/", "/xela", "/api/v1/sensors/palm0/stream", "/nowhere", f"{STREAM}?token=x", f"{STREAM}?x=y")
HANDSHAKES = {path: upgrade(path=path) for path in PATHS}
FRAMES = {
    "not masked": frame(TEXT, b"{}", masked=False),
    "reserved 1": frame(TEXT, b"{}", reserved=0x40),
    "reserved 2": frame(TEXT, b"{}", reserved=0x20),
    "reserved 3": frame(TEXT, b"{}", reserved=0x10),
    "opcode 3": frame(3),
    "opcode 15": frame(15),
    "continuation of nothing": frame(0, b"{}"),
    "text in a text": frame(TEXT, b"{", last=False) + frame(TEXT, b"}"),
    "binary in a text": frame(TEXT, b"{", last=False) + frame(BINARY, b"}"),
    "ping of 126 bytes": frame(PING, bytes(126)),
    "ping in pieces": frame(PING, b"x", last=False),
    "close in pieces": frame(CLOSE, b"\x03\xe8", last=False),
    "close of one byte": frame(CLOSE, b"\x03"),
    "close with a wrong code": frame(CLOSE, b"\x00\x00"),
    "close that is not UTF-8": frame(CLOSE, b"\x03\xe8\xff\xff"),
    "text that is not UTF-8": frame(TEXT, b"\xff\xfe"),
    "a message of 70 000 bytes": frame(TEXT, b"x" * 70_000),
    "a length of 2^63": b"\x81\xff" + b"\xff" * 8 + bytes(4),
    "a length longer than needed": b"\x81\xfe\x00\x01" + bytes(4) + b"x",
    "HTTP": request("GET /"),
    "a binary message": frame(BINARY, b"{}"),
    "deep JSON": frame(TEXT, b"[" * 5000),
}
FLOODS = {
    "continuations": (frame(TEXT, last=False), frame(0, last=False)),
    "continuations of nothing": (b"", frame(0, last=False)),
    "pings": (b"", frame(PING)),
    "texts": (b"", frame(TEXT)),
    "unmasked": (b"", frame(TEXT, masked=False)),
}
FLOOD_BYTES = 8 << 20  # of frames on one connection
TRAILERS_BYTES, TRAILERS_S = 105 << 20, 15.0  # of trailers, and the time in which they are sent


async def empty_frames(target: Target, _: Size, findings: Findings) -> None:
    """8 MB of empty frames behind a handshake, with and without a token."""
    for token in ("", CONTROL):
        for flood, (first, empty) in FLOODS.items():
            name = f"{flood}, {'accepted' if token else 'refused'}"
            connection = await Connection.to(target.port)
            try:
                await connection.send([upgrade(token=token)])
                findings.check(await connection.until(b"\r\n\r\n"), f"{name}: no handshake")
                block = empty * 8192
                pieces = [first + block, *[block] * (FLOOD_BYTES // len(block))]
                seconds = 2.0 if token else 4 * late_s("refused")
                __, ending = await asyncio.gather(
                    connection.send(pieces, seconds=seconds), connection.ending(seconds)
                )
                findings.outcomes[f"{name}: {ending.how}"] += 1
                findings.check(bool(token) or ending.how != "open", f"{name}: still open")
            finally:
                connection.cut()


def _trailers(head: bytes) -> Iterator[bytes]:
    """A chunked request that never ends."""
    piece = (b"X-Trailer: " + b"x" * 117 + b"\r\n") * 512
    yield head + b"0\r\n"
    yield from (piece for _ in range(TRAILERS_BYTES // len(piece)))


async def trailers(target: Target, _: Size, findings: Findings) -> None:
    """Trailers without end: without a token, with one, and at the port of XELA's clients."""
    heads = {
        "no token": (target.port, request("GET /api/v1/health", CHUNKED)),
        "no token, PUT": (target.port, request(METHOD, CHUNKED)),
        "token": (target.port, request("GET /api/v1/health", CHUNKED, token=CONTROL)),
        "token, PUT": (target.port, request(METHOD, CHUNKED, JSON, token=CONTROL)),
        "XELA's port": (target.xela, request("GET /", CHUNKED)),
    }
    for name, (port, head) in heads.items():
        connection = await Connection.to(port)
        try:
            reading = asyncio.create_task(connection.ending(TRAILERS_S + 2.0))
            count = await connection.send(_trailers(head), seconds=TRAILERS_S)
            findings.outcomes[f"{name}: {(await reading).how}"] += 1
            findings.check(reading.result().how != "open", f"{name}: {count >> 20} MiB of trailers were accepted")
        finally:
            connection.cut()


def _hello() -> bytes:
    """The first bytes of a TLS client."""
    output = ssl.MemoryBIO()
    client = trusting().wrap_bio(ssl.MemoryBIO(), output, server_hostname="localhost")
    with contextlib.suppress(ssl.SSLWantReadError):
        client.do_handshake()
    return output.read()


def tls(_: Target) -> Iterator[Try]:
    """Handshakes that are slow, half, missing or garbage, 300 at once; wrong bytes behind a good one."""
    hello = _hello()
    broken = {
        "nothing": b"",
        "half": hello[: len(hello) // 2],
        "no end": hello,
        "plain HTTP": request("GET /", token=CONTROL),
        "garbage": bytes(range(256)) * 16,
        "changed": hello[:40] + bytes(64) + hello[104:],
        "twice": hello * 2,
    }
    tries = [Try(name, [data]) for name, data in broken.items()]
    tries.append(Try("a byte at a time", [hello[at : at + 1] for at in range(len(hello))], pause_s=0.1))
    yield from tries * 38
    for name, data in (("garbage behind it", bytes(range(256))), ("half a head behind it", b"GET / HT")):
        yield from [Try(name, [data], tls=True)] * 20
    yield from (Try("cut in the middle", [hello[:at]], 0.0, ends=False) for at in range(0, len(hello), 8))


PROTOCOL = "Sec-WebSocket-Protocol: foxglove.sdk.v1"
FOXGLOVE = {
    "nothing": [b""],
    "half a head": [b"GET / HTTP/1.1\r\nX: "],
    "garbage": [bytes(range(256)) * 64],
    "plain HTTP": [request("GET /")],
    "no protocol": [upgrade(path="/")],
    "140 headers": [upgrade(PROTOCOL, *MANY_HEADERS, path="/")],
    "head without end": [b"GET / HTTP/1.1\r\n", *[b"X: " + b"x" * 8000 + b"\r\n"] * 200],
    "a frame of 2^63": [upgrade(PROTOCOL, path="/"), b"\x82\xff" + b"\x7f" + b"\xff" * 7 + bytes(4)],
    "nonsense": [upgrade(PROTOCOL, path="/"), frame(1, b'{"op": "subscribe", "subscriptions": 1e999}')],
}
