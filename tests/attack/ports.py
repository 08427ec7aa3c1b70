"""Attacks on TLS and on the port of Foxglove's apps."""

import asyncio
import contextlib
import ssl
import subprocess

from tests.attack.harness import Findings, Size, late_s
from tests.attack.service import CONTROL, HOST, Target, trusting
from tests.attack.wire import BINARY, Connection, frame, request, talk, upgrade

PROTOCOL = "Sec-WebSocket-Protocol: foxglove.sdk.v1"


def hello() -> bytes:
    """The first bytes of a TLS client."""
    sent = ssl.MemoryBIO()
    client = trusting().wrap_bio(ssl.MemoryBIO(), sent, server_hostname="localhost")
    with contextlib.suppress(ssl.SSLWantReadError):
        client.do_handshake()
    return sent.read()


async def tls(target: Target, size: Size, findings: Findings) -> None:
    """Handshakes that are slow, half, none or garbage, 300 at once; then what comes behind a good one."""
    whole = hello()
    broken = {
        "nothing": ([b""], 0.0),
        "half": ([whole[: len(whole) // 2]], 0.0),
        "a byte at a time": ([whole[at : at + 1] for at in range(len(whole))], 0.1),
        "no end": ([whole], 0.0),
        "plain HTTP": ([request("GET /", token=CONTROL)], 0.0),
        "garbage": ([bytes(range(256)) * 16], 0.0),
        "changed": ([whole[:40] + bytes(64) + whole[104:]], 0.0),
        "twice": ([whole, whole], 0.0),
    }

    async def one(name: str) -> None:
        pieces, pause_s = broken[name]
        findings.add(name, [await talk(target.port, pieces, late_s("head"), pause_s=pause_s)])

    async def behind(what: str, data: bytes) -> None:
        findings.add(what, [await talk(target.port, [data], late_s("head"), tls=trusting())])

    for _ in range(size.factor):
        tries = [one(name) for name in broken for _ in range(38)]
        tries += [behind("garbage behind it", bytes(range(256))) for _ in range(20)]
        tries += [behind("half a head behind it", b"GET / HT") for _ in range(20)]
        await asyncio.gather(*tries)
    await asyncio.gather(*(_cut(target, whole, at) for at in range(0, len(whole), 8)))
    findings.outcomes["cut in the middle"] += len(range(0, len(whole), 8))
    await asyncio.to_thread(_renegotiate, target, size.many(5), findings)


async def _cut(target: Target, whole: bytes, at: int) -> None:
    """Leave in the middle of a handshake."""
    one = await Connection.to(target.port)
    await one.send([whole[:at]])
    one.cut()


def _renegotiate(target: Target, times: int, findings: Findings) -> None:
    """Ask for another handshake on the same connection."""
    command = ["openssl", "s_client", "-connect", f"{HOST}:{target.port}", "-tls1_2", "-legacy_renegotiation"]
    for _ in range(times):
        done = subprocess.run(command, input=b"R\nR\n", capture_output=True, timeout=60)
        refused = b"no renegotiation" in done.stdout + done.stderr
        findings.outcomes[f"renegotiation: {'refused' if refused else 'unheard'}"] += 1
        findings.check(b"DONE" not in done.stdout, "renegotiation was taken")


FOXGLOVE = {
    "nothing": [b""],
    "half a head": [b"GET / HTTP/1.1\r\nX: "],
    "garbage": [bytes(range(256)) * 64],
    "plain HTTP": [request("GET /")],
    "no protocol": [upgrade(path="/")],
    "140 headers": [upgrade(PROTOCOL, *(f"X-{number}: x" for number in range(140)), path="/")],
    "head without end": [b"GET / HTTP/1.1\r\n", *[b"X: " + b"x" * 8000 + b"\r\n"] * 200],
    "a message of 40 MB": [upgrade(PROTOCOL, path="/"), frame(BINARY, bytes(40 << 20))],
    "a frame of 2^63": [upgrade(PROTOCOL, path="/"), b"\x82\xff" + b"\x7f" + b"\xff" * 7 + bytes(4)],
    "nonsense": [upgrade(PROTOCOL, path="/"), frame(1, b'{"op": "subscribe", "subscriptions": 1e999}')],
}


async def foxglove(target: Target, size: Size, findings: Findings) -> None:
    """Foxglove's port, which asks for no token: garbage, slow heads, large messages, and 400 connections."""

    async def one(name: str) -> None:
        findings.add(name, [await talk(target.foxglove, FOXGLOVE[name], 4.0)], may_live=True)

    names = [name for name in FOXGLOVE for _ in range(size.many(2 if "40 MB" in name else 20))]
    await asyncio.gather(*map(one, names))
    asked = [upgrade(PROTOCOL, path="/")]
    tries = (talk(target.foxglove, asked, 4.0) for _ in range(size.many(400)))
    findings.add("400 clients", await asyncio.gather(*tries), may_live=True)


async def foxglove_open(target: Target, size: Size, findings: Findings) -> None:
    """300 connections that say nothing at Foxglove's port, of a service that may have 256 descriptors.

    The SDK waits for a head without end, and has no limit of connections: the port is on loopback alone. What must
    hold is that the service's own port goes on.
    """
    tries = (talk(target.foxglove, [b"GET / HTTP/1.1\r\n"], late_s("head")) for _ in range(size.many(300)))
    findings.add("half a head", await asyncio.gather(*tries), may_live=True)
