import io
import json

import httpx
import numpy as np
import pytest

from tactiled.web.rest import frames
from tactiled.web.server import running
from tests.conftest import HTTP, Rig, ask, meanwhile, pressed, until
from tests.web.rest.test_sensors import problem

PATH = "/api/v1/sensors/palm/frames"


@pytest.fixture
def images(rig):
    """Twelve images; two frames before the fourth are lost."""
    shown = []
    for n in range(12):
        if n == 3:
            rig.sequence += 2
        shown.append(rig.show(pressed(n % 6)))
    return shown


def get(url, **query):
    return ask("GET", url + PATH, params=query)


@pytest.mark.parametrize("kind", ["raw", "restored"])
def test_the_last_seconds_are_the_same_in_every_format(url, images, kind):
    expected = np.stack([getattr(image, kind) for image in images])
    told = get(url, kind=kind, last="60s").json()
    assert (told["type"], told["sensor"], told["kind"], told["unit"]) == ("frames", "palm", kind, "kPa")
    assert [each["sequence"] for each in told["frames"]] == [image.sequence for image in images]
    assert [each["timestamp"] for each in told["frames"]] == [image.time for image in images]
    assert {each["method"] for each in told["frames"]} == {"wiener"}
    assert [each["flags"] for each in told["frames"]] == [None] * 12
    assert (told["before"], told["cut"]) == (None, False)
    np.testing.assert_allclose([each["values"] for each in told["frames"]], expected, atol=6e-5)
    frames.Frames.model_validate(told)
    npy = get(url, kind=kind, last="60s", format="npy")
    np.testing.assert_array_equal(np.load(io.BytesIO(npy.content)), expected)
    assert npy.headers["x-tactiled-sequence"] == "0-2,5-13"
    first, last = map(float, npy.headers["x-tactiled-timestamp"].split(","))
    assert (first, last) == pytest.approx((images[0].time, images[-1].time), abs=1e-6)
    npz = np.load(io.BytesIO(get(url, kind=kind, last="60s", format="npz").content))
    np.testing.assert_array_equal(npz["values"], expected)
    np.testing.assert_array_equal(npz["time"], [image.time for image in images])
    assert npz["method"].tolist() == ["wiener"] * 12
    np.testing.assert_array_equal(npz["sequence"], [image.sequence for image in images])
    assert npz["flags"].shape == (12, 8, 8)


def test_pages_lead_back_in_every_format(url, images):
    seen, before = [], {}
    while True:
        told = get(url, last="60s", limit=5, **before).json()
        npy = get(url, last="60s", limit=5, format="npy", **before)
        assert len(np.load(io.BytesIO(npy.content))) == len(told["frames"])
        assert npy.headers.get("x-tactiled-before") == told["before"]
        seen = [each["sequence"] for each in told["frames"]] + seen
        if told["before"] is None:
            break
        before = {"before": told["before"]}
    assert seen == [image.sequence for image in images]


@pytest.mark.parametrize("form", ["json", "npy"])
def test_pages_cover_the_window_that_was_asked_for_though_images_come_meanwhile(rig, url, images, form):
    wanted = [image.sequence for image in images[4:]]
    last = f"{images[-1].arrived - images[4].arrived + 1e-5:.6f}s"
    seen, before = [], {}
    while before is not None:
        answer = get(url, last=last, limit=3, format=form, **before)
        if form == "json":
            seen = [each["sequence"] for each in answer.json()["frames"]] + seen
            told = answer.json()["before"]
        else:
            first, _, newest = answer.headers["x-tactiled-sequence"].partition("-")
            seen = [*range(int(first), int(newest or first) + 1), *seen]
            told = answer.headers.get("x-tactiled-before")
        before = told and {"before": told}
        for _ in range(5):
            rig.show(pressed())
    assert seen == wanted


