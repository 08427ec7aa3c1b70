import io
import json
import tempfile
import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack

import numpy as np
import pytest

from tactiled.build import sensor_plan
from tactiled.recorded import offline
from tactiled.recorded.offline import Offline
from tactiled.web.http import body, timeouts
from tactiled.web.rest import restore
from tactiled.web.server import running
from tests.conftest import BUSY_S, ask, problem, until
from tests.web.http.raw import npy, plug

ONE_FRAME = npy(np.zeros((1, 8, 8)))


@pytest.fixture
def frames():
    """(T, 8, 8) kPa."""
    random = np.random.default_rng(0)
    frames = random.normal(0, 0.5, (20, 8, 8))
    frames[5:, 3:5, 3:5] += 100
    frames[9, 4, 4] = np.nan
    return frames


@pytest.fixture
def transfers(monkeypatch):
    """Those of the next application."""
    transfers = restore.Transfers()
    monkeypatch.setattr(restore, "Transfers", lambda: transfers)
    return transfers


def post(url, content, **query):
    return ask("POST", f"{url}/api/v1/restore", params={"sensor": "palm"} | query, content=content, timeout=30)


@pytest.mark.parametrize("query", [{}, {"method": "wiener"}, {"noise_kpa": 0.5, "method": "nnls"}])
def test_frames_are_restored_as_offline(rig, url, frames, query):
    answer = post(url, npy(frames), **query)
    assert answer.status_code == 200, answer.text
    plan = sensor_plan("palm", rig.config.sensor["palm"])
    offline = Offline(plan, frames, **query)
    expected = np.concatenate([images.copy() for images, _ in offline])
    np.testing.assert_array_equal(np.load(io.BytesIO(answer.content)), expected)
    assert float(answer.headers["x-tactiled-noise"]) == pytest.approx(offline.noise_kpa, rel=1e-5)
    assert sum(json.loads(answer.headers["x-tactiled-methods"]).values()) == 20
    assert answer.headers["x-tactiled-unit"] == "kPa"
    assert np.load(io.BytesIO(post(url, npy(frames[:0])).content)).shape == (0, 8, 8)


def test_wrong_frames_and_parameters_are_named(url):
    good = npy(np.zeros((3, 8, 8)))
    for content, query, status, detail in (
        (b"", {}, 422, "body: no complete .npy file of numbers"),
        (b"\x93NUMPY junk", {}, 422, "body: no complete .npy file of numbers"),
        (npy(np.zeros((3, 4, 4))), {}, 422, "body: shape (3, 4, 4) for sensor palm: give (T, 8, 8)"),
        (npy(np.zeros((3, 8, 8), complex)), {}, 422, "body: dtype complex128: give real numbers"),
        (npy(np.array([[None]])), {}, 422, "body: no complete .npy file of numbers"),
        (good, {"method": "sharpen"}, 422, "method = 'sharpen': no such method"),
        (good, {"noise_kpa": -1}, 422, "noise_kpa = '-1'"),
        (good, {"sensor": "plam"}, 404, "sensor 'plam': no such sensor"),
    ):
        assert problem(post(url, content, **query), status).startswith(detail)


def test_frames_or_images_of_too_many_bytes_are_refused(url, frames, monkeypatch):
    monkeypatch.setattr(restore, "MAX_IMAGE_BYTES", 1 << 10)
    assert "20 frames make images of more than" in problem(post(url, npy(frames)), 413)
    monkeypatch.setattr(body, "MAX_UPLOAD_BYTES", 1 << 10)
    assert "a body of more than 1 KiB" in problem(post(url, npy(frames)), 413)


def test_frames_are_refused_until_others_are_restored(url, frames, monkeypatch):
    began, go_on, write = threading.Event(), threading.Event(), Offline.write

    def slow(*arguments):
        began.set()
        assert go_on.wait(60)
        return write(*arguments)

    monkeypatch.setattr(Offline, "write", slow)
    monkeypatch.setattr(offline, "PIECE_FRAMES", 1)
    with ThreadPoolExecutor(1) as other:
        first = other.submit(post, url, npy(frames))
        assert began.wait(60)
        refused = post(url, npy(frames))
        go_on.set()
        assert first.result().status_code == 200
    assert problem(refused, 429) == "other frames are being restored: wait"
    assert refused.headers["retry-after"] == "1"
    assert post(url, npy(frames)).status_code == 200


