"""The service on buses that come and go: an adapter that is unplugged, a controller that leaves the bus."""

import gc
import os
import subprocess
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from tactiled.bus.reader import BUS_OFF_HINT, open_bus
from tactiled.config import parse
from tactiled.errors import BusError
from tactiled.runtime.service import Service

ADAPTER = "vcan8"  # a link of these tests' own
CONFIG = """
[bus.own]
interface = "socketcan"
channel = "vcan8"

[bus.other]
interface = "socketcan"
channel = "vcan0"
"""
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
BOTH = CONFIG + SENSOR.format(name="palm", bus="own") + SENSOR.format(name="twin", bus="other")
pytestmark = pytest.mark.filterwarnings(
    "ignore::ResourceWarning", "ignore::pytest.PytestUnraisableExceptionWarning"
)  # python-can leaves a socket that it could not bind to the collector, which warns


def ip(*arguments):
    sudo = [] if os.geteuid() == 0 else ["sudo"]
    subprocess.run([*sudo, "ip", "link", *arguments], check=True)


@pytest.fixture
def adapter():
    """Plugs an adapter in, or out; it is gone afterwards."""

    def plugged(there):
        if there:
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
    made = Service(parse(BOTH))
    made.start()
    yield made
    made.stop()


@pytest.fixture
def show(service, until):
    """Sends a frame of one count on a sensor's bus and waits for its image."""

    def shown(name, count, sequence=0):
        sensor = service.sensor(name)
        before = sensor.hub.latest()
        bus = open_bus(interface="socketcan", channel={"own": ADAPTER, "other": "vcan0"}[sensor.plan.bus])
        for message in sensor.codec.encode(np.full(16, count, np.uint16), sequence, time.time()):
            bus.send(message)
        bus.close()
        image = until(lambda: (now := sensor.hub.latest()) is not before and now)
        np.testing.assert_allclose(image.raw, count / 2)
        return image

    return shown


def error_frame(id_, *data):
    told = bytes(data).ljust(8, b"\0").hex()
    subprocess.run(["cansend", "vcan0", f"{0x20000000 | id_:08X}#{told}"], check=True)


def test_an_adapter_that_is_unplugged_is_told_and_used_again_when_it_is_back(service, show, adapter, until):
    first = show("palm", 100)
    assert service.sensor("palm").status().state == "live"
    adapter(False)
    until(lambda: "No such device" in service.sensor("palm").status().detail)
    status = service.sensor("palm").status()
    assert status.state == "down"
    assert status.detail.startswith(f"bus socketcan {ADAPTER}: ")
    assert "no such interface: see `ip link show type can`" in status.detail
    show("twin", 300)  # the other bus is not concerned
    adapter(True)
    until(lambda: service.sensor("palm").down is None)
    again = show("palm", 200)  # its sequence numbers start again
    assert service.sensor("palm").status().state == "live"
    assert again.sequence > first.sequence


def test_a_controller_that_leaves_the_bus_is_down_until_it_is_back(service, show, until):
    show("twin", 100)
    error_frame(0x004, 0, 0x10)
    error_frame(0x0A8)
    error_frame(0x040)
    status = until(lambda: (now := service.sensor("twin").status()).state == "down" and now)
    assert status.detail == f"bus socketcan vcan0: {BUS_OFF_HINT}"
    assert status.errors == {"rx_passive": 1, "protocol": 1, "no_ack": 1, "bus_error": 1, "bus_off": 1}
    assert (status.loss.errors, status.loss.bus_off) == (3, 1)
    assert service.sensor("palm").status().loss.errors == 0
    error_frame(0x100)
    until(lambda: service.sensor("twin").status().state == "live")
    assert service.sensor("twin").status().errors["restarted"] == 1
    image = show("twin", 200, 1)
    assert (image.loss.errors, image.loss.bus_off, image.loss.lost) == (4, 1, 0)


def test_sensors_with_the_same_ids_on_two_buses_are_two(service, show):
    for sequence in range(5):
        show("palm", 100 + sequence, sequence)
        show("twin", 300 + sequence, sequence)
    for sensor in service.sensors.values():
        assert (sensor.status().loss.lost, sensor.status().loss.foreign) == (0, 0)


def test_an_interface_that_is_not_there_at_the_start_is_named_and_nothing_runs():
    service = Service(parse(BOTH))
    threads = threading.active_count()
    with pytest.raises(BusError, match=rf"^bus socketcan {ADAPTER}: .*no such interface: see `ip link"):
        service.start()
    assert threading.active_count() == threads
    gc.collect()
