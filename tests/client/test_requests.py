"""Requests of the client: they give what the service has, and pages of the guide run as they are written."""

import asyncio
import inspect
import io
import re
import time
from base64 import b64decode
from dataclasses import replace

import matplotlib.image
import numpy as np
import pytest
from skimage.color import rgb2lab

from tactiled.bus import recording
from tactiled.client import Client, connect, display
from tactiled.client.results import RegionMeasures, parse, parse_window
from tactiled.client.stream import Image
from tactiled.config import Server
from tactiled.errors import ConfigError, TactileError
from tactiled.frames import FrameWarning
from tactiled.web.rest import frames
from tactiled.web.server import running
from tests.client.test_stream import GUIDE, answering
from tests.conftest import pressed, run_apart, until
from tests.skin import PALM, rigged

LIMIT = {"quantity": "force", "above": 5.0, "below": 4.0}
HEEL = {"shape": "rectangle", "points_mm": [[1.5, 1.5], [5.5, 5.5]], "threshold": LIMIT}
FINE = PALM.replace('method = "raw"', 'method = "wiener"\nrefine = 2')


@pytest.fixture
def images(rig):
    """Nine images; two frames before the fourth are lost."""
    rig.stale_after(600)
    images = []
    for n in range(9):
        rig.sequence += 2 if n == 3 else 0
        images.append(rig.show(pressed(n % 6, 400 + n)))
    return images


@pytest.fixture
def recorder(rig, tmp_path):
    with running(rig.service, Server(port=0, recordings=tmp_path, recordings_leave_mb=0)) as url:
        yield url


def test_a_snapshot_is_the_newest_image_with_its_force(images, rig, url):
    image = connect(url).snapshot("palm")
    np.testing.assert_array_equal(image.raw, images[-1].raw)
    np.testing.assert_array_equal(image.restored, images[-1].restored)
    assert (image.sequence, image.status["state"], image.shear) == (images[-1].sequence, "live", None)
    force = images[-1].restored.sum() * rig.sensor.plan.cells.side**2 * 1e-3
    assert image.force == pytest.approx(force, rel=1e-5)


def test_before_the_first_frame_a_snapshot_says_what_is_missing(rig, url):  # noqa: ARG001
    with pytest.raises(TactileError, match=r"no image for 3\.0 s: palm is silent: no frame yet on can0"):
        connect(url).snapshot("palm", patience_s=3.0)
    with pytest.raises(TactileError, match="no frame yet on can0"):
        connect(url).contacts("palm")
    window = connect(url).window("palm", 1)
    assert (window.values.shape, "peak nan kPa" in window._repr_html_()) == ((0, 8, 8), True)


@pytest.mark.parametrize("kind", ["raw", "restored"])
def test_a_window_joins_its_pages(images, url, kind, monkeypatch):
    monkeypatch.setitem(frames.MAX_VALUES, "npz", 4 * 64)  # four images a page
    window = connect(url).window("palm", 60.0, kind)
    assert (window.sensor, window.kind, window.unit, window.cut) == ("palm", kind, "kPa", False)
    np.testing.assert_array_equal(window.values, np.stack([getattr(each, kind) for each in images]))
    np.testing.assert_array_equal(window.flags, np.stack([each.flags for each in images]))
    assert window.time.tolist() == [each.time for each in images]
    assert window.sequence.tolist() == [0, 1, 2, 5, 6, 7, 8, 9, 10]
    assert set(window.method) == {"wiener"}
    assert re.search(r"frames lost</th><td>2<", window._repr_html_())
    assert len(connect(url).window("palm", 0, kind).time) == 1


def test_a_window_is_cut_where_a_page_is_and_has_one_unit(images, url):  # noqa: ARG001
    content, _ = connect(url)._answer("GET", "/api/v1/sensors/palm/frames?format=npz")
    kpa, counts = ({"X-Tactiled-Unit": unit} for unit in ("kPa", "counts"))
    assert parse_window("palm", "raw", [(content, kpa), (content, kpa | {"X-Tactiled-Cut": "true"})]).cut
    with pytest.raises(ValueError, match="read them again"):
        parse_window("palm", "raw", [(content, kpa), (content, counts)])


def test_a_restored_image_has_one_value_a_taxel_on_request(request):
    with rigged(request.node.name, FINE) as rig, running(rig.service) as url:
        sensor = rig.service.sensor("palm")
        for message in sensor.codec.encode(np.arange(100, 260, 10, "u2"), 0, time.time()):
            rig.bus.send(message)
        cells, taxels = (connect(url).snapshot("palm", image=each) for each in ("raster", "taxels"))
        window = connect(url).window("palm", 60.0, image="taxels")
    assert (cells.restored.shape, taxels.restored.shape, taxels.cells) == ((8, 8), (4, 4), None)
    means = cells.restored.reshape(4, 2, 4, 2).mean(axis=(1, 3))
    np.testing.assert_allclose(taxels.restored, means, atol=1e-4)
    np.testing.assert_array_equal(window.values, [taxels.restored])
    assert taxels.force == pytest.approx(cells.force, rel=1e-4)


