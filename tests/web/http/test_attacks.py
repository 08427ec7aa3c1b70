"""What a client may try: each attack on the whole service, and that it changes nothing."""

import io
import secrets
import socket
import subprocess
import tempfile
import time
from contextlib import ExitStack
from dataclasses import replace
from itertools import product
from pathlib import Path

import can
import httpx
import numpy as np
import pytest
from can.interfaces.virtual import VirtualBus
from pydantic import SecretStr
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

import tactiled
from tactiled.config import Server, parse
from tactiled.errors import TactileError
from tactiled.runtime.sensor import Sensor
from tactiled.runtime.service import Service
from tactiled.web.http import body, bounds
from tactiled.web.http.auth import Tokens
from tactiled.web.http.bounds import BOUNDS, State
from tactiled.web.server import running
from tests.conftest import BUSY_S, CONFIG, HTTP, ask, pressed, until
from tests.web.rest.test_sensors import problem

TOUCHED = Path("/tmp/was-here-by-a-film")
METHOD = "/api/v1/sensors/palm/method"
RAW = {"method": "raw"}


@pytest.fixture
def place(tmp_path):
    """A folder of recordings with a secret beside it."""
    (tmp_path / "secret.log").write_text("hush")
    return tmp_path


@pytest.fixture
def url(rig, place):
    with running(rig.service, Server(port=0, recordings=place / "recordings", control_per_minute=0)) as address:
        yield address


def bound(monkeypatch, state, **changed):
    """Give a state of a connection another bound."""
    monkeypatch.setitem(BOUNDS, state, replace(BOUNDS[state], **changed))


def plug(url):
    host, port = url.split("/")[2].split(":")
    return socket.create_connection((host, int(port)), timeout=BUSY_S)


def said(end):
    """All that the service says until it closes."""
    found = b""
    try:
        while data := end.recv(1 << 16):
            found += data
    except ConnectionResetError:
        pass
    return found


def raw(url, line, *headers, data=b""):
    """Send a request as it is, byte for byte; gives status and body."""
    with plug(url) as end:
        host = [] if any(each.lower().startswith("host:") for each in headers) else [f"Host: {url[7:]}"]
        head = "\r\n".join([f"{line} HTTP/1.1", *host, *headers, "Connection: close", "", ""])
        end.sendall(head.encode("latin-1") + data)
        answer = said(end)
    head, _, content = answer.partition(b"\r\n\r\n")
    return int(head.split()[1]), content


UP = ("..", "%2e%2e", "%2E.", ".%2e", "..%00", "....", "%252e%252e", "%c0%ae%c0%ae", "..\\", "..%5c")


SLASHES = ("/", "%2f", "%5c", "//", "/./", "%252f")


def test_no_path_leaves_its_folder(url, place):
    targets = (
        ("GET", "/api/v1/recordings", "secret.log"),
        ("DELETE", "/api/v1/recordings", "secret.log"),
        ("GET", "/static", "app.py"),
        ("GET", "/static", "..%2fapp.py"),
    )
    for (verb, folder, name), up, slash in product(targets, UP, SLASHES):
        path = f"{folder}{slash}{up}{slash}{name}"
        status, content = raw(url, f"{verb} {path}")
        assert status in (400, 404, 405, 422), (verb, path, status)
        assert b"hush" not in content
        assert b"import" not in content
    assert (place / "secret.log").read_text() == "hush"


STRANGERS = (
    "elsewhere.example", "localhost.elsewhere.example", "127.0.0.1.elsewhere.example", "localhost@elsewhere",
    "elsewhere@localhost", "localhost:80@elsewhere", "[::1", "[::1]x", "::1", "localhost:", "localhost:x", "",
    "127.0.0.2", "0x7f000001", "2130706433", "localhost\tx", "localhost, elsewhere", "l\xf6calhost",
)  # fmt: skip


def test_a_name_that_a_stranger_may_own_is_no_loopback(rig, url):
    for host in STRANGERS:
        status, content = raw(url, "GET /api/v1/health", f"Host: {host}")
        assert status in (400, 403), (host, content)
        json_body = "Content-Type: application/json", "Content-Length: 17"
        assert raw(url, f"PUT {METHOD}", f"Host: {host}", *json_body, data=b'{"method": "raw"}')[0] in (400, 403)
    assert rig.sensor.method == "wiener"


