"""From the last CAN message of a frame to its restored image at WebSocket clients, over the virtual bus."""

import asyncio
import multiprocessing
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing.connection import Connection
from threading import Event
from typing import NamedTuple

import numpy as np
import uvloop
from numpy.typing import NDArray
from websockets.asyncio.client import connect

from tactiled.bus.reader import open_bus
from tactiled.config import Config, Server
from tactiled.frames import Message
from tactiled.runtime.service import Service
from tactiled.simulate import play
from tactiled.web.server import running
from tactiled.wire import unpack

WARM_UP_S = 2.0  # connections, caches and the measured noise settle
DRAIN_S = 0.5  # after the last frame was sent
Source = Callable[[int, float, float], list[Message]]
Arrivals = dict[int, float]  # s, by sequence number
HEADINGS = ("figure", "measured", "aim")


class Latency(NamedTuple):
    """Result of a run, without its warm-up."""

    frames: int  # sent
    ages_ms: list[NDArray[np.float64]]  # of the frames that each client received
    cores: float  # that simulator, service and server kept busy together
    client_cores: float  # that the clients kept busy
    pinned: bool  # service and clients each had a core of their own


def lines(result: Latency) -> list[tuple[str, str, str]]:
    """A table by HEADINGS."""
    many, ages = len(result.ages_ms) > 1, np.concatenate(result.ages_ms)
    p99 = max(float(np.percentile(each, 99)) for each in result.ages_ms)
    core = ", on one core" if result.pinned else ""
    received = f"{result.frames} / {min(map(len, result.ages_ms))}"
    return [
        ("median", f"{np.median(ages):.2f} ms", "" if many else "under 2 ms"),
        ("99th percentile, worst client", f"{p99:.2f} ms", "under 20 ms" if many else "under 10 ms"),
        ("worst", f"{ages.max():.2f} ms", ""),
        ("frames sent / received, worst client", received, "equal"),
        (f"simulator, service and server{core}", f"{result.cores:.2f} cores", "" if many else "under 0.5"),
        ("clients", f"{result.client_cores:.2f} cores", ""),
    ]


def measure(
    service: Service, settings: Config, source: Source, rate_hz: float, seconds: float, clients: int = 1
) -> Latency:
    """Serve the first sensor to clients, a process of their own, while `source` is sent at `rate_hz`.

    Where there are several clients and two cores to give, the clients get one and all else another.
    """
    (settings_of_bus,) = settings.bus.values()
    bus = open_bus(**settings_of_bus.settings())
    send_times: list[float] = []  # of the last message of every frame

    def frame(sequence: int, t: float, now: float) -> list[Message]:
        send_times.append(0.0)
        return source(sequence, t, now)

    def send(message: Message) -> None:
        send_times[-1] = time.time()
        bus.send(message)

    context = multiprocessing.get_context("spawn")
    receiver, sender = context.Pipe(duplex=False)
    with _pinned(clients > 1) as client_core:
        service.start()
        with running(service, Server(port=0, streams_per_client=0, streams=0)) as url:
            stream = f"{url.replace('http', 'ws', 1)}/api/v1/sensors/{next(iter(service.sensors))}/stream"
            arguments = (f"{stream}?kinds=restored", clients, sender, seconds + WARM_UP_S, client_core)
            listeners = context.Process(target=_listen, args=arguments, daemon=True)
            listeners.start()
            receiver.recv()  # connected
            busy, began = time.process_time(), time.perf_counter()
            play(frame, send, rate_hz, Event(), seconds + WARM_UP_S)
            cores = (time.process_time() - busy) / (time.perf_counter() - began)
            arrivals, client_cores = receiver.recv()
            listeners.join()
        service.stop()
    bus.close()
    numbers = range(int(WARM_UP_S * rate_hz), len(send_times))
    ages_ms = [np.array([(at[n] - send_times[n]) * 1e3 for n in numbers if n in at]) for at in arrivals]
    return Latency(len(numbers), ages_ms, cores, client_cores, client_core is not None)


@contextmanager
def _pinned(apart: bool) -> Iterator[int | None]:
    """Keep this process on one core meanwhile; give another for the clients, None where there are not two."""
    cores = sorted(os.sched_getaffinity(0)) if apart and hasattr(os, "sched_setaffinity") else []
    if len(cores) < 2:
        yield None
        return
    os.sched_setaffinity(0, cores[:1])
    try:
        yield cores[1]
    finally:
        os.sched_setaffinity(0, cores)


def _listen(url: str, clients: int, sender: Connection, seconds: float, core: int | None) -> None:
    """Note when each sequence number came to each client, for `seconds` after all are connected."""
    if core is not None:
        os.sched_setaffinity(0, [core])
    uvloop.run(_receive_all(url, clients, sender, seconds + DRAIN_S))


async def _receive_all(url: str, clients: int, sender: Connection, seconds: float) -> None:
    connected = asyncio.Barrier(clients + 1)
    arrivals: list[Arrivals] = [{} for _ in range(clients)]
    tasks = [asyncio.create_task(_receive(url, connected, each)) for each in arrivals]
    await connected.wait()
    sender.send("connected")
    busy = time.process_time()
    await asyncio.sleep(seconds)
    sender.send((arrivals, (time.process_time() - busy) / seconds))
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)


async def _receive(url: str, connected: asyncio.Barrier, arrivals: Arrivals) -> None:
    async with connect(url, compression=None) as socket:
        await connected.wait()
        async for data in socket:
            if isinstance(data, bytes):
                arrivals.setdefault(unpack(data).sequence, time.time())
