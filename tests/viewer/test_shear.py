"""Shear as arrows: what is drawn is what the skin feels, told by the pixels."""

import io
import re
from contextlib import ExitStack

import numpy as np
import pytest
from PIL import Image

from tactiled.config import Server, parse
from tactiled.runtime.service import Service
from tactiled.web.server import running
from tests.conftest import ask
from tests.skin import CONFIG, PALM, Z, rigged
from tests.viewer.conftest import PHONE, keep, turned, wait
from tests.viewer.test_access import found
from tests.viewer.test_viewer import PAINTINGS, painted, pixels

REST = np.zeros(6, int)
X = np.array([1000, 0, 0, -600, 300, 900])  # counts; the last taxel is dead
Y = np.array([0, 0, -800, 600, 520, 900])
SWITCH = "document.getElementById('shear-on').click()"
KEY = "document.getElementById('shear-key').innerText"
LIVE = "document.body.dataset.level === 'live'"
CHOICE = "document.getElementById('shear-choice').hidden"


@pytest.fixture
def rig(request):
    with rigged(request.node.name) as made:
        made.stale_after(0.3)  # an image that a busy page was too late for is shown then
        yield made


@pytest.fixture
def url(rig):
    with running(rig.service) as address:
        yield address


def show(rig, page, x, y, z=Z):
    """Send a frame and wait until the page has painted it."""
    before = painted(page)
    rig.show(x, y, z)
    wait(page, f"{PAINTINGS} > {before}")


def inked(picture):
    """Where an arrow's light line is, its edges left out."""
    red, green, blue, alpha = np.moveaxis(picture, -1, 0)
    return (alpha == 255) & (red < 170) & (green > 225) & (blue > 235)


def arrows(page, name="raw-shear"):
    """Angle (rad, from x towards y) and length (px) of each taxel's arrow, by its pixels; None: there is none."""
    ink = inked(pixels(page, name))
    rows, columns = ink.shape[0] / 2, ink.shape[1] / 3
    return [
        measured(ink[int(r * rows) : int((r + 1) * rows), int(c * columns) : int((c + 1) * columns)])
        for r in range(2)
        for c in range(3)
    ]


def measured(ink):
    """The longest way through an arrow's ink; its head is where most of the ink is."""
    places = np.argwhere(ink)[:, ::-1].astype(float)
    if not len(places):
        return None
    angles = np.radians(np.arange(0, 180, 0.5))
    along = places @ np.stack([np.cos(angles), np.sin(angles)])
    reach = along.max(axis=0) - along.min(axis=0)
    way = reach.argmax()
    middle = (along[:, way].max() + along[:, way].min()) / 2
    turn = 0.0 if along[:, way].mean() > middle else np.pi
    return angles[way] + turn, reach[way]


def off(angle, wanted):
    """How far (degrees) an angle is from the wanted one."""
    return abs(np.degrees((angle - wanted + np.pi) % (2 * np.pi) - np.pi))


@pytest.mark.parametrize("options", [{"width": 1440, "height": 900}, PHONE], ids=["desk", "phone"])
def test_arrows_point_where_the_skin_is_pulled_to_the_scale_of_the_key(rig, url, open_page, options):
    rig.show(REST, REST)
    page = open_page(url, **options)
    show(rig, page, X, Y)
    got = arrows(page)
    assert page.evaluate(KEY) == "1000 counts"
    _, key = measured(inked(key_pixels(page)))
    for x, y, arrow in zip(X[:5], Y[:5], got[:5], strict=True):
        if not (x or y):
            assert arrow is None
            continue
        angle, length = arrow
        assert off(angle, np.arctan2(y, x)) < 4, (x, y)
        assert length == pytest.approx(key * np.hypot(x, y) / 1000, abs=3), (x, y)
    assert got[5] is None  # dead: nothing is known


def key_pixels(page):
    page.evaluate("document.querySelector('#shear-key canvas').id = 'key'")
    return pixels(page, "key")


def test_arrows_turn_with_the_shear_and_the_kept_frames_keep_theirs(rig, url, open_page):
    rig.show(REST, REST)
    page = open_page(url)
    for angle in np.radians([30, 150, 270]):
        show(rig, page, np.full(6, 900 * np.cos(angle)), np.full(6, 900 * np.sin(angle)))
        for points, _ in arrows(page)[:5]:
            assert off(points, angle) < 4
    page.keyboard.press("Space")
    for angle in np.radians([150, 30]):
        page.keyboard.press("ArrowLeft")
        turned(page)
        for points, _ in arrows(page)[:5]:
            assert off(points, angle) < 4


