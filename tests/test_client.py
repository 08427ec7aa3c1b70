import asyncio
import re
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from pydantic import SecretStr
from websockets.sync.server import serve

from tactiled.client import TOO_MANY, connect
from tactiled.config import Server
from tactiled.errors import ConfigError, TactileError
from tactiled.web.server import running
from tests.conftest import BUSY_S, pressed, until
from tests.skin import X, Y, rigged

FEW = 8  # images that may be on their way to a client
README = Path(__file__).parents[1] / "README.md"


@pytest.fixture
def playing(rig):
    stop = threading.Event()
    rig.stale_after(600)
    sender = rig.play(100, stop)
    yield rig
    stop.set()
    sender.join()


def test_live_images_as_arrays(rig, url):
    stop, seen = threading.Event(), []
    sender = rig.play(100, stop)
    for image in connect(url).stream("palm", patience_s=BUSY_S):
        assert image.raw.shape == image.restored.shape == (8, 8)
        assert image.flags.shape == (64,)
        seen.append(image.sequence)
        if len(seen) == 20:
            stop.set()
            sender.join()
        if len(seen) >= 20 and image.sequence == rig.sequence:
            break
    assert seen == sorted(set(seen))
    assert len(seen) <= 20 + FEW  # however long it was held up


@pytest.mark.usefixtures("playing")
def test_the_status_comes_with_the_images(url):
    for image in connect(url).stream("palm", patience_s=BUSY_S):
        if image.status:
            assert image.status["state"] == "live"
            assert image.status["sensor"] == "palm"
            break


def test_as_in_the_readme(playing, url, capsys):
    said = re.search(r"```python\nimport tactiled\n.*?```", README.read_text(), re.S)[0].splitlines()[1:-1]
    program = "\n".join(said).replace("http://127.0.0.1:8000", url) + "\n    break\n"
    exec(program)
    assert re.fullmatch(r"\d+ [\d.]+ kPa\n", capsys.readouterr().out)
    assert playing.sensor.status().state == "live"


def test_the_same_for_asyncio(playing, url):
    async def three():
        seen = []
        async for image in connect(url).astream("palm", rate_hz=50, patience_s=BUSY_S):
            seen.append(image)
            if len(seen) == 3:
                break
        return seen

    with ThreadPoolExecutor(1) as other:  # on this thread a browser's loop may be running
        images = other.submit(asyncio.run, three()).result()
    assert len({image.sequence for image in images}) == 3
    assert np.isfinite(images[-1].restored).all()
    assert playing.sensor.status().state == "live"


@pytest.mark.parametrize("sensor", ["skin", ["skin"]])
def test_shear_comes_with_the_images_where_it_is_asked_for(request, sensor):
    with rigged(request.node.name) as rig, running(rig.service) as url:
        shown = rig.show(X, Y)
        image = next(connect(url).stream(sensor, patience_s=BUSY_S, shear=True))
        np.testing.assert_array_equal(image.shear, shown.shear)
        assert image.shear[:, 0, :2].tolist() == [[100.0, -200.0], [1.0, 2.0]]
        np.testing.assert_array_equal(image.restored, shown.restored)
        np.testing.assert_array_equal(image.raw, shown.raw)
        assert (image.sequence, image.sensor) == (shown.sequence, "skin")
        assert next(connect(url).stream(sensor, patience_s=BUSY_S)).shear is None


def test_shear_as_in_the_readme(request, capsys):
    said = next(
        each for each in re.findall(r"```python\n(.*?)```", README.read_text(), re.S) if "shear=True" in each
    )
    with rigged(request.node.name) as rig, running(rig.service) as url:
        rig.show(X, Y)
        exec(said.replace("http://127.0.0.1:8000", url) + "    break\n")
    assert re.fullmatch(r"0 1388\.0\d* counts\n", capsys.readouterr().out)


