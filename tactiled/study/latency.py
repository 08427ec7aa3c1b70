"""From the last CAN message of a frame to its restored image at WebSocket clients, over the virtual bus."""

import asyncio
import multiprocessing
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.connection import Connection
from threading import Event

import numpy as np
import uvloop
from numpy.typing import NDArray
from websockets.asyncio.client import connect

from tactiled.bus.reader import Reader, open_bus
from tactiled.config import Config, Server
from tactiled.frames import Message
from tactiled.runtime.service import Service
from tactiled.simulate import play
from tactiled.web.server import running
from tactiled.wire import unpack

WARM_UP_S = 2.0  # connections, caches and the measured noise settle
LAST_S = 0.5  # that the last image may take
Source = Callable[[int, float, float], list[Message]]
Arrivals = dict[int, float]  # s, by sequence number


@dataclass(frozen=True, slots=True)
class Latency:
    """What a run measured; times in ms."""

    sent: int  # frames, after the warm-up
    received: int  # by the client that received fewest
    median: float  # over all clients
    p99: float  # of the client whose is worst
    worst: float
    cores: float  # that simulator, service and server kept busy together
    client_cores: float  # that the clients kept busy
    pinned: bool  # service and clients each had a core of their own


class _Sender:
    """Notes when the last message of every frame went out."""

    def __init__(self, bus: Reader, source: Source) -> None:
        self._bus, self._source = bus, source
        self.times: list[float] = []

    def frame(self, sequence: int, t: float, now: float) -> list[Message]:
        self.times.append(0.0)
        return self._source(sequence, t, now)

    def send(self, message: Message) -> None:
        self.times[-1] = time.time()
        self._bus.send(message)


def measure(
    service: Service, settings: Config, source: Source, rate_hz: float, seconds: float, clients: int = 1
) -> Latency:
    """Serve the first sensor to clients, a process of their own, while `source` is sent at `rate_hz`.

    Where there are several clients and two cores to give, the clients get one and all else another.
    """
    (bus,) = settings.bus.values()
    bus_end = open_bus(**bus.settings())
    sender = _Sender(bus_end, source)
    context = multiprocessing.get_context("spawn")
    receive, give = context.Pipe(duplex=False)
    with _pinned(clients > 1) as spare:
        service.start()
        with running(service, Server(port=0, streams_per_client=0, streams=0)) as url:
            name = next(iter(service.sensors))
            stream = f"{url.replace('http', 'ws', 1)}/api/v1/sensors/{name}/stream?kinds=restored"
            listeners = context.Process(
                target=_listen, args=(stream, clients, give, seconds + WARM_UP_S, spare), daemon=True
            )
            listeners.start()
            receive.recv()  # connected
            busy, began = time.process_time(), time.perf_counter()
            play(sender.frame, sender.send, rate_hz, Event(), seconds + WARM_UP_S)
            cores = (time.process_time() - busy) / (time.perf_counter() - began)
            arrived, client_cores = receive.recv()
            listeners.join()
        service.stop()
    bus_end.close()
    late = _late(sender.times, arrived, int(WARM_UP_S * rate_hz))
    return Latency(
        sent=len(sender.times) - int(WARM_UP_S * rate_hz),
        received=min(len(each) for each in late),
        median=float(np.median(np.concatenate(late))),
        p99=max(float(np.percentile(each, 99)) for each in late),
        worst=max(float(each.max()) for each in late),
        cores=cores,
        client_cores=client_cores,
        pinned=spare is not None,
    )


def _late(sent: list[float], arrived: list[Arrivals], first: int) -> list[NDArray[np.float64]]:
    """How old (ms) each image was at each client."""
    return [np.array([(at[n] - sent[n]) * 1e3 for n in range(first, len(sent)) if n in at]) for at in arrived]


@contextmanager
def _pinned(wanted: bool) -> Iterator[int | None]:
    """Keep this process on one core meanwhile; gives another for the clients, None where there are not two."""
    cores = sorted(os.sched_getaffinity(0)) if wanted and hasattr(os, "sched_setaffinity") else []
    if len(cores) < 2:
        yield None
        return
    os.sched_setaffinity(0, cores[:1])
    try:
        yield cores[1]
    finally:
        os.sched_setaffinity(0, cores)


def _listen(url: str, clients: int, give: Connection, seconds: float, core: int | None) -> None:
    """Note when each sequence number came to each client, for `seconds` after all are connected."""
    if core is not None:
        os.sched_setaffinity(0, [core])
    uvloop.run(_all(url, clients, give, seconds))


async def _all(url: str, clients: int, give: Connection, seconds: float) -> None:
    connected = asyncio.Barrier(clients + 1)
    arrived: list[Arrivals] = [{} for _ in range(clients)]
    tasks = [asyncio.create_task(_one(url, connected, each)) for each in arrived]
    await connected.wait()
    give.send("connected")
    busy = time.process_time()
    await asyncio.sleep(seconds + LAST_S)
    cores = (time.process_time() - busy) / (seconds + LAST_S)
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)
    give.send((arrived, cores))


async def _one(url: str, connected: asyncio.Barrier, arrived: Arrivals) -> None:
    async with connect(url, compression=None) as socket:
        await connected.wait()
        async for data in socket:
            if isinstance(data, bytes):
                arrived.setdefault(unpack(data).sequence, time.time())
