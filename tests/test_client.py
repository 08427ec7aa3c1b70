import asyncio
import logging
import math
import re
import socket
import ssl
import subprocess
import sys
import threading
import time
from collections.abc import AsyncGenerator, Generator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import get_type_hints

import numpy as np
import pytest
from pydantic import SecretStr
from websockets.exceptions import ConnectionClosedError
from websockets.frames import Close
from websockets.sync.server import serve

import tactiled
from tactiled import client as module
from tactiled.client import TOO_MANY, connect
from tactiled.config import Server
from tactiled.errors import ConfigError, TactileError
from tactiled.frames import Image as Frame
from tactiled.web.server import running
from tactiled.wire import pack
from tests.conftest import BUSY_S, Clock, pressed, until
from tests.skin import PALM, X, Y, rigged

FEW = 8  # images that may be on their way to a client
ROOT = Path(__file__).parents[1]
GUIDE = ROOT / "tactiled/docs/client.md"


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
        assert image.flags.shape == (8, 8)
        seen.append(image.sequence)
        if len(seen) == 20:
            stop.set()
            sender.join()
        if len(seen) >= 20 and image.sequence == rig.sequence:
            break
    assert seen == sorted(set(seen))
    assert len(seen) <= 20 + FEW  # however long it was held up


@pytest.mark.usefixtures("playing")
def test_the_status_comes_with_every_image(url):
    image = next(connect(url).stream("palm", patience_s=BUSY_S))
    assert (image.status["sensor"], image.status["state"], image.status["method"]) == ("palm", "live", "wiener")
    assert image.status["ran"]


KEPT = """
import sys, tactiled
images = tactiled.connect(sys.argv[1]).stream("palm")
next(images)
"""


@pytest.mark.usefixtures("playing")
@pytest.mark.parametrize(("more", "code"), [("", 0), ("sys.exit(3)", 3)])
def test_a_program_that_keeps_a_stream_ends(url, more, code):
    ended = subprocess.run(
        [sys.executable, "-c", KEPT + more, url], timeout=BUSY_S, capture_output=True, check=False
    )
    assert (ended.returncode, ended.stderr) == (code, b"")


def test_a_loop_that_pauses_sees_what_is_newest_then(playing, url):
    stream = connect(url).stream("palm", patience_s=BUSY_S)
    for _ in range(3):
        time.sleep(0.3)
        newest = playing.sensor.hub.latest()
        assert next(stream).sequence >= (newest.sequence - 1 if newest else 0)
    stream.close()


def test_one_that_blocks_asyncio_does_too(playing, url):
    async def look():
        stream = connect(url).astream("palm", patience_s=BUSY_S)
        for _ in range(3):
            time.sleep(0.3)
            newest = playing.sensor.hub.latest()
            assert (await anext(stream)).sequence >= (newest.sequence - 1 if newest else 0)
        await stream.aclose()

    with ThreadPoolExecutor(1) as other:
        other.submit(asyncio.run, look()).result()


@pytest.fixture
def inbox(monkeypatch):
    """What several sensors send, and a clock."""
    monkeypatch.setattr(module, "time", clock := Clock())
    made = module._Inbox({"palm": ("raw", "restored"), "tip": ("raw", "restored")})
    for name in ("palm", "tip"):
        made.take(f'{{"sensor": "{name}", "state": "live"}}')
    made.clock = clock
    return made


def come(inbox, name, sequence):
    zero = np.zeros((2, 2), np.float32)
    frame = Frame(name, sequence, 0.0, zero, zero, np.zeros((2, 2), np.uint8), "raw", "", 0, 9.0, 0.1, 1.0, 1.0)
    for kind in ("raw", "restored"):
        inbox.take(pack(frame, kind, 0.0, name))


def given(inbox):
    image = inbox.pop()
    return image and (image.sensor, image.sequence)


def test_of_several_sensors_what_waited_for_a_slow_loop_gives_way_to_what_is_newer(inbox):
    assert len(inbox.requests()) == 2
    come(inbox, "palm", 1)
    assert given(inbox) == ("palm", 1)
    inbox.clock.wait(5)
    inbox.ask()
    assert inbox.requests() == ['{"type": "next", "sensor": "palm"}']
    come(inbox, "tip", 1)
    assert given(inbox) is None
    assert inbox.requests() == ['{"type": "next", "sensor": "tip"}']
    come(inbox, "palm", 500)
    assert given(inbox) is None  # or the tip would never have its turn
    come(inbox, "tip", 500)
    assert given(inbox) == ("tip", 500)
    inbox.ask()
    assert given(inbox) == ("palm", 500)