def test_two_hosts_are_none_and_our_own_names_are_let_in(url):
    assert raw(url, "GET /api/v1/health", "Host: localhost", "Host: elsewhere.example")[0] == 400  # RFC 9112, 3.2
    for host in ("localhost", "LocalHost:1", "127.0.0.1", "[::1]", "[::1]:8000"):
        assert raw(url, "GET /api/v1/health", f"Host: {host}")[0] == 200


FOREIGN = (
    {"Origin": "https://elsewhere.example"},
    {"Origin": "null"},
    {"Origin": ""},
    {"Origin": "http://localhost:1"},
    {"Origin": "file://"},
    {"Sec-Fetch-Site": "cross-site"},
    {"Sec-Fetch-Site": "same-site", "Sec-Fetch-Mode": "no-cors"},
)


def test_no_page_of_another_site_controls_anything(rig, url):
    with httpx.Client(**HTTP, base_url=url) as client:
        spec = client.get("/api/v1/openapi.json").json()
        verbs = [(verb, path) for path, operations in spec["paths"].items() for verb in set(operations) - {"get"}]
        assert len(verbs) >= 6
        for headers, (verb, path) in product(FOREIGN, verbs):
            problem(client.request(verb, path.format(name="palm"), headers=headers, json=RAW), 403)
        for headers in FOREIGN:
            problem(client.get("/api/v1/health", headers=headers), 403)
    assert (rig.sensor.method, rig.service.events.newest) == ("wiener", 0)


def test_a_link_from_another_site_opens_the_viewer(url):
    headers = {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "navigate"}
    assert ask("GET", url, headers=headers).status_code == 200


def test_a_form_of_another_site_is_no_link(rig, url):
    headers = {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "navigate"}
    problem(ask("POST", url + "/api/v1/sensors/palm/tare", headers=headers), 403)
    with connect(url.replace("http", "ws", 1) + "/api/v1/stream", additional_headers=headers) as client:
        assert ended(client)[0] == 4403
    assert rig.service.events.newest == 0


@pytest.mark.parametrize("kind", ["text/plain", "application/x-www-form-urlencoded", "multipart/form-data"])
def test_what_a_form_can_send_is_no_json(rig, url, kind):
    answer = ask("PUT", url + METHOD, content=b'{"method": "raw"}', headers={"Content-Type": kind})
    assert problem(answer, 415) == f"Content-Type: {kind}: give application/json"
    assert rig.sensor.method == "wiener"


@pytest.mark.parametrize("origin", ["https://elsewhere.example", "null", "http://localhost:1"])
@pytest.mark.parametrize("path", ["sensors/palm/stream", "stream"])
def test_no_page_of_another_site_gets_a_stream(url, path, origin):
    with connect(f"{url.replace('http', 'ws', 1)}/api/v1/{path}", origin=origin) as client:
        with pytest.raises(ConnectionClosed) as caught:
            client.recv(timeout=BUSY_S)
        assert caught.value.rcvd.code == 4403


def test_a_message_that_is_too_long_ends_a_stream(url):
    with connect(f"{url.replace('http', 'ws', 1)}/api/v1/sensors/palm/stream") as client:
        client.send("x" * (65 << 10))
        with pytest.raises(ConnectionClosed) as caught:
            [client.recv(timeout=BUSY_S) for _ in range(1000)]
        assert caught.value.rcvd.code == 1009


def endless(url, path, verb, chunk=1 << 16, most=80 << 20):
    """Send a chunked body for ever; gives the status, and the bytes that the service took."""
    with plug(url) as end:
        end.sendall(f"{verb} {path} HTTP/1.1\r\nHost: {url[7:]}\r\nContent-Type: application/json\r\n".encode())
        end.sendall(b"Transfer-Encoding: chunked\r\n\r\n")
        sent, piece = 0, b"%x\r\n" % chunk + b" " * chunk + b"\r\n"
        try:
            while sent < most:
                end.sendall(piece)
                sent += chunk
        except (BrokenPipeError, ConnectionResetError):
            pass
        return said(end).split(b"\r\n")[0], sent


