import socket
import ssl
import subprocess
import sys
import threading
import time
from contextlib import ExitStack, contextmanager, suppress

import pytest
from websockets.sync.server import serve

import tactiled
from tactiled.client import connect
from tactiled.client import stream as module
from tactiled.client.stream import TOO_MANY, Stream
from tactiled.config import Server
from tactiled.errors import ConfigError, TactileError
from tactiled.web.server import running
from tests.client.test_stream import afirst, first
from tests.conftest import BUSY_S, pressed, run_apart, until


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
