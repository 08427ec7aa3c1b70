import socket
import threading
import time
from contextlib import contextmanager
from types import SimpleNamespace

import can
import httpx
import pytest
import uvicorn
from fastapi import FastAPI

from tactiled.bus import recorder, recording
from tactiled.runtime.events import Events
from tactiled.web.http import problems
from tactiled.web.rest import recordings
from tactiled.web.rest.recordings import Recordings, make
from tests.conftest import HTTP, until

ROOT = "/api/v1/recordings"


@contextmanager
def serving(app):
    """A client of an application that runs, its start and its end with it."""
    listener = socket.create_server(("127.0.0.1", 0))
    server = uvicorn.Server(uvicorn.Config(app, log_level="warning", access_log=False))
    thread = threading.Thread(target=server.run, args=([listener],), daemon=True)
    thread.start()
    while not server.started:
        time.sleep(0.005)
    with httpx.Client(**HTTP, base_url=f"http://127.0.0.1:{listener.getsockname()[1]}", trust_env=False) as client:
        yield client
    server.should_exit = True
    thread.join()
    listener.close()


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "secret.log").write_text("(0.0) can0 123#00 R\n")
    return tmp_path / "recordings"


@pytest.fixture
def api(folder, request):
    app = FastAPI()
    problems.install(app)
    buses = {
        "can0": {"interface": "virtual", "channel": request.node.name},
        "gone": {"interface": "slcan", "channel": "/dev/gone", "sleep_after_open": 0},
    }
    app.include_router(make(folder, buses, Events()))
    with serving(app) as client:
        yield client


@pytest.fixture
def bus(request):
    with can.Bus(interface="virtual", channel=request.node.name) as end:
        yield end


def send(bus, count):
    for number in range(count):
        bus.send(can.Message(arbitration_id=0x500, is_extended_id=False, data=number.to_bytes(8, "big")))


def only(api):
    """What is told of the one recording there is."""
    (told,) = api.get(ROOT).json()["recordings"]
    return told


def test_one_recording_from_its_start_to_its_end(api, bus, folder):
    assert api.get(ROOT).json() == {"recordings": [], "after": None}
    began = api.post(ROOT, json={"bus": "can0", "name": "a.log"})
    assert began.status_code == 201
    assert began.json()["running"] is True
    send(bus, 100)
    until(lambda: only(api)["messages"] == 100)
    seen = only(api)
    assert (seen["name"], seen["running"], seen["bus"], seen["messages"]) == ("a.log", True, "can0", 100)
    for act in (api.get, api.delete):
        assert act(f"{ROOT}/a.log").status_code == 409
    send(bus, 20)
    until(lambda: only(api)["messages"] == 120)
    ended = api.post(f"{ROOT}/a.log/stop").json()
    assert (ended["running"], ended["messages"], ended["error"]) == (False, 120, None)
    assert api.post(f"{ROOT}/a.log/stop").status_code == 200
    got = api.get(f"{ROOT}/a.log")
    assert got.headers["content-disposition"] == 'attachment; filename="a.log"'
    assert got.content == (folder / "a.log").read_bytes()
    assert [int.from_bytes(each.data, "big") for each in recording.read(folder / "a.log")] == [
        *range(100),
        *range(20),
    ]
    assert api.delete(f"{ROOT}/a.log").status_code == 204
    assert api.get(ROOT).json() == {"recordings": [], "after": None}
    assert api.get(f"{ROOT}/a.log").status_code == 404


def test_a_name_is_made_and_a_bus_is_recorded_once_at_a_time(api):
    name = api.post(ROOT, json={"bus": "can0"}).json()["name"]
    assert name.startswith("can0-")
    assert name.endswith(".log")
    again = api.post(ROOT, json={"bus": "can0"})
    assert (again.status_code, again.json()["detail"]) == (409, "bus can0: is being recorded already")
    api.post(f"{ROOT}/{name}/stop")
    taken = api.post(ROOT, json={"bus": "can0", "name": name})
    assert (taken.status_code, taken.json()["detail"]) == (409, f"recording {name}: is there already")
    assert api.post(ROOT, json={"bus": "can0"}).status_code == 201


BAD = (
    "../secret.log",
    "..",
    "/etc/passwd",
    "..%2fsecret.log",
    "%2e%2e%2fsecret.log",
    "a/../../secret.log",
    "..\\secret.log",
    ".hidden.log",
    "a.toml",
    "a.log\n",
    "a.log\0",
    "",
    "a" * 200 + ".log",
    "a.b.log",
)