@pytest.mark.parametrize(("path", "verb"), [(METHOD, "PUT"), ("/api/v1/recordings", "POST")])
def test_a_body_that_is_too_large_is_refused_told_or_untold(rig, url, path, verb):
    problem(ask(verb, url + path, content=b" " * (body.MAX_BODY_BYTES + 1)), 413)
    for length in (body.MAX_BODY_BYTES + 1, 10**15):
        assert raw(url, f"{verb} {path}", "Content-Type: application/json", f"Content-Length: {length}")[0] == 413
    status, sent = endless(url, path, verb)
    assert b"413" in status or not status  # or it was cut off while it sent
    assert sent < 80 << 20
    assert rig.sensor.method == "wiener"
    assert ask("GET", url + "/api/v1/health").status_code == 200


@pytest.fixture
def films(tmp_path, monkeypatch):
    """Where films are kept while they are restored."""
    place = tmp_path / "films"
    place.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(place))
    return place


def test_an_endless_film_is_cut_off_and_leaves_nothing(url, films, monkeypatch):
    monkeypatch.setattr(body, "MAX_UPLOAD_BYTES", 1 << 20)
    status, sent = endless(url, "/api/v1/restore?sensor=palm", "POST")
    assert b"413" in status or not status
    assert sent < 80 << 20
    until(lambda: not list(films.iterdir()))
    assert ask("POST", url + "/api/v1/restore?sensor=palm", content=npy(np.zeros((1, 8, 8)))).status_code == 200


def npy(array, **options):
    out = io.BytesIO()
    np.save(out, array, **options)
    return out.getvalue()


def header(text, length=None):
    """An .npy file whose header says `text`, with 64 bytes of data."""
    padded = text.encode().ljust(117) + b"\n"
    return b"\x93NUMPY\x01\x00" + (length or len(padded)).to_bytes(2, "little") + padded + bytes(64)


class Evil:
    def __reduce__(self):
        return (Path.touch, (TOUCHED,))


def zipped():
    out = io.BytesIO()
    np.savez_compressed(out, np.zeros((1 << 18, 8, 8)))
    return out.getvalue()


BOMBS = {
    "1e12 frames": header("{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000, 8, 8)}"),
    "more than 64 bits count": header("{'descr': '<f8', 'fortran_order': False, 'shape': (2**70, 8, 8)}"),
    "a number of 70 bits": header(f"{{'descr': '<f8', 'fortran_order': False, 'shape': ({2**70}, 8, 8)}}"),
    "a negative number": header("{'descr': '<f8', 'fortran_order': False, 'shape': (-1, 8, 8)}"),
    "empty items": header("{'descr': '|V0', 'fortran_order': False, 'shape': (1000000000000, 8, 8)}"),
    "text": header("{'descr': '<U0', 'fortran_order': False, 'shape': (9, 8, 8)}"),
    "a header longer than the file": header("{}", 65535),
    "code": header("__import__('os').system('touch /tmp/was-here-by-a-film')"),
    "a deep header": header("(" * 100),
    "a header that breaks the parser": header("-" * 9000 + "1"),
    "a pickle": npy(np.array([[[Evil()] * 8] * 8]), allow_pickle=True),
    "objects": header("{'descr': '|O', 'fortran_order': False, 'shape': (1, 8, 8)}"),
    "records": npy(np.zeros((2, 8, 8), [("a", "f4")])),
    "a compressed archive": zipped(),
}


def test_a_film_that_is_a_bomb_is_refused(url, films):
    for name, bomb in BOMBS.items():
        answer = ask("POST", f"{url}/api/v1/restore?sensor=palm", content=bomb)
        assert answer.status_code == 422, (name, answer.text)
        assert "tactiled-" not in problem(answer, 422)
    assert not TOUCHED.exists()
    assert not list(films.iterdir())


def closed_after(end):
    began = time.monotonic()
    answer = said(end)
    return answer, time.monotonic() - began


@pytest.mark.parametrize("begun", [b"", b"GET", b"GET / HTTP/1.1\r\nHost: localhost\r\nX: "])
def test_a_request_that_never_gets_anywhere_is_cut_off(rig, monkeypatch, begun):
    bound(monkeypatch, State.HEAD, seconds=0.5)
    with running(rig.service) as url, plug(url) as end:
        end.sendall(begun)
        answer, seconds = closed_after(end)
    assert answer == b""
    assert seconds < BUSY_S


def test_a_second_request_on_a_connection_is_watched_as_well(rig, monkeypatch):
    bound(monkeypatch, State.HEAD, seconds=3.0)
    with running(rig.service) as url, plug(url) as end:
        end.sendall(f"GET /api/v1/events HTTP/1.1\r\nHost: {url[7:]}\r\n\r\n".encode())
        assert end.recv(1 << 16).startswith(b"HTTP/1.1 200")
        end.sendall(b"GET /api")  # after which uvicorn itself waits for ever
        assert closed_after(end)[0].count(b"HTTP/1.1") == 0


