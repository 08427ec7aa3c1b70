"""The system's clock is set while a service runs, as by `date -s` or a time server."""

import subprocess
import time

import numpy as np
import pytest

from tactiled.bus.codecs.packed import Packed
from tactiled.config import parse
from tactiled.live.service import Service
from tests.vcan.conftest import OWN_KERNEL
from tests.vcan.test_interfaces import BUS, SENSOR

CODEC, HALF = Packed(16, 12), 2  # messages
CONFIG = BUS.format(name="can0", channel="vcan0") + SENSOR.format(name="palm", bus="can0")


@pytest.fixture
def put_clock():
    """Sets the clock forward or back by so many s; it is right again afterwards."""
    if not OWN_KERNEL:
        pytest.skip("this test sets the clock: it runs in the kernel of kernel.py only")
    off = time.time() - time.monotonic()

    def put(by):
        subprocess.run(["date", "-s", f"@{time.time() + by:.3f}"], check=True, stdout=subprocess.DEVNULL)

    yield put
    put(off - (time.time() - time.monotonic()))


@pytest.mark.parametrize("step", [-3600.0, 3600.0])
def test_a_service_is_not_disturbed_by_a_step_of_the_clock(bus, until, put_clock, step):
    service, sender = Service(parse(CONFIG)), bus()
    sensor = service.sensor("palm")

    def send(sequence, segments=None):
        for each in CODEC.encode(np.full(16, sequence % 256, np.uint16), sequence, 0.0)[:segments]:
            sender.send(each)

    def show(sequence):
        send(sequence)
        until(lambda: (image := sensor.hub.latest()) and image.raw[0, 0] == sequence / 2)

    with service.running():
        for n in range(100, 110):
            show(n)
        put_clock(step)
        for n in range(110, 120):
            show(n)
        history = sensor.history.page("raw", 1000.0, None, 1000, 10**6)
        assert len(history.sequence) == 20
        assert abs(history.time[-1] - history.time[0] - step) < 600  # as the kernel stamped them
        send(120, segments=HALF)  # half a frame, and silence
        until(lambda: sensor.hub.latest().flags.any())
        time.sleep(0.5)
        show(0)  # a sender that restarts
        loss = sensor.hub.latest().loss
        assert (loss.late, loss.lost, loss.incomplete) == (0, CODEC.segments - HALF, 1)
        assert "sensor_down" not in {each.kind for each in service.events.after(0)}
