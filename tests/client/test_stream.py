import logging
import math
import re
import ssl
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from websockets.exceptions import ConnectionClosedError
from websockets.frames import Close

from tactiled.client import connect
from tactiled.client import stream as module
from tactiled.client.results import measured
from tactiled.client.stream import Inbox, Service, Stream
from tactiled.config import Server
from tactiled.errors import TactileError
from tactiled.frames import Image as Frame
from tactiled.web.server import running
from tactiled.wire import pack
from tests.conftest import BUSY_S, Clock, pressed, run_apart
from tests.skin import PALM, X, Y, rigged

ROOT = Path(__file__).parents[2]
GUIDE = ROOT / "tactiled/docs/client.md"
NO_SHEAR = "sensor 'palm': its codec packed carries no shear"


@pytest.fixture
def playing(rig):
    rig.stale_after(600)
    with rig.playing(100):
        yield rig


def first(url, **options):
    return next(connect(url).stream("palm", **{"patience_s": BUSY_S} | options))


async def afirst(url, **options):
    return await anext(connect(url).astream("palm", **{"patience_s": BUSY_S} | options))


def test_images_are_arrays_in_order_with_the_status(playing, url):
    images = []
    for image in connect(url).stream("palm", rate_hz=50, patience_s=BUSY_S):
        images.append(image)
        if len(images) == 20:
            break
    assert image.raw.shape == image.restored.shape == image.flags.shape == (8, 8)
    assert np.isfinite(image.restored).all()
    assert image.force == pytest.approx(1e-3 * image.restored.sum(), rel=1e-6)  # cells of 1 mm2, kPa
    other = run_apart(afirst(url))
    assert other.force == pytest.approx(1e-3 * other.restored.sum(), rel=1e-6)
    holes = replace(image, restored=np.where(np.arange(64).reshape(8, 8) < 16, np.nan, image.restored))
    assert math.isnan(measured(holes, {"restored": {"cell_mm": 1.0}}).force)
    mask = np.isfinite(holes.restored)  # of a layout, whose taxels feel no more
    made = measured(holes, {"restored": {"cell_mm": 2.0, "origin_mm": [1.0, 0.5], "mask": mask.tolist()}})
    assert made.force == pytest.approx(4e-3 * image.restored[mask].sum())
    assert (made.cells.side_mm, made.cells.origin_mm, made.cells.mask.tolist()) == (2.0, (1.0, 0.5), mask.tolist())
    assert (image.cells.side_mm, image.cells.origin_mm, image.cells.mask.all()) == (1.0, (0.0, 0.0), True)
    sequences = [each.sequence for each in images]
    assert sequences == sorted(set(sequences))
    assert (image.status["sensor"], image.status["state"], image.status["method"]) == ("palm", "live", "wiener")
    assert image.status["ran"]
    assert playing.sensor.status().state == "live"


PROGRAM = """
import sys, tactiled
images = tactiled.connect(sys.argv[1]).stream("palm")
next(images)
"""


@pytest.mark.usefixtures("playing")
@pytest.mark.parametrize(("end", "code"), [("", 0), ("sys.exit(3)", 3)])
def test_a_program_that_does_not_close_its_stream_ends(url, end, code):
    command = [sys.executable, "-c", PROGRAM + end, url]
    ended = subprocess.run(command, timeout=BUSY_S, capture_output=True, check=False)
    assert (ended.returncode, ended.stderr) == (code, b"")


def test_a_loop_that_pauses_gets_the_newest_image(playing, url):
    async def look():
        stream = connect(url).astream("palm", patience_s=BUSY_S)
        for _ in range(3):
            time.sleep(0.3)
            newest = playing.sensor.hub.latest().sequence if playing.sensor.hub.latest() else 0
            assert (await anext(stream)).sequence >= newest - 1
        await stream.aclose()

    run_apart(look())


