"""The whole service as its users run it: `tactiled run` on two buses, HTTP and WebSocket clients outside of it."""

import re

import numpy as np

from tactiled.bus import recording
from tactiled.config.example import GRASP
from tests.cli.commands import TACTILED
from tests.cli.test_reload import started
from tests.conftest import BUSY_S, ask
from tests.skin import PALM
from tests.web.ws.clients import images, stream

FAST = '[server]\nport = 0\n[bus.fast]\ninterface = "socketcan"\nchannel = "vcan1"\nfd = true\n'
CONFIG = FAST + PALM.replace("can0", "fast") + GRASP.replace('channel = "can0"', 'channel = "vcan0"')
CONFIG += '[sensor.hand.kernel]\nmodel = "layered"\n'


def slower(log, folder):
    """A recording played at a tenth of its speed: the kernel of these tests has a part of one processor."""
    path = folder / "slower.log"
    path.write_text(re.sub(r"\((\S+)\)", lambda time: f"({10 * float(time[1]):.6f})", log.read_text()))
    return path


def test_two_skins_on_two_buses_reach_http_and_websocket(run, until, link, tmp_path):
    config = tmp_path / "two.toml"
    config.write_text(CONFIG.replace('method = "', 'stale_after_s = 60\nmethod = "'))

    def fetch(path):
        return ask("GET", f"{service.url}/api/v1/sensors/{path}").json()

    with started(config, tmp_path) as service:
        assert fetch("palm")["clock"] == "kernel"
        simulator = run(*TACTILED, "simulate", "--config", config, "--sensor", "palm", "--rate-hz", 5)
        assert "press Ctrl-C" in simulator.stdout.readline()  # asking in vain would slow its start
        run("canplayer", "-l", "i", "vcan0=can0", "-I", slower(recording.path("book_2"), tmp_path))
        until(lambda: fetch("palm")["state"] == fetch("hand")["state"] == "live")

        assert np.isfinite(np.array(fetch("palm/frames/restored")["values"], float)).all()
        # A machine that is busy may lose messages of a frame.
        taxels = until(lambda: None not in (values := fetch("hand/frames/raw")["values"]) and values)
        assert len(taxels) == 60
        assert -10 <= min(taxels) <= max(taxels) <= 12  # 245 - value, as the recording has them
        with stream(service.url, "?kinds=restored") as client:
            streamed = images(client, 10)
        assert all(image.values.shape == (4, 4) for image in streamed)
        sequences = [image.sequence for image in streamed]
        assert sequences == sorted(set(sequences))
        loss = fetch("palm")["loss"]
        assert loss["lost"] == loss["malformed"] == loss["foreign"] == 0

        link("vcan1", "down")
        status = until(lambda: (now := fetch("palm"))["state"] == "down" and now)
        assert "the interface is down: `ip link set" in status["detail"]
        assert fetch("hand")["state"] == "live"  # the other bus is not concerned
        assert simulator.wait(BUSY_S) == 2  # it says so, too, and ends
        assert "the interface is down" in simulator.stdout.read()