@pytest.mark.parametrize("name", BAD)
def test_no_name_leaves_the_folder(api, folder, name):
    refused = api.post(ROOT, json={"bus": "can0", "name": name})
    assert refused.status_code == 422
    assert refused.headers["content-type"] == "application/problem+json"
    for path in (name, name.replace("/", "%2f").replace("\n", "%0a").replace("\0", "%00").replace("\\", "%5c")):
        if path.strip("./\n\0"):
            for act in (api.get, api.delete):
                try:
                    status = act(f"{ROOT}/{path}").status_code
                except Exception as error:  # the client itself refuses such an address
                    assert "URL" in type(error).__name__, error  # noqa: PT017
                    continue
                assert status in (404, 405, 422)
    assert (folder.parent / "secret.log").read_text() == "(0.0) can0 123#00 R\n"
    assert not folder.exists()


def test_a_link_out_of_the_folder_is_no_recording(api, folder):
    folder.mkdir()
    (folder / "link.log").symlink_to(folder.parent / "secret.log")
    (folder / "dangling.log").symlink_to(folder.parent / "new.log")
    assert api.get(ROOT).json() == {"recordings": [], "after": None}
    assert api.get(f"{ROOT}/link.log").status_code == 404
    assert api.delete(f"{ROOT}/link.log").status_code == 404
    (folder / "folder.log").mkdir()
    for name in ("link.log", "dangling.log", "folder.log"):
        refused = api.post(ROOT, json={"bus": "can0", "name": name})
        says = f"recording {name}: something else of that name is in the folder"
        assert (refused.status_code, refused.json()["detail"]) == (409, says)
    assert not (folder.parent / "new.log").exists()


def test_a_bus_that_is_not_there(api):
    none = api.post(ROOT, json={"bus": "can9"})
    assert (none.status_code, none.json()["detail"]) == (404, "bus can9: no such bus: there are can0, gone")
    gone = api.post(ROOT, json={"bus": "gone"})
    assert gone.status_code == 503
    assert "No such file" in gone.json()["detail"]
    assert api.get(ROOT).json() == {"recordings": [], "after": None}


def test_a_folder_that_cannot_be_made_is_told(api, folder):
    folder.write_text("a file is in the way")
    refused = api.post(ROOT, json={"bus": "can0", "name": "a.log"})
    assert (refused.status_code, refused.json()["detail"]) == (503, "recording a.log: File exists")


def test_a_full_disk_ends_it_and_says_so(api, bus, monkeypatch):
    import os

    name = api.post(ROOT, json={"bus": "can0"}).json()["name"]
    time.sleep(0.1)

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "pwrite", full)
    send(bus, 10)
    until(lambda: not only(api)["running"])
    seen = only(api)
    assert "No space left on device: the recording ends early, after 0 messages" in seen["error"]
    assert api.post(f"{ROOT}/{name}/stop").status_code == 200


def test_the_end_of_the_service_ends_a_recording_whole(folder, request):
    app = FastAPI()
    app.include_router(make(folder, {"can0": {"interface": "virtual", "channel": request.node.name}}, Events()))
    with serving(app) as client, can.Bus(interface="virtual", channel=request.node.name) as bus:
        client.post(ROOT, json={"bus": "can0", "name": "a.blf"})
        send(bus, 50)
        until(lambda: only(client)["messages"] == 50)
    assert len(list(recording.read(folder / "a.blf"))) == 50


def test_a_recording_ends_before_the_disk_is_full_and_says_why(folder, request, monkeypatch):
    room, events = [600e6], Events()
    monkeypatch.setattr(recorder, "disk_usage", lambda _: SimpleNamespace(free=room[0]))
    app = FastAPI()
    problems.install(app)
    buses = {"can0": {"interface": "virtual", "channel": request.node.name}}
    app.include_router(make(folder, buses, events, 500))
    with serving(app) as client, can.Bus(interface="virtual", channel=request.node.name) as bus:
        client.post(ROOT, json={"bus": "can0", "name": "a.blf"})
        send(bus, 50)
        until(lambda: only(client)["messages"] == 50)
        assert only(client)["running"]
        room[0] = 499e6
        until(lambda: not only(client)["running"])
        why = "less than 500 MB of its disk are free (recordings_leave_mb)"
        assert only(client)["error"].startswith(f"{why}: the recording ends early, after 50 messages")
        (ended,) = (each.text for each in events.after(0) if each.kind == "recording_ended")
        assert ended == f"a.blf: {only(client)['error']}"
        refused = client.post(ROOT, json={"bus": "can0", "name": "b.blf"})
        assert (refused.status_code, refused.headers["content-type"]) == (503, "application/problem+json")
        assert refused.json()["detail"] == f"recording b.blf: {why}"
        assert not (folder / "b.blf").exists()
        room[0] = 501e6
        assert client.post(ROOT, json={"bus": "can0", "name": "b.blf"}).status_code == 201
    assert len(list(recording.read(folder / "a.blf"))) == 50


