"""How much one service carries: sensors, clients and rates, in CAN FD frames as SocketCAN gives them."""

import multiprocessing
import socket
import time
from typing import Any, NamedTuple

import numpy as np

from tactiled.bench.load_ends import core_meter, receive_all, send
from tactiled.bus.codecs.packed import Packed
from tactiled.bus.socketcan import SO_TIMESTAMPNS, FrameReader
from tactiled.config import Config, Server, parse
from tactiled.errors import ConfigError
from tactiled.frames import Message
from tactiled.live.bus_thread import BusThread
from tactiled.live.sensor import Sensor
from tactiled.live.service import Service
from tactiled.simulate.playback import SCENE_S, TOUR, player
from tactiled.web.server import running

WARM_UP_S = 3.0  # connections, caches and the measured noise settle
DRAIN_S = 0.5  # after the last frame was sent
SERVER = Server(port=0, streams_per_client=0, streams=0)
SCENE_FRAMES = 128  # of each scene, at the speed at which it moves: with those of the others a multiple of 256
SENSORS_PER_BUS = 4  # more of 32 x 32 at 100 Hz do not fit on one bus of CAN FD
BUFFER_BYTES = 8 << 20  # of a bus's socket
BUS = '[bus.b{bus}]\ninterface = "socketcan"\nchannel = "load{bus}"\nfd = true\n'
SENSOR = """
[sensor.s{number}]
bus = "b{bus}"
codec = {{ name = "packed", fd = true, base_id = {id} }}
array = {{ rows = 32, columns = 32, pitch_mm = 1.0 }}
cover = {{ thickness_mm = 1.0, young_mpa = 0.6, poisson = 0.48 }}
calibration = {{ kpa_per_count = 0.05, no_load = 100 }}
"""
HEADINGS = ("arrays", "clients", "Hz", "flow", "cores", "p50 ms", "p99 ms", "sent", "lost", "unseen")


class Load(NamedTuple):
    """Result of a run, without its warm-up."""

    frames: int  # sent of each sensor
    lost: int  # messages, by the sequence numbers and the kernel's count
    ages_ms: list[np.ndarray[Any, Any]]  # of the frames that each client received, from the last message on
    cores: float  # that the service kept busy: buses, restoration, server
    client_cores: float


class FrameSocket:
    """A bus as `BusThread` reads it: SocketCAN's frames, in datagrams of loopback, which any machine has."""

    off, unsent, clock = None, 0, "kernel"

    def __init__(self, port: int = 0) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", port))
        self._socket.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER_BYTES)
        if not FrameReader.supported(self._socket):
            raise ConfigError("this measurement needs 64-bit Linux: its sockets stamp what they receive")
        self.port: int = self._socket.getsockname()[1]
        self.batch = FrameReader(self._socket.fileno()).read
        self.kinds: dict[str, int] = {}

    def set_filters(self, filters: object) -> None:
        """Nothing: only its sensors' messages come."""

    def send(self, message: Message) -> None:
        """Nothing: its skins need no message."""

    def counts(self) -> dict[str, int]:
        """Nothing goes wrong on it that the sequence numbers do not show."""
        return {}

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


def configuration(sensors: int) -> Config:
    """The configuration of so many sensors of 32 x 32."""
    buses = [n // SENSORS_PER_BUS for n in range(sensors)]
    tables = [SENSOR.format(number=n, bus=bus, id=0x100 + 16 * n) for n, bus in enumerate(buses)]
    return parse("".join(BUS.format(bus=each) for each in sorted({*buses})) + "".join(tables))


def frames_of(sensor: Sensor, rate_hz: float) -> list[list[bytes]]:
    """A part of every scene of a tour as SocketCAN has it, one list of messages each, sent over and over."""
    plan = sensor.plan
    source = player(plan.array, plan.kernel, plan.codec, plan.calibration, noise_kpa=0.2)
    times = [SCENE_S * (n + 0.25) + k / rate_hz for n in range(len(TOUR)) for k in range(SCENE_FRAMES)]
    return [[each.data for each in source.messages(n, t, 0.0)] for n, t in enumerate(times)]


def measure(sensors: int, clients: int, rate_hz: float, seconds: float, pull: bool = False) -> Load:
    """Run a service whose sensors send at `rate_hz`; client n receives sensor n modulo their number."""
    payloads = frames_of(Service(configuration(1)).sensor("s0"), rate_hz)
    context, span_s = multiprocessing.get_context("spawn"), seconds + WARM_UP_S
    (from_clients, to_received), (from_sender, to_sent) = (context.Pipe(duplex=False) for _ in range(2))
    flow, end = "&flow=credit" if pull else "", context.Event()
    service, targets = _listening(sensors)
    with service.running(), running(service, SERVER) as url:
        base, names = f"{url.replace('http', 'ws', 1)}/api/v1/sensors", list(service.sensors)
        urls = [f"{base}/{names[n % sensors]}/stream?kinds=restored{flow}" for n in range(clients)]
        receiver = context.Process(target=receive_all, args=(urls, pull, end, to_received), daemon=True)
        receiver.start()
        to_received.close()  # so that the end of a process ends the wait for it
        from_clients.recv()  # connected
        sending = targets, payloads, rate_hz, span_s, to_sent
        sender = context.Process(target=send, args=sending, daemon=True)
        sender.start()
        to_sent.close()
        from_sender.recv()  # it begins
        time.sleep(WARM_UP_S)
        busy_cores = core_meter()
        time.sleep(seconds)
        cores = busy_cores()
        send_times = from_sender.recv()
        time.sleep(DRAIN_S)
        end.set()
        arrivals, client_cores = from_clients.recv()
        lost = sum(each.status().loss.lost for each in service.sensors.values())
        for each in (sender, receiver):
            each.join()
    first = round(WARM_UP_S * rate_hz)
    ages_ms = [
        np.array([1e3 * (at - send_times[n % sensors][k]) for k, at in own if k >= first])
        for n, own in enumerate(arrivals)
    ]
    return Load(len(send_times[0]) - first, lost, ages_ms, cores, client_cores)


def _listening(sensors: int) -> tuple[Service, list[tuple[int, int]]]:
    """A service of so many sensors, and the port and id of each one's messages."""
    sockets: dict[str, FrameSocket] = {}

    def listen(name: str, settings: dict[str, Any], own: dict[str, Sensor]) -> BusThread:
        thread = BusThread(name, settings, own)
        sockets[name] = FrameSocket()
        thread._reader = sockets[name]  # type: ignore[assignment]  # open already, so it opens none
        return thread

    service = Service(configuration(sensors), listen)
    plans = [each.plan for each in service.sensors.values()]
    return service, [(sockets[each.bus].port, each.codec.id) for each in plans if isinstance(each.codec, Packed)]


def line(sensors: int, rate_hz: float, pull: bool, result: Load) -> tuple[str, ...]:
    """A row of a table by HEADINGS."""
    ages, clients = np.concatenate(result.ages_ms), len(result.ages_ms)
    p50, p99 = np.percentile(ages, (50, 99)) if ages.size else (np.nan, np.nan)
    unseen = 1 - ages.size / (clients * result.frames)
    return (
        f"{sensors}", f"{clients}", f"{rate_hz:g}", "pulled" if pull else "newest",
        f"{result.cores:.2f} + {result.client_cores:.2f}", f"{p50:.2f}", f"{p99:.2f}",
        f"{result.frames * sensors}", f"{result.lost}", f"{unseen:.2%}",
    )  # fmt: skip
