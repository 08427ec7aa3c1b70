"""Shear of a 3-axis skin, from its messages on the bus to REST and the streams."""

import io

import jsonschema
import numpy as np
import pytest

from tactiled.client import connect
from tactiled.web.rest import frames
from tests.conftest import problem, until
from tests.skin import PALM, SCALE, X, Y, Z, rigged
from tests.web.ws.clients import closed, images, stream, text_of

SHEAR, TRACTION = "/sensors/skin/frames/shear", "/sensors/skin/frames/traction"


@pytest.fixture
def rig(request):
    """A skin beside a palm that feels no shear."""
    with rigged(request.node.name, PALM, getattr(request, "param", "")) as rig:
        yield rig


def npy(client):
    answer = client.get(SHEAR, headers={"Accept": "application/x-npy"})
    return np.load(io.BytesIO(answer.content)), answer.headers


def test_shear_is_served_in_counts_with_the_image_it_belongs_to(rig, client):
    assert problem(client.get(SHEAR), 503) == "sensor 'skin': no frame yet on can0"
    rig.show(X, Y)
    shear, headers = npy(client)
    np.testing.assert_array_equal(shear[:, :, :2], np.stack([X, Y]).reshape(2, 2, 3)[:, :, :2])
    assert (shear.shape, shear.dtype) == ((2, 2, 3), np.float32)
    assert np.isnan(shear[:, 1, 2]).all()  # dead
    answer = client.get(SHEAR).json()
    assert (answer["type"], answer["unit"], answer["state"]) == ("shear", headers["x-tactiled-unit"], "live")
    assert (answer["unit"], headers["x-tactiled-state"], headers["vary"]) == ("counts", "live", "Accept")
    assert answer["x"] == [[100.0, -200.0, 0.0], [1388.0, -1388.0, None]]
    assert answer["y"] == [[1.0, 2.0, 3.0], [4.0, 5.0, None]]
    raw = client.get("/sensors/skin/frames/raw").json()
    assert (answer["sequence"], answer["timestamp"]) == (raw["sequence"], raw["timestamp"])
    assert raw["unit"] == "kPa"
    assert client.get(SHEAR, headers={"Accept": "image/png"}).status_code == 406
    assert client.get(f"{SHEAR}?format=png").status_code == 422
    rig.show(X, Y, drop=(1,))
    assert np.argwhere(np.isnan(npy(client)[0])).tolist() == [[0, 0, 1], [0, 1, 2], [1, 0, 1], [1, 1, 2]]


def test_a_tare_takes_shear_off_as_well(rig, client):
    rig.show(X, Y)
    assert client.post("/sensors/skin/tare").status_code == 202
    until(lambda: rig.show(X, Y) and rig.sensor.pipeline.tares.done)
    rig.show(X + 10, Y - 20)
    shear, _ = npy(client)
    for axis, expected in zip(shear, (10.0, -20.0), strict=True):
        assert set(axis[~np.isnan(axis)]) == {expected}


def test_past_shear_is_x_and_y_of_each_frame(rig, client):
    images = [rig.show(X + n, Y - n) for n in range(4)]
    images.append(rig.show(X, Y, drop=(1,)))
    expected = np.stack([image.shear for image in images])
    query = {"kind": "shear", "last": "60s"}
    page = client.get("/sensors/skin/frames", params=query).json()
    frames.Frames.model_validate(page)
    assert (page["kind"], page["unit"], page["before"]) == ("shear", "counts", None)
    assert [each["sequence"] for each in page["frames"]] == [image.sequence for image in images]
    xy = np.array([[each["x"], each["y"]] for each in page["frames"]], np.float32)
    np.testing.assert_array_equal(xy, expected)
    assert page["frames"][-1]["flags"] == images[-1].flags.tolist()
    npz = np.load(io.BytesIO(client.get("/sensors/skin/frames", params=query | {"format": "npz"}).content))
    np.testing.assert_array_equal(npz["values"], expected)