def test_contacts_are_those_of_the_service(images, rig, url):  # noqa: ARG001
    contacts = connect(url).contacts("palm")
    _, (expected,) = rig.sensor.contacts()
    (contact,) = contacts.contacts
    assert all(getattr(contact, name) == getattr(expected, name) for name in contact.__slots__)
    assert (contacts.sequence, contacts.unit, contacts.force_unit, contacts.unknown_cells) == (10, "kPa", "N", 0)
    rig.send(pressed(), drop=[0])
    until(lambda: rig.sensor.hub.latest().sequence > 10)
    hole = np.count_nonzero(np.isnan(rig.sensor.hub.latest().restored))
    assert connect(url).contacts("palm").unknown_cells == hole > 0


def test_regions_hold_what_the_newest_image_has(rig, url, client):
    client.put("/sensors/palm/regions/heel", json=HEEL)
    (heel,) = connect(url).regions("palm")
    assert (heel.name, heel.now, heel.points_mm) == ("heel", None, ((1.5, 1.5), (5.5, 5.5)))
    assert (heel.threshold, heel.since, heel.exceeded) == (LIMIT, None, False)
    image = rig.show(pressed())
    (heel,) = connect(url).regions("palm")
    assert heel.now.peak == heel.highest.peak == pytest.approx(image.restored[2:6, 2:6].max())


def test_events_come_in_order_with_their_warning_and_the_next_is_waited_for(rig, url):
    client = connect(url)
    rig.stale_after(600)
    rig.show(pressed(force=3990))  # at the ceiling
    until(lambda: {"sensor_live", "warning_raised"} <= {each.kind for each in client.events()})
    events = client.events()
    assert [each.id for each in events] == [*range(1, len(events) + 1)]
    (raised,) = (each for each in events if each.kind == "warning_raised" and each.warning.code == "saturated")
    assert (raised.sensor, raised.warning.taxels) == ("palm", 4)
    assert client.events(after=1)[0].id == 2

    async def wait():
        waiting = asyncio.create_task(client.aevents(rig.service.events.newest, wait_s=30))
        await asyncio.sleep(0.1)
        await client.aset_method("palm", "raw")
        return await waiting

    assert run_apart(wait())


def test_a_recording_is_uploaded_listed_and_downloaded(recorder, tmp_path):
    client, source, copy = connect(recorder), recording.path("book_1"), tmp_path / "copy.bin"
    content = source.read_bytes()
    assert client.recordings() == ()
    for name in ("a.log", "b.log"):
        added = client.upload(source, name)
        assert (added.name, added.bytes, added.running, added.error) == (name, len(content), False, None)
        assert added.duration_s == pytest.approx(0.28225)
    assert [each.name for each in client.recordings()] == ["a.log", "b.log"]
    assert client.recordings("a.log") == (added,)
    client.download("a.log", copy)
    assert copy.read_bytes() == content
    with pytest.raises(ConfigError, match="is there already"):
        client.download("a.log", copy)
    with pytest.raises(TactileError, match=r"recording a\.log: is there already"):
        client.upload(source, "a.log")
    with pytest.raises(TactileError, match=r"recording c\.log: no such recording"):
        client.download("c.log", tmp_path / "c.log")


def test_the_reason_is_read_when_the_service_refuses_a_file_before_it_has_all_of_it(recorder, tmp_path):
    with (tmp_path / "large.log").open("wb") as file:
        file.truncate(100_000_000)
    with pytest.raises(TactileError, match=r"recording large\.log: is there already"):
        connect(recorder).upload(tmp_path / "large.log")


def test_a_download_that_breaks_off_leaves_no_file(tmp_path):
    short = b"HTTP/1.1 200 OK\r\nContent-Length: 10\r\n\r\nhello"
    with answering(short) as url, pytest.raises(TactileError, match="IncompleteRead"):
        connect(url).download("a.log", tmp_path / "a.log")
    assert not list(tmp_path.iterdir())


def test_asyncio_has_every_method_with_the_same_arguments_and_errors(url):
    arguments = {name: inspect.signature(each).parameters for name, each in vars(Client).items() if name[0] != "_"}
    twins = {name: each for name, each in arguments.items() if name[1:] in arguments}
    assert arguments == twins | {name[1:]: each for name, each in twins.items()}
    with pytest.raises(TactileError, match="sensor 'plam': no such sensor: there are palm"):
        run_apart(connect(url).aregions("plam"))