@pytest.fixture
def inbox(monkeypatch):
    """The messages of several sensors, and a clock."""
    monkeypatch.setattr(module, "time", clock := Clock())
    made = Inbox({"palm": ("raw", "restored"), "tip": ("raw", "restored")})
    for name in ("palm", "tip"):
        made.take(f'{{"sensor": "{name}", "state": "live"}}')
    made.clock = clock
    return made


def put(inbox, name, sequence):
    zero = np.zeros((2, 2), np.float32)
    frame = Frame(name, sequence, 0.0, zero, zero, np.zeros((2, 2), np.uint8), "raw", "", 0, 9.0, 0.1, 1.0, 1.0)
    for kind in ("raw", "restored"):
        inbox.take(pack(frame, kind, 0.0, name))


def pop(inbox):
    image = inbox.pop()
    return image and (image.sensor, image.sequence)


def test_after_a_pause_an_old_image_waits_for_a_newer_one(inbox):
    assert len(inbox.requests()) == 2
    put(inbox, "palm", 1)
    assert pop(inbox) == ("palm", 1)
    inbox.clock.wait(5)
    inbox.ask()
    assert inbox.requests() == ['{"type": "next", "sensor": "palm"}']
    put(inbox, "tip", 1)
    assert pop(inbox) is None
    assert inbox.requests() == ['{"type": "next", "sensor": "tip"}']
    put(inbox, "palm", 500)
    assert pop(inbox) is None  # or the tip would never have its turn
    put(inbox, "tip", 500)
    assert pop(inbox) == ("tip", 500)
    inbox.ask()
    assert pop(inbox) == ("palm", 500)


def test_after_a_pause_an_old_image_is_handed_out_if_no_newer_one_comes(inbox):
    inbox.requests()
    put(inbox, "palm", 1)
    assert pop(inbox) == ("palm", 1)
    inbox.clock.wait(0.3)
    inbox.ask()
    put(inbox, "tip", 1)
    assert pop(inbox) is None
    inbox.clock.wait(inbox.wait_s())
    assert pop(inbox) == ("tip", 1)


def test_without_a_pause_no_image_waits_and_those_in_line_are_renewed(inbox):
    assert inbox.wait_s() == math.inf
    inbox.requests()
    for name in ("palm", "tip"):
        put(inbox, name, 1)
    assert inbox.requests() == []  # before the loop asks
    assert pop(inbox) == ("palm", 1)
    inbox.clock.wait(0.05)
    inbox.ask()
    assert len(inbox.requests()) == 2
    put(inbox, "palm", 5)
    put(inbox, "tip", 2)
    assert [pop(inbox), pop(inbox)] == [("tip", 2), ("palm", 5)]


@pytest.mark.usefixtures("playing")
def test_a_loop_that_pauses_a_minute_keeps_its_connection(url, monkeypatch, caplog):
    monkeypatch.setattr("tactiled.web.ws.stream.STATUS_S", 0.0)
    monkeypatch.setattr("tactiled.web.ws.stream.CHANGE_S", 0.0)
    stream = connect(url).stream("palm", patience_s=BUSY_S)
    before = next(stream)
    time.sleep(1)  # some hundred messages
    assert next(stream).sequence > before.sequence
    stream.close()
    assert not [each for each in caplog.records if each.name.startswith("tactiled.client")]
    assert module.MAX_QUEUE > 600


@pytest.mark.parametrize("path", [ROOT / "README.md", GUIDE], ids=["readme", "guide"])
@pytest.mark.usefixtures("playing")
def test_examples_of_readme_and_guide(url, capsys, path):
    lines = re.search(r"```python\nimport tactiled\n.*?```", path.read_text(), re.S)[0].splitlines()[1:-1]
    exec("\n".join(lines).replace("http://127.0.0.1:8000", url) + "\n    break\n")
    assert re.fullmatch(r"\d+ [\d.]+ kPa\n", capsys.readouterr().out)