def test_the_scale_holds_still_and_noise_is_not_drawn_large(rig, url, open_page):
    rig.show(REST, REST)
    page = open_page(url)
    show(rig, page, REST + 3, REST)
    assert page.evaluate(KEY) == "50 counts"
    assert arrows(page) == [None] * 6
    seen = []
    for most in (480, 400, 470, 430):
        show(rig, page, REST + most, REST)
        seen.append((page.evaluate(KEY), arrows(page)[0][1]))
    assert {key for key, _ in seen} == {"500 counts"}
    assert seen[0][1] > seen[2][1] > seen[3][1] > seen[1][1]


def test_shear_switched_off_is_neither_drawn_nor_asked_for(rig, url, open_page):
    rig.show(X, Y)
    page = open_page(url)
    assert inked(pixels(page, "raw-shear")).any()
    with page.expect_websocket() as opened:
        page.evaluate(SWITCH)
    assert "shear" not in opened.value.url
    show(rig, page, X, Y)
    assert not pixels(page, "raw-shear").any()
    assert page.evaluate("document.getElementById('shear-key').hidden")
    with page.expect_websocket() as opened:
        page.keyboard.press("v")
    assert "kinds=raw,restored,shear" in opened.value.url
    show(rig, page, X, Y)
    wait(page, "!document.getElementById('shear-key').hidden")
    assert inked(pixels(page, "raw-shear")).any()


def test_a_sensor_that_feels_none_has_neither_arrows_nor_the_choice(request, open_page):
    with ExitStack() as stack:
        rig = stack.enter_context(rigged(request.node.name, PALM))
        rig.stale_after(0.3)
        url = stack.enter_context(running(rig.service))
        rig.show(X, Y)
        page = open_page(url)
        assert not page.evaluate(CHOICE)
        with page.expect_websocket() as opened:
            page.keyboard.press("2")
        assert "palm" in opened.value.url
        assert "shear" not in opened.value.url
        wait(page, CHOICE)
        assert not pixels(page, "raw-shear").any()
        assert page.evaluate("document.getElementById('shear-key').hidden")
        page.keyboard.press("v")
        assert page.evaluate("document.getElementById('shear-on').checked")
        page.close()  # which else misses the service


def test_a_service_that_comes_back_without_shear_is_watched_on(rig, request, open_page):
    with running(rig.service) as url:
        rig.show(X, Y)
        page = open_page(url)
    text = CONFIG.format(channel=request.node.name + "-2").replace(
        'name = "xela", rows = [0, 1], columns = [0, 1, 2]', 'name = "packed"'
    )
    service = Service(parse(text))
    service.start()
    with running(service, Server(port=int(url.rsplit(":", 1)[1]))):
        wait(page, CHOICE)
        wait(page, "document.body.dataset.level === 'silent'")
        page.goto("about:blank")
        page.wait_for_timeout(200)
    service.stop()
    page.faults.clear()  # the browser itself reports every attempt that fails


def luminance(rgb):
    """Relative, as WCAG has it, of colours 0 to 255."""
    share = np.asarray(rgb, float) / 255
    linear = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    return linear @ [0.2126, 0.7152, 0.0722]


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("pressure", [0.0, 0.5, 0.95], ids=["dark", "middle", "bright"])
def test_arrows_stand_out_from_every_colour_of_the_map(rig, url, open_page, scheme, pressure):
    rig.show(REST, REST)
    page = open_page(url, color_scheme=scheme)
    page.evaluate("document.getElementById('contacts-on').click()")
    for name, value in (("low", "0"), ("high", "40")):
        page.locator(f"#range-{name}").fill(value)
    rig.stale_after(600)
    keep(
        lambda: rig.show(REST + 1000, REST, np.full(6, 40_000 * pressure)),
        page,
        f"{LIVE} && {PAINTINGS} > {painted(page)}",
    )
    turned(page)
    picture = np.array(Image.open(io.BytesIO(page.locator("#raw-frame").screenshot())).convert("RGBA"))
    height, width = picture.shape[0] // 2, picture.shape[1] // 3
    cell = picture[:height, :width].astype(int)
    ink = inked(cell)
    assert ink.sum() > 60
    rows, columns = np.nonzero(ink)
    shaft = columns < np.quantile(columns, 0.4)  # before the head
    top = rows[shaft].min()
    rim = cell[top - 2, columns[shaft].min() + 4 : columns[shaft].max() - 1, :3]
    light, dark = luminance(cell[ink][:, :3]).min(), luminance(rim).max()
    assert (light + 0.05) / (dark + 0.05) >= 3


