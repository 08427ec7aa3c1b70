import asyncio
import logging
import re
import signal
import socket
import ssl
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import partial

import httpx
import hypothesis
import numpy as np
import pytest

from tactiled import processes
from tactiled.bus.reader import open_bus
from tactiled.config import Server, parse
from tactiled.interop.xela import XelaClients
from tactiled.live.service import Service
from tactiled.logs import HANDLER
from tactiled.web import server
from tactiled.web.bridge import Host
from tests.process import free_port

# A shell that runs the tests in the background has them, and all that they start, ignore it.
signal.signal(signal.SIGINT, signal.default_int_handler)

BUSY_S = 60.0  # that a machine may be busy with other things
# Where other processes have every core for minutes, what waits for them all does not end in that time.
NICENESS, processes.NICENESS = processes.NICENESS, 0
hypothesis.settings.register_profile(
    "busy", deadline=None, suppress_health_check=[hypothesis.HealthCheck.too_slow]
)
hypothesis.settings.load_profile("busy")
HTTP = {"timeout": BUSY_S, "verify": ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)}  # httpx's own takes 0.1 s each
ask = partial(httpx.request, **HTTP)
BRIDGES = (XelaClients(),)
running = partial(server.running, bridges=BRIDGES)

SIDE = 8
READ, CONTROL = "r" * 16, "c" * 16
TOKENS = {"read_token": READ, "control_token": CONTROL}
NO_LOAD, GAIN = 100, 0.5  # counts, kPa a count
CONFIG = """
[bus.can0]
interface = "virtual"
channel = "{channel}"

[sensor.palm]
bus = "can0"
method = "wiener"
stale_after_s = 0.3
codec = {{ name = "packed", bits = 12, fd = true }}
array = {{ rows = 8, columns = 8, pitch_mm = 1.0 }}
cover = {{ thickness_mm = 0.8, young_mpa = 0.6, poisson = 0.48 }}
kernel = {{ model = "layered" }}
calibration = {{ kpa_per_count = 0.5, no_load = 100, noise_kpa = 0.5, saturation = 4000 }}
"""


@pytest.fixture(autouse=True)
def no_log_of_a_command():
    """A command that ran in this process logs no more: what it wrote to is another test's, or closed."""
    yield
    logging.getLogger().removeHandler(HANDLER)


class Rig:
    """A service on a virtual bus, and the other end of that bus."""

    def __init__(self, channel, more="", text=CONFIG):
        self.config = parse(text.format(channel=channel) + more, "rig")
        self.service = Service(self.config)
        self.bus = open_bus(interface="virtual", channel=channel)
        self.sensor = self.service.sensor(next(iter(self.config.sensor)))
        self.sequence = -1

    @property
    def host(self):
        return Host(self.service, self.config.server, [])

    def send(self, counts, drop=()):
        """Send one frame, some of its messages left out."""
        self.sequence += 1
        messages = self.sensor.codec.encode(np.asarray(counts, np.uint16).ravel(), self.sequence, time.time())
        for segment, message in enumerate(messages):
            if segment not in drop:
                self.bus.send(message)

    def show(self, counts):
        """Send one frame and wait for its image."""
        self.send(counts)
        until(lambda: (image := self.sensor.hub.latest()) and image.sequence == self.sequence)
        return self.sensor.hub.latest()

    def show_until_tared(self, counts):
        """Show frames until the tare under way is done, or refused; returns the last image."""
        pipeline, image = self.sensor.pipeline, None
        before = pipeline.tares.done, pipeline.tares.refused
        while (pipeline.tares.done, pipeline.tares.refused) == before:
            image = self.show(counts)
        return image

    def stale_after(self, seconds):
        """Let the palm be stale so long (s) after its newest frame, from now on."""
        self.sensor.plan = replace(self.sensor.plan, stale_after_s=seconds)

    @contextmanager
    def playing(self, rate_hz):
        """Send moving frames meanwhile."""
        stop = threading.Event()

        def play():
            while not stop.wait(1 / rate_hz):
                self.send(pressed(self.sequence % 6))

        with ThreadPoolExecutor(1) as other:
            playback = other.submit(play)
            try:
                yield self
            finally:
                stop.set()
        playback.result()


class Clock:
    """In the place of `time`, and of the event that ends what waits: to wait makes the time go on."""

    def __init__(self):
        self.now = 1000.0

    def monotonic(self):
        return self.now

    def time(self):
        return self.now

    def wait(self, seconds):
        self.now += seconds
        return False

    def is_set(self):
        return False

    def set(self):
        pass


def pressed(at=3, force=400):
    counts = np.full((SIDE, SIDE), NO_LOAD)
    counts[3:5, at : at + 2] += force
    return counts


def run_apart(coroutine, seconds=None):
    """What a coroutine gives in a loop of its own thread: on this one a browser's loop may be running."""
    with ThreadPoolExecutor(1) as other:
        return other.submit(asyncio.run, coroutine).result(seconds)


def until(true, seconds=BUSY_S):
    """Wait until this is true, and leave the cores to what is waited for."""
    began = time.monotonic()
    while not true():
        waited = time.monotonic() - began
        assert waited < seconds, "it did not happen in time"
        time.sleep(min(0.002 + waited / 50, 0.02))


@contextmanager
def turn(name):
    """Wait until no other process of this machine has this turn, and have it meanwhile."""
    with socket.socket(socket.AF_UNIX) as mine:

        def free():
            with suppress(OSError):
                mine.bind(f"\0tactiled-{name}")
            return mine.getsockname()

        until(free, 4 * BUSY_S)
        yield


@pytest.fixture
def multicast():
    """A channel between processes, ours alone: whoever hears one of them hears them all."""
    with turn("multicast"):
        yield "239.74.163.77"


@pytest.fixture
def udp_port():
    """A port of UDP that is free, so that no other test's traffic comes."""
    return free_port(socket.SOCK_DGRAM)


@contextmanager
def meanwhile(rig):
    """Have a rig's service read its bus meanwhile."""
    rig.service.start()
    try:
        yield rig
    finally:
        rig.service.stop()
        rig.bus.close()


@pytest.fixture
def rig(request):
    with meanwhile(Rig(re.sub(r"\W", "-", request.node.name))) as made:
        yield made


@pytest.fixture
def url(rig):
    with running(rig.service) as address:
        yield address


@pytest.fixture
def guarded(rig):
    """The address of a service that needs a token."""
    with running(rig.service, Server(port=0, **TOKENS)) as address:
        yield address


@pytest.fixture
def client(url):
    with httpx.Client(**HTTP, base_url=url + "/api/v1") as made:
        yield made


def problem(answer, status):
    """The detail of an answer that must be a problem of this status."""
    assert answer.status_code == status, answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    body = answer.json()
    assert body["status"] == status
    assert body["title"]
    return body["detail"]