@pytest.mark.usefixtures("playing")
def test_shear_of_a_skin_without_is_refused_in_the_services_own_words(url):
    with pytest.raises(TactileError, match="sensor 'palm': its codec packed carries no shear"):
        next(connect(url).stream("palm", patience_s=BUSY_S, shear=True))


def test_a_stream_goes_on_when_the_service_is_back(playing):
    with running(playing.service) as url:
        stream = connect(url).stream("palm", patience_s=BUSY_S)
        before = next(stream)
    with running(playing.service, Server(port=int(url.rsplit(":", 1)[1]))):
        after = next(image for image in stream if image.sequence > before.sequence + 5)
    assert after.sequence > before.sequence
    stream.close()


def test_a_silent_sensor_ends_patience(rig, url):
    rig.show(pressed())
    stream = connect(url).stream("palm", patience_s=2.0)
    next(stream)
    with pytest.raises(TactileError, match=f"sensor 'palm' at {url}: no image for 2.0 s"):
        next(stream)


def test_a_refusal_is_told_though_the_next_attempt_hears_nothing():
    attempts = []

    def answer(socket):
        attempts.append(socket)
        if len(attempts) == 1:
            socket.close(TOO_MANY, "one too many")
        else:
            list(socket)  # until the client leaves

    with serve(answer, "127.0.0.1", 0) as service:
        threading.Thread(target=service.serve_forever, daemon=True).start()
        stream = connect(f"http://127.0.0.1:{service.socket.getsockname()[1]}").stream("palm", patience_s=2.0)
        with pytest.raises(TactileError, match=r"no image for 2\.0 s: one too many"):
            next(stream)
    assert len(attempts) > 1


def test_asking(rig, url):
    client = connect(url + "/")
    with pytest.raises(TactileError, match="silent, no frame yet on can0: a tare needs frames"):
        client.tare("palm")
    rig.stale_after(600)
    rig.show(pressed())
    assert [each["name"] for each in client.sensors()] == ["palm"]
    client.set_method("palm", "raw")
    until(lambda: rig.sensor.method == "raw")
    client.tare("palm")


@pytest.mark.parametrize("streamed", [True, False])
def test_refusals_are_in_the_services_own_words(url, streamed):
    client = connect(url)
    with pytest.raises(TactileError, match="sensor 'plam': no such sensor: there are palm"):
        next(client.stream("plam")) if streamed else client.tare("plam")


def test_a_token_is_shown(rig):
    rig.stale_after(600)
    rig.show(pressed())
    with running(rig.service, Server(port=0, control_token=SecretStr("c" * 16))) as url:
        assert next(connect(url, "c" * 16).stream("palm", patience_s=BUSY_S)).sequence == 0
        connect(url, "c" * 16).tare("palm")
        with pytest.raises(TactileError, match="a token is needed"):
            next(connect(url).stream("palm", patience_s=BUSY_S))


@pytest.mark.parametrize("url", ["127.0.0.1:8000", "file:///etc/passwd", "http://", ""])
def test_an_address_that_is_none_is_refused(url):
    with pytest.raises(ConfigError, match="give the service's address"):
        connect(url)


def test_a_service_that_is_not_there_is_told():
    with pytest.raises(TactileError, match="is the service running"):
        connect("http://127.0.0.1:9").sensors()
    with pytest.raises(TactileError, match=r"no image for 2\.0 s: Connection refused: is the service running\?"):
        next(connect("http://127.0.0.1:9").stream("palm", patience_s=2.0))


def test_what_a_stream_waits_for_is_logged_once(caplog):
    with pytest.raises(TactileError):
        next(connect("http://127.0.0.1:9").stream("palm", patience_s=2.0))
    why = "Connection refused: is the service running?"
    said = f"sensor 'palm' at http://127.0.0.1:9: no connection: {why}: trying again"
    assert [each.getMessage() for each in caplog.records if each.name == "tactiled.client"] == [said]
