"""The system's clock is set while a service runs, as by `date -s` or a time server."""

import subprocess
import time
from pathlib import Path

import numpy as np
import pytest

from tactiled.bus.codecs.packed import Packed
from tactiled.config import parse
from tactiled.runtime.service import Service

CODEC, HALF = Packed(16, 12), 2  # messages
CONFIG = """
[bus.can0]
interface = "socketcan"
channel = "vcan0"

[sensor.palm]
bus = "can0"
method = "raw"
codec = { name = "packed", bits = 12 }
array = { rows = 4, columns = 4, pitch_mm = 1.0 }
cover = { thickness_mm = 0.8, young_mpa = 0.6, poisson = 0.48 }
kernel = { model = "layered" }
calibration = { kpa_per_count = 0.5, no_load = 0, noise_kpa = 0.5 }
"""


@pytest.fixture
def put_clock():
    """Sets the clock forward or back by so many s; it is right again afterwards."""
    if "User Mode Linux" not in Path("/proc/cpuinfo").read_text():
        pytest.skip("this test sets the clock: it runs in the kernel of kernel.py only")
    off = time.time() - time.monotonic()

    def put(by):
        subprocess.run(["date", "-s", f"@{time.time() + by:.3f}"], check=True, stdout=subprocess.DEVNULL)

    yield put
    put(off - (time.time() - time.monotonic()))


@pytest.mark.parametrize("step", [-3600.0, 3600.0])
def test_a_service_goes_on_as_if_nothing_had_happened(bus, until, put_clock, step):
    service, sender = Service(parse(CONFIG)), bus()
    sensor = service.sensor("palm")

    def send(sequence, segments=None):
        for each in CODEC.encode(np.full(16, sequence % 256, np.uint16), sequence, 0.0)[:segments]:
            sender.send(each)

    def shown(sequence):
        return lambda: (image := sensor.hub.latest()) and image.raw[0, 0] == sequence / 2

    service.start()
    try:
        for n in range(100, 110):
            send(n)
            until(shown(n))
        put_clock(step)
        for n in range(110, 120):
            send(n)
            until(shown(n))
        kept = sensor.history("raw", 1000.0, None, 1000, 10**6)
        assert len(kept.sequence) == 20
        assert abs(kept.time[-1] - kept.time[0] - step) < 600  # as the kernel stamped them
        send(120, segments=HALF)  # half a frame, and silence
        until(lambda: sensor.hub.latest().flags.any())
        time.sleep(0.5)
        send(0)  # a sender that begins anew
        until(shown(0))
        loss = sensor.hub.latest().loss
        assert (loss.late, loss.lost, loss.incomplete) == (0, CODEC.segments - HALF, 1)
        assert "sensor_down" not in {each.kind for each in service.events.after(0)}
    finally:
        service.stop()
