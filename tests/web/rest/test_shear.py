"""Shear of a 3-axis skin, from its messages on the bus to the API."""

import io
import json
from contextlib import ExitStack

import httpx
import jsonschema
import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from tactiled.runtime.pipeline import TARE_FRAMES
from tactiled.web.rest import frames
from tactiled.web.rest.shear import Shear
from tactiled.web.server import running
from tactiled.wire import unpack
from tests.conftest import BUSY_S, HTTP, ask
from tests.skin import PALM, X, Y, rigged

LACKS = "sensor 'palm': its codec packed carries no shear"


@pytest.fixture
def skin(request):
    with ExitStack() as stack:
        rig = stack.enter_context(rigged(request.node.name))
        url = stack.enter_context(running(rig.service))
        yield rig.show, stack.enter_context(httpx.Client(**HTTP, base_url=url + "/api/v1/sensors"))


def stream(client, query=""):
    """A stream of the skin, or of what the query names."""
    address = str(client.base_url).replace("http", "ws", 1)
    return connect(f"{address}skin/stream{query}", compression=None)


def heard(socket, count, timeout=BUSY_S):
    """The next messages that are no status."""
    got = []
    while len(got) < count:
        data = socket.recv(timeout=timeout)
        if isinstance(data, bytes) or json.loads(data)["type"] != "status":
            got.append(data)
    return got


def npy(client):
    answer = client.get("/skin/frames/shear", headers={"Accept": "application/x-npy"})
    return np.load(io.BytesIO(answer.content)), answer.headers


def test_shear_is_served_in_counts_with_the_image_it_belongs_to(skin):
    show, client = skin
    show(X, Y)
    shear, headers = npy(client)
    np.testing.assert_array_equal(shear[:, :, :2], np.stack([X, Y]).reshape(2, 2, 3)[:, :, :2])
    assert (shear.shape, shear.dtype) == ((2, 2, 3), np.float32)
    assert np.isnan(shear[:, 1, 2]).all()  # dead
    told = client.get("/skin/frames/shear").json()
    assert (told["unit"], told["state"]) == (headers["x-tactiled-unit"], "live") == ("counts", "live")
    assert told["x"] == [[100.0, -200.0, 0.0], [1388.0, -1388.0, None]]
    assert told["y"] == [[1.0, 2.0, 3.0], [4.0, 5.0, None]]
    raw = client.get("/skin/frames/raw").json()
    assert (told["sequence"], told["timestamp"]) == (raw["sequence"], raw["timestamp"])
    assert raw["unit"] == "kPa"


def test_a_taxel_that_did_not_come_has_no_shear(skin):
    show, client = skin
    show(X, Y, drop=(1,))
    shear, _ = npy(client)
    assert np.argwhere(np.isnan(shear)).tolist() == [[0, 0, 1], [0, 1, 2], [1, 0, 1], [1, 1, 2]]


def test_a_tare_takes_shear_off_as_well(skin):
    show, client = skin
    show(X, Y)
    assert client.post("/skin/tare").status_code == 202
    for _ in range(TARE_FRAMES):
        show(X, Y)
    show(X + 10, Y - 20)
    shear, _ = npy(client)
    known = ~np.isnan(shear[0])
    assert set(shear[0][known]) == {10.0}
    assert set(shear[1][known]) == {-20.0}


def test_what_cannot_be_served_is_said(skin):
    show, client = skin
    assert client.get("/skin/frames/shear").status_code == 503
    show(X, Y)
    assert client.get("/skin/frames/shear", headers={"Accept": "image/png"}).status_code == 406
    assert client.get("/skin/frames/shear?format=png").status_code == 422
    assert client.get("/palm/frames/shear").status_code == 404


def test_a_skin_without_shear_says_so(url):
    answer = ask("GET", url + "/api/v1/sensors/palm/frames/shear")
    assert answer.status_code == 404
    assert answer.json()["detail"] == LACKS


@pytest.mark.parametrize("kinds", [("shear",), ("raw", "shear", "restored")])
def test_a_stream_has_shear_among_its_kinds_in_the_order_asked(skin, kinds):
    show, client = skin
    with stream(client, f"?kinds={','.join(kinds)}") as socket:
        image = show(X, Y)
        got = [unpack(each) for each in heard(socket, len(kinds))]
    assert tuple(each.kind for each in got) == kinds
    assert {(each.sequence, each.timestamp) for each in got} == {(image.sequence, image.time)}
    shear = got[kinds.index("shear")]
    np.testing.assert_array_equal(shear.values, image.shear)
    assert shear.values[:, 0].tolist() == [[100.0, -200.0, 0.0], [1.0, 2.0, 3.0]]
    assert shear.flags.size == 0


def test_a_stream_sends_no_shear_unasked(skin):
    show, client = skin
    with stream(client) as socket:
        for _ in range(2):
            show(X, Y)
            assert [unpack(each).kind for each in heard(socket, 2)] == ["raw", "restored"]


