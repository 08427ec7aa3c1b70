"""Handshakes of WebSocket and TLS that no library finishes, and frames that break the protocol."""

import contextlib
import ssl
from itertools import chain, repeat

from tests.attack.harness import Try, late_s
from tests.attack.requests import JSON, METHOD
from tests.attack.service import CONTROL, trusting
from tests.attack.wire import BINARY, CLOSE, KEY, PING, STREAM, TEXT, UPGRADE, frame, request, upgrade

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


def empty_frames(_):
    """8 MB of empty frames behind a handshake, with and without a token."""
    for flood, (first, empty) in FLOODS.items():
        block = empty * 8192
        pieces = [first + block, *[block] * (FLOOD_BYTES // len(block))]
        upgraded = {"expect": lambda ending: ending.status in (0, 101)}
        yield Try(f"{flood}, accepted", [upgrade(token=CONTROL), *pieces], 2.0, send_s=2.0, ends=False, **upgraded)
        yield Try(f"{flood}, refused", [upgrade(), *pieces], late_s("refused"), **upgraded)


def trailers(_):
    """Trailers without end: without a token, with one, and at the port of XELA's clients."""
    piece = (b"X-Trailer: " + b"x" * 117 + b"\r\n") * 512
    heads = {
        "no token": request("GET /api/v1/health", CHUNKED),
        "no token, PUT": request(METHOD, CHUNKED),
        "token": request("GET /api/v1/health", CHUNKED, token=CONTROL),
        "token, PUT": request(METHOD, CHUNKED, JSON, token=CONTROL),
        "XELA's port": request("GET /", CHUNKED),
    }
    for name, head in heads.items():
        pieces = chain([head + b"0\r\n"], repeat(piece, TRAILERS_BYTES // len(piece)))
        yield Try(name, pieces, late_s("refused"), send_s=TRAILERS_S, port="xela" if "XELA" in name else "port")


def _hello():
    """The first bytes of a TLS client."""
    output = ssl.MemoryBIO()
    client = trusting().wrap_bio(ssl.MemoryBIO(), output, server_hostname="localhost")
    with contextlib.suppress(ssl.SSLWantReadError):
        client.do_handshake()
    return output.read()


def tls(_):
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
