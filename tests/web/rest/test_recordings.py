import errno
import shutil
from contextlib import contextmanager
from threading import Event, Thread
from types import SimpleNamespace
from unittest.mock import Mock

import can
import httpx
import pytest

from tactiled.bus import recorder, recording
from tactiled.bus.reader import open_bus
from tactiled.config import Server, parse
from tactiled.live.events import Events
from tactiled.live.service import Service
from tactiled.web.http import body
from tactiled.web.http.timeouts import BOUNDS, Phase
from tactiled.web.rest import recordings, uploads
from tactiled.web.server import running
from tests.conftest import CONFIG, HTTP, problem, until
from tests.web.http.raw import bound

ROOT = "/api/v1/recordings"


BUSES = """
[bus.can1]
interface = "virtual"
channel = "{channel} 1"
[bus.missing]
interface = "slcan"
channel = "/dev/missing"
sleep_after_open = 0
"""


class Api:
    """Recordings over REST, and the other end of the bus can0."""

    def __init__(self, folder, channel):
        self.bus = can.Bus(interface="virtual", channel=channel)
        self._service = Service(parse((CONFIG + BUSES).format(channel=channel)))
        self._server = Server(port=0, recordings=folder, recordings_leave_mb=500, control_per_minute=0)
        self.events = self._service.events

    @contextmanager
    def serving(self):
        """Serve it, its start and its end with it."""
        with (
            running(self._service, self._server) as url,
            httpx.Client(**HTTP, base_url=url) as self.client,
            self.bus,
        ):
            yield self

    def send(self, count, recorded):
        """Send messages and wait until as many are recorded."""
        for number in range(count):
            data = number.to_bytes(8, "big")
            self.bus.send(can.Message(arbitration_id=0x500, is_extended_id=False, data=data))
        until(lambda: self.all()[0]["messages"] == recorded)

    def start(self, name=None, bus="can0"):
        return self.client.post(ROOT, json={"bus": bus} | ({"name": name} if name else {}))

    def stop(self, name):
        return self.client.post(f"{ROOT}/{name}/stop")

    def read_and_delete(self, name):
        """The answers to reading and to deleting one."""
        return self.client.get(f"{ROOT}/{name}"), self.client.delete(f"{ROOT}/{name}")

    def all(self):
        return self.client.get(ROOT).json()["recordings"]

    def only(self):
        """The one recording that there is."""
        (recorded,) = self.all()
        return recorded


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "secret.log").write_text("(0.0) can0 123#00 R\n")
    return tmp_path / "recordings"


@pytest.fixture
def free_mb(monkeypatch):
    """How much room the disk has."""
    free = [600]
    for module in (recorder, uploads):
        monkeypatch.setattr(module, "disk_usage", lambda _: SimpleNamespace(free=free[0] * 1e6))
    return free


@pytest.fixture
def api(folder, request, free_mb):  # noqa: ARG001
    with Api(folder, request.node.name).serving() as api:
        yield api


def test_a_recording_from_its_start_to_its_end(api, folder):
    assert api.client.get(ROOT).json() == {"recordings": [], "after": None}
    began = api.start("a.log")
    assert (began.status_code, began.json()["running"]) == (201, True)
    api.send(100, 100)
    assert [api.only()[key] for key in ("name", "running", "bus")] == ["a.log", True, "can0"]
    for refused in api.read_and_delete("a.log"):
        assert problem(refused, 409) == "recording a.log: runs: stop it first"
    api.send(20, 120)
    ended = api.stop("a.log").json()
    assert [ended[key] for key in ("running", "messages", "error")] == [False, 120, None]
    assert api.stop("a.log").json() == ended
    assert [each.text for each in api.events.after(0)] == ["a.log", "a.log: 120 messages"]
    file = api.client.get(f"{ROOT}/a.log")
    assert file.headers["content-disposition"] == 'attachment; filename="a.log"'
    assert file.content == (folder / "a.log").read_bytes()
    part = api.client.get(f"{ROOT}/a.log", headers={"Range": "bytes=2-9"})
    assert (part.status_code, part.content) == (206, file.content[2:10])
    part = api.client.get(f"{ROOT}/a.log", headers={"Range": "frames=0-9"})  # RFC 9110, 14.2: an unknown unit
    assert (part.status_code, part.content) == (200, file.content)
    refusals = (
        ("bytes", 400, "give bytes=FIRST-LAST"),
        ("bytes=9-2", 400, "give bytes=FIRST-LAST"),
        ("bytes=99999-", 416, "is not within the file"),
    )
    for wrong, status, why in refusals:
        part = api.client.get(f"{ROOT}/a.log", headers={"Range": wrong})
        assert problem(part, status) == f"Range: {wrong}: {why}"
    assert part.headers["content-range"] == f"bytes */{len(file.content)}"
    numbers = [int.from_bytes(each.data, "big") for each in recording.read(folder / "a.log")]
    assert numbers == [*range(100), *range(20)]
    assert api.client.delete(f"{ROOT}/a.log").status_code == 204
    assert api.all() == []
    for refused in (*api.read_and_delete("a.log"), api.stop("a.log")):
        assert problem(refused, 404) == "recording a.log: no such recording"


