"""Bodies of requests that are too large, too late or harmful, and paths that leave their folder."""

import io
import tempfile
import time
from itertools import product
from pathlib import Path

import httpx
import numpy as np
import pytest

from tactiled.config import Server
from tactiled.web.http import body, timeouts
from tactiled.web.http.timeouts import Phase
from tactiled.web.server import running
from tests.conftest import BUSY_S, HTTP, ask, pressed, problem, until
from tests.web.http.raw import bound, npy, plug, read_all, send_raw

EXECUTED = Path("/tmp/was-here-by-an-upload")
METHOD, TARE = "/api/v1/sensors/palm/method", "/api/v1/sensors/palm/tare"
RESTORE = "/api/v1/restore?sensor=palm"
DISCONNECTED = (BrokenPipeError, ConnectionResetError)


@pytest.fixture
def folder(tmp_path):
    """A folder of recordings with a secret beside it."""
    (tmp_path / "secret.log").write_text("hush")
    return tmp_path


@pytest.fixture
def url(rig, folder):
    with running(rig.service, Server(port=0, recordings=folder / "recordings", control_per_minute=0)) as address:
        yield address


def test_no_path_leaves_its_folder(url, folder):
    up = ("..", "%2e%2e", "%2E.", ".%2e", "..%00", "....", "%252e%252e", "%c0%ae%c0%ae", "..\\", "..%5c")
    slashes = ("/", "%2f", "%5c", "//", "/./", "%252f")
    recordings = "/api/v1/recordings"
    targets = [(verb, recordings, "secret.log") for verb in ("GET", "DELETE")] + [("GET", "/static", "app.py")]
    for (verb, parent, name), parts, slash in product(targets, up, slashes):
        path = f"{parent}{slash}{parts}{slash}{name}"
        status, content = send_raw(url, f"{verb} {path}")
        assert status in (400, 404, 405, 422), (verb, path, status)
        assert b"hush" not in content
        assert b"import" not in content
    assert (folder / "secret.log").read_text() == "hush"


def endless(url, path, verb):
    """Send a chunked body for ever; gives the status line, empty where the service cut it off."""
    with plug(url) as end:
        end.sendall(f"{verb} {path} HTTP/1.1\r\nHost: {url[7:]}\r\nContent-Type: application/json\r\n".encode())
        end.sendall(b"Transfer-Encoding: chunked\r\n\r\n")
        piece = b"10000\r\n" + b" " * (1 << 16) + b"\r\n"
        with pytest.raises(DISCONNECTED):
            [end.sendall(piece) for _ in range(80 << 4)]
        return read_all(end).split(b"\r\n")[0]


@pytest.mark.parametrize(("path", "verb"), [(METHOD, "PUT"), ("/api/v1/recordings", "POST")])
def test_a_body_that_is_too_large_is_refused(rig, url, path, verb):
    problem(ask(verb, url + path, content=b" " * (body.MAX_BODY_BYTES + 1)), 413)
    assert ask(verb, url + path, content=b" " * body.MAX_BODY_BYTES).status_code != 413
    for length in (body.MAX_BODY_BYTES + 1, 10**15):
        headers = "Content-Type: application/json", f"Content-Length: {length}"
        assert send_raw(url, f"{verb} {path}", *headers)[0] == 413
    assert endless(url, path, verb)[9:12] in (b"", b"413")
    assert rig.sensor.method == "wiener"


@pytest.fixture
def uploads(tmp_path, monkeypatch):
    """The folder of uploads while they are restored."""
    path = tmp_path / "uploads"
    path.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(path))
    return path


def header(text, length=None):
    """An .npy file with this header and 64 bytes of data."""
    padded = text.encode().ljust(117) + b"\n"
    return b"\x93NUMPY\x01\x00" + (length or len(padded)).to_bytes(2, "little") + padded + bytes(64)


def shaped(shape, kind="<f8"):
    return header(f"{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}}}")


class Pickled:
    def __reduce__(self):
        return (Path.touch, (EXECUTED,))


def archive():
    out = io.BytesIO()
    np.savez_compressed(out, np.zeros((1 << 18, 8, 8)))
    return out.getvalue()


BOMBS = {
    "1e12 frames": shaped("(1000000000000, 8, 8)"),
    "an expression": shaped("(2**70, 8, 8)"),
    "a number of 70 bits": shaped(f"({2**70}, 8, 8)"),
    "a negative number": shaped("(-1, 8, 8)"),
    "empty items": shaped("(1000000000000, 8, 8)", "|V0"),
    "text": shaped("(9, 8, 8)", "<U0"),
    "objects": shaped("(1, 8, 8)", "|O"),
    "a header longer than the file": header("{}", 65535),
    "code": header(f"__import__('os').system('touch {EXECUTED}')"),
    "a deep header": header("(" * 100),
    "a header that breaks the parser": header("-" * 9000 + "1"),
    "a pickle": npy(np.array([[[Pickled()] * 8] * 8]), allow_pickle=True),
    "records": npy(np.zeros((2, 8, 8), [("a", "f4")])),
    "a compressed archive": archive(),
}


def test_an_upload_that_is_a_bomb_is_refused(url, uploads):
    for name, bomb in BOMBS.items():
        answer = ask("POST", url + RESTORE, content=bomb)
        assert answer.status_code == 422, (name, answer.text)
        assert "tactiled-" not in problem(answer, 422)
    assert not EXECUTED.exists()
    assert not list(uploads.iterdir())


def test_an_endless_upload_is_cut_off_and_its_file_removed(url, uploads, monkeypatch):
    monkeypatch.setattr(body, "MAX_UPLOAD_BYTES", 1 << 20)
    assert endless(url, RESTORE, "POST")[9:12] in (b"", b"413")
    until(lambda: not list(uploads.iterdir()))
    assert ask("POST", url + RESTORE, content=npy(np.zeros((1, 8, 8)))).status_code == 200


