"""Parts of files over HTTP."""

import httpx
import pytest

from tactiled.config import Server
from tactiled.web.app import STATIC
from tactiled.web.server import running
from tests.conftest import HTTP
from tests.web.rest.test_sensors import problem

DATA = bytes(range(200)) * 20
FILES = {"/": "index.html", "/static/app.js": "app.js"}
GRASP = "/api/v1/recordings/grasp.log"


@pytest.fixture
def client(rig, tmp_path):
    (tmp_path / "grasp.log").write_bytes(DATA)
    with (
        running(rig.service, Server(port=0, recordings=tmp_path)) as url,
        httpx.Client(**HTTP, base_url=url) as made,
    ):
        yield made


def whole(path):
    return DATA if path == GRASP else (STATIC / FILES[path]).read_bytes()


@pytest.mark.parametrize("path", [GRASP, *FILES])
def test_a_part_of_a_file_is_had_and_is_not_packed(client, path):
    answer = client.get(path, headers={"Range": "bytes=100-2999", "Accept-Encoding": "gzip"})
    assert (answer.status_code, answer.headers.get("content-encoding")) == (206, None)
    assert answer.headers["content-range"] == f"bytes 100-2999/{len(whole(path))}"
    assert answer.content == whole(path)[100:3000]
    assert client.get(path, headers={"Range": "bytes=-5"}).content == whole(path)[-5:]


@pytest.mark.parametrize("path", [GRASP, *FILES])
def test_a_part_that_is_not_there_is_a_problem(client, path):
    answer = client.get(path, headers={"Range": "bytes=9999999-"})
    says = problem(answer, 416)
    assert says == f"Range: bytes=9999999-: the file has {len(whole(path))} bytes"
    assert answer.headers["content-range"] == f"bytes */{len(whole(path))}"
    assert answer.headers["x-content-type-options"] == "nosniff"


@pytest.mark.parametrize("path", [GRASP, *FILES])
@pytest.mark.parametrize("nonsense", ["x", "bytes=9-2", "bytes=", "bytes=-", "bytes=a-b", "pages=1-2", ""])
def test_a_range_that_means_nothing_is_not_heard(client, path, nonsense):
    answer = client.get(path, headers={"Range": nonsense, "Accept-Encoding": "identity"})
    assert (answer.status_code, answer.content) == (200, whole(path))


def test_a_range_of_what_is_no_file_is_not_heard(client):
    for nonsense in ("x", "bytes=0-1", "bytes=9999999-"):
        assert client.get("/api/v1/colormap", headers={"Range": nonsense}).json()["name"]
        problem(client.get("/api/v1/nothing", headers={"Range": nonsense}), 404)
    packed = client.get("/static/app.js", headers={"Accept-Encoding": "gzip"})
    assert packed.headers["content-encoding"] == "gzip"
