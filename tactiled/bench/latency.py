"""From the last CAN message of a frame to its restored image at a WebSocket client, over the virtual bus."""

import multiprocessing
import time
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from threading import Event

import numpy as np
from websockets.sync.client import connect

from tactiled.bus.reader import Reader, open_bus
from tactiled.config import Config
from tactiled.frames import Message
from tactiled.service import Service
from tactiled.simulate import play
from tactiled.web.server import running
from tactiled.web.wire import unpack

WARM_UP_S = 2.0  # connections, caches and the measured noise settle
Source = Callable[[int, float, float], list[Message]]


@dataclass(frozen=True, slots=True)
class Latency:
    """What a run measured; times in ms."""

    sent: int  # frames, after the warm-up
    received: int
    median: float
    p99: float
    worst: float
    cores: float  # that simulator, service and server kept busy together


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


def measure(service: Service, settings: Config, source: Source, rate_hz: float, seconds: float) -> Latency:
    """Serve the first sensor to one client, a process of its own, while `source` is sent at `rate_hz`."""
    (bus,) = settings.bus.values()
    bus_end = open_bus(**bus.settings())
    sender = _Sender(bus_end, source)
    context = multiprocessing.get_context("spawn")
    receive, give = context.Pipe(duplex=False)
    service.start()
    with running(service) as url:
        stream = (
            f"{url.replace('http', 'ws', 1)}/api/v1/sensors/{next(iter(service.sensors))}/stream?kinds=restored"
        )
        client = context.Process(target=_listen, args=(stream, give, seconds + WARM_UP_S), daemon=True)
        client.start()
        receive.recv()  # connected
        busy, began = time.process_time(), time.perf_counter()
        play(sender.frame, sender.send, rate_hz, Event(), seconds + WARM_UP_S)
        cores = (time.process_time() - busy) / (time.perf_counter() - began)
        arrived: dict[int, float] = receive.recv()
        client.join()
    service.stop()
    bus_end.close()
    return _summary(sender.times, arrived, int(WARM_UP_S * rate_hz), cores)


def _summary(sent: list[float], arrived: dict[int, float], first: int, cores: float) -> Latency:
    late = np.array([(arrived[n] - sent[n]) * 1e3 for n in range(first, len(sent)) if n in arrived])
    median, p99, worst = np.percentile(late, [50, 99, 100])
    return Latency(len(sent) - first, len(late), float(median), float(p99), float(worst), cores)


def _listen(url: str, give: Connection, seconds: float) -> None:
    """Note when each sequence number came, for `seconds` after the first image."""
    arrived: dict[int, float] = {}
    with connect(url) as socket:
        give.send("connected")
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            try:
                data = socket.recv(timeout=left)
            except TimeoutError:
                break
            if isinstance(data, bytes):
                arrived.setdefault(unpack(data).sequence, time.time())
    give.send(arrived)
