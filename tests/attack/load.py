"""More of the allowed than one client should ask for: uploads, calls, messages on the bus."""

import asyncio
import io
import socket
import time

import can
import numpy as np
from can.interfaces.udp_multicast.utils import pack_message

from tests.attack.harness import Findings, Size
from tests.attack.service import CONTROL, GROUP, Target
from tests.attack.wire import Ending, request, talk

FLOOD_HZ = 91_000.0
FLOOD_S = 4.0
FILM_TYPE = "Content-Type: application/x-npy"


def film(frames: int = 4) -> bytes:
    """Frames of the palm as .npy."""
    out = io.BytesIO()
    np.save(out, np.zeros((frames, 8, 8)))
    return out.getvalue()


async def uploads(target: Target, size: Size, findings: Findings) -> None:
    """160 films at once, whole, cut in the middle, and larger than they say."""
    data = film(64)
    line = "POST /api/v1/restore?sensor=palm0"

    async def one(number: int) -> None:
        length = len(data) * (2 if number % 4 == 1 else 1)
        head = request(line, f"Content-Length: {length}", FILM_TYPE, "Connection: close", token=CONTROL)
        body = data[: len(data) // 2] if number % 4 == 2 else data
        wait_s = 30.0 if number % 4 in (0, 3) else 1.0
        ending = await talk(target.port, [head, body], wait_s, source=f"127.0.2.{1 + number % 16}")
        findings.add(("whole", "half of it", "cut", "whole")[number % 4], [ending], may_live=number % 4 in (1, 2))

    await asyncio.gather(*(one(number) for number in range(size.many(160))))


CALLS = (
    "GET /api/v1/health",
    "GET /api/v1/sensors",
    "GET /api/v1/sensors/palm0/frames/raw",
    "GET /api/v1/sensors/palm0/frames/restored?format=npy",
    "GET /api/v1/sensors/palm0/contacts",
    "GET /api/v1/config",
    "GET /metrics",
    "GET /api/v1/events",
    "GET /",
)


async def calls(target: Target, size: Size, findings: Findings) -> None:
    """1800 calls of 20 clients, each as fast as it is answered."""

    async def client(number: int) -> None:
        for call in CALLS * size.many(10):
            asked = request(call, "Connection: close", token=CONTROL)
            ending = await talk(target.port, [asked], 60.0, source=f"127.0.3.{1 + number}")
            findings.add(call.split("?")[0], [ending])

    await asyncio.gather(*map(client, range(20)))


def _datagrams() -> list[bytes]:
    """Messages as python-can packs them: of the palm, out of order, of the skin, of nobody."""
    ids = [(0x500, bytes([0, at]) + bytes(62), True) for at in (0, 1, 1, 3)]
    ids += [(0x4D5, b"\x40" + bytes(7), False), (0x135, bytes(8), False), (0x7FF, b"", False)]
    made = []
    for id_, data, fd in ids:
        message = can.Message(arbitration_id=id_, is_extended_id=False, is_fd=fd, data=data)
        message.timestamp = time.time()
        made.append(bytes(pack_message(message)))
    return made


def _flood(port: int, seconds: float) -> int:
    """Send at the rate; gives how many."""
    datagrams, sent, began = _datagrams(), 0, time.monotonic()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
        out.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 0)
        while (passed := time.monotonic() - began) < seconds:
            due = int(passed * FLOOD_HZ) - sent
            for at in range(min(due, 1000)):
                out.sendto(datagrams[at % len(datagrams)], (GROUP, port))
            sent += min(due, 1000)
            if due < 100:
                time.sleep(0.001)
    return sent


async def flood(target: Target, size: Size, findings: Findings) -> None:
    """91 000 messages a second on the bus."""
    sent = await asyncio.to_thread(_flood, target.buses[0], size.many(1) * FLOOD_S)
    findings.outcomes["messages"] += sent
    answer: Ending = await talk(
        target.port, [request("GET /api/v1/health", "Connection: close", token=CONTROL)], 30.0
    )
    findings.check(answer.status == 200, f"health: {answer.told}")
