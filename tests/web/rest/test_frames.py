import dataclasses
import io
import re
import threading
from concurrent.futures import ThreadPoolExecutor

import matplotlib.image
import numpy as np
import pytest

from tactiled.config import Server
from tactiled.processes import SideProcess
from tactiled.web.http import limits
from tactiled.web.rest import drawing as pictures
from tactiled.web.rest import frames
from tactiled.web.rest.frames import picture
from tactiled.web.server import running
from tests.conftest import GAIN, NO_LOAD, SIDE, Rig, ask, meanwhile, pressed, problem, until
from tests.viewer.conftest import THUMB, Pair

PAST = "/api/v1/sensors/palm/frames"
NEWEST = "/sensors/palm/frames/raw"
PNG = f"{PAST}/raw?format=png"


@pytest.fixture
def images(rig):
    """Twelve images; two frames before the fourth are lost."""
    images = []
    for n in range(12):
        if n == 3:
            rig.sequence += 2
        images.append(rig.show(pressed(n % 6)))
    return images


def test_the_surface_has_what_lies_beyond_the_taxels(rig, client):
    counts = NO_LOAD + 0 * pressed()
    counts[3:5, 0] = NO_LOAD + 200 / GAIN  # on the border
    image = rig.show(counts)
    answer, geometry = (client.get(f"/sensors/palm/{each}").json() for each in ("frames/surface", "geometry"))
    top, bottom, left, right = answer["own"]
    values, deviation = load(client.get("/sensors/palm/frames/surface?format=npy"))
    np.testing.assert_allclose(values, answer["values"], atol=1e-4)
    np.testing.assert_allclose(deviation, answer["deviation"], atol=1e-4)
    np.testing.assert_allclose(values[top:bottom, left:right], image.restored, atol=1e-3 * image.restored.max())
    own = np.array(client.get("/sensors/palm/frames/deviation").json()["values"])
    np.testing.assert_allclose(deviation[top:bottom, left:right], own, atol=1e-4)
    assert (answer["cell_mm"], answer["unit"]) == (geometry["restored"]["cell_mm"], "kPa")
    first = np.array(answer["origin_mm"]) + answer["cell_mm"] * np.array([left, top])
    np.testing.assert_allclose(first, geometry["restored"]["origin_mm"])
    assert left > 0
    assert values[:, :left].sum() > 0.1 * values.sum()  # the press goes on
    assert values[:, right:].sum() < 0.01 * values.sum()
    assert (deviation > 0).all()


def get(url, **query):
    return ask("GET", url + PAST, params=query)


def load(answer):
    return np.load(io.BytesIO(answer.content))


def sequences(page):
    return [each["sequence"] for each in page["frames"]]


def test_before_the_first_frame_there_is_no_image(url, client):
    answer = client.get(NEWEST)
    assert problem(answer, 503) == "sensor 'palm': no frame yet on can0"
    assert answer.headers["retry-after"] == "1"
    assert get(url).json()["frames"] == []
    empty = get(url, format="npy")
    assert load(empty).shape == (0, 8, 8)
    assert empty.headers["x-tactiled-sequence"] == ""


def test_the_newest_image_is_the_same_in_every_format(rig, client):
    rig.stale_after(600)
    image = rig.show(pressed())
    frame = client.get(NEWEST).json()
    assert (frame["unit"], frame["sequence"], frame["kind"], frame["state"]) == ("kPa", 0, "raw", "live")
    assert (frame["type"], frame["sensor"], frame["method"]) == ("frame", "palm", "wiener")
    np.testing.assert_allclose(frame["values"], (pressed() - NO_LOAD) * GAIN)
    made = ("why", "iterations", "microseconds", "noise", "noise_gain", "resolution_mm")
    assert [frame[each] for each in made] == [getattr(image, each) for each in made]
    assert frame["noise_kpa"] == frame["noise"]
    assert (frame["timestamp"], frame["loss"]["lost"], frame["warnings"]) == (image.time, 0, [])
    npy = client.get("/sensors/palm/frames/restored", headers={"Accept": "application/x-npy"})
    np.testing.assert_array_equal(load(npy), image.restored)
    names = ("sequence", "state", "unit", "timestamp")
    expected = ["0", "live", "kPa", f"{image.time:.6f}"]
    assert [npy.headers[f"x-tactiled-{name}"] for name in names] == expected
    assert 0 <= float(npy.headers["x-tactiled-age"]) < 600
    openapi = client.get("/openapi.json").json()["paths"]["/api/v1/sensors/{name}/frames/{kind}"]["get"]
    documented = {name.lower() for name in openapi["responses"]["200"]["headers"]}
    assert documented == {name for name in npy.headers if name.startswith(("x-tactiled", "etag"))}
    png = client.get("/sensors/palm/frames/restored", params={"format": "png", "top_kpa": 300})
    assert png.headers["content-type"] == "image/png"
    assert matplotlib.image.imread(io.BytesIO(png.content)).shape[2] == 4


