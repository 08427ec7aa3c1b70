"""The service is told to end, or is killed, while all kinds of clients are there."""

import asyncio
import contextlib
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import can

from tests.attack.bystander import queued_s
from tests.attack.connections import UPGRADES
from tests.attack.harness import Findings, Size
from tests.attack.service import CONTROL, MB, Target, trusting
from tests.attack.wire import Connection, frame, request, talk, upgrade

END_S = 2.0  # in which a service ends
MOST_END_S = 30.0  # that is waited for it
STOP = 0x20D, b"\x07\x01"  # to the board
RUN_S = 2.0  # of recording
TAKEN_S = 0.5  # in which what is on the bus is taken into a recording
LOST_S = 1.0  # of a recording, at most, by SIGKILL
RECORDINGS = "/api/v1/recordings"
FORMATS = (".log", ".asc", ".blf", ".log.gz")  # csv and others cannot be read without their end
JSON = "Content-Type: application/json"


async def sigterm(target: Target, size: Size, findings: Findings) -> None:
    """SIGTERM, as of systemd, with every kind of client."""
    del size
    await _end(target, signal.SIGTERM, findings)


async def sigint(target: Target, size: Size, findings: Findings) -> None:
    """SIGINT, as of Ctrl-C, with every kind of client and TLS."""
    del size
    await _end(target, signal.SIGINT, findings)


async def _end(target: Target, how: signal.Signals, findings: Findings) -> None:
    big = target.folder / "recordings" / "big.log"
    big.parent.mkdir(exist_ok=True)
    with big.open("wb") as file:
        file.truncate(64 * MB)
    with target.bus() as bus:
        await _record(target, 0, "a.blf", findings)
        recorded_from = time.time() + TAKEN_S
        clients = await _clients(target)
        heard = await asyncio.to_thread(_hear, bus, RUN_S)
        seen = [each for each in heard if each.timestamp > recorded_from]
        await asyncio.sleep(TAKEN_S)
        code, own_s = await asyncio.to_thread(_signalled, target, how)
        said = await asyncio.to_thread(_hear, bus, 0.3)
    for client in clients:
        client.cut()
    findings.outcomes[f"{len(clients)} clients: exit code {code}"] += 1
    findings.check(code == 0, f"exit code {code}: {target.log.read_text().splitlines()[-1]}")
    findings.check(own_s <= END_S, f"it took {own_s:.1f} s to end")
    findings.check(STOP in [(each.arbitration_id, bytes(each.data)) for each in said], "the board was not stopped")
    _whole(target.folder / "recordings" / "a.blf", seen, findings)


def _whole(path: Path, seen: list[can.Message], findings: Findings) -> None:
    """The recording can be read to its end, and has what was on the bus."""
    try:
        with can.LogReader(path) as log:
            got = [(each.arbitration_id, bytes(each.data)) for each in log]
    except Exception as error:  # readers raise what they like
        findings.fail(f"the recording: {type(error).__name__} {error}")
        return
    missing = [each for each in seen if (each.arbitration_id, bytes(each.data)) not in set(got)]
    findings.check(bool(seen), "nothing was on the bus")
    findings.check(not missing, f"the recording lacks {len(missing)} of {len(seen)} messages")


def _hear(bus: can.BusABC, seconds: float) -> list[can.Message]:
    found, end = [], time.monotonic() + seconds
    while (left := end - time.monotonic()) > 0:
        if (message := bus.recv(left)) is not None:
            found.append(message)
    return found


def _signalled(target: Target, how: signal.Signals) -> tuple[int | None, float]:
    """Exit code, and the time (s) it took without what the machine was busy with other things."""
    before, queued, began = queued_s(target.process.pid), 0.0, time.monotonic()
    target.process.send_signal(how)
    while target.process.poll() is None and time.monotonic() - began < MOST_END_S:
        now = queued_s(target.process.pid)
        queued = max([queued, *(now[each] - before.get(each, now[each]) for each in now)])
        time.sleep(0.01)
    return target.process.returncode, time.monotonic() - began - queued


