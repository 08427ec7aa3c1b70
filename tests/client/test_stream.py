import logging
import math
import re
import socket
import ssl
import subprocess
import sys
import threading
import time
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from websockets.exceptions import ConnectionClosedError
from websockets.frames import Close
from websockets.sync.server import serve

import tactiled
from tactiled.client import connect
from tactiled.client import stream as module
from tactiled.client.results import measured
from tactiled.client.stream import TOO_MANY, Inbox, Service, Stream
from tactiled.config import Server
from tactiled.errors import ConfigError, TactileError
from tactiled.frames import MISSING
from tactiled.frames import SensorImage as Frame
from tactiled.web.server import running
from tactiled.wire import pack
from tests.conftest import BUSY_S, Clock, pressed, run_apart, until
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
    holes = replace(image, restored=np.where(np.arange(64).reshape(8, 8) < 1, np.nan, image.restored))
    lost = replace(image, flags=np.where(np.arange(64).reshape(8, 8) < 13, MISSING, image.flags))
    assert math.isnan(measured(lost, {"restored": {"cell_mm": 1.0}}).force)
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
    lines = re.search(r"```python\nimport numpy as np\n\nimport tactiled\n.*?```", path.read_text(), re.S)[
        0
    ].splitlines()[1:-1]
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
        np.testing.assert_array_equal(client.snapshot("skin", shear=True).shear, frame.shear)
        window = client.window("skin", 60.0, "shear")
        np.testing.assert_array_equal(window.values, [frame.shear])
        assert "peak 1388 counts" in window._repr_html_()
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


@contextmanager
def answering(data):
    """A server that sends the same to each client, or nothing."""
    done = threading.Event()

    def go():
        with suppress(OSError), ExitStack() as clients:
            while not done.is_set():
                client = clients.enter_context(server.accept()[0])
                if data is not None:
                    client.recv(10000)
                    client.sendall(data)
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


BOTH = pytest.mark.parametrize(
    "ask", [first, lambda *args, **options: run_apart(afirst(*args, **options))], ids=["sync", "async"]
)


@BOTH
def test_patience_ends_whatever_fails(url, caplog, ask):
    with answering(None) as silent:
        for address, reason in (
            (silent, "timed out"),
            (url.replace("http", "https"), ".*WRONG_VERSION_NUMBER"),
            ("http://127.0.0.1:9", r".*is the service running\?"),
        ):
            began = time.monotonic()
            with pytest.raises(TactileError, match=rf"no image for 1\.0 s: {reason}"):
                ask(address, patience_s=1.0)
            assert 1 <= time.monotonic() - began < module.ANSWER_S / 2
    (message,) = [each for each in caplog.messages if "http://127.0.0.1:9: no connection" in each]  # once
    assert message.endswith("is the service running?: trying again")


GARBAGE = {
    b"": "closed connection without response",
    b"SSH-2.0-OpenSSH_9.2\r\n": "SSH",
    b"HTTP/1.1 200 OK\r\nContent-Length: 10\r\n\r\n{": "IncompleteRead",
    b"HTTP/1.1 200 OK\r\nContent-Length: 5\r\n\r\nhello": "no service of tactiled: its answer is no JSON",
    b"HTTP/1.1 200 OK\r\nContent-Length: 2\r\n\r\n{}": "no service of tactiled: it names no sensors",
    b"HTTP/1.1 500 No\r\nContent-Length: 50\r\n\r\n{": "HTTP 500",
}


@pytest.mark.parametrize(("answer", "error"), GARBAGE.items())
def test_an_answer_of_another_server_is_an_error(answer, error):
    with answering(answer) as url, pytest.raises(TactileError, match=error):
        connect(url).sensors()