def test_shear_comes_with_the_images_of_the_sensors_named(request, capsys):
    examples = re.findall(r"```python\n(.*?)```", GUIDE.read_text(), re.S)
    with rigged(request.node.name, PALM) as rig, running(rig.service) as url:
        client, frame = connect(url), rig.show(X, Y)
        for sensor, shear in (("skin", True), (["skin"], True), (["palm", "skin"], "skin")):
            image = next(client.stream(sensor, patience_s=BUSY_S, shear=shear))
            assert (image.sequence, image.sensor) == (frame.sequence, "skin")
            np.testing.assert_array_equal(image.shear, frame.shear)
            np.testing.assert_array_equal(image.restored, frame.restored)
            np.testing.assert_array_equal(image.raw, frame.raw)
        assert image.shear[:, 0, :2].tolist() == [[100.0, -200.0], [1.0, 2.0]]
        assert next(client.stream("skin", patience_s=BUSY_S)).shear is None
        with pytest.raises(TactileError, match=NO_SHEAR):
            next(client.stream(["palm", "skin"], patience_s=BUSY_S, shear=True))
        with pytest.raises(
            TactileError, match=f"sensor 'palm' at {url}: no image for 0.5 s: palm is silent: no frame"
        ):
            next(client.stream("palm", patience_s=0.5))
        (example,) = (each for each in examples if "shear=True" in each)
        exec(example.replace("http://127.0.0.1:8000", url) + "    break\n")
    assert re.fullmatch(r"0 1388\.0\d* counts\n", capsys.readouterr().out)


def test_a_stream_continues_when_the_service_is_back_and_logs_why_it_ended(playing, caplog):
    with running(playing.service) as url:
        stream = connect(url).stream("palm", patience_s=BUSY_S)
        before = next(stream)
    with running(playing.service, Server(port=int(url.rsplit(":", 1)[1]))):
        next(image for image in stream if image.sequence > before.sequence + 5)
    stream.close()
    assert "no connection: the service ends (1012): trying again" in caplog.text


def test_a_silent_sensor_ends_patience_and_its_state_is_logged(rig, url, caplog):
    rig.show(pressed())
    stream = connect(url).stream(["palm"], patience_s=4.0)
    next(stream)
    state = r"palm is stale: no frame for [\d.]+ s"
    with pytest.raises(TactileError, match=f"sensors palm at {url}: no image for 4.0 s: {state}"):
        next(stream)
    (message,) = [each.getMessage() for each in caplog.records if each.name == "tactiled.client"]
    assert re.fullmatch(f"sensors palm at {url}: no image: {state}: waiting", message)


def offline(patience_s=None):
    """A stream of a service that is not there."""
    return Stream(Service("https://h", {}, None), "palm", 0.0, patience_s, False)


def test_no_attempt_waits_longer_than_patience_which_begins_when_the_loop_asks(monkeypatch):
    monkeypatch.setattr(module, "time", clock := Clock())
    stream = offline(7.0)
    clock.wait(100.0)
    stream.ask()
    assert stream.wait_s() == 7.0
    refused, began = ConnectionRefusedError(111, "Connection refused"), clock.now
    while clock.now - began < 7.0:
        clock.wait(stream.failed(refused))
    with pytest.raises(TactileError, match=r"7\.0 s: Connection refused: is the service running\?"):
        stream.failed(refused)
    assert clock.now - began == 7.0
    assert stream.options()["open_timeout"] == module.MIN_CONNECT_S


def test_errors_of_a_connection_are_described():
    stream = offline()
    for error, text in (
        (ConnectionClosedError(None, None), "the connection broke"),
        (ConnectionClosedError(None, Close(1011, "keepalive ping timeout")), "keepalive ping timeout"),
        (ConnectionClosedError(Close(1009, ""), None), "closed (1009)"),
    ):
        stream.failed(error)
        assert stream._error == text
    untrusted = ssl.SSLCertVerificationError(1, "certificate verify failed: self-signed certificate")
    with pytest.raises(TactileError, match="https://h: certificate verify failed: self-signed certificate"):
        stream.failed(untrusted)
    assert not module.WEBSOCKETS_LOG.isEnabledFor(logging.ERROR)
