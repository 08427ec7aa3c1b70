import threading
import time

import numpy as np
import pytest

from tactiled.bus.reader import open_bus
from tactiled.config import parse
from tactiled.errors import BusError, UnknownSensorError
from tactiled.live.service import Service
from tests.conftest import CONFIG, NO_LOAD, until


def test_several_sensors_on_several_buses(request, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))  # an empty cache
    names = [f"{request.node.name}-{n}" for n in (0, 1)]
    palm = CONFIG.format(channel=names[0])
    index = palm.partition("[sensor.palm]")[2].replace('"packed"', '"packed", array_id = 3')
    thumb = CONFIG.format(channel=names[1]).replace("can0", "can1").replace("sensor.palm", "sensor.thumb")
    both = f"{palm}{thumb}[sensor.index]{index}"
    lines = []
    service = Service(parse(both), report=lines.append)
    assert lines == ["palm: solving the cover (1 of 3)"]  # the others have the same
    ends = {"can0": open_bus("virtual", channel=names[0]), "can1": open_bus("virtual", channel=names[1])}
    with service.running():
        for n, (name, sensor) in enumerate(service.sensors.items()):
            counts = np.full(64, NO_LOAD + 20 * n, np.uint16)
            for message in sensor.codec.encode(counts, 0, time.time()):
                ends[sensor.plan.bus].send(message)
            until(service.sensor(name).hub.latest)
    for end in ends.values():
        end.close()
    assert [float(each.hub.latest().raw[0, 0]) for each in service.sensors.values()] == [0, 10, 20]
    assert service.sensor("palm").hub.latest().loss.foreign == 0
    with pytest.raises(UnknownSensorError, match="sensor 'toe': no such sensor: there are palm, thumb, index"):
        service.sensor("toe")


def test_a_bus_that_cannot_be_opened_leaves_no_thread_running():
    service = Service(parse(CONFIG.format(channel="none").replace('"virtual"', '"slcan"')))
    threads = set(threading.enumerate())  # of earlier tests, too: some may end meanwhile
    with pytest.raises(BusError, match="bus slcan none: "):
        service.start()
    assert set(threading.enumerate()) <= threads
