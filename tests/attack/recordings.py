"""The fuzzer of uploads: real files of every kind with seeded changes, each refused or taken in bounded time.

Of those that are taken some are played. The harness sees to it that a bystander is served meanwhile.
"""

import asyncio
import gzip
import json
import random
import tempfile
import time
from pathlib import Path

import can
import numpy as np

from tactiled.calibrate.calibration_file import _checksum
from tests.attack.requests import LAST, NPY, RESTORE
from tests.attack.service import CONTROL
from tests.attack.wire import exchange, request
from tests.calibrate.files import calibration_file
from tests.web.http.raw import npy

ROOT = "/api/v1/recordings"
ENDINGS = ".log", ".asc", ".blf", ".log.gz", ".asc.gz"
CALIBRATION = "PUT /api/v1/sensors/palm0/calibration/file"
ANSWER_S = 30.0  # that an upload or a question may take on a busy machine
READ_CPU_S = 20.0  # that reading a small file may take, with other files that are read meanwhile
MESSAGES = 40
UPLOADS_SHARE = 0.03  # of the connections of the fuzzer of connections
PLAYED_SHARE = 0.05  # of those that are taken
STATUSES = (200, 201, 409, 413, 422, 429)
WORDS = [
    bytes(4),
    b"\xff\xff\xff\xff",
    b"\x00\x00\x00\x80",
    b"\x01\x00\x00\x00",
    b"LOBJ",
    b"\n\n",
    b"1e999",
    b"nan",
]
BLANK = gzip.compress(b"\n" * (64 << 20), 1)


def seeds():
    """A file of each kind: its ending, and its content, of packed ones unpacked."""
    with tempfile.TemporaryDirectory() as folder:
        for ending in ENDINGS[:3]:
            path = Path(folder) / f"a{ending}"
            with can.Logger(path) as log:
                for n in range(MESSAGES):
                    options = {"is_fd": n % 2 == 0, "is_extended_id": n % 3 == 0, "channel": 0}
                    size = 64 if n % 2 == 0 else 8
                    log(can.Message(1.7e9 + n / 100, 0x500, data=bytes([0, n % 2]).ljust(size, b"7"), **options))
            yield ending, path.read_bytes()
    yield ".npy", npy(np.zeros((4, 8, 8)))
    yield ".json", calibration_file(sensor="palm0").text.encode()


def mutated(data, rng):
    """Bytes with some changed, taken away, repeated, or replaced by words that mean something."""
    changed = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 5, 20))):
        at, size = rng.randrange(len(changed) + 1), rng.choice((1, 4, 16, 200))
        match rng.randrange(5):
            case 0:
                changed[at : at + size] = rng.randbytes(size)
            case 1:
                del changed[at : at + size]
            case 2:
                changed[at:at] = changed[at : at + size] * rng.choice((1, 3, 50))
            case 3:
                word = rng.choice(WORDS)
                changed[at : at + len(word)] = word
            case 4 if len(changed) > at > 0:
                changed[at] ^= 1 << rng.randrange(8)
    return bytes(changed)


def upload(kind, data, number, rng):
    """A request that brings a changed file, and the name under which it lies if it is taken."""
    body = mutated(data, rng)
    if kind == ".npy":
        return request(RESTORE, NPY, f"Content-Length: {len(body)}", LAST, token=CONTROL, body=body), None
    if kind == ".json":
        return _calibration(data, rng), None
    name = f"f{number}{kind}"
    if kind != ".blf" and rng.random() < 0.4:
        name, body = f"{name}.gz", gzip.compress(body)
        body = mutated(body, rng) if rng.random() < 0.3 else body
    return request(f"PUT {ROOT}/{name}", f"Content-Length: {len(body)}", LAST, token=CONTROL, body=body), name


def _calibration(data, rng):
    """A changed calibration file, without the changes where they are no JSON; its checksum is its own."""
    try:
        content = json.loads(mutated(data, rng))
        content.pop("checksum", None)
        body = json.dumps(content | {"checksum": _checksum(content)}).encode()
    except (ValueError, AttributeError, TypeError, RecursionError):
        body = mutated(data, rng)
    return request(CALIBRATION, f"Content-Length: {len(body)}", LAST, token=CONTROL, body=body)


async def ask(target, findings, line, wait_s=ANSWER_S):
    """Ask, and have an answer in time; gives its content, None where it is another than 200."""
    ending = await exchange(target.port, [request(line, LAST, token=CONTROL)], wait_s)
    findings.check(ending.how == "closed" and ending.status != 500, f"{line}: {ending}")
    return ending.received.partition(b"\r\n\r\n")[2] if ending.status == 200 else None


async def play(target, findings, name):
    """Play a recording until it is read: what reads waits for all others, and needs bounded processor time."""
    end, state, late = target.children_s() + READ_CPU_S, b'"reading":true', True
    try:
        while b'"reading":true' in state and target.children_s() < end:
            state = await ask(target, findings, f"GET {ROOT}/{name}/playback?sensor=palm0") or b""
            await asyncio.sleep(0.05)
        late = b'"reading":true' in state
    finally:  # also where the attack took too long
        findings.check(not late, f"{name} is still being read")
    findings.outcomes["played" if state else "not played"] += 1


async def fuzz(target, size, findings):
    """Changed files of every kind, a few at once; one that holds nothing, from a client that leaves."""
    rng, files, began = random.Random(size.seed), list(seeds()), time.monotonic()
    places = asyncio.Semaphore(4)
    head = request(f"PUT {ROOT}/blank.log.gz", f"Content-Length: {len(BLANK)}", token=CONTROL)
    leaving = asyncio.create_task(exchange(target.port, [head, BLANK], 1.0))

    async def send(number):
        kind, data = files[number % len(files)]
        data, name = upload(kind, data, number, rng)
        played = rng.random() < PLAYED_SHARE
        async with places:
            ending = await exchange(target.port, [data], ANSWER_S, source=f"127.0.4.{1 + number % 16}")
            findings.outcomes[f"{kind}: {ending}"] += 1
            findings.check(ending.how == "closed" and ending.status in STATUSES, f"{kind} {ending}: {data[:4000]}")
            if name and ending.status == 201:
                if played:
                    await play(target, findings, name)
                await ask(target, findings, f"DELETE {ROOT}/{name}")

    async with asyncio.TaskGroup() as group:
        for number in range(round(size.connections * UPLOADS_SHARE)):
            if time.monotonic() - began > size.seconds:
                break
            await places.acquire()
            places.release()
            group.create_task(send(number))
            await asyncio.sleep(0)
    await leaving
    listed = json.loads(await ask(target, findings, f"GET {ROOT}") or b"{}")
    findings.check(not listed.get("recordings"), f"left behind: {listed}")