def test_an_upload_does_not_wait_for_a_bus_that_is_being_opened(api, monkeypatch):
    opening, opened = Event(), Event()

    def slow(**settings):
        opening.set()
        assert opened.wait(60)
        return open_bus(**settings)

    monkeypatch.setattr(recordings, "open_bus", slow)
    start = Thread(target=api.start, args=("a.log",))
    start.start()
    assert opening.wait(60)
    added = api.client.put(f"{ROOT}/b.log", content=b"(1.000000) can0 123#00 R\n")
    opened.set()
    start.join()
    assert added.status_code == 201, added.text


def test_a_file_that_is_uploaded_is_a_recording_or_refused_and_leaves_nothing(api, folder, free_mb, monkeypatch):
    put = lambda name, content: api.client.put(f"{ROOT}/{name}", content=content)  # noqa: E731
    text = b"(1.000000) can0 123#00 R\n"
    free_mb[0] = 500
    why = "would leave less than 500 MB of its disk (recordings_leave_mb) free"
    assert problem(put("a.log", text), 503) == f"recording a.log: {why}"
    free_mb[0] = 2000
    added = put("a.log", iter([text[:5], text[5:]]))  # chunked: of unknown length
    assert (added.status_code, added.json()["bytes"]) == (201, len(text))
    assert (folder / "a.log").read_bytes() == text
    assert problem(put("a.log", text), 409) == "recording a.log: is there already"
    assert problem(put("b.log", b"nonsense\n"), 422).startswith("recording b.log: 'nonsense' is no line")
    part = api.client.put(f"{ROOT}/b.log", content=text, headers={"Content-Range": "bytes 25-49/50"})
    assert problem(part, 400) == "Content-Range: send the whole file"
    assert problem(put("b.log", b""), 422) == "recording b.log: it holds no data frame"
    problem(put("b.toml", text), 422)
    monkeypatch.setattr(body, "MAX_RECORDING_BYTES", 100)
    problem(put("b.log", 5 * text), 413)
    problem(put("b.log", iter([text] * 5)), 413)
    assert [each.name for each in folder.iterdir()] == ["a.log"]
    assert [(each.kind, each.text) for each in api.events.after(0)] == [("recording_added", "a.log")]


def test_a_recording_may_be_larger_and_take_longer_than_other_bodies(api, monkeypatch):
    bound(monkeypatch, Phase.BODY, bytes=1 << 16)
    text = b"(1.000000) can0 123#00 R\n" * 10_000
    assert api.client.put(f"{ROOT}/a.log", content=text).status_code == 201
    assert BOUNDS[Phase.UPLOAD].seconds > body.RECORDING_TIMEOUT_S
    assert BOUNDS[Phase.UPLOAD].bytes > body.MAX_RECORDING_BYTES


def test_a_name_is_made_and_a_bus_is_recorded_once_at_a_time(api):
    name = api.start().json()["name"]
    assert name.startswith("can0-")
    assert name.endswith(".log")
    assert problem(api.start(), 409) == "bus can0: is being recorded already"
    api.stop(name)
    assert problem(api.start(name), 409) == f"recording {name}: is there already"
    assert api.start().status_code == 201
    assert problem(api.start(bus="can9"), 404) == "bus can9: no such bus: there are can0, can1, missing"
    assert "No such file" in problem(api.start(bus="missing"), 503)
    assert len(api.all()) == 2


def test_pages_of_recordings_by_name(api, folder):
    folder.mkdir()
    for name in ("c.log", "a.log", "b.blf", "notes.txt", ".hidden.log"):
        (folder / name).write_bytes(b"12")
    first = api.client.get(ROOT, params={"limit": 2}).json()
    assert [(each["name"], each["bytes"]) for each in first["recordings"]] == [("a.log", 2), ("b.blf", 2)]
    second = api.client.get(ROOT, params={"limit": 2, "after": first["after"]}).json()
    assert ([each["name"] for each in second["recordings"]], second["after"]) == (["c.log"], None)


BAD = (
    "../secret.log", "..", "/etc/passwd", "..%2fsecret.log", "%2e%2e%2fsecret.log", "a/../../secret.log", "",
    "..\\secret.log", ".hidden.log", "a.toml", "a.log\n", "a.log\0", "a" * 200 + ".log", "a.b.log",
)  # fmt: skip


def test_no_name_leaves_the_folder(api, folder):
    for name in BAD:
        problem(api.client.post(ROOT, json={"bus": "can0", "name": name}), 422)
    assert (folder.parent / "secret.log").read_text() == "(0.0) can0 123#00 R\n"
    assert not folder.exists()