def test_nothing_is_done_before_the_body_is_known_to_fit(rig, url, monkeypatch):
    chunk = b"10000\r\n" + bytes(1 << 16) + b"\r\n"
    for length, data in (("Content-Length: 65537", b""), ("Transfer-Encoding: chunked", 5 * chunk + b"0\r\n\r\n")):
        assert send_raw(url, f"POST {TARE}", length, data=data)[0] == 413
    with plug(url) as end:
        end.sendall(f"POST {TARE} HTTP/1.1\r\nHost: {url[7:]}\r\nContent-Length: 9\r\n\r\nx".encode())
    with monkeypatch.context() as hasty:
        hasty.setattr(body, "BODY_TIMEOUT_S", 0.5)
        for line in (f"POST {TARE}", f"PUT {METHOD}", f"POST {RESTORE}"):
            assert send_raw(url, line, "Content-Type: application/json", "Content-Length: 9", data=b"x")[0] == 408
    assert {each.kind for each in rig.service.events.after(0)} <= {"sensor_silent"}
    rig.stale_after(BUSY_S)
    rig.show(pressed(force=0))
    assert send_raw(url, f"POST {TARE}", "Content-Length: 9", data=b" " * 9)[0] == 202


CHUNKED = "Transfer-Encoding: chunked"
CALIBRATION = "/api/v1/sensors/palm/calibration/file"


@pytest.mark.parametrize("length", ["Content-Length: 8000000", CHUNKED])
@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("GET /api/v1/sensors/palm/geometry", 422),
        ("HEAD /api/v1/sensors/palm/geometry", 422),
        (f"GET {CALIBRATION}", 404),
        (f"OPTIONS {CALIBRATION}", 405),
        (f"GET {TARE}", 405),
    ],
)
def test_where_no_body_belongs_none_is_waited_for(url, line, expected, length):
    status, content = send_raw(url, line, length)  # of which nothing comes
    assert status == expected
    assert not content or status != 422 or b"body: GET takes none" in content


def test_of_all_bodies_together_the_largest_incomplete_one_gives_way(url, monkeypatch):
    monkeypatch.setattr(body, "MAX_HELD_BYTES", 300_000)
    head = f"PUT {CALIBRATION} HTTP/1.1\r\nHost: {url[7:]}\r\nContent-Length: 1000000\r\n\r\n".encode()
    with plug(url) as large, plug(url) as other:
        large.sendall(head + bytes(200_000))
        other.sendall(head + bytes(90_000))
        large.sendall(bytes(20_000))
        answer = large.recv(1 << 16)
        assert answer.startswith(b"HTTP/1.1 503")
        assert b"retry-after" in answer
        assert problem(ask("PUT", url + METHOD, json={"method": "spline"}), 422)  # others are served
        other.sendall(bytes(210_000))  # 300 000 in all: the bound
        other.sendall(b"x")
        assert other.recv(1 << 16).startswith(b"HTTP/1.1 503")
    assert ask("PUT", url + CALIBRATION, content=bytes(290_000)).status_code == 422  # nothing is held for ever


@pytest.mark.parametrize(("length", "piece"), [("Content-Length: 1000000000", b"z"), (CHUNKED, b"1\r\nz\r\n")])
@pytest.mark.parametrize("line", [f"POST {TARE}", "GET /api/v1/health", f"POST {RESTORE}"])
def test_after_a_refusal_no_body_is_accepted(guarded, monkeypatch, line, length, piece):
    bound(monkeypatch, Phase.CLOSING, seconds=0.5)
    with plug(guarded) as end:
        end.sendall(f"{line} HTTP/1.1\r\nHost: {guarded[7:]}\r\n{length}\r\n\r\n".encode())
        answer = end.recv(1 << 16)
        with pytest.raises(DISCONNECTED):
            [(end.sendall(piece), time.sleep(0.05)) for _ in range(1000)]
    assert answer.startswith(b"HTTP/1.1 401")
    assert b"\r\nconnection: close\r\n" in answer


def test_a_client_reads_its_refusal_after_it_sent_the_body(guarded, monkeypatch):
    bound(monkeypatch, Phase.CLOSING, bytes=10 << 20, seconds=BUSY_S)
    with plug(guarded) as end:
        end.sendall(f"POST {TARE} HTTP/1.1\r\nHost: {guarded[7:]}\r\nContent-Length: 8000000\r\n\r\n".encode())
        time.sleep(0.2)  # in which it is refused
        end.sendall(bytes(8_000_000))
        assert b"a token is needed" in read_all(end)


def test_a_connection_is_kept_when_the_body_is_complete(url):
    with httpx.Client(**HTTP, base_url=url) as client:
        for answer in (client.post(TARE, content=b"x" * 1000), client.put(METHOD, content=b"{"), client.get("/")):
            assert "connection" not in answer.headers


def test_an_answer_that_the_client_does_not_read_is_given_up(rig, folder, monkeypatch):
    size = 64 << 20
    with (folder / "large.log").open("wb") as file:
        file.truncate(size)
    monkeypatch.setattr(timeouts, "UNREAD_S", 1.0)
    with running(rig.service, Server(port=0, recordings=folder)) as url, plug(url) as slow, plug(url) as silent:
        for end in (slow, silent):
            end.sendall(f"GET /api/v1/recordings/large.log HTTP/1.1\r\nHost: {url[7:]}\r\n\r\n".encode())
        count = 0
        for _ in range(20):
            count += len(slow.recv(1 << 18))
            time.sleep(0.2)
        assert len(read_all(silent)) < size
        while count < size and (piece := slow.recv(1 << 20)):
            count += len(piece)
    assert count > size
