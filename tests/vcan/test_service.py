"""The whole service as its users run it: `tactiled run` on two buses, HTTP and WebSocket clients outside of it."""

import json
import re
import sys
import urllib.error
import urllib.request

import numpy as np
import pytest
from websockets.sync.client import connect

from tactiled.bus import recording
from tactiled.wire import unpack

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
TACTILED = (sys.executable, "-m", "tactiled")


@pytest.fixture
def config(tmp_path):
    path = tmp_path / "two.toml"
    path.write_text(CONFIG)
    return path


@pytest.fixture
def url(run, config, until):
    """Where the service is; it answers."""
    service = run(*TACTILED, "run", config)
    line = service.stdout.readline()
    found = re.search(r"http://\S+:\d+", line)
    assert found, line + service.communicate()[0]
    until(lambda: answers(found[0]))
    return found[0]


def answers(url):
    try:
        return fetch(f"{url}/api/v1/health")
    except urllib.error.URLError as error:
        if isinstance(error.reason, ConnectionRefusedError):
            return None
        raise


@pytest.fixture
def state(url):
    def asked(name):
        return fetch(f"{url}/api/v1/sensors/{name}")

    return asked


def fetch(address):
    with urllib.request.urlopen(address, timeout=60) as answer:
        return json.load(answer)


@pytest.fixture
def palm(run, config):
    return lambda: run(*TACTILED, "simulate", "--config", config, "--sensor", "palm", "--rate-hz", 10)


def test_two_skins_on_two_buses_reach_http_and_websocket(url, state, palm, run, until):
    palm()
    run("canplayer", "-l", "i", "vcan0=can0", "-I", recording.path("book_2"))
    until(lambda: state("palm")["state"] == state("hand")["state"] == "live")

    frame = fetch(f"{url}/api/v1/sensors/palm/frames/restored")
    assert np.shape(frame["values"]) == (12, 12)
    assert np.isfinite(np.array(frame["values"], float)).all()
    taxels = fetch(f"{url}/api/v1/sensors/hand/frames/raw")["values"]
    assert len(taxels) == 60
    assert -10 <= min(taxels) <= max(taxels) <= 12  # 245 - value, as the recording has them

    with connect(f"{url.replace('http', 'ws', 1)}/api/v1/sensors/palm/stream?kinds=restored") as stream:
        images = []
        while len(images) < 10:
            data = stream.recv(timeout=60)
            if isinstance(data, bytes):
                images.append(unpack(data))
    assert all(image.values.shape == (12, 12) for image in images)
    sequences = [image.sequence for image in images]
    assert sequences == sorted(set(sequences))
    loss = state("palm")["loss"]
    assert loss["lost"] == loss["malformed"] == loss["foreign"] == 0


def test_a_link_that_goes_down_is_told_and_a_link_that_comes_back_is_used(state, palm, until, link):
    one = palm()
    until(lambda: state("palm")["state"] == "live")
    link("vcan1", "down")
    told = until(lambda: (now := state("palm"))["state"] == "down" and now)
    assert "the interface is down: `ip link set" in told["detail"]
    assert state("hand")["state"] == "silent"  # the other bus is not concerned
    assert one.wait(60) == 2  # the simulator says so, too, and ends
    assert "the interface is down" in one.stdout.read()
    link("vcan1", "up")
    palm()
    until(lambda: (now := state("palm"))["state"] == "live" and now["sequence"] > told["sequence"])


def test_a_skin_that_falls_silent_is_stale_and_live_again_when_it_restarts(state, palm, until):
    one = palm()
    until(lambda: state("palm")["state"] == "live")
    one.terminate()
    stale = until(lambda: (now := state("palm"))["state"] == "stale" and now)
    assert stale["age_s"] > 1.5
    assert stale["rate_hz"] == 0
    palm()  # its sequence numbers start again
    until(lambda: (now := state("palm"))["state"] == "live" and now["sequence"] > stale["sequence"])


def test_times_are_the_kernels(state, until):
    until(lambda: state("palm")["clock"] == "kernel")


def test_nothing_is_served_before_the_first_frame(url, state):
    assert state("hand")["state"] == "silent"
    with pytest.raises(urllib.error.HTTPError, match="503"):
        fetch(f"{url}/api/v1/sensors/hand/frames/raw")
