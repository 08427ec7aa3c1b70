"""Attacks on connections: handshakes, frames, trailers and waits without end."""

import asyncio
import json
from collections.abc import Iterator

from tests.attack.harness import Findings, Size, late_s
from tests.attack.service import CONTROL, Target
from tests.attack.wire import PING, STREAM, TEXT, Connection, Ending, frame, request, talk, upgrade

MANY_HEADERS = tuple(f"X-{number}: x" for number in range(140))
UPGRADES = {
    "Content-Length": upgrade("Content-Length: 5"),
    "Content-Length and body": upgrade("Content-Length: 5", body=b"hello"),
    "Transfer-Encoding": upgrade("Transfer-Encoding: chunked"),
    "140 headers": upgrade(*MANY_HEADERS),
    "head of 9 KB": upgrade("X: " + "x" * 9000),
    "target of 9 KB": upgrade(path=f"{STREAM}?x={'x' * 9000}"),
}
FLOOD = 8 << 20  # bytes of frames on one connection
TRAILERS, TRAILERS_S = 105 << 20, 15.0  # bytes of them, and the time (s) in which they are sent


async def upgrades(target: Target, size: Size, findings: Findings) -> None:
    """300 handshakes that no library finishes, against a service that may have 256 descriptors."""
    wait_s = late_s("head")
    for _ in range(size.factor):
        names = [name for _ in range(50) for name in UPGRADES]
        endings = await asyncio.gather(*(talk(target.port, [UPGRADES[name]], wait_s) for name in names))
        for name, ending in zip(names, endings, strict=True):
            findings.add(name, [ending])


FLOODS = {
    "continuations": frame(TEXT, last=False) + frame(0, last=False) * 8192,
    "strayed": frame(0, last=False) * 8192,
    "pings": frame(PING) * 8192,
    "texts": frame(TEXT) * 8192,
    "unmasked": frame(TEXT, masked=False) * 8192,
}


