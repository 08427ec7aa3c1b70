"""Every attack by its name."""

import asyncio
import signal
import socket
import time
from functools import partial

import can
from can.interfaces.udp_multicast.utils import pack_message

from tests.attack import fuzz, recordings, requests, shutdown, sockets
from tests.attack.harness import Attack, each, late_s
from tests.attack.service import CONTROL, DESCRIPTORS_256, GROUP, TLS
from tests.attack.wire import BINARY, PONG, frame, upgrade

FLOOD_HZ = 91_000.0  # messages/s
FLOOD_S = 4.0


def _flood(port):
    """Send messages of the palm, out of order, of the skin and of no sensor at the rate; gives how many."""
    ids = [(0x500, bytes([0, at]) + bytes(62), True) for at in (0, 1, 1, 3)]
    ids += [(0x4D5, b"\x40" + bytes(7), False), (0x135, bytes(8), False), (0x7FF, b"", False)]
    options = {"is_extended_id": False, "timestamp": time.time()}
    messages = [can.Message(arbitration_id=id_, is_fd=fd, data=data, **options) for id_, data, fd in ids]
    datagrams = [bytes(pack_message(each)) for each in messages]
    count, began = 0, time.monotonic()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
        out.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 0)
        while (passed := time.monotonic() - began) < FLOOD_S:
            due = int(passed * FLOOD_HZ) - count
            for at in range(min(due, 1000)):
                out.sendto(datagrams[at % len(datagrams)], (GROUP, port))
            count += min(due, 1000)
            if due < 100:
                time.sleep(0.001)
    return count


async def flood(target, _, findings):
    """91 000 messages a second on the bus."""
    findings.outcomes["messages"] += await asyncio.to_thread(_flood, target.bus_port)


# Foxglove's SDK waits for a head without end, and has no limit of connections: its port is on loopback alone. What
# must hold is that the service's own port goes on.
UNBOUNDED = {"port": "foxglove", "ends": False}
CLIENT = upgrade(sockets.PROTOCOL, path="/")
LARGE = {"a message of 40 MB": [CLIENT, frame(BINARY, bytes(40 << 20))]}
ACCEPTED = {name: [upgrade(token=CONTROL), frame(PONG, b"x") + data] for name, data in sockets.FRAMES.items()}
UPGRADED = {"pause_s": 0.5, "expect": lambda ending: b" 101 " in ending.received}
UNAUTHORIZED = {"wait_s": late_s("refused"), "expect": partial(requests.closed_with, 4401)}
ATTACKS = {
    "upgrades": Attack(each(sockets.UPGRADES, 50), kind=DESCRIPTORS_256),
    "empty-frames": Attack(sockets.empty_frames, at_once=1),
    "trailers": Attack(sockets.trailers, at_once=1),
    "polls": Attack(requests.polls),
    "bad-upgrades": Attack(each(sockets.BAD_UPGRADES, 200, wait_s=1.0, ends=False), at_once=100),
    "slow": Attack(each(requests.SLOW_SENDERS, 50, pause_s=0.2)),
    "nonsense": Attack(requests.nonsense, at_once=50),
    "frames": Attack(each(ACCEPTED, 5, **UPGRADED), at_once=50),
    "handshakes": Attack(each(sockets.HANDSHAKES, 15, **UNAUTHORIZED), at_once=50),
    "tls": Attack(sockets.tls, kind=TLS, grown_mb=160),  # 0.3 MB for each connection that was open at once
    "foxglove": Attack(each(sockets.FOXGLOVE, 20, wait_s=4.0, **UNBOUNDED)),
    "foxglove-large": Attack(each(LARGE, 2, wait_s=4.0, **UNBOUNDED), grown_mb=128),
    # Its heap may keep 0.2 MB for each client that was there at once, where no attack came before.
    "foxglove-many": Attack(each({"a client": CLIENT}, 400, wait_s=4.0, **UNBOUNDED), grown_mb=128),
    "foxglove-open": Attack(each({"half a head": CLIENT[:20]}, 300, **UNBOUNDED), kind=DESCRIPTORS_256),
    "fuzz": Attack(run=fuzz.fuzz),
    "files": Attack(run=recordings.fuzz, more_descriptors=40),  # four recordings that were played stay open
    "uploads": Attack(requests.uploads),
    "bodies": Attack(requests.bodies),
    "calls": Attack(requests.calls, at_once=20),
    "flood": Attack(run=flood),
    "sigterm": Attack(run=partial(shutdown.stop, signal.SIGTERM), alone=True),
    "sigint": Attack(run=partial(shutdown.stop, signal.SIGINT), kind=TLS, alone=True),
}
