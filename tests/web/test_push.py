"""Frames that a program pushes: by HTTP, by WebSocket, and what is refused of them."""

import time
from contextlib import closing, suppress

import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed

from tactiled.bus.assembler import assemble
from tactiled.bus.reader import open_bus
from tactiled.config import Server, parse
from tactiled.frames import Loss
from tactiled.live.service import Service
from tactiled.web.server import running
from tactiled.web.ws.push import HEADER
from tests.conftest import CONTROL, READ, TOKENS, ask, problem, until
from tests.web.ws.clients import closed, stream

CONFIG = """
[bus.can0]
interface = "virtual"
channel = "push-test"
[sensor.pad]
array = { rows = 3, columns = 5, pitch_mm = 2.0 }
cover = { thickness_mm = 0.8, young_mpa = 0.6, poisson = 0.48 }
kernel = { model = "layered" }
calibration = { kpa_per_count = 1.0, noise_kpa = 0.1 }
method = "raw"
[sensor.palm]
bus = "can0"
codec = { name = "packed" }
array = { rows = 3, columns = 5, pitch_mm = 2.0 }
cover = { thickness_mm = 0.8, young_mpa = 0.6, poisson = 0.48 }
kernel = { model = "layered" }
"""
PATH = "/api/v1/sensors/pad/push"
VALUES = np.round(np.linspace(-1.25, 90.5, 15), 2).reshape(3, 5)


@pytest.fixture(scope="module")
def service():
    service = Service(parse(CONFIG))
    with service.running():
        yield service


@pytest.fixture(scope="module")
def url(service):
    with running(service, Server(port=0, **TOKENS)) as address:
        yield address


def post(url, frame, sensor="pad", token=CONTROL):
    headers = {"Authorization": f"Bearer {token}"}
    return ask("POST", f"{url}/api/v1/sensors/{sensor}/frames", json=frame, headers=headers)


def shown(service, true):
    hub = service.sensor("pad").hub
    until(lambda: (image := hub.latest()) and true(image))
    return hub.latest()


def test_a_frame_over_http_is_served_with_its_time_and_unknown_taxels(service, url):
    rows, when = VALUES.tolist(), 1000.25
    rows[1][2] = None
    assert post(url, {"values": rows, "sequence": 70_000, "time": when}).json() == {"sequence": 70_000}
    first = shown(service, lambda image: image.time == when)
    expected = VALUES.astype(np.float32)
    expected[1, 2] = np.nan
    np.testing.assert_array_equal(first.raw, expected)
    assert [each.code for each in first.warnings] == ["missing"]
    assert post(url, {"values": VALUES.ravel().tolist()}).json() == {"sequence": 70_001}
    image = shown(service, lambda image: image.sequence == first.sequence + 1)
    np.testing.assert_array_equal(image.raw, VALUES.astype(np.float32))
    assert abs(time.time() - image.time) < 60
    assert post(url, {"values": rows, "sequence": 70_005}).status_code == 202
    image = shown(service, lambda image: image.sequence == first.sequence + 5)
    assert image.loss.lost == first.loss.lost + 3 * 2  # messages of the frames between


def test_cells_whose_taxels_a_frame_lacks_are_unknown(service, url):
    rows = [3 * [None] + [50.0, 50.0]] * 3
    assert post(url, {"values": rows, "time": 1001.0}).status_code == 202
    restored = shown(service, lambda image: image.time == 1001.0).restored
    assert np.isnan(restored[:, 0]).all()
    assert np.isfinite(restored[:, -1]).all()


def test_a_websocket_takes_json_and_bytes(service, url):
    with stream(url, f"?token={CONTROL}", PATH) as client:
        client.send(f'{{"values": {VALUES.tolist()}, "time": 2000}}')
        first = shown(service, lambda image: image.time == 2000)
        number = service.push_frame("pad", VALUES)
        client.send(HEADER.pack(123.5, number + 7, 1) + (2 * VALUES).astype("<f4").tobytes())
        image = shown(service, lambda image: image.time == 123.5)
        assert image.sequence == first.sequence + 8
        np.testing.assert_array_equal(image.raw, (2 * VALUES).astype(np.float32))
        client.send(HEADER.pack(0.0, 0, 0) + VALUES.astype("<f4").tobytes())
        assert shown(service, lambda image: image.sequence == first.sequence + 9).time > 1e9
        huge = np.where(np.arange(15).reshape(VALUES.shape) == 3, 1e20, VALUES)  # which nothing can press
        client.send(HEADER.pack(125.5, number + 20, 1) + huge.astype("<f4").tobytes())
        image = shown(service, lambda image: image.time == 125.5)
        assert np.isnan(image.raw).ravel().tolist() == [taxel == 3 for taxel in range(15)]