def test_a_missing_taxel_is_null_and_flagged_never_zero(rig, client):
    rig.show(pressed())
    rig.send(pressed(), drop=[0])
    rig.send(pressed())  # closes the one before, marked
    rig.send(pressed(), drop=[0])
    until(lambda: rig.sensor.hub.latest().sequence == 3)  # it is given up on when it is too old
    taxels = rig.sensor.codec.taxels
    newest = client.get(NEWEST).json()
    past = client.get("/sensors/palm/frames?kind=raw&last=60s").json()["frames"][-1]
    for frame in (newest, past):
        values, flags = np.ravel(np.array(frame["values"], object)), np.ravel(frame["flags"])
        assert [value is None for value in values] == [n < taxels for n in range(64)]
        assert (flags[:taxels] == 1).all()
    assert [(each["code"], each["taxels"]) for each in newest["warnings"]] == [("missing", taxels)]
    first, *_, last = client.get("/sensors/palm/frames/restored").json()["values"]
    assert set(first) == {None}  # no taxel feels it
    assert None not in last


def test_polling_gives_304_until_there_is_a_newer_image_or_another_state(rig, client):
    rig.stale_after(600)
    rig.show(pressed())
    headers = {"Accept": "application/x-npy"}
    headers["If-None-Match"] = client.get(NEWEST, headers=headers).headers["etag"]
    unchanged = client.get(NEWEST, headers=headers)
    assert (unchanged.status_code, unchanged.content) == (304, b"")
    assert client.get(NEWEST, headers=headers | {"Accept": "*/*"}).status_code == 200
    rig.stale_after(0.01)
    until(lambda: client.get(NEWEST).json()["state"] == "stale")
    stale = client.get(NEWEST, headers=headers)
    assert (stale.status_code, stale.headers["x-tactiled-state"]) == (200, "stale")
    headers["If-None-Match"] = f'"x", {stale.headers["etag"]}'
    assert client.get(NEWEST, headers=headers).status_code == 304
    rig.show(pressed())
    assert client.get(NEWEST, headers=headers).status_code == 200


def test_the_accept_header_selects_the_format(rig, client):
    rig.show(pressed())
    for accept, expected in (
        ("*/*", "application/json"),
        ("image/*, application/json;q=0.5", "image/png"),
        ("application/json;q=0.5, image/png", "image/png"),
        ("text/html, application/x-npy;q=0.1", "application/x-npy"),
        ("application/json;q=0, application/x-npy;q=0.1", "application/x-npy"),
        ("application/json;q=0, */*", "application/x-npy"),
    ):
        assert client.get(NEWEST, headers={"Accept": accept}).headers["content-type"] == expected
    for accept in ("text/html", "application/json;q=0, image/png;q=x"):
        assert accept in problem(client.get(NEWEST, headers={"Accept": accept}), 406)


@pytest.mark.parametrize("kind", ["raw", "restored"])
def test_past_images_are_the_same_in_every_format(url, images, kind):
    expected = np.stack([getattr(image, kind) for image in images])
    page = get(url, kind=kind, last="60s").json()
    assert (page["type"], page["sensor"], page["kind"], page["unit"]) == ("frames", "palm", kind, "kPa")
    assert sequences(page) == [image.sequence for image in images]
    assert [each["timestamp"] for each in page["frames"]] == [image.time for image in images]
    assert {(each["method"], each["flags"]) for each in page["frames"]} == {("wiener", None)}
    assert (page["before"], page["cut"]) == (None, False)
    np.testing.assert_allclose([each["values"] for each in page["frames"]], expected, atol=6e-5)
    frames.Frames.model_validate(page)
    npy = get(url, kind=kind, last="60s", format="npy")
    np.testing.assert_array_equal(load(npy), expected)
    assert npy.headers["x-tactiled-sequence"] == "0-2,5-13"
    first, last = map(float, npy.headers["x-tactiled-timestamp"].split(","))
    assert (first, last) == pytest.approx((images[0].time, images[-1].time), abs=1e-6)