async def _record(target: Target, bus: int, name: str, findings: Findings) -> None:
    body = b'{"bus": "can%d", "name": "%s"}' % (bus, name.encode())
    length = f"Content-Length: {len(body)}"
    asked = request(f"POST {RECORDINGS}", JSON, length, "Connection: close", token=CONTROL, body=body)
    ending = await talk(target.port, [asked], 30.0, tls=trusting() if target.kind.tls else None)
    findings.check(ending.status == 201, f"recording {name}: {ending.told}")


async def _clients(target: Target) -> list[Connection]:
    """Connected: two of every kind; what a client reads before the end, if anything."""
    method = "PUT /api/v1/sensors/palm0/method"
    kinds = [
        ([request("GET /api/v1/health", token=CONTROL)], b"200"),  # kept alive
        ([request("GET /", token=CONTROL)[:20]], b""),
        ([request(method, JSON, "Content-Length: 20", token=CONTROL, body=b"{")], b""),
        ([request("GET /api/v1/events?wait=30&after=9", token=CONTROL)], b""),
        ([request(f"GET {RECORDINGS}/big.log", token=CONTROL)], b"200"),  # and reads no further
        ([upgrade(token=CONTROL)], b" 101 "),  # stops reading
        ([upgrade(token=CONTROL), frame(1, b"{", last=False)], b" 101 "),
        *(([each], b"") for each in UPGRADES.values()),
        ([upgrade()], b" 101 "),  # refused
    ]
    protocol = "Sec-WebSocket-Protocol: foxglove.sdk.v1"
    others = [(target.xela, upgrade(path="/")), (target.foxglove, upgrade(protocol, path="/"))]
    tls = trusting() if target.kind.tls else None
    made = []
    for pieces, mark in kinds * 2:
        made.append(one := await Connection.to(target.port, tls=tls))
        await one.send(pieces)
        await one.until(mark, 30.0)
    for port, asked in others * 2:
        made.append(one := await Connection.to(port))
        await one.send([asked])
        await one.until(b" 101 ", 30.0)
    if target.kind.tls:
        made += [await Connection.to(target.port) for _ in range(2)]  # before their handshake
    return made


async def sigkill(target: Target, size: Size, findings: Findings) -> None:
    """SIGKILL while four buses are recorded, each in another format."""
    del size
    names = [f"a{ending}" for ending in FORMATS]
    for number, name in enumerate(names):
        await _record(target, number, name, findings)
    sent = await asyncio.to_thread(_send, target, 3.0)
    target.process.kill()
    target.process.wait()
    killed = time.monotonic()
    for name in names:
        got = list(_numbers(target.folder / "recordings" / name))
        findings.check(got == list(range(len(got))), f"{name}: not all in order")
        lost_s = killed - sent[len(got)] if len(got) < len(sent) else 0.0
        findings.outcomes[f"{name}: {1000 * lost_s:.0f} ms lost"] += 1
        findings.check(lost_s <= LOST_S and len(got) > 0, f"{name}: {lost_s:.2f} s lost")


def _numbers(path: Path) -> Iterator[int]:
    """What was numbered, as far as the file goes."""
    with can.LogReader(path) as log, contextlib.suppress(EOFError):  # of what is packed
        yield from (int.from_bytes(each.data, "big") for each in log if each.arbitration_id == 0x123)


def _send(target: Target, seconds: float) -> list[float]:
    """Numbered messages on every bus; gives when each was sent."""
    buses = [target.bus(number) for number in range(len(target.buses))]
    sent, began = [], time.monotonic()
    try:
        while time.monotonic() - began < seconds:
            data = len(sent).to_bytes(8, "big")
            sent.append(time.monotonic())
            for bus in buses:
                bus.send(can.Message(arbitration_id=0x123, is_extended_id=False, data=data))
            time.sleep(0.002)
    finally:
        for bus in buses:
            bus.shutdown()
    return sent
