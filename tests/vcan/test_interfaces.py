"""The service on interfaces that come and go: an adapter that is unplugged, a controller that leaves the bus."""

import gc
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest

from tactiled.bus.reader import BUS_OFF_HINT, open_bus
from tactiled.config import parse
from tactiled.live.service import Service
from tests.vcan.conftest import ip

ADAPTER = "vcan8"  # a link of these tests' own
BUS = '[bus.{name}]\ninterface = "socketcan"\nchannel = "{channel}"\n'
SENSOR = """
[sensor.{name}]
bus = "{bus}"
method = "raw"
stale_after_s = 60
codec = {{ name = "packed", bits = 12 }}
array = {{ rows = 4, columns = 4, pitch_mm = 1.0 }}
cover = {{ thickness_mm = 0.8, young_mpa = 0.6, poisson = 0.48 }}
kernel = {{ model = "layered" }}
calibration = {{ kpa_per_count = 0.5, noise_kpa = 0.5 }}
"""
CHANNELS = {"own": ADAPTER, "other": "vcan0"}
CONFIG = "".join(BUS.format(name=name, channel=channel) for name, channel in CHANNELS.items())
CONFIG += SENSOR.format(name="palm", bus="own") + SENSOR.format(name="twin", bus="other")
pytestmark = pytest.mark.filterwarnings(
    "ignore::ResourceWarning", "ignore::pytest.PytestUnraisableExceptionWarning"
)  # python-can leaves a socket that it could not bind to the collector, which warns


@pytest.fixture
def adapter():
    """Plugs an adapter in, or out; it is gone afterwards."""

    def plugged(into):
        if into:
            ip("add", ADAPTER, "type", "vcan")
            ip("set", ADAPTER, "mtu", "16", "up")
        else:
            ip("del", ADAPTER)

    yield plugged
    if Path("/sys/class/net", ADAPTER).exists():
        plugged(False)
    gc.collect()


@pytest.fixture
def service(adapter):
    adapter(True)
    made = Service(parse(CONFIG))
    with made.running():
        yield made


@pytest.fixture
def show(service, until):
    """Sends a frame of one count on a sensor's bus and waits for its image."""

    def send_and_wait(name, count, sequence=0):
        sensor = service.sensor(name)
        before = sensor.hub.latest()
        bus = open_bus(interface="socketcan", channel=CHANNELS[sensor.plan.bus])
        for message in sensor.plan.codec.encode(np.full(16, count, np.uint16), sequence, time.time()):
            bus.send(message)
        bus.close()
        image = until(lambda: (now := sensor.hub.latest()) is not before and now)
        np.testing.assert_allclose(image.raw, count / 2)
        return image

    return send_and_wait


def send_error_frame(id_, *data):
    payload = bytes(data).ljust(8, b"\0").hex()
    subprocess.run(["cansend", "vcan0", f"{0x20000000 | id_:08X}#{payload}"], check=True)


def test_an_unplugged_adapter_is_reported_and_used_again_when_it_is_back(service, show, adapter, until):
    palm = service.sensor("palm")
    first = show("palm", 100)
    assert palm.status().state == "live"
    adapter(False)
    until(lambda: "No such device" in palm.status().detail)
    status = palm.status()
    assert status.state == "down"
    assert status.detail.startswith(f"bus socketcan {ADAPTER}: ")
    assert "no such interface: see `ip link show type can`" in status.detail
    show("twin", 300)  # the other bus, with the same ids, is not concerned
    assert service.sensor("twin").status().loss.foreign == 0
    adapter(True)
    until(lambda: palm.health.down is None)
    again = show("palm", 200)  # its sequence numbers start again
    assert palm.status().state == "live"
    assert again.sequence > first.sequence


def test_a_controller_that_leaves_the_bus_is_down_until_it_is_back(service, show, until):
    twin = service.sensor("twin")
    show("twin", 100)
    send_error_frame(0x004, 0, 0x10)
    send_error_frame(0x0A8)
    send_error_frame(0x040)
    status = until(lambda: (now := twin.status()).state == "down" and now)
    assert status.detail == f"bus socketcan vcan0: {BUS_OFF_HINT}"
    assert status.errors == {"rx_passive": 1, "protocol": 1, "no_ack": 1, "bus_error": 1, "bus_off": 1}
    assert (status.loss.errors, status.loss.bus_off) == (3, 1)
    assert service.sensor("palm").status().loss.errors == 0
    send_error_frame(0x100)
    until(lambda: twin.status().state == "live")
    assert twin.status().errors["restarted"] == 1
    image = show("twin", 200, 1)
    assert (image.loss.errors, image.loss.bus_off, image.loss.lost) == (4, 1, 0)