def test_the_probe_and_the_table_tell_shear_in_counts(rig, url, open_page):
    rig.show(REST, REST)
    page = open_page(url)
    show(rig, page, X, Y)
    box = page.locator("#raw").bounding_box()
    page.mouse.click(box["x"] + box["width"] / 6, box["y"] + 3 * box["height"] / 4)
    page.locator("#probe", has_text="shear −600, 600 counts (taxel 1, 0)").wait_for()
    page.mouse.click(box["x"] + 5 * box["width"] / 6, box["y"] + 3 * box["height"] / 4)
    page.locator("#probe", has_text=re.compile(r"restored [\d.]+ kPa \(taxel 1, 2, dead\)")).wait_for()
    with page.expect_download() as saved:
        page.keyboard.press("c")
    lines = saved.value.path().read_text().splitlines()[2:]
    assert lines[0].endswith(",kpa,flags,shear_x_counts,shear_y_counts")
    assert {line.count(",") for line in lines} == {8}
    told = [line.split(",")[-2:] for line in lines if line.startswith("raw")]
    assert told == [*([str(x), str(y)] for x, y in zip(X[:5], Y[:5], strict=True)), ["", ""]]
    with page.expect_download() as saved:
        page.keyboard.press("s")
    with Image.open(saved.value.path()) as sheet:
        assert inked(np.array(sheet.convert("RGBA")).astype(int))[: sheet.height // 2].sum() > 60


TILE_KEY = "document.querySelector('.tile .shear-key')"
CANVASES = "[...document.querySelectorAll('.tile')].map(each => each.querySelectorAll('.frame canvas').length)"


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("size", [{"width": 1440, "height": 900}, PHONE], ids=["desk", "phone"])
def test_the_wall_has_arrows_on_the_same_socket(request, open_page, size, scheme):
    with rigged(request.node.name, PALM) as rig, running(rig.service) as url:
        page = open_page(f"{url}/#/wall", ready=f"!!{TILE_KEY}", color_scheme=scheme, **size)
        keep(lambda: rig.show(REST, REST), page, f"{TILE_KEY}.innerText === '50 counts'")
        keep(lambda: rig.show(X, Y), page, f"{TILE_KEY}.innerText === '1000 counts'")
        assert "tactiled_streams 1" in ask("GET", url + "/metrics").text.splitlines()
        assert page.evaluate(CANVASES) == [2, 1]  # the palm feels none
        page.evaluate("document.querySelectorAll('.tile .frame canvas')[1].id = 'over'")
        page.evaluate("document.querySelector('.tile .shear-key canvas').id = 'over-key'")
        _, key = measured(inked(pixels(page, "over-key")))
        for x, y, arrow in zip(X, Y, arrows(page, "over"), strict=True):
            if not (x or y) or x == X[5]:  # none; dead
                assert arrow is None
                continue
            assert off(arrow[0], np.arctan2(y, x)) < 4, (x, y)
            assert arrow[1] == pytest.approx(key * np.hypot(x, y) / 1000, abs=3), (x, y)
        assert found(page) == []
        assert page.evaluate("document.documentElement.scrollWidth") <= size["width"]
        page.keyboard.press("1")
        page.locator("#main").wait_for()
        wait(page, "!document.getElementById('shear-key').hidden")  # the stream with shear is there
        with page.expect_websocket() as opened:
            page.keyboard.press("v")
        assert "shear" not in opened.value.url
        with page.expect_websocket() as opened:
            page.keyboard.press("w")
        assert "shear" not in opened.value.url
        page.close()  # which else misses the service


@pytest.mark.parametrize("size", [{"width": 1440, "height": 900}, PHONE], ids=["desk", "phone"])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_nothing_is_found_and_nothing_is_cut_off(rig, url, open_page, scheme, size):
    rig.show(20 * X, Y)
    page = open_page(url, color_scheme=scheme, **size)
    rig.stale_after(600)
    keep(lambda: rig.show(20 * X, Y), page, f"{LIVE} && !document.getElementById('shear-key').hidden")
    assert ask("GET", url + "/api/v1/sensors/skin").json()["state"] == "live"
    assert found(page) == []
    assert page.evaluate("document.documentElement.scrollWidth") <= size["width"]
    raw, restored = (page.locator(f"#{name}").bounding_box() for name in ("raw", "restored"))
    assert raw["y"] == pytest.approx(restored["y"], abs=0.5)
    caption = page.locator("figcaption").first
    assert caption.evaluate("it => it.scrollWidth <= it.clientWidth")