def test_a_window_of_which_images_are_kept_no_longer_says_so(request):
    with meanwhile(Rig(request.node.name, "[server]\nhistory_s = 0.05")) as rig, running(rig.service) as url:
        keeps = rig.sensor.history.capacity
        for _ in range(keeps):
            oldest = rig.show(pressed())
        assert not get(url, last="60s").json()["cut"]
        page = get(url, last="60s", limit=5).json()
        assert not page["cut"]
        rig.show(pressed())
        rest = get(url, last="60s", limit=5, before=page["before"])
        assert [each["sequence"] for each in rest.json()["frames"]] == [1, 2, 3]
        assert (rest.json()["before"], rest.json()["cut"]) == (None, True)
        assert get(url, last="60s", format="npy").headers["x-tactiled-cut"] == "true"
        kept = get(url, last=f"{rig.sensor.hub.latest().arrived - oldest.arrived:.6f}s", format="npy")
        assert "x-tactiled-cut" not in kept.headers
        for _ in range(keeps):
            rig.show(pressed())
        gone = get(url, before=page["before"]).json()
        assert (gone["frames"], gone["before"], gone["cut"]) == ([], None, True)


def test_a_page_is_cut_where_its_images_are_large(rig, url, monkeypatch):
    for _ in range(5):
        rig.show(pressed())
    monkeypatch.setitem(frames.MOST_VALUES, "json", 3 * 64)
    told = get(url, last="60s").json()
    assert (len(told["frames"]), told["before"].split("@")[0]) == (3, str(told["frames"][0]["sequence"]))


def test_only_what_is_asked_for_comes_back_in_time(url, images):
    last = images[-1].arrived - images[-3].arrived + 1e-4
    assert len(get(url, last=f"{last:.6f}s").json()["frames"]) == 3
    assert len(get(url, last="0s").json()["frames"]) == 1


def test_taxels_that_did_not_come_are_null_and_flagged(rig, url):
    rig.show(pressed())
    rig.send(pressed(), drop=[0])
    until(lambda: rig.sensor.hub.latest().sequence == 1)
    marked = get(url, kind="raw", last="60s").json()["frames"][1]
    taxels = rig.sensor.codec.taxels
    assert np.ravel(marked["flags"])[:taxels].tolist() == [1] * taxels
    assert {*np.ravel(np.array(marked["values"], object))[:taxels]} == {None}


def test_before_the_first_frame_there_are_none(url):
    assert get(url).json()["frames"] == []
    empty = get(url, format="npy")
    assert np.load(io.BytesIO(empty.content)).shape == (0, 8, 8)
    assert empty.headers["x-tactiled-sequence"] == ""


@pytest.mark.parametrize(
    ("query", "says"),
    [
        ({"last": "2"}, "last = '2'"),
        ({"last": "2min"}, "last = '2min'"),
        ({"last": "٢s"}, "last = '٢s'"),
        ({"kind": "deviation"}, "kind = 'deviation'"),
        ({"limit": 0}, "limit = '0'"),
        ({"limit": 1001}, "limit = '1001'"),
        ({"before": -1}, "before = '-1'"),
        ({"before": "5@"}, "before = '5@'"),
        ({"before": "5@nan"}, "before = '5@nan'"),
        ({"format": "png"}, "format = 'png'"),
    ],
)
def test_what_is_wrong_is_named(url, query, says):
    assert says in problem(get(url, **query), 422)


def test_large_text_is_compressed_for_who_takes_it_and_numbers_are_not(rig, url):
    for _ in range(12):
        rig.show(pressed())
    headers = {"Accept-Encoding": "gzip"}
    with httpx.Client(**HTTP, base_url=url, headers=headers) as client:
        packed = client.get(PATH, params={"last": "60s"})
        assert packed.headers["content-encoding"] == "gzip"
        assert int(packed.headers["content-length"]) < len(packed.content) / 3
        json.loads(packed.content)
        for path, query in ((PATH, "format=npy&last=60s"), (PATH + "/raw", "format=png"), ("/api/v1/events", "")):
            assert "content-encoding" not in client.get(path, params=query).headers
    for coding in ("identity", "br", "*"):
        plain = ask("GET", url + PATH, params={"last": "60s"}, headers={"Accept-Encoding": coding})
        assert (plain.headers.get("content-encoding"), plain.headers["vary"]) == (None, "Accept, Accept-Encoding")