def test_links_and_folders_are_no_recordings(api, folder):
    folder.mkdir()
    (folder / "link.log").symlink_to(folder.parent / "secret.log")
    (folder / "dangling.log").symlink_to(folder.parent / "new.log")
    (folder / "folder.log").mkdir()
    assert api.all() == []
    for refused in api.read_and_delete("link.log"):
        assert refused.status_code == 404
    for name in ("link.log", "dangling.log", "folder.log"):
        detail = f"recording {name}: something else of that name is there already"
        assert problem(api.start(name), 409) == detail
    assert not (folder.parent / "new.log").exists()
    shutil.rmtree(folder)
    folder.write_text("a file is in the way")
    assert problem(api.start("a.log"), 503) == "recording a.log: File exists"


def test_a_recording_ends_before_the_disk_is_full(api, folder, free_mb, caplog):
    api.start("a.blf")
    api.send(50, 50)
    free_mb[0] = 499
    until(lambda: not api.only()["running"])
    why = "less than 500 MB of its disk are free (recordings_leave_mb)"
    error = f"{why}: the recording ends early, after 50 messages"
    assert api.only()["error"] == error
    assert [each.text for each in api.events.after(0)] == ["a.blf", f"a.blf: {error}"]
    assert [each.levelname for each in caplog.records if each.message == f"a.blf: {error}"] == ["WARNING"]
    assert problem(api.start("b.blf"), 503) == f"recording b.blf: {why}"
    assert not (folder / "b.blf").exists()
    free_mb[0] = 501
    assert api.start("b.blf").status_code == 201
    assert len(list(recording.read(folder / "a.blf"))) == 50


def test_what_the_disk_refuses_is_named(folder, request, monkeypatch):
    refuse = Mock(side_effect=OSError(errno.EROFS, "Read-only file system"))
    with Api(folder / ("a" * 300), request.node.name).serving() as api:
        assert problem(api.start("a.log"), 503) == "recording a.log: File name too long"
        assert problem(api.client.get(ROOT), 503) == "recordings: File name too long"
    with Api(folder, request.node.name).serving() as api:
        shutil.copy(recording.path("book_1"), folder / "a.log")
        monkeypatch.setattr(recordings.Path, "unlink", refuse)
        assert problem(api.client.delete(f"{ROOT}/a.log"), 503) == "recording a.log: Read-only file system"


def test_a_recording_whose_file_is_removed_ends_and_its_bus_is_free_again(api, folder):
    api.start("a.log")
    api.send(10, 10)
    (folder / "a.log").unlink()
    until(lambda: not api.all())
    ended = api.stop("a.log").json()
    assert [ended[key] for key in ("running", "bytes", "messages")] == [False, None, 10]
    assert ended["error"] == "was removed: the recording ends early, after 10 messages"
    assert api.start("b.log").status_code == 201


def test_a_recording_whose_file_is_renamed_keeps_its_name_until_it_is_stopped(api, folder):
    api.start("a.log")
    api.send(10, 10)
    (folder / "a.log").rename(folder / "b.log")
    running, file = api.all()
    assert [running[key] for key in ("name", "running", "bytes")] == ["a.log", True, None]
    assert (file["name"], file["running"]) == ("b.log", False)
    for refused in (*api.read_and_delete("a.log"), api.start("a.log", "can1")):
        assert problem(refused, 409) == "recording a.log: runs: stop it first"
    ended = {"name": "a.log", "bytes": None, "modified": None, "duration_s": None, "running": False}
    ended |= {"bus": "can0", "messages": 10, "unreadable": 0}
    for _ in range(2):
        assert api.stop("a.log").json() == ended | {"error": None}
    assert api.only()["name"] == "b.log"
    for refused in api.read_and_delete("a.log"):
        assert refused.status_code == 404
    assert api.start("a.log", "can1").status_code == 201
    (folder / "a.log").rename(folder.parent / "a.log")
    (folder / "a.log").symlink_to(folder.parent / "secret.log")  # which is not its file
    assert api.stop("a.log").json()["bytes"] is None
    assert len(list(recording.read(folder / "b.log"))) == 10


def test_the_size_of_an_ended_recording_is_that_of_its_whole_file(folder, request, monkeypatch):
    """It may end while its size is read; what the end writes would be missing."""
    buses = {"can0": {"interface": "virtual", "channel": request.node.name}}
    files = recordings.Recordings(folder, buses, Events(), 0.0)
    files.start("can0", "a.log.gz")
    status_of, run = recordings._status, files._runs["a.log.gz"]
    with monkeypatch.context() as patched:
        patched.setattr(recordings, "_status", lambda path: (status_of(path), run.stop())[0])
        during = files.recording("a.log.gz")
    (after,) = files.page(recordings.PageQuery()).recordings
    assert not after.running
    assert during.running or during.bytes == after.bytes