def test_pages_cover_their_window_though_images_come_meanwhile(rig, url, images):
    expected = [image.sequence for image in images[4:]]
    last = f"{images[-1].arrived - images[4].arrived + 1e-5:.6f}s"
    received, query = [], {}
    while query is not None:
        answer = get(url, last=last, limit=3, **query).json()
        received = [*sequences(answer), *received]
        query = answer["before"] and {"before": answer["before"]}
        for _ in range(5):
            rig.show(pressed())
    assert received == expected


def test_a_window_whose_beginning_was_discarded_is_marked_as_cut(request):
    with meanwhile(Rig(request.node.name, "[server]\nhistory_s = 0.05")) as rig, running(rig.service) as url:
        capacity = rig.sensor.history.capacity
        for _ in range(capacity):
            oldest = rig.show(pressed())
        page = get(url, last="60s", limit=5).json()
        assert [page["cut"], get(url, last="60s").json()["cut"]] == [False, False]
        rig.show(pressed())
        rest = get(url, last="60s", limit=5, before=page["before"]).json()
        assert (sequences(rest), rest["before"], rest["cut"]) == ([1, 2, 3], None, True)
        assert get(url, last="60s", format="npy").headers["x-tactiled-cut"] == "true"
        inside = get(url, last=f"{rig.sensor.hub.latest().arrived - oldest.arrived:.6f}s", format="npy")
        assert "x-tactiled-cut" not in inside.headers
        for _ in range(capacity):
            rig.show(pressed())
        discarded = get(url, before=page["before"]).json()
        assert (discarded["frames"], discarded["before"], discarded["cut"]) == ([], None, True)


def test_the_window_and_the_size_of_images_bound_a_page(url, images, monkeypatch):
    last = images[-1].arrived - images[-3].arrived + 1e-4
    assert len(get(url, last=f"{last:.6f}s").json()["frames"]) == 3
    assert len(get(url, last="0s").json()["frames"]) == 1
    monkeypatch.setitem(frames.MAX_VALUES, "json", 3 * 64)
    page = get(url, last="60s").json()
    assert (len(page["frames"]), page["before"].split("@")[0]) == (3, str(page["frames"][0]["sequence"]))


def test_large_text_is_compressed_and_arrays_are_not(url, client, images):
    gzip = {"Accept-Encoding": "gzip"}
    answer = client.get("/sensors/palm/frames?last=60s", headers=gzip)
    assert answer.headers["content-encoding"] == "gzip"
    assert int(answer.headers["content-length"]) < len(answer.content) / 3
    assert len(answer.json()["frames"]) == len(images)
    for path in ("frames?format=npy&last=60s", "frames/raw?format=png", "contacts"):
        assert "content-encoding" not in client.get(f"/sensors/palm/{path}", headers=gzip).headers
    for coding in ("identity", "br", "*"):
        headers = ask("GET", f"{url}{PAST}?last=60s", headers={"Accept-Encoding": coding}).headers
        assert (headers.get("content-encoding"), headers["vary"]) == (None, "Accept, Accept-Encoding")


@pytest.fixture
def drawing(monkeypatch):
    """An event that pictures wait for, and of each that began its thread and whether it was the only one."""
    go_on, busy, began = threading.Event(), threading.Lock(), []

    def png(*_):
        alone = busy.acquire(blocking=False)
        began.append((threading.get_ident(), alone))
        assert go_on.wait(60)
        if alone:
            busy.release()
        return b"a picture"

    monkeypatch.setattr(SideProcess, "run", png)
    yield go_on, began
    go_on.set()


def draw(url, client_number, **headers):
    """Request a picture as one of several clients."""
    return ask("GET", url + PNG, headers={"X-Forwarded-For": f"10.0.0.{client_number}"} | headers)


def test_pictures_are_made_one_at_a_time_and_other_answers_do_not_wait(rig, url, client, drawing):
    """More pictures than the service has threads, of which the first is not done before other answers are."""
    rig.show(pressed())
    go_on, began = drawing
    with ThreadPoolExecutor(50) as clients:
        answers = [clients.submit(draw, url, number % 5) for number in range(50)]
        until(lambda: began)
        for path in ("", "/frames/deviation", "/frames"):
            assert client.get(f"/sensors/palm{path}").status_code == 200
        go_on.set()
        assert [each.result().status_code for each in answers] == [200] * 50
    ((_, alone),) = {*began}
    assert (len(began), alone) == (50, True)


