"""The service is stopped while all kinds of clients are there."""

import asyncio
import time

import can

from tests.attack.bystander import queued_s
from tests.attack.requests import JSON, METHOD
from tests.attack.service import CONTROL, GROUP
from tests.attack.sockets import PROTOCOL, UPGRADES
from tests.attack.wire import Connection, exchange, frame, request, upgrade

END_S = 2.0  # in which a service ends
TIMEOUT_S = 30.0  # that the end is waited for
STOP = 0x20D, b"\x07\x01"  # to the board
RECORD_S = 2.0
RECORD_DELAY_S = 0.5  # from a message on the bus to the recording, at most
RECORDINGS = "/api/v1/recordings"
BODY = b'{"bus": "can0", "name": "a.blf"}'
HEADERS = JSON, f"Content-Length: {len(BODY)}", "Connection: close"
RECORD = request(f"POST {RECORDINGS}", *HEADERS, token=CONTROL, body=BODY)


async def stop(how, target, _, findings):
    """A signal while every kind of client is there."""
    large = target.folder / "recordings" / "large.log"
    large.parent.mkdir(exist_ok=True)
    with large.open("wb") as file:
        file.truncate(64 << 20)
    options = {"interface": "udp_multicast", "channel": GROUP, "hop_limit": 0, "fd": True}
    with can.Bus(port=target.bus_port, **options) as bus:
        ending = await exchange(target.port, [RECORD], 30.0, tls=target.tls)
        findings.check(ending.status == 201, f"recording: {ending}")
        recorded_from = time.time() + RECORD_DELAY_S
        clients = await _clients(target)
        messages = await asyncio.to_thread(_receive, bus, RECORD_S)
        await asyncio.sleep(RECORD_DELAY_S)
        code, own_s = await asyncio.to_thread(_signal, target, how)
        last = await asyncio.to_thread(_receive, bus, 0.3)
    for client in clients:
        client.cut()
    findings.outcomes[f"{len(clients)} clients: exit code {code}"] += 1
    findings.check(code == 0, f"exit code {code}: {target.log.read_text().splitlines()[-1]}")
    findings.check(own_s <= END_S, f"it took {own_s:.1f} s to end")
    findings.check(STOP in map(_content, last), "the board was not stopped")
    with can.LogReader(target.folder / "recordings" / "a.blf") as log:
        recorded = set(map(_content, log))
    due = {_content(each) for each in messages if each.timestamp > recorded_from}
    findings.check(bool(due), "no message on the bus")
    findings.check(due <= recorded, f"the recording lacks {len(due - recorded)} of {len(due)} messages")


def _content(message):
    return message.arbitration_id, bytes(message.data)


def _receive(bus, seconds):
    messages, end = [], time.monotonic() + seconds
    while (remaining := end - time.monotonic()) > 0:
        if (message := bus.recv(remaining)) is not None:
            messages.append(message)
    return messages


def _signal(target, how):
    """Exit code, and the time (s) it took without what the machine was busy with other things."""
    before, queued, began = queued_s(target.process.pid), 0.0, time.monotonic()
    target.process.send_signal(how)
    while target.process.poll() is None and time.monotonic() - began < TIMEOUT_S:
        now = queued_s(target.process.pid)
        queued = max([queued, *(now[each] - before.get(each, now[each]) for each in now)])
        time.sleep(0.01)
    return target.process.returncode, time.monotonic() - began - queued


async def _clients(target):
    """Two connected clients of every kind."""
    upgraded = b" 101 "
    kinds = [  # pieces, what a client reads before the end, port
        ([request("GET /api/v1/health", token=CONTROL)], b"200", "port"),  # kept alive
        ([request("GET /", token=CONTROL)[:20]], b"", "port"),
        ([request(METHOD, JSON, "Content-Length: 20", token=CONTROL, body=b"{")], b"", "port"),
        ([request("GET /api/v1/events?wait=30&after=9", token=CONTROL)], b"", "port"),
        ([request(f"GET {RECORDINGS}/large.log", token=CONTROL)], b"200", "port"),  # and reads no further
        ([upgrade(token=CONTROL)], upgraded, "port"),  # stops reading
        ([upgrade(token=CONTROL), frame(1, b"{", last=False)], upgraded, "port"),
        *(([each], b"", "port") for each in UPGRADES.values()),
        ([upgrade()], upgraded, "port"),  # refused
        ([upgrade(path="/")], upgraded, "xela"),
        ([upgrade(PROTOCOL, path="/")], upgraded, "foxglove"),
    ]
    clients = []
    for pieces, mark, port in kinds * 2:
        tls = target.tls if port == "port" else None
        clients.append(client := await Connection.to(getattr(target, port), tls=tls))
        await client.send(pieces)
        await client.ending(30.0, mark)
    if target.tls:
        clients += [await Connection.to(target.port) for _ in range(2)]  # before their handshake
    return clients