def test_a_recording_whose_file_is_removed_ends_and_its_bus_is_free_again(api, bus, folder):
    api.post(ROOT, json={"bus": "can0", "name": "a.log"})
    send(bus, 10)
    until(lambda: only(api)["messages"] == 10)
    (folder / "a.log").unlink()
    until(lambda: api.post(ROOT, json={"bus": "can0", "name": "b.log"}).status_code == 201)
    assert [each["name"] for each in api.get(ROOT).json()["recordings"]] == ["b.log"]


def test_a_recording_whose_file_is_renamed_is_listed_until_it_is_stopped_and_says_that_it_was(api, bus, folder):
    api.post(ROOT, json={"bus": "can0", "name": "a.log"})
    send(bus, 10)
    until(lambda: only(api)["messages"] == 10)
    (folder / "a.log").rename(folder / "b.log")
    runs, file = api.get(ROOT).json()["recordings"]
    assert (runs["name"], runs["running"], runs["bytes"]) == ("a.log", True, None)
    assert (file["name"], file["running"]) == ("b.log", False)
    for act in (api.get, api.delete):
        assert act(f"{ROOT}/a.log").json()["detail"] == "recording a.log: runs: stop it first"
    ended = {
        "name": "a.log",
        "bytes": None,
        "running": False,
        "bus": "can0",
        "messages": 10,
        "unreadable": 0,
        "error": None,
    }
    for _ in range(2):
        stopped = api.post(f"{ROOT}/a.log/stop")
        assert (stopped.status_code, stopped.json()) == (200, ended)
    assert only(api)["name"] == "b.log"
    for act in (api.get, api.delete):
        assert act(f"{ROOT}/a.log").status_code == 404
    assert api.post(ROOT, json={"bus": "can0", "name": "c.log"}).status_code == 201
    assert len(list(recording.read(folder / "b.log"))) == 10


def test_what_is_told_as_ended_is_told_whole(folder, request, monkeypatch):
    """It may end while its size is looked at: an end that is written last is missing then."""
    of = Recordings(folder, {"can0": {"interface": "virtual", "channel": request.node.name}}, Events(), 0.0)
    of.start("can0", "a.log.gz")
    size_of = recordings._bytes

    def slowly(path):
        size = size_of(path)
        of._runs["a.log.gz"].stop()
        return size

    with monkeypatch.context() as patched:
        patched.setattr(recordings, "_bytes", slowly)
        told = of._told(folder / "a.log.gz")
    whole = of.listed(None, 1).recordings[0]
    assert not whole.running
    assert told.running or told.bytes == whole.bytes


def test_a_link_in_the_place_of_a_recordings_file_is_not_its_file(api, folder):
    api.post(ROOT, json={"bus": "can0", "name": "a.log"})
    (folder / "a.log").rename(folder.parent / "a.log")
    (folder / "a.log").symlink_to(folder.parent / "secret.log")
    assert only(api)["bytes"] is None
    assert api.post(f"{ROOT}/a.log/stop").json()["bytes"] is None
    assert api.get(ROOT).json()["recordings"] == []


def test_a_recording_that_ended_because_its_file_was_removed_says_so_when_it_is_stopped(api, bus, folder):
    api.post(ROOT, json={"bus": "can0", "name": "a.log"})
    send(bus, 10)
    until(lambda: only(api)["messages"] == 10)
    (folder / "a.log").unlink()
    until(lambda: not api.get(ROOT).json()["recordings"])
    told = api.post(f"{ROOT}/a.log/stop").json()
    assert (told["running"], told["bytes"], told["messages"]) == (False, None, 10)
    assert "was removed: the recording ends early, after 10 messages" in told["error"]


def test_the_name_of_a_recording_whose_file_is_renamed_stays_its_own_while_it_runs(folder, request):
    names = [f"{request.node.name} {each}" for each in (0, 1)]
    app = FastAPI()
    problems.install(app)
    buses = {f"can{at}": {"interface": "virtual", "channel": each} for at, each in enumerate(names)}
    app.include_router(make(folder, buses, Events()))
    with serving(app) as client:
        client.post(ROOT, json={"bus": "can0", "name": "a.log"})
        (folder / "a.log").rename(folder / "b.log")
        taken = client.post(ROOT, json={"bus": "can1", "name": "a.log"})
        assert (taken.status_code, taken.json()["detail"]) == (409, "recording a.log: runs: stop it first")
        client.post(f"{ROOT}/a.log/stop")
        assert client.post(ROOT, json={"bus": "can1", "name": "a.log"}).status_code == 201
