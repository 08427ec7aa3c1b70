"""The fuzzer of connections: pieces of HTTP/1.1 and WebSocket in any order, by a seeded chance.

Thousands of connections, hundreds at once; each must end within its deadline. The harness sees to it that a
bystander is served, and that descriptors and memory come back.
"""

import asyncio
import random
import time

from tests.attack import wire
from tests.attack.bystander import in_line_s, queued_s
from tests.attack.harness import DEADLINES_S, late_s
from tests.attack.service import CONTROL, READ
from tests.attack.wire import STREAM, Connection, frame, request, upgrade

AT_ONCE, ADDRESSES = 200, 16
PATIENT = 0.03  # of the connections wait until the service ends them, the others leave
MAX_PATIENT, PATIENT_AT_ONCE = 2000, 100
SHORT = 10_000  # connections: below, nobody waits for a deadline of a minute
LEAVE_S = 2.0  # that an impatient one waits for its first answer
AFTER_S, EARLY_S = 0.3, 0.1  # it leaves so long after at most; one that leaves earlier does not wait for it

PATHS = (
    "/", "/metrics", "/static/app.js", "/nowhere", "/api/v1/health", "/api/v1/sensors", "/api/v1/config", STREAM,
    "/api/v1/sensors/palm0/frames/raw", "/api/v1/events?wait=1", "/api/v1/recordings", "/" + "x" * 3000, "*", "//",
)  # fmt: skip
VERBS = ("GET", "GET", "GET", "HEAD", "POST", "PUT", "DELETE", "OPTIONS", "CONNECT", "TRACE", "get", "G\x00T", "")
HEADERS = (
    "Connection: close", "Connection: keep-alive", "Connection: Upgrade", "Upgrade: websocket", "Upgrade: h2c",
    "Expect: 100-continue", "Range: bytes=0-10,20-", "Content-Length: 0", "Content-Length: 5",
    "Content-Length: -1", "Content-Length: 99999999999999999999", "Transfer-Encoding: chunked",
    "Transfer-Encoding: gzip, chunked", "Origin: null",
    "Host: elsewhere", "Host: ", "X: " + "x" * 9000, "X\x00: y", "X : y", ": y", " folded", "Cookie: tactiled=x",
    "Content-Type: application/json", "Accept-Encoding: gzip", "If-None-Match: *", "Trailer: X",
)  # fmt: skip
CUT, SLOW = 0.4, 0.2  # how often a connection is cut somewhere, and sent slowly


def _token(rng):
    return rng.choice(("", "", READ, CONTROL, "wrong"))


def _valid(rng):
    return request(f"GET {rng.choice(PATHS[:7])}", token=_token(rng))


def _any(rng):
    headers = rng.choices(HEADERS, k=rng.choice((0, 1, 2, 5, 140)))
    return request(f"{rng.choice(VERBS)} {rng.choice(PATHS)}", *headers, token=_token(rng))


def _body(rng):
    data = rng.choice((b'{"method": "raw"}', b"{", b"", rng.randbytes(200), b"x" * 70_000))
    length = len(data) + rng.choice((0, 0, 0, 1, -1, 10**6))
    path = rng.choice(("sensors/palm0/method", "recordings", "restore?sensor=palm0", "sensors/palm0/tare"))
    headers = "Content-Type: application/json", f"Content-Length: {length}"
    return request(f"{rng.choice(('PUT', 'POST'))} /api/v1/{path}", *headers, token=_token(rng), body=data)


def _chunked(rng):
    sizes = [rng.choice((b"5", b"5;x=y", b"05", b"zz", b"-1", b"ffffffffffffffffff", b"")) for _ in range(3)]
    body = b"".join(size + b"\r\nhello\r\n" for size in sizes) + rng.choice((b"0\r\n", b"0\r\n\r\n", b""))
    body += b"X-Trailer: x\r\n" * rng.choice((0, 1, 200)) + b"\r\n"
    return request("PUT /api/v1/sensors/palm0/method", "Transfer-Encoding: chunked", token=_token(rng), body=body)


def _garbage(rng):
    return rng.choice(
        (rng.randbytes(rng.randrange(1, 300)), b"\r\n" * 20, b"\x00" * 50, b"\x16\x03\x01\x02\x00\x01")
    )


