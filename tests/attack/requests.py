"""Requests that must be refused, or are more than one client should make."""

import json
import random

import numpy as np

from tests.attack.harness import Try, late_s
from tests.attack.service import CONTROL, READ
from tests.attack.wire import request, upgrade
from tests.web.http.raw import npy

JSON, NPY = "Content-Type: application/json", "Content-Type: application/x-npy"
LAST = "Connection: close"
READS = ("/", "/metrics", "/docs", *(f"/api/v1/{each}" for each in (
    "health", "sensors", "sensors/palm0", "sensors/palm0/frames/raw", "config", "events", "recordings",
    "openapi.json",
)))  # fmt: skip
METHOD, RECORD, RESTORE = (
    "PUT /api/v1/sensors/palm0/method",
    "POST /api/v1/recordings",
    "POST /api/v1/restore?sensor=palm0",
)


def closed_with(code, ending):
    """Whether a WebSocket was closed with a code, or its handshake refused."""
    return code.to_bytes(2, "big") in ending.received or ending.status in (400, code - 4000)


def _mutated(data, rng):
    """Some bytes changed, deleted or added."""
    changed = bytearray(data)
    for _ in range(rng.randrange(1, 8)):
        at = rng.randrange(len(changed) + 1)
        changed[at : at + rng.choice((0, 1, 4))] = rng.randbytes(rng.choice((0, 1, 4)))
    return bytes(changed)


def nonsense(_):
    """300 wrong bodies, headers and ranges, with the control token."""
    rng = random.Random(1)
    seeds = (
        ("JSON", METHOD, JSON, b'{"method": "raw"}'),
        ("JSON of a recording", RECORD, JSON, b'{"bus": "can9", "name": "a.log"}'),
        (".npy", RESTORE, NPY, npy(np.zeros((4, 8, 8)))),
    )
    for number in range(300):
        name, line, kind, body = seeds[number % 3]
        body = _mutated(body, rng)
        headers = kind, f"Content-Length: {len(body)}", LAST
        yield Try(name, [request(line, *headers, token=CONTROL, body=body)])
        if number % 3 == 0:
            part = f"Range: bytes={rng.randrange(10**9)}-{rng.randrange(-9, 99)},{rng.randrange(99)}-"
            yield Try("range", [request("GET /static/app.js", part, LAST, token=CONTROL)])
            yield Try("header", [_mutated(request("GET /", LAST), rng) + b"\r\n\r\n"])


def uploads(_):
    """160 uploads of frames at once, complete, cut in the middle, and larger than announced."""
    data = npy(np.zeros((64, 8, 8)))
    kinds = (  # name, announced length, body, whether the service ends it
        ("complete", len(data), data, True),
        ("half of it", 2 * len(data), data, False),
        ("cut", len(data), data[: len(data) // 2], False),
    )
    for number in range(160):
        name, length, body, ends = kinds[number % 4 % 3]
        head = request(RESTORE, f"Content-Length: {length}", NPY, LAST, token=CONTROL)
        source = f"127.0.2.{1 + number % 16}"
        yield Try(name, [head, body], 30.0 if ends else 1.0, ends=ends, source=source)


def bodies(_):
    """120 calibration files that stay incomplete, 120 MB in all, and as many bodies where none belongs."""
    for verb, token, expect in (
        ("PUT", CONTROL, lambda ending: ending.status in (0, 429, 503)),
        ("GET", READ, lambda ending: ending.status in (404, 422)),  # as another attack left a file
    ):
        head = request(f"{verb} /api/v1/sensors/palm0/calibration/file", "Content-Length: 8000000", token=token)
        ends = verb == "GET"
        tries = Try(verb, [head, bytes(1 << 20)], late_s("head") if ends else 2.0, ends=ends, expect=expect)
        yield from [tries] * 120


def calls(_):
    """1800 calls, 20 at once, each as fast as it is answered."""
    paths = (*READS, "/api/v1/sensors/palm0/frames/restored?format=npy", "/api/v1/sensors/palm0/contacts")
    for number in range(1800):
        path = paths[number % len(paths)]
        data = request(f"GET {path}", LAST, token=CONTROL)
        yield Try(path, [data], 60.0, source=f"127.0.3.{1 + number % 20}")


def polls(target):
    """400 clients of one address wait for events."""
    newest = json.loads(target.get("/api/v1/events"))["newest"]
    data = request(f"GET /api/v1/events?wait=30&after={newest}", token=CONTROL)
    yield from [Try("events?wait=30", [data], 5.0, ends=False)] * 400


SLOW_SENDERS = {  # pieces with a pause after each
    "nothing": b"",
    "a letter": b"G",
    "half a head": b"GET / HTTP/1.1\r\nHost: localhost\r\nX: ",
    "a byte at a time": [bytes([each]) for each in request("GET /", "X: " + "x" * 200)],
    "blank lines": [b"\r\n"] * 200,
    "half a body": request(METHOD, "Content-Length: 9", body=b"{"),
    "half an upgrade": upgrade()[:-2],
    "answered, then half a head": request("GET /", token=CONTROL) + b"GET ",
}
