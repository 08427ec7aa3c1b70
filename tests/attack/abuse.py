"""Requests and frames that must be refused, in numbers: tokens, strangers, nonsense, WebSockets."""

import asyncio
import random
from collections.abc import Iterable

from tests.attack.harness import Findings, Size, late_s
from tests.attack.load import film
from tests.attack.service import CONTROL, READ, Target
from tests.attack.wire import (
    BINARY,
    CLOSE,
    KEY,
    PING,
    PONG,
    STREAM,
    TEXT,
    VERSION,
    Connection,
    Ending,
    frame,
    request,
    talk,
    upgrade,
)

AT_ONCE = 50
JSON = "Content-Type: application/json"
READS = ("/", "/metrics", "/docs", *(f"/api/v1/{each}" for each in (
    "health", "sensors", "sensors/palm0", "sensors/palm0/frames/raw", "config", "events", "recordings",
    "openapi.json",
)))  # fmt: skip
CHANGES = (
    "PUT /api/v1/sensors/palm0/method", "POST /api/v1/sensors/palm0/tare", "POST /api/v1/recordings",
    "DELETE /api/v1/recordings/a.log", "POST /api/v1/restore?sensor=palm0",
)  # fmt: skip


async def _all(
    target: Target, tries: Iterable[tuple[str, bytes]], findings: Findings, wait_s: float = late_s("refused")
) -> list[tuple[str, Ending]]:
    """Send requests, some at once, each on its own connection."""
    few, ended = asyncio.Semaphore(AT_ONCE), []

    async def one(what: str, data: bytes) -> None:
        async with few:
            ending = await talk(target.port, [data], wait_s)
        findings.add(what, [ending])
        ended.append((what, ending))

    await asyncio.gather(*(one(what, data) for what, data in tries))
    return ended


def _wrong(number: int, rng: random.Random) -> str:
    """A token that is not one."""
    token = rng.choice((READ, CONTROL))
    at = rng.randrange(len(token))
    kinds = (
        token[:at],
        token + "x",
        token[:at] + "?" + token[at + 1 :],
        token.upper(),
        "",
        token[::-1],
        f"{at:032}",
    )
    return kinds[number % len(kinds)]


async def tokens(target: Target, size: Size, findings: Findings) -> None:
    """1000 requests with a wrong token, or with one that does not suffice."""
    rng, tries = random.Random(size.seed), []
    for number in range(size.many(1000)):
        line = rng.choice([f"GET {path}" for path in READS] + list(CHANGES))
        wrong = _wrong(number, rng)
        if number % 5 == 4 and not line.startswith("GET"):
            how, shown = "read token", [f"Authorization: Bearer {READ}"]
        elif number % 3 == 0:
            how, shown = "wrong in the header", [f"Authorization: Bearer {wrong}"]
        elif number % 3 == 1:
            how, shown = "wrong in the cookie", [f"Cookie: tactiled={wrong}"]
        else:
            how, shown, line = (
                "wrong in the address",
                [],
                f"{line}{'&' if '?' in line else '?'}token={wrong or 'x'}",
            )
        tries.append((how, request(line, *shown, "Connection: close", "Content-Length: 0")))
    for what, ending in await _all(target, tries, findings):
        findings.check(ending.status in (401, 403), f"{what}: {ending.told}")


async def strangers(target: Target, size: Size, findings: Findings) -> None:
    """300 requests and handshakes of pages of another site, or to another name than loopback's."""
    foreign = {
        "rebinding": ("Host: elsewhere.example",),
        "rebinding, two hosts": ("Host: localhost", "Host: elsewhere.example"),
        "origin": ("Origin: https://elsewhere.example",),
        "origin null": ("Origin: null",),
        "cross-site": ("Sec-Fetch-Site: cross-site",),
        "same site": ("Sec-Fetch-Site: same-site",),
    }
    tries = []
    for name, headers in list(foreign.items()) * size.many(10):
        for line in ("GET /api/v1/health", *CHANGES[:3]):
            data = request(
                line, *headers, JSON, "Content-Length: 2", "Connection: close", token=CONTROL, body=b"{}"
            )
            tries.append((name, data))
        tries.append((f"{name}, stream", upgrade(*headers, token=CONTROL)))
    for what, ending in await _all(target, tries, findings):
        refused = (4403).to_bytes(2, "big") in ending.heard if "stream" in what else ending.status in (400, 403)
        findings.check(refused or ending.status in (400, 403), f"{what}: {ending.told}")