def test_of_several_sensors_a_slow_one_has_its_turn_in_a_slow_loop(inbox):
    inbox.requests()
    come(inbox, "palm", 1)
    assert given(inbox) == ("palm", 1)
    inbox.clock.wait(0.3)
    inbox.ask()
    come(inbox, "tip", 1)
    assert given(inbox) is None
    inbox.clock.wait(inbox.wait_s())
    assert given(inbox) == ("tip", 1)


def test_of_several_sensors_a_fast_loop_waits_for_none_and_what_waits_is_renewed(inbox):
    assert inbox.wait_s() == math.inf
    inbox.requests()
    for name in ("palm", "tip"):
        come(inbox, name, 1)
    assert inbox.requests() == []  # before the loop asks
    assert given(inbox) == ("palm", 1)
    inbox.clock.wait(0.05)
    inbox.ask()
    assert len(inbox.requests()) == 2
    come(inbox, "palm", 5)
    come(inbox, "tip", 2)
    assert given(inbox) == ("tip", 2)
    assert given(inbox) == ("palm", 5)


@pytest.mark.usefixtures("playing")
def test_a_loop_that_pauses_a_minute_costs_no_connection(url, monkeypatch, caplog):
    """Told a thousand times how the sensor is, the client still reads."""
    monkeypatch.setattr("tactiled.web.ws.stream.STATUS_S", 0.0)
    monkeypatch.setattr("tactiled.web.ws.stream.CHANGE_S", 0.0)
    stream = connect(url).stream("palm", patience_s=BUSY_S)
    before = next(stream)
    time.sleep(1)  # some hundred messages
    assert next(stream).sequence > before.sequence
    stream.close()
    assert not caplog.records
    assert module.MAX_QUEUE > 600


@pytest.mark.parametrize("path", [ROOT / "README.md", GUIDE], ids=["readme", "guide"])
def test_as_in_readme_and_guide(playing, url, capsys, path):
    said = re.search(r"```python\nimport tactiled\n.*?```", path.read_text(), re.S)[0].splitlines()[1:-1]
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


def test_shear_comes_of_those_named(request):
    with rigged(request.node.name, PALM) as rig, running(rig.service) as url:
        shown = rig.show(X, Y)
        image = next(connect(url).stream(["palm", "skin"], patience_s=BUSY_S, shear="skin"))
        np.testing.assert_array_equal(image.shear, shown.shear)
        with pytest.raises(TactileError, match="sensor 'palm': its codec packed carries no shear"):
            next(connect(url).stream(["palm", "skin"], patience_s=BUSY_S, shear=True))