@pytest.mark.parametrize(
    ("bound", "clients", "detail"),
    [
        ("MAX_WAITING", 20, "3 such answers are waited for already: wait"),
        ("MAX_WAITING_PER_CLIENT", 1, "3 such answers are waited for by 10.0.0.0 already: wait"),
    ],
)
def test_waiting_pictures_are_bounded(rig, url, client, drawing, monkeypatch, bound, clients, detail):
    monkeypatch.setattr(limits, bound, 3)
    rig.show(pressed())
    go_on, _ = drawing
    with ThreadPoolExecutor(21) as threads:
        answers = [threads.submit(draw, url, number % clients) for number in range(20)]
        until(lambda: sum(each.done() for each in answers) == 16)
        assert client.get("/sensors/palm/frames").status_code == 200  # another kind
        go_on.set()
        refused = [answer for each in answers if (answer := each.result()).status_code != 200]
    assert len(refused) == 16
    for each in refused:
        assert problem(each, 429) == detail
        assert int(each.headers["retry-after"]) >= 1


def test_a_known_image_or_a_full_queue_uses_up_no_turn(rig, monkeypatch):
    """Six costly answers a minute are one at a time."""
    monkeypatch.setattr(SideProcess, "run", lambda *_: b"a picture")
    rig.show(pressed())
    until(lambda: rig.sensor.status().state == "stale")  # and stays so: its tag does not change
    with running(rig.service, Server(port=0, control_per_minute=6)) as url:
        with monkeypatch.context() as full:
            full.setattr(limits, "MAX_WAITING", 0)
            for _ in range(3):
                assert problem(draw(url, 1), 429) == "0 such answers are waited for already: wait"
        etag = draw(url, 1).headers["etag"]
        statuses = [draw(url, 1, **{"If-None-Match": etag}).status_code for _ in range(5)]
        assert statuses == [304] * 5
        assert problem(draw(url, 1), 429) == "more than 1 at once, or 6 a minute: wait"


def drawn(*arguments):
    return pictures.draw(picture(*arguments))


def scale(figure):
    return figure.axes[0].images[0].get_clim()


def test_noise_alone_is_dark_and_a_load_fills_the_scale(rig):
    idle = rig.show(np.full((SIDE, SIDE), NO_LOAD) + np.arange(SIDE) % 2)  # up to 0.5 kPa, the noise
    assert scale(drawn(rig.sensor, idle, "raw", None)) == (0, 15 * 0.5)
    assert scale(drawn(rig.sensor, idle, "raw", 3.0)) == (0, 3.0)
    strong = rig.show(pressed())
    unknown = dataclasses.replace(strong, noise_gain=float("nan"))
    for image in (strong, unknown):
        assert scale(drawn(rig.sensor, image, "raw", None)) == (0, 200)
    assert scale(drawn(rig.sensor, strong, "restored", None)) == (0, strong.restored.max())
    deviation = rig.sensor.pipeline.deviation(strong)
    assert scale(drawn(rig.sensor, strong, "deviation", None)) == (0, deviation.max())


def test_the_title_gives_the_age_of_a_stale_image(rig):
    image = rig.show(pressed())
    assert drawn(rig.sensor, image, "raw", None).axes[0].get_title() == "palm, raw, frame 0"
    until(lambda: rig.sensor.status().state == "stale")
    title = drawn(rig.sensor, image, "raw", None).axes[0].get_title()
    assert re.fullmatch(r"palm, raw, frame 0\nSTALE: \d+\.\d+ s old", title)


def test_a_map_is_true_to_scale_and_taxels_of_no_grid_are_as_large_as_they_are():
    with meanwhile(Pair("picture", THUMB)) as pair:
        for sensor, image in zip(("palm", "thumb"), pair.both(), strict=True):
            figure = drawn(pair.service.sensor(sensor), image, "raw", None)
            figure.draw_without_rendering()
            extent, axes = figure.axes[0].get_window_extent(), figure.axes[0]
            across, down = np.ptp(axes.get_xlim()), np.ptp(axes.get_ylim())
            assert extent.width / extent.height == pytest.approx(across / down, rel=0.01)
    (discs,) = axes.collections
    assert set(discs.get_widths()) == {1.5}
    np.testing.assert_array_equal(discs.get_array(), image.raw)
