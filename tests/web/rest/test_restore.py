import io
import json
import math
import socket
import tempfile
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack

import numpy as np
import pytest

from tactiled.build import sensor_plan
from tactiled.runtime import offline
from tactiled.runtime.offline import Offline
from tactiled.web.http import body, bounds
from tactiled.web.rest import restore
from tactiled.web.server import running
from tests.conftest import ask, until


@pytest.fixture
def frames():
    """(T, 8, 8) kPa."""
    random = np.random.default_rng(0)
    frames = random.normal(0, 0.5, (20, 8, 8))
    frames[5:, 3:5, 3:5] += 100
    frames[9, 4, 4] = np.nan
    return frames


def npy(array):
    out = io.BytesIO()
    np.save(out, array)
    return out.getvalue()


def post(url, body, **query):
    return ask("POST", f"{url}/api/v1/restore", params={"sensor": "palm"} | query, content=body, timeout=30)


@pytest.mark.parametrize("query", [{}, {"method": "wiener"}, {"noise_kpa": 0.5, "method": "nnls"}])
def test_a_film_is_restored_as_offline(rig, url, frames, query):
    answer = post(url, npy(frames), **query)
    assert answer.status_code == 200, answer.text
    images = np.load(io.BytesIO(answer.content))
    offline = Offline(sensor_plan("palm", rig.config.sensor["palm"]), frames, **query)
    np.testing.assert_array_equal(images, np.concatenate([each.copy() for each, _ in offline]))
    assert float(answer.headers["x-tactiled-noise"]) == pytest.approx(offline.noise_kpa, rel=1e-5)
    assert sum(json.loads(answer.headers["x-tactiled-methods"]).values()) == 20


@pytest.mark.parametrize(
    ("body", "query", "status", "says"),
    [
        (b"", {}, 422, "body: no .npy file of numbers"),
        (b"\x93NUMPY junk", {}, 422, "body: no .npy file of numbers"),
        (npy(np.zeros((3, 4, 4))), {}, 422, "shape (3, 4, 4) for sensor palm: give (T, 8, 8)"),
        (npy(np.zeros((3, 8, 8), complex)), {}, 422, "dtype complex128: give real numbers"),
        (npy(np.array([[None]])), {}, 422, "no .npy file of numbers"),
        (npy(np.zeros((3, 8, 8))), {"method": "sharpen"}, 422, "method = 'sharpen': no such method"),
        (npy(np.zeros((3, 8, 8))), {"noise_kpa": -1}, 422, "noise_kpa = '-1'"),
        (npy(np.zeros((3, 8, 8))), {"sensor": "plam"}, 404, "sensor 'plam': no such sensor"),
    ],
)
def test_what_is_no_film_of_this_sensor_is_refused_by_name(url, body, query, status, says):
    answer = post(url, body, **query)
    assert answer.status_code == status
    assert answer.headers["content-type"] == "application/problem+json"
    assert says in answer.json()["detail"]
    assert "/tmp" not in answer.json()["detail"]


def test_a_film_that_is_too_large_is_refused_as_soon_as_that_is_known(url, frames, monkeypatch):
    monkeypatch.setattr(body, "MAX_UPLOAD_BYTES", 1 << 10)
    assert post(url, npy(frames)).status_code == 413
    monkeypatch.setattr(body, "MAX_UPLOAD_BYTES", 1 << 20)
    monkeypatch.setattr(restore, "MOST_OUT", 1 << 10)
    assert post(url, npy(frames)).status_code == 413


def test_an_empty_film_gives_an_empty_one(url):
    answer = post(url, npy(np.zeros((0, 8, 8))))
    assert answer.status_code == 200
    assert np.load(io.BytesIO(answer.content)).shape == (0, 8, 8)


@pytest.mark.parametrize(
    ("elapsed", "done", "wait"), [(7.2, 0, 8), (0.0, 0, 1), (10.0, 5, 30), (10.0, 19, 1), (10.0, 20, 1)]
)
def test_who_comes_while_a_film_is_restored_is_told_how_long_that_will_take(elapsed, done, wait):
    now = [100.0]
    progress = restore.Progress(lambda: now[0])
    now[0] += 1000.0  # in which it comes in
    assert progress.wait() == 1000
    progress.begin(20)
    now[0] += elapsed
    progress.add(done)
    assert progress.wait() == wait