async def empty_frames(target: Target, size: Size, findings: Findings) -> None:
    """8 MB of empty frames behind a handshake, whether a token was shown or not."""
    for token, name in ((token, name) for token in ("", CONTROL) for name in FLOODS):
        what = f"{name}, {'accepted' if token else 'refused'}"
        one = await Connection.to(target.port, seconds=60.0)
        try:
            await one.send([upgrade(token=token)])
            findings.check(await one.until(b"\r\n\r\n", 60.0), f"{what}: no handshake")
            first, rest = FLOODS[name], FLOODS[name].removeprefix(frame(TEXT, last=False))
            pieces = [first, *[rest] * (size.many(FLOOD) // len(rest))]
            most_s = 2.0 if token else 4 * late_s("refused")
            sent, ending = await asyncio.gather(one.send(pieces, seconds=most_s), one.ending(most_s))
            findings.outcomes[f"{what}: {ending.how}"] += 1
            findings.check(bool(token) or ending.how != "open", f"{what}: open after {sent >> 10} KiB")
        finally:
            one.cut()


def _trailers(head: bytes) -> Iterator[bytes]:
    """A chunked request that never ends."""
    piece = (b"X-Trailer: " + b"x" * 117 + b"\r\n") * 512
    yield head + b"0\r\n"
    yield from (piece for _ in range(TRAILERS // len(piece)))


async def trailers(target: Target, size: Size, findings: Findings) -> None:
    """Trailers without end: without a token, with one, and at the port of XELA's clients."""
    chunked = "Transfer-Encoding: chunked"
    method = "PUT /api/v1/sensors/palm0/method"
    heads = {
        "no token": (target.port, request("GET /api/v1/health", chunked)),
        "no token, PUT": (target.port, request(method, chunked)),
        "token": (target.port, request("GET /api/v1/health", chunked, token=CONTROL)),
        "token, PUT": (target.port, request(method, chunked, "Content-Type: application/json", token=CONTROL)),
        "XELA's port": (target.xela, request("GET /", chunked)),
    }
    for _ in range(size.factor):
        for name, (port, head) in heads.items():
            one = await Connection.to(port, seconds=60.0)
            try:
                reading = asyncio.create_task(one.ending(TRAILERS_S + 2.0))
                sent = await one.send(_trailers(head), seconds=TRAILERS_S)
                cut = (await reading).how != "open"
                findings.outcomes[f"{name}: {'cut off' if cut else 'taken'}"] += 1
                findings.check(cut, f"{name}: {sent >> 20} MiB of trailers were taken")
            finally:
                one.cut()


async def polls(target: Target, size: Size, findings: Findings) -> None:
    """400 clients of one address wait for events."""
    newest = await talk(target.port, [request("GET /api/v1/events", "Connection: close", token=CONTROL)], 30.0)
    after = json.loads(newest.heard.partition(b"\r\n\r\n")[2])["newest"]
    asked = request(f"GET /api/v1/events?wait=30&after={after}", token=CONTROL)
    endings = await asyncio.gather(*(talk(target.port, [asked], 5.0) for _ in range(size.many(400))))
    findings.add("events?wait=30", endings, may_live=True)


BAD_UPGRADES = {
    "no key": request(f"GET {STREAM}", "Upgrade: websocket", "Connection: Upgrade"),
    "version": request(f"GET {STREAM}", "Upgrade: websocket", "Connection: Upgrade", "Sec-WebSocket-Version: 7"),
    "two keys": upgrade("Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA=="),
    "POST": upgrade().replace(b"GET", b"POST", 1),
    "no version": upgrade().replace(b"Sec-WebSocket-Version: 13\r\n", b""),
    "protocol": upgrade("Sec-WebSocket-Protocol: \x01\x02"),
    "extension": upgrade("Sec-WebSocket-Extensions: ;;;"),
    "HTTP/1.0": upgrade().replace(b"HTTP/1.1", b"HTTP/1.0", 1),
    "frame": upgrade() + frame(15, b"x", reserved=0x70),
    "garbage": bytes(range(256)),
    "no HTTP": b"GET / HTTP/9\r\n\r\n",
    "a chunk that is none": request("GET /", "Transfer-Encoding: chunked", body=b"zz\r\n"),
    "to HTTP/2": request("GET /", "Upgrade: h2c", "Connection: Upgrade, HTTP2-Settings", "HTTP2-Settings: AAMA"),
    "to TLS": request("OPTIONS *", "Upgrade: TLS/1.0", "Connection: Upgrade"),
}


async def bad_upgrades(target: Target, size: Size, findings: Findings) -> None:
    """Handshakes that are wrong, without a token: each one a line in the log would fill a disk."""
    names = [name for _ in range(size.many(200)) for name in BAD_UPGRADES]
    few = asyncio.Semaphore(100)

    async def one(name: str) -> None:
        async with few:
            findings.add(name, [await talk(target.port, [BAD_UPGRADES[name]], 1.0)], may_live=True)

    await asyncio.gather(*map(one, names))


SLOW = {
    "nothing": [b""],
    "a letter": [b"G"],
    "half a head": [b"GET / HTTP/1.1\r\nHost: localhost\r\nX: "],
    "a byte at a time": [bytes([each]) for each in request("GET /", "X: " + "x" * 200)],
    "blank lines": [b"\r\n"] * 200,
    "half a body": [request("PUT /api/v1/sensors/palm0/method", "Content-Length: 9", body=b"{")],
    "half an upgrade": [upgrade()[:-2]],
    "answered, then half a head": [request("GET /", token=CONTROL) + b"GET "],
}


async def slow(target: Target, size: Size, findings: Findings) -> None:
    """400 sockets that say little."""

    async def one(pieces: list[bytes]) -> Ending:
        return await talk(target.port, pieces, late_s("head"), pause_s=0.2 if len(pieces) > 1 else 0.0)

    for _ in range(size.factor):
        names = [name for name in SLOW for _ in range(50)]
        for name, ending in zip(names, await asyncio.gather(*(one(SLOW[each]) for each in names)), strict=True):
            findings.add(name, [ending])