def _upgrade(rng):
    headers = rng.choices(HEADERS, k=rng.choice((0, 0, 0, 1, 3, 140)))
    path = rng.choice((STREAM, STREAM, "/", "/api/v1/sensors/palm0/stream", f"{STREAM}?flow=credit", "/nowhere"))
    made = upgrade(*headers, path=path, token=_token(rng))
    return made.replace(b"13\r\n", b"7\r\n") if rng.random() < 0.1 else made


def _frame(rng):
    data = rng.choice((b"", b"{}", b'{"type": "next"}', b"\xff", b"x" * 130, b"x" * 70_000, b"\x03\xe8"))
    opcode = rng.choice(
        (0, wire.TEXT, wire.TEXT, wire.BINARY, wire.CLOSE, wire.PING, wire.PONG, rng.randrange(16))
    )
    reserved = rng.choice((0, 0, 0, 0, 0x40, 0x10))
    return frame(opcode, data, last=rng.random() < 0.7, masked=rng.random() < 0.8, reserved=reserved)


HTTP = (_valid, _valid, _any, _body, _chunked, _garbage)


def script(rng):
    """What one connection sends, its pause (s) after each piece, and the longest state that it may end in."""
    made = [rng.choice(HTTP)] * rng.choice((0, 1, 1, 2)) + rng.choices(HTTP, k=rng.choice((0, 0, 1, 3)))
    made += [_upgrade, *[_frame] * rng.randrange(6)] if rng.random() < 0.4 or not made else []
    parts = [make(rng) for make in made]
    valid = all(make is _valid for make in made)
    data = b"".join(parts)
    complete = rng.random() > CUT
    if not complete:
        data = data[: rng.randrange(len(data) + 1)]
    state = "body" if not valid else "idle" if complete else "head"
    places = sorted(rng.randrange(len(data) + 1) for _ in range(rng.choice((0, 0, 1, 2, 8))))
    ends = zip([0, *places], [*places, len(data)], strict=True)
    pieces = tuple(data[begin:end] for begin, end in ends if end > begin)
    return pieces, 0.02 if rng.random() < SLOW else 0.0, state


async def fuzz(target, size, findings):
    """Valid and invalid pieces of HTTP/1.1 and WebSocket in any order, cut anywhere, slow or at once."""
    rng, began = random.Random(size.seed), time.monotonic()
    places, waiting = asyncio.Semaphore(AT_ONCE), asyncio.Semaphore(PATIENT_AT_ONCE)

    async def play(number, pieces, pause_s, state, patient, leave_s):
        """Play a script; a patient one gives its place to another while it waits."""
        async with places:
            try:
                source = f"127.0.1.{1 + number % ADDRESSES}"
                connection = await Connection.to(target.port, source=source, seconds=30.0)
            except wire.CONNECTION_ERRORS:
                findings.outcomes["not accepted"] += 1
                return
            await connection.send(pieces, pause_s)
            if not patient:
                if leave_s > EARLY_S:
                    await connection.ending(LEAVE_S, b"\r\n\r\n")
                ending = await connection.ending(leave_s)
        if patient:
            async with waiting:
                before = queued_s(target.process.pid)
                ending = await connection.ending(late_s("body") + 1)
            # a stream that was accepted has longer than a head
            state = "websocket" if b" 101 " in ending.received else state
            in_line = in_line_s(before, queued_s(target.process.pid))
            late = ending.how == "open" or ending.seconds - in_line > late_s(state)
            findings.check(not late, f"{state}: {ending.how} after {ending.seconds:.0f} s: {pieces}")
        findings.outcomes[str(ending)] += 1
        findings.check(ending.status != 500, f"500 to {pieces}")
        connection.cut()

    share = min(PATIENT, MAX_PATIENT / size.connections)
    async with asyncio.TaskGroup() as group:
        for number in range(size.connections):
            if time.monotonic() - began > size.seconds:
                break
            pieces, pause_s, state = script(rng)
            patient, leave_s = rng.random() < share, rng.random() * AFTER_S
            patient &= DEADLINES_S[state] <= DEADLINES_S["head"] or size.connections >= SHORT
            while places.locked():
                await asyncio.sleep(0.001)
            group.create_task(play(number, pieces, pause_s, state, patient, leave_s))
            await asyncio.sleep(0)
    count = findings.outcomes.total()
    findings.check(count >= min(size.connections, 1000), f"only {count} connections in {size.seconds:.0f} s")