def test_shear_as_in_the_guide(request, capsys):
    said = next(
        each for each in re.findall(r"```python\n(.*?)```", GUIDE.read_text(), re.S) if "shear=True" in each
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


def test_a_silent_sensor_ends_patience_and_its_state_is_told(rig, url, caplog):
    rig.show(pressed())
    stream = connect(url).stream("palm", patience_s=4.0)
    next(stream)
    told = r"palm is stale: no frame for [\d.]+ s"
    with pytest.raises(TactileError, match=f"sensor 'palm' at {url}: no image for 4.0 s: {told}"):
        next(stream)
    (said,) = [each.getMessage() for each in caplog.records if each.name == "tactiled.client"]
    assert re.fullmatch(f"sensor 'palm' at {url}: no image: {told}: waiting", said)


def test_patience_begins_when_the_loop_asks(playing, url):
    stream = connect(url).stream("palm", patience_s=2.0)
    for _ in range(2):
        time.sleep(2.5)
        next(stream)
    stream.close()
    assert playing.sensor.status().state == "live"


@contextmanager
def answering(said):
    """A server that says the same to each, or nothing."""
    done = threading.Event()

    def go():
        with suppress(OSError), ExitStack() as kept:
            while not done.is_set():
                client = kept.enter_context(server.accept()[0])
                if said is not None:
                    client.recv(10000)
                    client.sendall(said)
                    client.close()

    with socket.create_server(("127.0.0.1", 0)) as server:
        thread = threading.Thread(target=go)
        thread.start()
        try:
            yield f"http://127.0.0.1:{server.getsockname()[1]}"
        finally:
            done.set()
            socket.create_connection(server.getsockname()).close()
            thread.join()


def test_patience_ends_at_a_server_that_says_nothing():
    async def first(url):
        await anext(connect(url).astream("palm", patience_s=1.0))

    with answering(None) as url, ThreadPoolExecutor(1) as other:
        for ask in (
            lambda: next(connect(url).stream("palm", patience_s=1.0)),
            lambda: other.submit(asyncio.run, first(url)).result(),
        ):
            began = time.monotonic()
            with pytest.raises(TactileError, match=r"no image for 1\.0 s: timed out"):
                ask()
            assert 1 <= time.monotonic() - began < module.ANSWER_S / 2


def test_no_attempt_waits_longer_than_patience(monkeypatch):
    monkeypatch.setattr(module, "time", clock := Clock())
    stream = module._Stream(connect("http://127.0.0.1:9"), "palm", 0.0, 7.0, False)
    stream.ask()
    refused, began = ConnectionRefusedError(111, "Connection refused"), clock.now
    while clock.now - began < 7.0:
        clock.wait(stream.failed(refused))
    with pytest.raises(TactileError, match=r"7\.0 s: Connection refused: is the service running\?"):
        stream.failed(refused)
    assert clock.now - began == 7.0
    assert stream.options()["open_timeout"] == module.MIN_CONNECT_S


GARBAGE = {
    b"": "closed connection without response",
    b"SSH-2.0-OpenSSH_9.2\r\n": "SSH",
    b"HTTP/1.1 200 OK\r\nContent-Length: 10\r\n\r\n{": "IncompleteRead",
    b"HTTP/1.1 200 OK\r\nContent-Length: 5\r\n\r\nhello": "no service of tactiled: its answer is no JSON",
    b"HTTP/1.1 200 OK\r\nContent-Length: 2\r\n\r\n{}": "no service of tactiled: it names no sensors",
    b"HTTP/1.1 500 No\r\nContent-Length: 50\r\n\r\n{": "HTTP 500",
}


@pytest.mark.parametrize(("said", "told"), GARBAGE.items())
def test_what_is_no_service_is_told(said, told):
    with answering(said) as url, pytest.raises(TactileError, match=told):
        connect(url).sensors()


@pytest.mark.parametrize("said", ["hello", '{"type": "status"}', b"hello"])
def test_a_message_that_no_service_sends_is_told(said):
    with serve(lambda socket: socket.send(said), "127.0.0.1", 0) as service:
        threading.Thread(target=service.serve_forever, daemon=True).start()
        url = f"http://127.0.0.1:{service.socket.getsockname()[1]}"
        with pytest.raises(TactileError, match="no message of this version of tactiled"):
            next(connect(url).stream("palm", patience_s=BUSY_S))


WRONG = {
    "sensor = None": (None, {}),
    "sensor = ''": ("", {}),
    r"sensor = \[\]": ([], {}),
    "sensor = 'palm,tip'": ("palm,tip", {}),
    "patience_s = 0": ("palm", {"patience_s": 0}),
    "patience_s = nan": ("palm", {"patience_s": float("nan")}),
    "patience_s = '3'": ("palm", {"patience_s": "3"}),
    "shear = 3": ("palm", {"shear": 3}),
}


@pytest.mark.parametrize(("told", "asked"), WRONG.items())
def test_wrong_arguments_are_refused_at_once(told, asked):
    sensor, more = asked
    for stream in (connect("http://h").stream, connect("http://h").astream):
        with pytest.raises(ConfigError, match=told):
            stream(sensor, **more)


def test_a_sensor_without_a_name_is_refused_at_once():
    for ask in (connect("http://h").tare, lambda sensor: connect("http://h").set_method(sensor, "raw")):
        with pytest.raises(ConfigError, match="sensor = None: give a sensor's name"):
            ask(None)


def test_what_comes_back_can_be_closed():
    assert get_type_hints(tactiled.Client.stream)["return"] == Generator[tactiled.Image, None, None]
    assert get_type_hints(tactiled.Client.astream)["return"] == AsyncGenerator[tactiled.Image, None]
    assert issubclass(ConfigError, tactiled.TactileError)


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
    with pytest.raises(tactiled.LoadedError, match=r"contact of 200 kPa on 4 taxels: .* force=true") as refused:
        client.tare("palm")
    assert refused.value.seen == "contact of 200 kPa on 4 taxels"
    client.tare("palm", force=True)
    until(lambda: rig.service.events.after(0)[-1].kind == "tare_asked")


@pytest.mark.parametrize("streamed", [True, False])
def test_refusals_are_in_the_services_own_words(url, streamed):
    client = connect(url)
    with pytest.raises(TactileError, match="sensor 'plam': no such sensor: there are palm"):
        next(client.stream("plam")) if streamed else client.tare("plam")


def test_a_token_is_shown(rig):
    rig.stale_after(600)
    rig.show(pressed(force=0))
    with running(rig.service, Server(port=0, control_token=SecretStr("c" * 16))) as url:
        assert next(connect(url, "c" * 16).stream("palm", patience_s=BUSY_S)).sequence == 0
        connect(url, "c" * 16).tare("palm")
        connect(f"{url.upper()}/?token={'c' * 16}").tare("palm")
        with pytest.raises(TactileError, match="a token is needed"):
            next(connect(url).stream("palm", patience_s=BUSY_S))


NONE = (
    "127.0.0.1:8000",
    "file:///etc/passwd",
    "ws://h",
    "http://",
    "",
    None,
    b"http://h",
    "http://h:99999",
    "http://h:x",
    "http://h:0",
    "http://u:p@h",
    "http://h ost",
    "http://h?x=1",
    "http://h?token=a&token=b",
    "http://h/#palm",
    "http://[::1",
    "http://h/\n",
    "http://h/é",
)


@pytest.mark.parametrize("url", NONE)
def test_an_address_that_is_none_is_refused(url):
    with pytest.raises(ConfigError, match=re.escape("give the service's address")):
        connect(url)


@pytest.mark.parametrize("token", ["a\nb", "€", "ä", 3])
def test_a_token_that_no_header_carries_is_refused_and_not_shown(token):
    with pytest.raises(ConfigError, match=r"^token: give printable ASCII characters$"):
        connect("http://h", token)


def test_a_token_is_given_once():
    with pytest.raises(ConfigError, match="token: given twice"):
        connect("http://h/?token=a", "b")
    assert connect("http://h/?token=a", "").headers == {"Authorization": "Bearer a"}


def test_a_certificate_that_is_not_trusted_is_told_at_once():
    stream = module._Stream(connect("https://h"), "palm", 0.0, None, False)
    error = ssl.SSLCertVerificationError(1, "certificate verify failed: self-signed certificate")
    with pytest.raises(TactileError, match="https://h: certificate verify failed: self-signed certificate"):
        stream.failed(error)


def test_tls_where_there_is_none_is_told(url, caplog):
    async def first():
        await anext(connect(secure).astream("palm", patience_s=1.0))

    secure = url.replace("http", "https")
    with ThreadPoolExecutor(1) as other:
        for ask in (
            lambda: next(connect(secure).stream("palm", patience_s=1.0)),
            lambda: other.submit(asyncio.run, first()).result(),
        ):
            with pytest.raises(TactileError, match=r"no image for 1\.0 s: .*WRONG_VERSION_NUMBER"):
                ask()
    assert "is the service running" not in caplog.text


def test_what_tls_must_show_can_be_said():
    context = ssl.create_default_context()
    client = connect("https://h", ssl_context=context)
    assert module._Stream(client, "palm", 0.0, None, False).options()["ssl"] is context
    with pytest.raises(ConfigError, match="ssl_context: url = 'http://h' is not https"):
        connect("http://h", ssl_context=context)


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


def test_why_a_connection_ended_is_logged(playing, caplog):
    with running(playing.service) as url:
        stream = connect(url).stream("palm", patience_s=1.0)
        next(stream)
    with pytest.raises(TactileError, match=r"Connection refused|the service ends \(1012\)"):
        for _ in stream:
            pass
    assert "no connection: the service ends (1012): trying again" in caplog.text


def test_a_connection_that_breaks_is_told():
    stream = module._Stream(connect("http://h"), "palm", 0.0, None, False)
    for error, told in (
        (ConnectionClosedError(None, None), "the connection broke"),
        (ConnectionClosedError(None, Close(1011, "keepalive ping timeout")), "keepalive ping timeout"),
        (ConnectionClosedError(Close(1009, ""), None), "closed (1009)"),
    ):
        stream.failed(error)
        assert stream._error == told


def test_what_websockets_says_of_an_end_is_not_shown():
    assert not module.WEBSOCKETS_LOG.isEnabledFor(logging.ERROR)


def test_a_client_needs_numpy_and_websockets_alone():
    program = (
        "import sys; before = set(sys.modules); import tactiled;"
        "assert not {'numpy', 'websockets'} & set(sys.modules);"
        "assert callable(tactiled.connect) and 'connect' in dir(tactiled);"
        "print(*{name.partition('.')[0] for name in set(sys.modules) - before} - set(sys.stdlib_module_names))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert {name for name in done.stdout.split() if not name.startswith("_")} == {
        "tactiled",
        "numpy",
        "websockets",
    }