def test_a_second_film_is_refused_until_the_first_is_restored(url, frames, monkeypatch):
    some, go_on, write = threading.Event(), threading.Event(), restore.write

    def slow(images, shape, path, done):
        def told(count):
            done(count)
            some.set()
            assert go_on.wait(60)

        write(images, shape, path, told)

    monkeypatch.setattr(restore, "write", slow)
    monkeypatch.setattr(offline, "PIECE_FRAMES", 1)
    with ThreadPoolExecutor(1) as other:
        began = time.monotonic()
        first = other.submit(post, url, npy(frames))
        assert some.wait(60)
        time.sleep(0.2)  # one frame of twenty is done in so long
        refused = post(url, npy(frames))
        longest = math.ceil(19 * (time.monotonic() - began))
        go_on.set()
        assert first.result().status_code == 200
    assert (refused.status_code, refused.json()["detail"]) == (429, "another film is being restored: wait")
    assert math.ceil(19 * 0.2) <= int(refused.headers["retry-after"]) <= longest
    assert post(url, npy(frames)).status_code == 200


def begun(url, who, body=b"", length=5000):
    """A connection on which a client sends the beginning of a film."""
    end = socket.create_connection(url[7:].split(":"), timeout=60)
    head = f"POST /api/v1/restore?sensor=palm&method=raw HTTP/1.1\r\nHost: {url[7:]}\r\nX-Forwarded-For: {who}\r\n"
    end.sendall(f"{head}Content-Length: {length}\r\n\r\n".encode() + body)
    return end


def refused(url, who):
    answer = ask("POST", f"{url}/api/v1/restore?sensor=palm", headers={"X-Forwarded-For": who})
    assert answer.status_code == 429
    assert int(answer.headers["retry-after"]) >= 1
    return answer.json()["detail"]


def test_a_film_that_comes_in_slowly_keeps_only_its_client_waiting(rig, monkeypatch):
    films = restore.Films()
    monkeypatch.setattr(restore, "Films", lambda: films)
    with running(rig.service) as url, ExitStack() as stack:
        for n in range(1, restore.MOST_HELD):
            stack.enter_context(begun(url, f"10.0.0.{n}"))
        until(lambda: len(films._held) == restore.MOST_HELD - 1)
        assert refused(url, "10.0.0.1") == "another film of 10.0.0.1 comes in or goes out: wait"
        for _ in range(3):
            assert post(url, npy(np.zeros((1, 8, 8)))).status_code == 200
        last = stack.enter_context(begun(url, "10.0.0.9"))
        until(lambda: len(films._held) == restore.MOST_HELD)
        assert refused(url, "10.0.0.10") == "4 films come in or go out: wait"
        last.close()
        until(lambda: len(films._held) == restore.MOST_HELD - 1)
        assert post(url, npy(np.zeros((1, 8, 8)))).status_code == 200


def test_a_film_that_nobody_reads_keeps_its_place_until_it_is_cut_off(rig, tmp_path, monkeypatch):
    films, body = restore.Films(), npy(np.zeros((80_000, 8, 8), np.float32))
    monkeypatch.setattr(restore, "Films", lambda: films)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr(bounds, "UNREAD_S", 3.0)
    with running(rig.service) as url, begun(url, "10.0.0.1", body, len(body)) as end:
        assert end.recv(12) == b"HTTP/1.1 200"
        assert refused(url, "10.0.0.1") == "another film of 10.0.0.1 comes in or goes out: wait"
        assert [each.name for each in tmp_path.glob("tactiled-*/*")] == ["restored.npy"]
        assert post(url, npy(np.zeros((1, 8, 8)))).status_code == 200
        until(lambda: not films._held)
        assert not list(tmp_path.iterdir())


def test_a_client_that_leaves_amid_its_film_is_no_failure_of_the_service(rig, monkeypatch, caplog):
    films = restore.Films()
    monkeypatch.setattr(restore, "Films", lambda: films)
    with running(rig.service) as url:
        with socket.create_connection(url[7:].split(":")) as leaves:
            head = f"POST /api/v1/restore?sensor=palm HTTP/1.1\r\nHost: {url[7:]}\r\nContent-Length: 5000\r\n\r\n"
            leaves.sendall(head.encode() + b"\x93NUMPY")
            until(lambda: films._held)
        until(lambda: not films._held)
        assert post(url, npy(np.zeros((1, 8, 8)))).status_code == 200
    assert not caplog.records
