"""Uploads that would never end, many at once, and those whose clients leave."""

import gzip
from concurrent.futures import ThreadPoolExecutor
from threading import Event
from types import SimpleNamespace

import pytest

from tactiled.bus import recording
from tactiled.config import Server
from tactiled.web.rest import recordings, uploads
from tactiled.web.server import running
from tests.conftest import BUSY_S, ask, problem, until
from tests.web.http.raw import plug

PATH = "/api/v1/recordings/a.log"
TEXT = b"(1.000000) can0 123#00 R\n"
BLANK = gzip.compress(b"\n" * (32 << 20), 1)


@pytest.fixture
def folder(tmp_path):
    return tmp_path / "recordings"


@pytest.fixture
def server(folder):
    return Server(port=0, recordings=folder, recordings_leave_mb=0, control_per_minute=0)


@pytest.fixture
def check(monkeypatch):
    """What begins and ends when a file is read that was uploaded, for whose end nothing else cares."""
    begun, ended, check = Event(), Event(), recordings._check

    def noted(*arguments):
        begun.set()
        try:
            check(*arguments)
        finally:
            ended.set()

    monkeypatch.setattr(recordings, "_check", noted)
    monkeypatch.setattr(recording, "CPU_S", 600.0)
    return SimpleNamespace(begun=begun, ended=ended)


def test_what_an_upload_left_that_kill_9_ended_is_removed_at_the_start(rig, server, folder):
    (folder / ".tactiled-x").mkdir(parents=True)
    (folder / ".tactiled-x" / "a.log").write_bytes(TEXT)
    with running(rig.service, server):
        assert not list(folder.iterdir())


def head(url, path, size):
    return f"PUT {path} HTTP/1.1\r\nHost: {url[7:]}\r\nContent-Length: {size}\r\n\r\n".encode()


def test_reading_an_upload_ends_with_its_client(rig, server, folder, check):
    with running(rig.service, server) as url:
        with plug(url) as end:
            end.sendall(head(url, f"{PATH}.gz", len(BLANK)) + BLANK)
            assert check.begun.wait(BUSY_S)
            assert not check.ended.is_set()
        assert check.ended.wait(BUSY_S)
        until(lambda: not list(folder.iterdir()))
        assert ask("PUT", url + PATH, content=TEXT).status_code == 201


def test_reading_an_upload_ends_with_the_service(rig, server, folder, check):
    with running(rig.service, server) as url, plug(url) as end:
        end.sendall(head(url, f"{PATH}.gz", len(BLANK)) + BLANK)
        assert check.begun.wait(BUSY_S)
    assert check.ended.is_set()
    assert not list(folder.iterdir())


def test_an_upload_that_holds_nothing_for_long_is_refused_in_one_line(rig, server, monkeypatch):
    monkeypatch.setattr(recording, "CPU_S", 1.0)
    with running(rig.service, server) as url:
        why = problem(ask("PUT", f"{url}{PATH}.gz", content=BLANK), 422)
    assert why == "recording a.log.gz: after 0 messages nothing comes of it in 1 s of processor time"


def test_a_client_has_few_uploads_at_once(rig, server, folder, monkeypatch):
    monkeypatch.setattr(recordings, "MAX_UPLOADS_PER_CLIENT", 1)
    with running(rig.service, server) as url:
        with plug(url) as end:
            end.sendall(head(url, PATH, 9) + b"x")
            until(lambda: list(folder.glob(".tactiled-*")))
            why = problem(ask("PUT", url + PATH.replace("a.log", "b.log"), content=TEXT), 429)
        assert why == "uploads_per_client = 1: 127.0.0.1 has as many open: close one"
        until(lambda: ask("PUT", url + PATH, content=TEXT).status_code == 201)


def test_uploads_at_once_share_what_the_disk_has(rig, server, folder, monkeypatch):
    """What the first two still need is not given to the third."""
    content, size, go_on, begun = TEXT * 4000, [2.2e5], Event(), [Event(), Event()]

    def usage(_):
        return SimpleNamespace(free=size[0] - sum(each.stat().st_size for each in folder.rglob("*.log")))

    def halves(which):
        yield content[: len(content) // 2]
        begun[which].set()
        assert go_on.wait(BUSY_S)
        yield content[len(content) // 2 :]

    def put(which, body):
        headers = {"Content-Length": str(len(content))}
        return ask("PUT", url + PATH.replace("a.log", f"{which}.log"), content=body, headers=headers)

    monkeypatch.setattr(uploads, "disk_usage", usage)
    with running(rig.service, server) as url, ThreadPoolExecutor() as pool:
        first = []
        for which in (0, 1):
            first.append(pool.submit(put, which, halves(which)))
            assert begun[which].wait(BUSY_S)
        third = problem(put(2, content), 503)
        go_on.set()
        assert [each.result().status_code for each in first] == [201, 201]
        assert third == "recording 2.log: would leave less than 0 MB of its disk (recordings_leave_mb) free"
        size[0] = 3.2e5
        assert put(2, content).status_code == 201
    assert sorted(each.name for each in folder.iterdir()) == ["0.log", "1.log", "2.log"]