@pytest.mark.parametrize(
    ("path", "sensor", "kinds"),
    [
        ("sensors/skin/stream", "", ["raw", "restored"]),
        ("sensors/skin/stream?kinds=shear", "", ["shear"]),
        ("sensors/skin/stream?kinds=raw,shear,restored", "", ["raw", "shear", "restored"]),
        ("stream?sensors=skin&kinds=shear", "skin", ["shear"]),
        ("stream?kinds=restored&shear=skin", "skin", ["restored", "shear"]),
    ],
)
def test_a_stream_has_the_kinds_of_its_query_in_their_order(rig, client, path, sensor, kinds):
    with stream(str(client.base_url), path, "") as socket:
        for _ in range(2):
            image = rig.show(X, Y)
            messages = images(socket, len(kinds))
            assert [each.kind for each in messages] == kinds
            assert {each.sensor for each in messages} == {sensor}
            assert {(each.sequence, each.timestamp) for each in messages} == {(image.sequence, image.time)}
            for each in messages:
                np.testing.assert_array_equal(each.values, getattr(image, each.kind))
                assert (each.flags.size > 0) == (each.kind == "raw")


def test_shear_in_a_json_stream_is_that_of_rest_as_described(rig, client):
    with stream(str(client.base_url), "sensors/skin/stream?kinds=raw,shear&format=json", "") as socket:
        rig.show(X, Y)
        frame, shear = (text_of(socket, kind) for kind in ("frame", "shear"))
    assert shear == client.get(SHEAR).json()
    assert (frame["type"], frame["sequence"]) == ("frame", shear["sequence"])
    document = client.get("/asyncapi.json").json()
    schema = document["components"]["messages"]["shear"]["payload"] | {"components": document["components"]}
    jsonschema.validate(shear, schema)
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate({key: value for key, value in shear.items() if key != "state"}, schema)


@pytest.mark.parametrize("rig", [SCALE], indirect=True)
def test_shear_with_a_scale_is_restored_once_it_was_tared(rig, client):
    assert problem(client.get(TRACTION), 503) == "sensor 'skin': no frame yet on can0"
    rig.show(X, Y)
    assert client.get(TRACTION).json()["x"] == [[None] * 3] * 2
    assert client.post("/sensors/skin/tare").status_code == 202
    until(lambda: rig.show(X, Y) and rig.sensor.pipeline.tares.done)
    image = rig.show(X + 2000, Y, Z + np.array([9000, 9000, 0, 9000, 9000, 0]))
    assert image.traction[0].mean() > 0.5
    answer = client.get(TRACTION)
    traction = answer.json()
    assert (traction["type"], traction["unit"], answer.headers["x-tactiled-unit"]) == ("traction", "kPa", "kPa")
    np.testing.assert_allclose([traction["x"], traction["y"]], image.traction, atol=1e-4)
    deviations = [traction["x_deviation"], traction["y_deviation"]]
    np.testing.assert_allclose(deviations, image.traction_deviation, atol=1e-4)
    values = np.load(io.BytesIO(client.get(f"{TRACTION}?format=npy").content))
    np.testing.assert_array_equal(values, image.traction)
    assert client.get("/sensors").json()["sensors"][0]["traction"] is True
    with stream(str(client.base_url), "sensors/skin/stream?kinds=raw,traction", "") as socket:
        messages = images(socket, 2)
        assert [each.kind for each in messages] == ["raw", "traction"]
        np.testing.assert_array_equal(messages[1].values, image.traction)
    with stream(str(client.base_url), "sensors/skin/stream?kinds=traction&format=json&image=taxels", "") as socket:
        assert text_of(socket, "traction") == traction
    snapshot = connect(str(client.base_url).removesuffix("/api/v1/")).snapshot("skin", traction=True)
    np.testing.assert_array_equal(snapshot.traction, image.traction)


def test_shear_without_a_scale_is_not_restored(client):
    message = "sensor 'skin': shear is not restored: that needs calibration.shear_n_per_count"
    assert problem(client.get(TRACTION), 404).startswith(message)
    with stream(str(client.base_url), "stream?sensors=skin&traction=skin", "") as socket:
        code, reason = closed(socket)
    assert (code, reason.startswith(message)) == (4404, True)


def test_a_sensor_without_shear_is_refused(client):
    sensors = client.get("/sensors").json()["sensors"]
    assert {each["name"]: each["shear"] for each in sensors} == {"skin": True, "palm": False}
    for path in ("/sensors/palm/frames/shear", "/sensors/palm/frames?kind=shear"):
        assert problem(client.get(path), 404) == "sensor 'palm': its codec packed carries no shear"