@contextmanager
def websocket_server(handle):
    with serve(handle, "127.0.0.1", 0) as service:
        threading.Thread(target=service.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{service.socket.getsockname()[1]}"


@BOTH
def test_a_service_that_hangs_does_not_delay_the_end_of_patience(ask):
    ended = threading.Event()

    def hang(socket):
        with socket.protocol_mutex:
            ended.wait()

    def excess_s():
        began = time.monotonic()
        with pytest.raises(TactileError, match=r"no image for 0\.2 s"):
            ask(url, patience_s=0.2)
        return time.monotonic() - began - 0.2

    with websocket_server(hang) as url:
        try:
            assert min(excess_s() for _ in range(3)) < 0.7
        finally:
            ended.set()


@pytest.mark.parametrize("message", ["hello", '{"type": "status"}', b"hello"])
def test_a_message_of_another_server_is_an_error(message):
    error = "no message of this version of tactiled"
    with websocket_server(lambda socket: socket.send(message)) as url, pytest.raises(TactileError, match=error):
        first(url)


def test_after_one_stream_too_many_the_client_tries_again():
    attempts = []

    def answer(socket):
        attempts.append(socket)
        if len(attempts) == 1:
            socket.close(TOO_MANY, "one too many")
        else:
            list(socket)  # until the client leaves

    with websocket_server(answer) as url, pytest.raises(TactileError, match=r"no image for 2\.0 s: one too many"):
        first(url, patience_s=2.0)
    assert len(attempts) > 1


WRONG_SENSORS = {"sensor = None": None, "sensor = ''": "", r"sensor = \[\]": [], "sensor = 'palm,tip'": "palm,tip"}
WRONG = {error: (sensor, {}) for error, sensor in WRONG_SENSORS.items()} | {
    "patience_s = 0": ("palm", {"patience_s": 0}),
    "patience_s = nan": ("palm", {"patience_s": float("nan")}),
    "patience_s = '3'": ("palm", {"patience_s": "3"}),
    "rate_hz = -1": ("palm", {"rate_hz": -1}),
    "rate_hz = nan": ("palm", {"rate_hz": float("nan")}),
    "rate_hz = '5'": ("palm", {"rate_hz": "5"}),
    "shear = 3": ("palm", {"shear": 3}),
}


def test_wrong_arguments_are_refused_at_once():
    client = connect("http://h")
    for error, (sensor, options) in WRONG.items():
        for stream in (client.stream, client.astream):
            with pytest.raises(ConfigError, match=error):
                stream(sensor, **options)
    for request in (client.tare, lambda sensor: client.set_method(sensor, "raw")):
        with pytest.raises(ConfigError, match="sensor = None: give a sensor's name"):
            request(None)


WRONG_URLS = (
    "127.0.0.1:8000", "file:///etc/passwd", "ws://h", "http://", "", None, b"http://h", "http://h:99999",
    "http://h:x", "http://h:0", "http://u:p@h", "http://h ost", "http://[::1", "http://h/\n", "http://h/é",
    "http://h?x=1", "http://h?token=a&token=b", "http://h/#palm",
)  # fmt: skip


def test_a_wrong_url_token_or_context_is_refused():
    for url in WRONG_URLS:
        with pytest.raises(ConfigError, match=r"^url = .*: give the service's address, such as") as caught:
            connect(url)
        assert "token=a" not in str(caught.value)
    for token in ("a\nb", "€", "ä", 3):
        with pytest.raises(ConfigError, match=r"^token: give printable ASCII characters$"):
            connect("http://h", token)
    with pytest.raises(ConfigError, match="token: given twice"):
        connect("http://h/?token=a", "b")
    context = ssl.create_default_context()
    with pytest.raises(ConfigError, match="ssl_context: url = 'http://h' is not https"):
        connect("http://h", ssl_context=context)
    stream = Stream(connect("https://h", ssl_context=context)._service, "palm", 0.0, None, False)
    assert stream.options()["ssl"] is context


def test_requests(rig, url):
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
    until(lambda: any(each.kind == "tare_asked" for each in rig.service.events.after(0)))
    for request in (client.tare, lambda name: next(client.stream(name))):
        with pytest.raises(TactileError, match="sensor 'plam': no such sensor: there are palm"):
            request("plam")
    with pytest.raises(TactileError, match="is the service running"):
        connect("http://127.0.0.1:9").sensors()


def test_a_token_is_sent_with_every_request(rig):
    rig.stale_after(600)
    rig.show(pressed(force=0))
    token = "c" * 16
    with running(rig.service, Server(port=0, control_token=token)) as url:
        assert next(connect(url, token).stream("palm", patience_s=BUSY_S)).sequence == 0
        connect(url, token).tare("palm")
        connect(f"{url.upper()}/?token={token}").tare("palm")
        with pytest.raises(TactileError, match="a token is needed"):
            first(url)


def test_a_client_needs_numpy_and_websockets_only():
    program = (
        "import sys; before = set(sys.modules); import tactiled;"
        "assert not {'numpy', 'websockets'} & set(sys.modules);"
        "assert callable(tactiled.connect) and 'connect' in dir(tactiled);"
        "print(*{name.partition('.')[0] for name in set(sys.modules) - before} - set(sys.stdlib_module_names))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    packages = {name for name in done.stdout.split() if not name.startswith("_")}
    assert packages == {"tactiled", "numpy", "websockets"}