def test_a_recording_of_its_bus_holds_the_frame(service):
    """As recordings over REST are made, which `replay` and `export` read."""
    with closing(open_bus(**service.buses["pad"])) as reader:
        service.push_frame("pad", VALUES, 7, 3000.5)
        messages = [reader.receive(10.0) for _ in range(service.sensor("pad").codec.segments)]
    (frame,), loss = assemble(service.sensor("pad").codec, messages)
    assert (frame.time, loss) == (3000.5, Loss())
    np.testing.assert_array_equal(frame.counts, VALUES.ravel().astype(np.float32))


def test_a_program_that_pushes_as_fast_as_it_can_waits_and_images_stay_new(service):
    service.push_frame("pad", VALUES, 80_000, 0.0)
    shown(service, lambda image: image.time == 0.0)
    shown_late = []
    for n in range(1, 500):
        service.push_frame("pad", VALUES, 80_000 + n, float(n))
        shown_late.append(n - service.sensor("pad").newest.time)
    queue = service.buses["pad"]["rx_queue_size"] / service.sensor("pad").codec.segments
    assert max(shown_late) <= queue + 3  # frames; two more are in the hands of either end
    shown(service, lambda image: image.time == 499.0)


@pytest.mark.parametrize(
    ("frame", "detail"),
    [
        ({"values": [[1.0] * 5] * 2}, "values: shape (2, 5) for sensor pad: give 3 x 5, or 15 in a list"),
        ({"values": [[1.0] * 5, [1.0] * 4]}, "values: rows of different lengths"),
        ({"values": [1.0] * 15, "sequence": -1}, "sequence = -1"),
        ({"values": [1.0] * 15, "time": 1e12}, "time = 1000000000000.0"),
        ({"values": [1.1e9] * 15}, "values[0] = 1100000000.0: Input should be less than or equal to 1000000000"),
        ({"values": [1.0, "x"]}, "values[1] = 'x': "),
    ],
)
def test_wrong_frames_are_refused(url, frame, detail):
    assert problem(post(url, frame), 422).startswith(detail)


@pytest.mark.parametrize("values", [[1.0] * 15, [[1.0] * 5, [1.0] * 4]])
def test_frames_of_a_sensor_that_reads_a_bus_are_refused(url, values):
    assert problem(post(url, {"values": values}, "palm"), 409).startswith("sensor 'palm': reads bus can0")


def test_the_control_token_is_needed(url):
    assert "control token" in problem(post(url, {"values": VALUES.tolist()}, token=READ), 403)
    with stream(url, f"?token={READ}", PATH) as client:
        assert closed(client) == (4403, "this token reads only: show the control token to change anything")


@pytest.mark.parametrize(
    ("path", "message", "code", "reason"),
    [
        ("pad", b"\0" * 18, 4400, "18 bytes: give 16 and four for each taxel"),
        ("pad", HEADER.pack(-1.0, 0, 0) + bytes(60), 4400, "time = -1"),
        ("pad", HEADER.pack(0.0, 0, 0) + bytes(56), 4400, "values: shape (14,) for sensor pad"),
        ("pad", '{"value": []}', 4400, "values: missing"),
        ("pad", '{"values": "a"}', 4400, "values: Input should be a valid array"),
        ("palm", "", 4400, "sensor 'palm': reads bus can0"),
        ("pat", "", 4404, "sensor 'pat': no such sensor"),
    ],
)
def test_a_wrong_message_ends_the_websocket_with_its_reason(url, path, message, code, reason):
    with stream(url, f"?token={CONTROL}", f"/api/v1/sensors/{path}/push") as client:
        with suppress(ConnectionClosed):  # before anything is sent
            client.send(message)
        got = closed(client)
        assert got[0] == code
        assert got[1].startswith(reason)