def test_a_head_without_end_is_cut_off(url):
    with plug(url) as end:
        end.sendall(b"GET / HTTP/1.1\r\n")
        with pytest.raises((BrokenPipeError, ConnectionResetError)):
            [end.sendall(b"X-%d: " % n + b"x" * 8000 + b"\r\n") for n in range(10_000)]
    assert ask("GET", url + "/api/v1/health").status_code == 200


def test_a_body_that_never_comes_is_given_up_on_and_blocks_nobody(url, monkeypatch):
    with monkeypatch.context() as hasty:
        hasty.setattr(body, "BODY_TIMEOUT_S", 0.5)
        for path, verb in ((METHOD, "PUT"), ("/api/v1/restore?sensor=palm", "POST")):
            headers = "Content-Type: application/json", "Content-Length: 10"
            status, content = raw(url, f"{verb} {path}", *headers, data=b"{")
            assert status == 408, content
    film = npy(np.zeros((1, 8, 8)))
    assert ask("POST", url + "/api/v1/restore?sensor=palm", content=film).status_code == 200


@pytest.fixture
def guarded(rig):
    """A service that asks for a token."""
    with running(rig.service, Server(port=0, control_token=SecretStr("c" * 16))) as address:
        yield address


TARE = "/api/v1/sensors/palm/tare"
LENGTHS = {"Content-Length: 1000000000": b"z", "Transfer-Encoding: chunked": b"1\r\nz\r\n"}


def trickle(end, piece):
    for _ in range(1000):
        end.sendall(piece)
        time.sleep(0.05)


@pytest.mark.parametrize("length", LENGTHS)
@pytest.mark.parametrize("line", [f"POST {TARE}", "GET /api/v1/health", "POST /api/v1/restore?sensor=palm"])
def test_who_is_refused_cannot_go_on_sending_a_body(guarded, monkeypatch, line, length):
    bound(monkeypatch, State.CLOSING, seconds=0.5)
    with plug(guarded) as end:
        end.sendall(f"{line} HTTP/1.1\r\nHost: {guarded[7:]}\r\n{length}\r\n\r\n".encode())
        answer = end.recv(1 << 16)
        with pytest.raises((BrokenPipeError, ConnectionResetError)):
            trickle(end, LENGTHS[length])
    assert answer.startswith(b"HTTP/1.1 401")
    assert b"\r\nconnection: close\r\n" in answer


def test_who_is_refused_amid_a_body_still_hears_why(guarded, monkeypatch):
    bound(monkeypatch, State.CLOSING, bytes=10 << 20, seconds=BUSY_S)
    with plug(guarded) as end:
        end.sendall(f"POST {TARE} HTTP/1.1\r\nHost: {guarded[7:]}\r\nContent-Length: 8000000\r\n\r\n".encode())
        time.sleep(0.2)  # in which it is refused
        end.sendall(bytes(8_000_000))
        assert b"a token is needed" in said(end)
        assert not end.recv(1)


def test_more_than_a_little_behind_a_refusal_is_cut_off(guarded):
    with plug(guarded) as end:
        end.sendall(f"POST {TARE} HTTP/1.1\r\nHost: {guarded[7:]}\r\nContent-Length: 1000000000\r\n\r\n".encode())
        with pytest.raises((BrokenPipeError, ConnectionResetError)):
            end.sendall(bytes(80 << 20))


def test_a_connection_is_kept_where_the_body_has_come(url):
    with httpx.Client(**HTTP, base_url=url) as client:
        for answer in (client.post(TARE, content=b"x" * 1000), client.put(METHOD, content=b"{"), client.get("/")):
            assert "connection" not in answer.headers


