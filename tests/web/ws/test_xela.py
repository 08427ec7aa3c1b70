import json
import re
import time

import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from tactiled.frames import Message
from tests.conftest import BUSY_S, Rig, meanwhile, pressed, until

SKIN = """
[sensor.skin]
bus = "can0"
method = "raw"
stale_after_s = {stale_after_s}
codec = {{ name = "xela" }}
array = {{ rows = 4, columns = 6, pitch_mm = 4.7 }}
cover = {{ thickness_mm = 0.8, young_mpa = 0.6, poisson = 0.48 }}
kernel = {{ model = "layered" }}
calibration = {{ no_load = 36000, noise_kpa = 5 }}
"""


@pytest.fixture
def rig(request):
    skin = SKIN.format(stale_after_s=0.4 if "silent" in request.node.name else 600)
    made = Rig(re.sub(r"\W", "-", request.node.name), skin if "without" not in request.node.name else "")
    with meanwhile(made):
        yield made


def counts(step):
    """X, Y and Z of 24 taxels, row by row; some are bytes that a module has sent."""
    axes = np.arange(72).reshape(24, 3) + np.array([0x3F00, 0x40E0, 0x8E00 + 0x100 * step])
    axes[1] = 0x4098, 0x3F0C, 0x9151  # SDA 4, taxel 4
    return axes


def send(rig, axes, drop=()):
    """One frame of a 4 x 6 module: ids SDA << 8 | taxel << 4 | 1, SDAs from 4 down, taxels from 5 down."""
    ids = [sda << 8 | taxel << 4 | 1 for sda in (4, 3, 2, 1) for taxel in (5, 4, 3, 2, 1, 0)]
    for place, (id_, xyz) in enumerate(zip(ids, axes, strict=True)):
        if place not in drop:
            data = bytes((0x93, *np.asarray(xyz, ">u2").tobytes(), 0x0C))
            rig.bus.send(Message(time.time(), id_, data))


def websocket(url, path):
    return connect(url.replace("http", "ws", 1) + path, compression=None)


def parsed(module):
    """(taxels, 3), as XELA's own client reads a module's part of a message."""
    values = [int(each, 16) for each in module["data"].split(",")]
    assert len(values) == 3 * module["taxels"]
    return np.reshape(values, (-1, 3))


@pytest.mark.parametrize("path", ["/xela", "/", ""])
def test_a_client_of_xelas_server_reads_what_the_module_sent(rig, url, path):
    with websocket(url, path) as client:
        assert json.loads(client.recv(timeout=BUSY_S)) == {"message": "Welcome"}
        for number in (1, 2):
            began = time.time()
            send(rig, counts(number))
            told = json.loads(client.recv(timeout=BUSY_S))
            at, rates = told.pop("time"), told["1"].pop("ups")
            assert began <= at <= told.pop("sendtime") <= time.time()
            assert len(rates) == 24
            assert set(rates) == {rates[0]}
            assert told == {
                "message": number,
                "type": "routine",
                "sensors": 1,
                "1": {
                    "sensor": "1",
                    "time": at,
                    "model": "uSPa46",
                    "taxels": 24,
                    "data": ",".join(f"{each:04X}" for each in counts(number).ravel()),
                    "integer": counts(number).ravel().tolist(),
                    "temp": [0.0] * 24,
                    "special": [[*each, *[0.0, 0, 0, 0] * 2, 0.0] for each in counts(number).tolist()],
                },
            }
            np.testing.assert_array_equal(parsed(told["1"]), counts(number))
            assert told["1"]["data"].split(",")[3:6] == ["4098", "3F0C", "9151"]


def test_a_frame_with_taxels_missing_is_not_passed_off_as_whole(rig, url):
    with websocket(url, "/xela") as client:
        client.recv(timeout=BUSY_S)
        send(rig, counts(1))
        np.testing.assert_array_equal(parsed(json.loads(client.recv(timeout=BUSY_S))["1"]), counts(1))
        send(rig, counts(2), drop=(7,))
        until(lambda: (rig.service.sensor("skin").newest.flags > 0).any())
        with pytest.raises(TimeoutError):
            client.recv(timeout=0.3)
        send(rig, counts(3))
        np.testing.assert_array_equal(parsed(json.loads(client.recv(timeout=BUSY_S))["1"]), counts(3))


def test_a_module_that_has_fallen_silent_is_shown_no_longer(rig, url):
    send(rig, counts(1))
    until(lambda: rig.service.sensor("skin").status().state == "stale")
    with websocket(url, "/xela") as client:
        client.recv(timeout=BUSY_S)
        with pytest.raises(TimeoutError):
            client.recv(timeout=1)


def test_a_service_without_xelas_modules_says_so(rig, url):
    rig.show(pressed())
    with websocket(url, "/xela") as client:
        with pytest.raises(ConnectionClosed) as caught:
            client.recv(timeout=BUSY_S)
        assert (caught.value.rcvd.code, caught.value.rcvd.reason) == (4404, "no sensor here has the codec xela")