def _mutated(data: bytes, rng: random.Random) -> bytes:
    """Some bytes changed, left out or doubled."""
    changed = bytearray(data)
    for _ in range(rng.randrange(1, 8)):
        at = rng.randrange(len(changed) + 1)
        changed[at : at + rng.choice((0, 1, 4))] = rng.randbytes(rng.choice((0, 1, 4)))
    return bytes(changed)


async def nonsense(target: Target, size: Size, findings: Findings) -> None:
    """300 bodies, headers and ranges that mean nothing, with the control token."""
    rng, tries = random.Random(size.seed), []
    seeds = (
        ("JSON", CHANGES[0], JSON, b'{"method": "raw"}'),
        ("JSON of a recording", CHANGES[2], JSON, b'{"bus": "can9", "name": "a.log"}'),
        (".npy", CHANGES[4], "Content-Type: application/x-npy", film()),
    )
    for number in range(size.many(300)):
        what, line, kind, body = seeds[number % 3]
        body = _mutated(body, rng)
        headers = kind, f"Content-Length: {len(body)}", "Connection: close"
        spoilt = f"Range: bytes={rng.randrange(10**9)}-{rng.randrange(-9, 99)},{rng.randrange(99)}-"
        tries.append((what, request(line, *headers, token=CONTROL, body=body)))
        if number % 3 == 0:
            asked = request("GET /static/app.js", spoilt, "Connection: close", token=CONTROL)
            tries += [
                ("range", asked),
                ("header", _mutated(request("GET /", "Connection: close"), rng) + b"\r\n\r\n"),
            ]
    await _all(target, tries, findings, late_s("head"))


ABUSES = {
    "not masked": frame(TEXT, b"{}", masked=False),
    "reserved 1": frame(TEXT, b"{}", reserved=0x40),
    "reserved 2": frame(TEXT, b"{}", reserved=0x20),
    "reserved 3": frame(TEXT, b"{}", reserved=0x10),
    "opcode 3": frame(3),
    "opcode 15": frame(15),
    "strayed continuation": frame(0, b"{}"),
    "text in a text": frame(TEXT, b"{", last=False) + frame(TEXT, b"}"),
    "binary in a text": frame(TEXT, b"{", last=False) + frame(BINARY, b"}"),
    "ping of 126 bytes": frame(PING, bytes(126)),
    "ping in pieces": frame(PING, b"x", last=False),
    "close in pieces": frame(CLOSE, b"\x03\xe8", last=False),
    "close of one byte": frame(CLOSE, b"\x03"),
    "close with a wrong code": frame(CLOSE, b"\x00\x00"),
    "close that is no text": frame(CLOSE, b"\x03\xe8\xff\xff"),
    "text that is none": frame(TEXT, b"\xff\xfe"),
    "a message of 70 000 bytes": frame(TEXT, b"x" * 70_000),
    "a length of 2^63": b"\x81\xff" + b"\xff" * 8 + bytes(4),
    "a length without need": b"\x81\xfe\x00\x01" + bytes(4) + b"x",
    "HTTP": request("GET /"),
    "a binary message": frame(BINARY, b"{}"),
    "JSON that means nothing": frame(TEXT, b"[" * 5000),
}


async def frames(target: Target, size: Size, findings: Findings) -> None:
    """Abuses of the WebSocket protocol on a stream that was accepted."""
    few = asyncio.Semaphore(AT_ONCE)

    async def one(name: str) -> None:
        async with few:
            stream = await Connection.to(target.port)
            await stream.send([upgrade(token=CONTROL)])
            findings.check(await stream.until(b"\r\n\r\n"), f"{name}: no handshake")
            await stream.send([frame(PONG, b"x"), ABUSES[name]])
            findings.add(name, [await stream.ending(late_s("head"))])
            stream.cut()

    await asyncio.gather(*(one(name) for name in ABUSES for _ in range(size.many(5))))


async def handshakes(target: Target, size: Size, findings: Findings) -> None:
    """Streams without the token are closed with 4401, whatever is asked for, and soon."""
    paths = (
        STREAM,
        "/",
        "/xela",
        "/api/v1/sensors/palm0/stream",
        "/nowhere",
        f"{STREAM}?token=x",
        f"{STREAM}?kinds=x",
    )
    tries = [(path, request(f"GET {path}", *KEY, VERSION)) for path in paths for _ in range(size.many(15))]
    for what, ending in await _all(target, tries, findings):
        findings.check((4401).to_bytes(2, "big") in ending.heard, f"{what}: {ending.told}")