def begin(url, client, content=b"", length=5000):
    """A connection on which a client sends the beginning of its frames."""
    connection = plug(url)
    connection.sendall(
        f"POST /api/v1/restore?sensor=palm&method=raw HTTP/1.1\r\nHost: {url[7:]}\r\n"
        f"X-Forwarded-For: {client}\r\nContent-Length: {length}\r\n\r\n".encode()
        + content
    )
    return connection


def refusal(url, client):
    answer = ask("POST", f"{url}/api/v1/restore?sensor=palm", headers={"X-Forwarded-For": client})
    return problem(answer, 429)


def test_slow_transfers_delay_only_their_own_clients(rig, transfers, caplog):
    bound = restore.MAX_TRANSFERS
    with running(rig.service) as url:
        with ExitStack() as stack:
            for n in range(1, bound):
                stack.enter_context(begin(url, f"10.0.0.{n}", b"\x93NUMPY"))
            until(lambda: len(transfers.clients) == bound - 1)
            assert refusal(url, "10.0.0.1") == "frames of 10.0.0.1 are in transfer: wait"
            for _ in range(3):
                assert post(url, ONE_FRAME).status_code == 200
            last = stack.enter_context(begin(url, "10.0.0.9"))
            until(lambda: len(transfers.clients) == bound)
            assert refusal(url, "10.0.0.10") == "frames of 4 clients are in transfer: wait"
            last.close()
            until(lambda: len(transfers.clients) == bound - 1)
            assert post(url, ONE_FRAME).status_code == 200
        until(lambda: not transfers.clients)
    assert not [
        each for each in caplog.records if each.name != "tactiled.events"
    ]  # a client that leaves is no failure of the service


def test_an_answer_that_nobody_reads_keeps_its_place_until_it_is_cut_off(rig, transfers, tmp_path, monkeypatch):
    content = npy(np.zeros((80_000, 8, 8), np.float32))
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr(timeouts, "UNREAD_S", 3.0)
    with running(rig.service) as url, begin(url, "10.0.0.1", content, len(content)) as client:
        assert client.recv(12) == b"HTTP/1.1 200"
        assert refusal(url, "10.0.0.1") == "frames of 10.0.0.1 are in transfer: wait"
        assert [each.name for each in tmp_path.glob(".tactiled-*/*")] == ["restored.npy"]
        assert post(url, ONE_FRAME).status_code == 200
        until(lambda: not transfers.clients)
        assert not list(tmp_path.iterdir())


MANY_FRAMES = 200_000  # some seconds of restoring
MANY = npy(np.zeros((MANY_FRAMES, 8, 8), np.uint8))
RESTORE = Offline._restore


class Restoring(threading.Event):
    """Set once frames are being restored, which are counted."""

    frames = 0

    def one(self, *arguments):
        self.set()
        self.frames += 1
        return RESTORE(*arguments)

    def begin(self, url):
        """A client whose many frames are being restored."""
        end = plug(url)
        head = f"POST /api/v1/restore?sensor=palm&noise=1&method=wiener HTTP/1.1\r\nHost: {url[7:]}\r\n"
        end.sendall(f"{head}Content-Length: {len(MANY)}\r\n\r\n".encode() + MANY)
        assert self.wait(BUSY_S)
        return end


@pytest.fixture
def restoring(monkeypatch):
    restoring = Restoring()
    monkeypatch.setattr(Offline, "_restore", lambda *arguments: restoring.one(*arguments))
    return restoring


def test_restoring_ends_with_its_client(rig, transfers, restoring):
    with running(rig.service) as url:
        restoring.begin(url).close()
        until(lambda: not transfers.clients)
        assert not transfers.restoring.locked()
        assert restoring.frames < MANY_FRAMES


def test_restoring_ends_with_the_service(rig, restoring):
    with running(rig.service) as url, restoring.begin(url):
        pass
    assert restoring.frames < MANY_FRAMES