def test_nothing_is_done_before_the_body_is_known_to_fit(rig, url, monkeypatch):
    chunk = b"10000\r\n" + bytes(1 << 16) + b"\r\n"
    for length, data in (("Content-Length: 65537", b""), ("Transfer-Encoding: chunked", 5 * chunk + b"0\r\n\r\n")):
        assert raw(url, f"POST {TARE}", length, data=data)[0] == 413
    with plug(url) as end:
        end.sendall(f"POST {TARE} HTTP/1.1\r\nHost: {url[7:]}\r\nContent-Length: 9\r\n\r\nx".encode())
    monkeypatch.setattr(body, "BODY_TIMEOUT_S", 0.5)
    assert raw(url, f"POST {TARE}", "Content-Length: 9", data=b"x")[0] == 408
    assert rig.service.events.newest == 0
    rig.stale_after(BUSY_S)
    rig.show(pressed(force=0))
    assert raw(url, f"POST {TARE}", "Content-Length: 9", data=b"x" * 9)[0] == 202


def test_an_answer_that_nobody_reads_is_given_up_on(rig, place, monkeypatch):
    size = 64 << 20
    with (place / "big.log").open("wb") as file:
        file.truncate(size)
    monkeypatch.setattr(bounds, "UNREAD_S", 1.0)
    with running(rig.service, Server(port=0, recordings=place)) as url, plug(url) as slow, plug(url) as silent:
        for end in (slow, silent):
            end.sendall(f"GET /api/v1/recordings/big.log HTTP/1.1\r\nHost: {url[7:]}\r\n\r\n".encode())
        taken = 0
        for _ in range(20):
            taken += len(slow.recv(1 << 18))
            time.sleep(0.2)
        assert len(said(silent)) < size
        while taken < size and (piece := slow.recv(1 << 20)):
            taken += len(piece)
    assert taken > size


def test_an_address_with_a_slash_behind_it_hands_no_token_on(url):
    for path in ("sensors/", "health/", "sensors/palm/"):
        for host in ("localhost", f"{url[7:]}"):
            answer = ask("GET", f"{url}/api/v1/{path}", params={"token": "hush"}, headers={"Host": host})
            assert problem(answer, 404) == f"GET /api/v1/{path}: not found"
            assert "location" not in answer.headers


@pytest.fixture
def certificate(tmp_path):
    """Keys of a server with TLS."""
    command = "openssl req -x509 -newkey rsa:2048 -nodes -subj /CN=localhost -out certificate.pem -keyout key.pem"
    subprocess.run(command, shell=True, cwd=tmp_path, check=True, capture_output=True)
    return {"tls_certificate": tmp_path / "certificate.pem", "tls_key": tmp_path / "key.pem"}


def test_a_tls_handshake_that_does_not_come_is_given_up_on(rig, certificate, monkeypatch):
    bound(monkeypatch, State.TLS, seconds=0.5)
    with running(rig.service, Server(port=0, **certificate)) as url, plug(url) as end:
        answer, seconds = closed_after(end)
        assert answer == b""
        assert seconds < 30  # asyncio itself waits a minute
        assert ask("GET", url + "/api/v1/health", verify=False).status_code == 200


@pytest.mark.parametrize("host", ["127.0.0.1", "0.0.0.0"])
def test_a_browser_stays_with_tls_where_other_machines_come_by(rig, certificate, host):
    """On loopback every other server of this machine would have to have it."""
    bearer = {"Authorization": "Bearer " + "c" * 16}
    for tls in (certificate, {}):
        with running(rig.service, Server(host=host, port=0, control_token=SecretStr("c" * 16), **tls)) as url:
            answer = ask("GET", url + "/api/v1/health", headers=bearer, verify=False)
            assert answer.status_code == 200
            told = answer.headers.get("strict-transport-security")
            assert told == ("max-age=31536000" if tls and host == "0.0.0.0" else None)


def test_control_is_bounded_for_each_client_and_reading_is_not(rig):
    rig.show(pressed())
    with running(rig.service, Server(port=0, control_per_minute=1)) as url:
        assert ask("PUT", url + METHOD, json=RAW).status_code == 200
        answer = ask("PUT", url + METHOD, json={"method": "nnls"})
        problem(answer, 429)
        assert 1 <= int(answer.headers["retry-after"]) <= 60
        frames = f"{url}/api/v1/sensors/palm/frames"
        assert ask("GET", frames + "/deviation").status_code == 200  # counted apart
        for path in ("/raw?format=png", "/deviation", "?last=1s"):
            problem(ask("GET", frames + path), 429)
        assert {ask("GET", url + path).status_code for path in ("/api/v1/health", METHOD, "/") * 5} == {200}
    assert rig.sensor.method == "raw"


