"""The whole service as its users run it: `tactiled run` on two buses, HTTP and WebSocket clients outside of it."""

import json
import re
import urllib.error
import urllib.request
from contextlib import suppress

import numpy as np
from websockets.sync.client import connect

from tactiled.bus import recording
from tactiled.wire import unpack
from tests.cli.commands import TACTILED

CONFIG = """
[server]
port = 0

[bus.fast]
interface = "socketcan"
channel = "vcan1"
fd = true

[bus.slow]
interface = "socketcan"
channel = "vcan0"

[sensor.palm]
bus = "fast"
stale_after_s = 1.5
codec = { name = "packed", fd = true }
array = { rows = 12, columns = 12, pitch_mm = 1.0 }
cover = { thickness_mm = 0.8, young_mpa = 0.6, poisson = 0.48 }
kernel = { model = "layered" }
calibration = { kpa_per_count = 0.05, no_load = 80, noise_kpa = 0.1 }

[sensor.hand]
bus = "slow"
stale_after_s = 1.5
codec = { name = "icub", board = 14, triangles = [0, 1, 2, 3, 4], thermal_pads = false }
array = { aperture_mm = 3.6 }
cover = { thickness_mm = 2.0, young_mpa = 0.3, poisson = 0.45 }
kernel = { model = "layered" }
calibration = { no_load = 245 }
"""


def fetch(url, path):
    with urllib.request.urlopen(f"{url}/api/v1/sensors/{path}", timeout=60) as answer:
        return json.load(answer)


def answers(url):
    with suppress(urllib.error.URLError):
        return fetch(url, "palm")
    return None


def test_two_skins_on_two_buses_reach_http_and_websocket(run, until, link, tmp_path):
    config = tmp_path / "two.toml"
    config.write_text(CONFIG)
    service = run(*TACTILED, "run", config)
    line = next(line for line in service.stdout if "http" in line)  # those before it tell what takes time
    url = re.search(r"http://\S+:\d+", line)[0]
    until(lambda: answers(url))
    assert fetch(url, "palm")["clock"] == "kernel"
    simulator = run(*TACTILED, "simulate", "--config", config, "--sensor", "palm", "--rate-hz", 10)
    run("canplayer", "-l", "i", "vcan0=can0", "-I", recording.path("book_2"))
    until(lambda: fetch(url, "palm")["state"] == fetch(url, "hand")["state"] == "live")

    frame = fetch(url, "palm/frames/restored")
    assert np.shape(frame["values"]) == (12, 12)
    assert np.isfinite(np.array(frame["values"], float)).all()
    taxels = fetch(url, "hand/frames/raw")["values"]
    assert len(taxels) == 60
    assert -10 <= min(taxels) <= max(taxels) <= 12  # 245 - value, as the recording has them

    images = []
    with connect(f"{url.replace('http', 'ws', 1)}/api/v1/sensors/palm/stream?kinds=restored") as stream:
        while len(images) < 10:
            data = stream.recv(timeout=60)
            if isinstance(data, bytes):
                images.append(unpack(data))
    assert all(image.values.shape == (12, 12) for image in images)
    sequences = [image.sequence for image in images]
    assert sequences == sorted(set(sequences))
    loss = fetch(url, "palm")["loss"]
    assert loss["lost"] == loss["malformed"] == loss["foreign"] == 0

    link("vcan1", "down")
    status = until(lambda: (now := fetch(url, "palm"))["state"] == "down" and now)
    assert "the interface is down: `ip link set" in status["detail"]
    assert fetch(url, "hand")["state"] == "live"  # the other bus is not concerned
    assert simulator.wait(60) == 2  # it says so, too, and ends
    assert "the interface is down" in simulator.stdout.read()
