"""Both ends of a service under load, in processes of their own that start fast: they import no service."""

import asyncio
import socket
import time
from collections.abc import Callable, Sequence
from multiprocessing.connection import Connection
from multiprocessing.synchronize import Event
from struct import Struct

import uvloop
from websockets.asyncio.client import connect

from tactiled.wire import unpack

CAN_FRAME = Struct("=IB3x64s")  # of Linux, CAN FD
UDP_SEGMENT = 103  # of Linux; Python's socket module has no name for it
NEXT = '{"type": "next"}'
Ages = list[tuple[int, float]]  # sequence number, s (Unix) of arrival


def core_meter() -> Callable[[], float]:
    """How to get the cores that this process has kept busy from now on."""
    busy, began = time.process_time(), time.perf_counter()
    return lambda: (time.process_time() - busy) / (time.perf_counter() - began)


def send(
    targets: Sequence[tuple[int, int]],
    payloads: Sequence[Sequence[bytes]],
    rate_hz: float,
    span_s: float,
    results: Connection,
) -> None:
    """Send every sensor's frames, one sensor after another in a period; then the time (s) of each."""
    frames = [
        [b"".join(CAN_FRAME.pack(id_, len(data), data) for data in frame) for frame in payloads]
        for _, id_ in targets
    ]
    send_times: list[list[float]] = [[] for _ in targets]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
        out.setsockopt(socket.IPPROTO_UDP, UDP_SEGMENT, CAN_FRAME.size)  # a datagram each, in one call
        results.send("begun")
        began = time.monotonic()
        for n in range(round(span_s * rate_hz)):
            for place, (port, _) in enumerate(targets):
                due = began + (n + place / len(targets)) / rate_hz
                time.sleep(max(0.0, due - time.monotonic()))
                send_times[place].append(time.time())
                out.sendto(frames[place][n % len(payloads)], ("127.0.0.1", port))
    results.send(send_times)


def receive_all(urls: Sequence[str], pull: bool, end: Event, results: Connection) -> None:
    """Have a client for each URL; at the `end` the arrivals at each, and the cores that all kept busy."""
    uvloop.run(_receive(urls, pull, end, results))


async def _receive(urls: Sequence[str], pull: bool, end: Event, results: Connection) -> None:
    """Note when each sequence number came to each client, until `end`."""
    arrivals: list[Ages] = [[] for _ in urls]
    connected = asyncio.Barrier(len(urls) + 1)
    tasks = [
        asyncio.create_task(_client(url, pull, connected, own)) for url, own in zip(urls, arrivals, strict=True)
    ]
    await connected.wait()
    results.send("connected")
    busy_cores = core_meter()
    while not end.is_set():
        await asyncio.sleep(0.1)
    results.send((arrivals, busy_cores()))
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)


async def _client(url: str, pull: bool, connected: asyncio.Barrier, arrivals: Ages) -> None:
    async with connect(url, compression=None) as stream:
        await connected.wait()
        if pull:
            await stream.send(NEXT)
        async for data in stream:
            if isinstance(data, bytes):
                arrivals.append((unpack(data).sequence, time.time()))
                if pull:
                    await stream.send(NEXT)