def test_who_looks_without_end_may_still_change_something(rig):
    rig.show(pressed())
    with running(rig.service, Server(port=0, control_per_minute=1)) as url:
        codes = [ask("GET", url + "/api/v1/sensors/palm/frames/deviation").status_code for _ in range(3)]
        assert codes == [200, 429, 429]
        assert ask("PUT", url + METHOD, json=RAW).status_code == 200


def ended(client):
    """Code and reason that a stream is closed with."""
    with pytest.raises(ConnectionClosed) as caught:
        [client.recv(timeout=BUSY_S) for _ in range(1000)]
    return caught.value.rcvd.code, caught.value.rcvd.reason


@pytest.mark.parametrize("path", ["api/v1/stream", "api/v1/sensors/palm/stream", "xela", ""])
def test_streams_are_bounded_for_each_client_and_for_all_and_counted(rig, path):
    bounds = Server(port=0, streams_per_client=2, streams=3)
    with running(rig.service, bounds) as url, ExitStack() as stack:

        def stream(who, path="api/v1/stream"):
            address = f"{url.replace('http', 'ws', 1)}/{path}"
            return stack.enter_context(connect(address, additional_headers={"X-Forwarded-For": who}))

        streams = [stream(who) for who in ("10.0.0.1", "10.0.0.2", "10.0.0.1")]
        for each in streams:
            assert "status" in each.recv(timeout=BUSY_S)
        assert ended(stream("10.0.0.1", path)) == (
            4429,
            "streams_per_client = 2: 10.0.0.1 has as many open: close one",
        )
        assert ended(stream("10.0.0.2", path)) == (4503, "streams = 3: as many are open: come again later")
        told = ask("GET", url + "/metrics").text.splitlines()
        assert "tactiled_streams 3" in told
        assert 'tactiled_streams_refused_total{bound="streams_per_client"} 1' in told
        assert 'tactiled_streams_refused_total{bound="streams"} 1' in told
        streams[0].close()
        until(lambda: "tactiled_streams 2" in ask("GET", url + "/metrics").text)
        assert "status" in stream("10.0.0.1").recv(timeout=BUSY_S)


def test_a_proxy_on_this_machine_says_whose_request_it_is(rig):
    """The address that the proxy has added is the last one; the client itself may have claimed others before."""
    with running(rig.service, Server(port=0, control_per_minute=1, streams_per_client=1)) as url:
        hosts = "10.0.0.1", "10.0.0.2", "9.9.9.9, 10.0.0.1", "10.0.0.1, 10.0.0.3"
        asked = [ask("PUT", url + METHOD, json=RAW, headers={"X-Forwarded-For": each}) for each in hosts]
        assert [each.status_code for each in asked] == [200, 200, 429, 200]
        address = url.replace("http", "ws", 1) + "/api/v1/stream"
        with connect(address, additional_headers={"X-Forwarded-For": hosts[0]}) as first:
            for host in hosts[1:]:
                with connect(address, additional_headers={"X-Forwarded-For": host}) as other:
                    if host.endswith("10.0.0.1"):
                        assert ended(other)[0] == 4429
                    else:
                        assert "status" in other.recv(timeout=BUSY_S)
            assert "status" in first.recv(timeout=BUSY_S)


def test_a_program_waits_for_a_place_and_says_why_it_has_none(rig):
    with running(rig.service, Server(port=0, streams_per_client=1)) as url:
        why = r"no image for 2\.0 s: streams_per_client = 1: 127\.0\.0\.1 has as many open"
        with connect(url.replace("http", "ws", 1) + "/api/v1/stream"), pytest.raises(TactileError, match=why):
            next(tactiled.connect(url).stream("palm", patience_s=2.0))
        rig.show(pressed())
        assert next(tactiled.connect(url).stream("palm", patience_s=BUSY_S)).sequence == 0


def test_every_token_is_compared_in_full_whatever_is_shown(monkeypatch):
    """`compare_digest` takes a time that tells nothing; so all rests on its being what compares, every time."""
    keys = Tokens(Server(read_token=SecretStr("r" * 16), control_token=SecretStr("c" * 16)))
    compared, compare = [], secrets.compare_digest

    def spy(shown, token):
        compared.append(token)
        return compare(shown, token)

    monkeypatch.setattr(secrets, "compare_digest", spy)
    for shown in ("", "r", "r" * 16, "c" * 16, "x" * 1000, "ü"):
        compared.clear()
        keys.rights(shown)
        assert compared == [b"r" * 16, b"c" * 16]


