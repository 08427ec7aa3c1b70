import threading

import pytest

from tactiled.config import parse
from tactiled.errors import BusError, UnknownSensorError
from tactiled.live.service import Service
from tests.conftest import CONFIG


def test_sensors_that_are_alike_share_a_cover_and_an_unknown_one_is_named(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))  # an empty cache
    palm, lines = CONFIG.format(channel="none"), []
    index = palm.partition("[sensor.palm]")[2].replace('"packed"', '"packed", array_id = 3')
    service = Service(parse(f"{palm}[sensor.index]{index}"), report=lines.append)
    assert [line.partition(" in ")[0] for line in lines] == [
        "palm: solving the cover (1 of 2)",
        "palm: cover solved",
    ]
    with pytest.raises(UnknownSensorError, match="sensor 'toe': no such sensor: there are palm, index"):
        service.sensor("toe")


def test_a_bus_that_cannot_be_opened_leaves_no_thread_running():
    service = Service(parse(CONFIG.format(channel="none").replace('"virtual"', '"slcan"')))
    threads = set(threading.enumerate())  # of earlier tests, too: some may end meanwhile
    with pytest.raises(BusError, match="bus slcan none: "):
        service.start()
    assert set(threading.enumerate()) <= threads