def test_a_stream_in_json_says_of_shear_what_rest_says_as_it_is_described(skin):
    show, client = skin
    with stream(client, "?kinds=raw,shear&format=json") as socket:
        show(X, Y)
        frame, told = (json.loads(each) for each in heard(socket, 2))
    assert told == client.get("/skin/frames/shear").json()
    assert (frame["type"], told["type"], told["unit"]) == ("frame", "shear", "counts")
    assert frame["sequence"] == told["sequence"]
    document = ask("GET", f"{client.base_url.join('/')}api/v1/asyncapi.json").json()
    schema = document["components"]["messages"]["shear"]["payload"] | {"components": document["components"]}
    jsonschema.validate(told, schema)
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate({key: value for key, value in told.items() if key != "state"}, schema)


def test_a_stream_of_several_has_the_shear_of_those_it_is_asked_of(request):
    with rigged(request.node.name, PALM) as rig, running(rig.service) as url:
        address = f"{url.replace('http', 'ws', 1)}/api/v1/stream?kinds=restored&shear=skin"
        with connect(address, compression=None) as socket:
            image = rig.show(X, Y)
            got = [unpack(each) for each in heard(socket, 2)]
    assert [(each.sensor, each.kind, each.sequence) for each in got] == [
        ("skin", kind, image.sequence) for kind in ("restored", "shear")
    ]
    np.testing.assert_array_equal(got[1].values, image.shear)


@pytest.mark.parametrize(
    "path", ["sensors/palm/stream?kinds=shear", "stream?kinds=raw,shear", "stream?sensors=skin,palm&kinds=shear"]
)
def test_a_stream_of_shear_of_a_skin_without_is_refused_in_the_words_of_rest(request, path):
    with rigged(request.node.name, PALM) as rig, running(rig.service) as url:
        assert ask("GET", url + "/api/v1/sensors/palm/frames/shear").json()["detail"] == LACKS
        address = f"{url.replace('http', 'ws', 1)}/api/v1/{path}"
        with connect(address) as socket, pytest.raises(ConnectionClosed) as caught:
            socket.recv(timeout=BUSY_S)
        assert (caught.value.rcvd.code, caught.value.rcvd.reason) == (4404, LACKS)


def test_one_socket_has_the_shear_of_those_that_feel_it(request):
    with ExitStack() as stack:
        rig = stack.enter_context(rigged(request.node.name, PALM))
        url = stack.enter_context(running(rig.service)).replace("http", "ws", 1)
        socket = stack.enter_context(connect(f"{url}/api/v1/stream?sensors=skin&kinds=shear"))
        image = rig.show(X, Y)
        got = unpack(heard(socket, 1)[0])
    assert (got.sensor, got.kind) == ("skin", "shear")
    np.testing.assert_array_equal(got.values, image.shear)


def test_the_last_seconds_of_shear_are_the_same_in_every_format(skin):
    show, client = skin
    images = [show(X + n, Y - n) for n in range(4)]
    images.append(show(X, Y, drop=(1,)))
    expected = np.stack([image.shear for image in images])
    query = {"kind": "shear", "last": "60s"}
    told = client.get("/skin/frames", params=query).json()
    frames.Frames.model_validate(told)
    assert (told["kind"], told["unit"], told["before"]) == ("shear", "counts", None)
    assert [each["sequence"] for each in told["frames"]] == [image.sequence for image in images]
    xy = np.array([[each["x"], each["y"]] for each in told["frames"]], np.float32)
    np.testing.assert_array_equal(xy, expected)
    assert told["frames"][-1]["flags"] == images[-1].flags.tolist()
    npy = client.get("/skin/frames", params=query | {"format": "npy"})
    assert npy.headers["x-tactiled-unit"] == "counts"
    np.testing.assert_array_equal(np.load(io.BytesIO(npy.content)), expected)
    npz = np.load(io.BytesIO(client.get("/skin/frames", params=query | {"format": "npz"}).content))
    np.testing.assert_array_equal(npz["values"], expected)
    np.testing.assert_array_equal(npz["flags"], [image.flags for image in images])


def test_the_last_seconds_of_shear_of_a_skin_without_are_refused(url):
    answer = ask("GET", url + "/api/v1/sensors/palm/frames?kind=shear")
    assert (answer.status_code, answer.json()["detail"]) == (404, LACKS)


def test_the_list_of_sensors_says_which_feel_shear(request):
    with rigged(request.node.name, PALM) as rig, running(rig.service) as url:
        told = ask("GET", url + "/api/v1/sensors").json()["sensors"]
    assert {each["name"]: each["shear"] for each in told} == {"skin": True, "palm": False}


@pytest.mark.parametrize("path", ["/api/v1/sensors/{name}/frames", "/api/v1/sensors/{name}/frames/shear"])
def test_the_examples_of_the_description_are_what_they_are_examples_of(url, path):
    said = ask("GET", url + "/api/v1/openapi.json").json()["paths"][path]["get"]["responses"]["200"]
    form = Shear if path.endswith("shear") else frames.Frames
    form.model_validate(said["content"]["application/json"]["example"])