def test_no_answer_holds_a_secret(rig, place):
    rig.show(pressed())
    tokens = "hush-hush-reader", "hush-hush-master"
    asked = Server(
        port=0, read_token=SecretStr(tokens[0]), control_token=SecretStr(tokens[1]), recordings=place / "r"
    )
    seen = 0
    with running(rig.service, asked) as url, httpx.Client(**HTTP, base_url=url) as client:
        client.headers["Authorization"] = f"Bearer {tokens[1]}"
        for path, operations in client.get("/api/v1/openapi.json").json()["paths"].items():
            if "get" in operations:
                address = path.format(name="palm", kind="raw")
                for query in ("", f"?token={tokens[1]}", f"?limit={tokens[0][:4]}"):
                    answer = client.get(address + query)
                    assert not any(token in answer.text + str(answer.headers) for token in tokens), address
                    seen += 1
    assert seen >= 30


def test_no_answer_holds_the_login_of_a_bus(place, monkeypatch):
    channel = "socket://palm:hush-hush@adapter:1?pin=hush"
    service = Service(parse(CONFIG.format(channel=channel)))

    def gone(*_, **__):
        raise OSError(f"no answer from {channel}")

    with ExitStack() as stack:
        service.start()
        stack.callback(service.stop)
        url = stack.enter_context(running(service, Server(port=0, recordings=place / "recordings")))
        stream = stack.enter_context(connect(url.replace("http", "ws", 1) + "/api/v1/sensors/palm/stream"))
        monkeypatch.setattr(can, "Bus", gone)
        monkeypatch.setattr(VirtualBus, "_recv_internal", gone)
        until(lambda: service.sensors["palm"].status().state == "down" and service.events.newest)
        started = ask("POST", url + "/api/v1/recordings", json={"bus": "can0"})
        told = [problem(started, 503), next(each for each in stream if '"down"' in each)]
        told += [
            ask("GET", f"{url}/api/v1/{path}").text for path in ("health", "sensors/palm", "events", "config")
        ]
    for each in told:
        assert "socket://adapter:1" in each
        assert "hush" not in each


def test_a_fault_of_our_own_is_a_problem_that_tells_nothing_and_carries_the_headers(rig, url, monkeypatch):
    rig.show(pressed())
    monkeypatch.setattr(Sensor, "contacts", lambda _: {}["hush"])
    answer = ask("GET", url + "/api/v1/sensors/palm/contacts")
    assert problem(answer, 500) == "the service failed at this: see its log"
    assert "default-src 'none'" in answer.headers["content-security-policy"]
    assert "hush" not in answer.text
    assert ask("GET", url + "/api/v1/health").status_code == 200


@pytest.mark.parametrize(
    ("verb", "path", "allowed"), [("POST", METHOD, "GET"), ("DELETE", "/api/v1/health", "GET")]
)
def test_an_unknown_method_is_a_problem_that_names_it(url, verb, path, allowed):
    answer = ask(verb, url + path)
    assert f"{verb} {path}" in problem(answer, 405)
    assert allowed in answer.headers["allow"]


@pytest.mark.parametrize(
    "path", ["/nothing", "/api/v1/nothing", "/api/v2/health", "/static/nothing", "/API/v1/health"]
)
def test_a_path_that_is_not_there_is_a_problem_that_names_it(url, path):
    assert problem(ask("GET", url + path), 404) == f"GET {path}: not found"


@pytest.mark.parametrize(
    ("content", "status", "says"),
    [
        (b"{", 400, "body: no JSON at character 1: Expecting property name enclosed in double quotes"),
        (b"\xff\xfe", 400, "body: no JSON at character 0: Expecting value"),
        (b'"\xff"', 400, "body: 'utf-8' codec can't decode byte 0xff in position 1"),
        (b"[" * 5000, 400, "body: maximum recursion depth exceeded"),
        (b'{"method": "raw", "x": 1}', 422, "x = 1: Extra inputs are not permitted"),
        (b"", 422, "body: give a JSON object"),
        (b"null", 422, "body: give a JSON object"),
        (b"1e999", 422, "body = inf: give a JSON object"),
        (b"[]", 422, "body = []: give a JSON object"),
    ],
)
def test_a_body_that_is_no_json_is_named(url, content, status, says):
    answer = ask("PUT", url + METHOD, content=content, headers={"Content-Type": "application/json"})
    assert problem(answer, status).startswith(says)