WRONG = {
    "seconds = -1: give 0 to 999999 s": lambda client: client.window("palm", -1),
    "seconds = '2s'": lambda client: client.window("palm", "2s"),
    "wait_s = nan: give 0 to 30 s": lambda client: client.events(wait_s=float("nan")),
    "sensor = None": lambda client: client.snapshot(None),
    "image = 'cells': give 'raster' or 'taxels'": lambda client: client.window("palm", 1, image="cells"),
    "kind = 'rwa': give 'raw', 'restored', 'shear'": lambda client: client.window("palm", 1, "rwa"),
    "recording = ''": lambda client: client.download("", "a.log"),
}


def test_wrong_arguments_are_refused_before_anything_is_sent():
    for error, ask in WRONG.items():
        with pytest.raises(ConfigError, match=error):
            ask(connect("http://127.0.0.1:9"))


def test_lists_are_tuples_and_null_of_a_number_is_nan():
    fields = {"code": "cover_mismatch", "text": "", "taxels": None, "thickness_mm": 1.5, "direction": None}
    warning = parse(FrameWarning | None, fields | {"interval_mm": [1.0, 2.0], "newer": 3})
    assert warning == FrameWarning("cover_mismatch", "", None, 1.5, None, (1.0, 2.0))
    assert np.isnan(parse(RegionMeasures, dict.fromkeys(("force", "mean", "peak", "area"))).peak)


@pytest.mark.parametrize("body", [b"{}", b"[]", b'{"events": [{"id": 1}]}', b'{"contacts": 3}'])
def test_an_answer_of_another_version_is_an_error(body):
    data = b"HTTP/1.1 200 OK\r\nContent-Length: %d\r\n\r\n%s" % (len(body), body)
    for ask in (Client.events, lambda client: client.contacts("palm"), lambda client: client.window("palm", 1)):
        with answering(data) as url, pytest.raises(TactileError, match="no answer of this version of tactiled"):
            ask(connect(url))


def test_the_greys_have_even_steps_of_lightness():
    lab = rgb2lab(display.palette()[: display.LEVELS : 11] / 255)
    np.testing.assert_allclose(lab, np.outer(np.linspace(0, 100, 24), [1, 0, 0]), atol=0.3)


def test_a_notebook_shows_raw_and_restored_on_one_scale_and_marks_what_is_unknown():
    raw = np.array([[0, 50], [np.nan, 0]], np.float32)
    status = {"state": "stale", "ran": "nnls", "warnings": [{"text": "1 taxel <missing>"}]}
    image = Image(raw, 2 * np.nan_to_num(raw), raw > 9, 7, 0.0, 0.5, 1.0, status, "palm", None, 0.5, force=0.1)
    assert f"{image}" == "palm, frame 7, state stale, method nnls, force 0.1 N, warnings 1 taxel <missing>"
    html = image._repr_html_()
    for part in ("raw, peak 50 kPa", "restored, peak 100 kPa", "0.1 N", "stale", "nnls", "&lt;missing&gt;"):
        assert part in html
    sources = re.findall(r'src="data:image/png;base64,([^"]+)"', html)
    first, second = (matplotlib.image.imread(io.BytesIO(b64decode(each)))[..., :3] for each in sources)
    ramp = display.palette() / 255
    assert first.shape == (256, 256, 3)
    for pixel, color in ((second[5, 250], 253), (first[5, 250], 126), (first[5, 5], 0)):
        np.testing.assert_allclose(pixel, ramp[color], atol=0.01)
    np.testing.assert_allclose(np.unique(first[128:, :128].reshape(-1, 3), axis=0), ramp[254:], atol=0.01)
    line = replace(image, raw=raw.reshape(1, 4), restored=raw.reshape(1, 4) * 0, unit="counts", force=np.nan)
    assert "force" not in line._repr_html_()
    assert "0 to 50 counts" in line._repr_html_()
    assert "0 to 5 kPa" in replace(image, raw=0 * raw, restored=0 * raw)._repr_html_()  # ten times the noise


def test_the_programs_of_the_guide_run(images, rig, url, capsys):
    until(lambda: rig.service.events.newest)
    _, requests, awaited, _ = re.findall(r"```python\n(.*?)```", GUIDE.read_text(), re.DOTALL)
    run_apart(asyncio.to_thread(exec, requests.replace("http://127.0.0.1:8000", url).replace("2.0", "60.0"), {}))
    lines = capsys.readouterr().out.splitlines()
    image = images[-1]
    assert lines[0] == f"{image.restored.max():.1f} kPa, {image.restored.sum() * 1e-3:.2f} N, live"
    assert lines[1] == f"9 images, {image.raw.max():.1f} kPa"
    assert re.fullmatch(r"1 at \d\.\d, \d\.\d mm: \d\.\d\d N", lines[2])
    assert lines[3].startswith("1 ")
    run_apart(asyncio.to_thread(exec, awaited.replace("http://127.0.0.1:8000", url), {}))
    assert capsys.readouterr().out == f"frame {image.sequence}, contacts: 1\n"
