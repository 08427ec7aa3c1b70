"""Shear of a 3-axis skin, from its messages on the bus to the API."""

import io
import time

import httpx
import numpy as np
import pytest

from tactiled.bus.codecs.xela import REST
from tactiled.bus.reader import open_bus
from tactiled.config import parse
from tactiled.pipeline import TARE_FRAMES
from tactiled.service import Service
from tactiled.web.server import running
from tests.conftest import until

CONFIG = """
[bus.can0]
interface = "virtual"
channel = "{channel}"
[sensor.skin]
bus = "can0"
method = "raw"
stale_after_s = 600
codec = {{ name = "xela", rows = [0, 1], columns = [0, 1, 2] }}
array = {{ rows = 2, columns = 3, pitch_mm = 4.0 }}
cover = {{ thickness_mm = 2.0, young_mpa = 0.3, poisson = 0.45 }}
kernel = {{ model = "layered" }}
calibration = {{ kpa_per_count = 0.001, dead = [5] }}
"""
X, Y = np.array([100, -200, 0, 1388, -1388, 7]), np.array([1, 2, 3, 4, 5, 6])


@pytest.fixture
def skin(request):
    channel = request.node.name
    service = Service(parse(CONFIG.format(channel=channel)))
    bus = open_bus(interface="virtual", channel=channel)
    codec, sensor = service.sensor("skin").codec, service.sensor("skin")

    def show(x, y, drop=()):
        """Send frames until one of them is whole, or as whole as it can be, and served."""
        before = sensor.hub.latest().sequence if sensor.hub.latest() else -1
        for at, each in enumerate(codec.encode(np.full(6, 0x9000, np.uint16), 0, time.time())):
            axes = np.array([REST + x[at], REST + y[at]], ">u2").tobytes()
            if at not in drop:
                bus.send(each._replace(data=each.data[:1] + axes + each.data[5:]))
        until(lambda: (image := sensor.hub.latest()) and image.sequence > before)

    service.start()
    with running(service) as url, httpx.Client(base_url=url + "/api/v1/sensors") as client:
        yield show, client
    service.stop()
    bus.close()


def npy(client):
    answer = client.get("/skin/frames/shear", headers={"Accept": "application/x-npy"})
    return np.load(io.BytesIO(answer.content)), answer.headers


def test_shear_is_served_in_counts_with_the_image_it_belongs_to(skin):
    show, client = skin
    show(X, Y)
    shear, headers = npy(client)
    np.testing.assert_array_equal(shear[:, :, :2], np.stack([X, Y]).reshape(2, 2, 3)[:, :, :2])
    assert (shear.shape, shear.dtype) == ((2, 2, 3), np.float32)
    assert np.isnan(shear[:, 1, 2]).all()  # dead
    told = client.get("/skin/frames/shear").json()
    assert (told["unit"], told["state"]) == (headers["x-tactiled-unit"], "live") == ("counts", "live")
    assert told["x"] == [[100.0, -200.0, 0.0], [1388.0, -1388.0, None]]
    assert told["y"] == [[1.0, 2.0, 3.0], [4.0, 5.0, None]]
    raw = client.get("/skin/frames/raw").json()
    assert (told["sequence"], told["timestamp"]) == (raw["sequence"], raw["timestamp"])
    assert raw["unit"] == "kPa"


def test_a_taxel_that_did_not_come_has_no_shear(skin):
    show, client = skin
    show(X, Y, drop=(1,))
    shear, _ = npy(client)
    assert np.argwhere(np.isnan(shear)).tolist() == [[0, 0, 1], [0, 1, 2], [1, 0, 1], [1, 1, 2]]


def test_a_tare_takes_shear_off_as_well(skin):
    show, client = skin
    assert client.post("/skin/tare").status_code == 202
    for _ in range(TARE_FRAMES):
        show(X, Y)
    show(X + 10, Y - 20)
    shear, _ = npy(client)
    known = ~np.isnan(shear[0])
    assert set(shear[0][known]) == {10.0}
    assert set(shear[1][known]) == {-20.0}


def test_what_cannot_be_served_is_said(skin):
    show, client = skin
    assert client.get("/skin/frames/shear").status_code == 503
    show(X, Y)
    assert client.get("/skin/frames/shear", headers={"Accept": "image/png"}).status_code == 406
    assert client.get("/skin/frames/shear?format=png").status_code == 422
    assert client.get("/palm/frames/shear").status_code == 404


def test_a_skin_without_shear_says_so(url):
    answer = httpx.get(url + "/api/v1/sensors/palm/frames/shear")
    assert answer.status_code == 404
    assert answer.json()["detail"] == "sensor 'palm': its codec packed carries no shear"
