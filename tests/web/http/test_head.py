from pathlib import Path

import httpx
import pytest

from tactiled.config import Server
from tactiled.web.server import running
from tests.conftest import HTTP, pressed, until

VARIABLE = ("date", "x-tactiled-age", "content-length")  # at another time; of a text with an age in it


@pytest.fixture
def client(rig, tmp_path):
    rig.show(pressed())
    until(lambda: rig.sensor.status().state == "stale")
    with (
        running(rig.service, Server(port=0, recordings=tmp_path)) as url,
        httpx.Client(**HTTP, base_url=url, headers={"Accept-Encoding": "gzip"}) as made,
    ):
        yield made


def head_of(answer, *but):
    return answer.status_code, {key: each for key, each in answer.headers.items() if key not in but}


def test_head_is_answered_as_get_without_a_body(client, tmp_path):
    (tmp_path / "grasp.log").write_text("(0.0) can0 123#00 R\n")
    paths = [path for path, verbs in client.get("/api/v1/openapi.json").json()["paths"].items() if "get" in verbs]
    assert len(paths) > 10
    for path in ("/", "/metrics", "/static/app.js", "/api/v1/openapi.json", "/nothing", "/api/v1/restore", *paths):
        url = path.format(
            name="grasp.log" if "recordings" in path else "palm", kind="raw", number=0, region="heel"
        )
        get, head = (client.request(verb, url) for verb in ("GET", "HEAD"))
        assert head.content == b""
        assert head_of(head, *VARIABLE) == head_of(get, *VARIABLE), path
    image = "/api/v1/sensors/palm/frames/raw?format=npy"
    get, head = (client.request(verb, image) for verb in ("GET", "HEAD"))
    assert int(head.headers["content-length"]) == len(get.content) > 0
    assert client.head(image, headers={"If-None-Match": get.headers["etag"]}).status_code == 304


def test_head_of_a_file_reads_none_of_it(client, tmp_path):
    with (tmp_path / "a.log").open("wb") as file:
        file.truncate(1 << 40)
    for part in ({}, {"Range": "bytes=0-"}):
        head = client.head("/api/v1/recordings/a.log", headers=part)
        assert (head.status_code, head.headers["content-length"]) == (200, str(1 << 40))
        until(lambda: tmp_path / "a.log" not in [each.resolve() for each in Path("/proc/self/fd").iterdir()])
