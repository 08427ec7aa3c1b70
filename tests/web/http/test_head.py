import os

import httpx
import pytest
from pydantic import SecretStr

from tactiled.config import Server
from tactiled.web.server import running
from tests.conftest import HTTP, ask, pressed, until

ASKED = {"Accept-Encoding": "gzip"}
OTHER = ("date", "x-tactiled-age")  # at another time
PATHS = (
    "/",
    "/metrics",
    "/static/app.js",
    "/static/index.html",
    "/api/v1/openapi.json",
    "/nothing",
    "/api/v1/restore",
)
FIXED = ("/frames/raw?format=npy", "/geometry", "/kernel", "/method")


@pytest.fixture
def client(rig, tmp_path):
    rig.show(pressed())
    until(lambda: rig.sensor.status().state == "stale")
    with (
        running(rig.service, Server(port=0, recordings=tmp_path)) as url,
        httpx.Client(**HTTP, base_url=url) as made,
    ):
        yield made


def told(answer, *but):
    return answer.status_code, {key: each for key, each in answer.headers.items() if key not in (*OTHER, *but)}


def test_head_is_answered_wherever_get_is(client, tmp_path):
    (tmp_path / "grasp.log").write_text("(0.0) can0 123#00 R\n")
    paths = client.get("/api/v1/openapi.json").json()["paths"]
    known = {each for each, verbs in paths.items() if "get" in verbs}
    assert len(known) > 10
    for path in (*PATHS, *known):
        place = path.format(name="grasp.log" if "recordings" in path else "palm", kind="raw")
        got, head = (client.request(verb, place, headers=ASKED) for verb in ("GET", "HEAD"))
        assert head.content == b""
        assert told(head, "content-length") == told(got, "content-length"), path  # of a text with an age in it


@pytest.mark.parametrize("path", FIXED)
def test_head_says_what_get_would_say(client, path):
    place = "/api/v1/sensors/palm" + path
    got, head = (client.request(verb, place, headers=ASKED) for verb in ("GET", "HEAD"))
    if "format=" in path:
        assert int(head.headers["content-length"]) == len(got.content) > 0
    assert told(head) == told(got)
    if "etag" in got.headers:
        known = {"If-None-Match": got.headers["etag"]}
        assert client.head(place, headers=known).status_code == 304


def test_head_of_a_file_reads_none_of_it(client, tmp_path):
    with (tmp_path / "a.log").open("wb") as file:
        file.truncate(1 << 40)
    for part in ({}, {"Range": "bytes=0-"}):
        head = client.head("/api/v1/recordings/a.log", headers=part)
        assert (head.status_code, head.headers["content-length"]) == (200, str(1 << 40))
        until(lambda: str(tmp_path / "a.log") not in opened())


def opened():
    """Paths that this process has open."""
    for each in os.listdir("/proc/self/fd"):  # noqa: PTH208
        try:
            yield os.readlink(f"/proc/self/fd/{each}")  # noqa: PTH115
        except FileNotFoundError:
            continue


def test_head_changes_nothing_and_asks_for_the_same_token(rig):
    with running(rig.service, Server(port=0, control_token=SecretStr("c" * 16))) as url:
        assert ask("HEAD", url + "/api/v1/health").status_code == 401
        bearer = {"Authorization": "Bearer " + "c" * 16}
        assert ask("HEAD", url + "/api/v1/health", headers=bearer).status_code == 200
        assert ask("HEAD", url + "/api/v1/sensors/palm/tare", headers=bearer).status_code == 405
    assert rig.sensor.pipeline.tared == 0
