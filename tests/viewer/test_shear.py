"""Shear as arrows: what is drawn is what the skin measures, by the pixels."""

import re

import numpy as np
import pytest
from PIL import Image

from tactiled.web.server import running
from tests.conftest import ask, until
from tests.skin import PALM, SCALE, Z, rigged
from tests.viewer.conftest import FITS, LIVE

REST = np.zeros(6, int)
X = np.array([1000, 0, 0, -600, 300, 900])  # counts; the last taxel is dead
Y = np.array([0, 0, -800, 600, 520, 900])
PRESSED = Z + np.array([9000, 9000, 0, 9000, 9000, 0])
KEY = "document.getElementById('shear-key').innerText"
RESTORED_KEY = "document.getElementById('traction-key')"
NO_CHOICE = "document.getElementById('shear-choice').hidden"
TILE_KEY = "document.querySelector('.tile .shear-key')"


@pytest.fixture
def rig(request):
    with rigged(request.node.name, scale=getattr(request, "param", "")) as made:
        made.stale_after(0.3)  # an image that a busy page was too late for is shown then
        yield made


def inked(picture):
    """Where an arrow's light line is, its edges left out."""
    red, green, blue, alpha = np.moveaxis(picture, -1, 0)
    return (alpha == 255) & (red < 170) & (green > 225) & (blue > 235)


def test_arrows_keep_to_their_frames_and_nothing_is_inaccessible_or_cut_off(rig, url, open_page):
    rig.show(REST, REST)
    page = open_page(url)
    assert not inked(page.pixels("raw-shear")).any()
    pictures = []
    for x, y in ((X, Y), (Y, X)):
        page.show(rig, x, y)
        pictures.append(page.pixels("raw-shear"))
        assert inked(pictures[-1]).sum() > 200
    assert page.evaluate(KEY) == "1000 counts"
    page.press("ArrowLeft")
    page.refreshed()
    assert (page.pixels("raw-shear") == pictures[0]).all()
    page.press("l")
    rig.stale_after(600)
    page.keep(lambda: rig.show(20 * X, Y, Z), f"{LIVE} && {KEY} === '20000 counts'")
    page.inspect()
    for width in (320, 390):
        page.resize(width, 640)
        for caption in page.locator("#boxes figcaption").all():
            assert caption.evaluate(FITS)
    page.evaluate("window.scrollTo(0, 0)")
    for width in (900, 1280, 1600, 1440):
        page.resize(width, 860)
        raw = page.box("#raw")
        page.mouse.move(raw["x"] + 0.05 * raw["width"], raw["y"] + 0.1 * raw["height"])
        page.get_by_text(re.compile(r"shear 20000, 0 counts \(taxel r0 c0\)")).wait_for()
        assert page.locator("#probe").evaluate(FITS)
    page.get_by_role("button", name="Panels").click()  # beside the maps, which are smaller
    page.resize(1440, 900)
    assert page.locator("#boxes figcaption").first.evaluate(FITS)
    page.get_by_role("button", name="Panels").click()
    assert raw["y"] == pytest.approx(page.box("#restored")["y"], abs=0.5)


@pytest.mark.parametrize("rig", [SCALE], indirect=True)
def test_shear_is_read_saved_and_switched_off(rig, url, open_page):
    rig.show(REST, REST)
    page = open_page(url)
    page.show(rig, X, Y, PRESSED)
    assert page.evaluate(f"{RESTORED_KEY}.hidden")  # not tared yet
    rig.stale_after(600)  # a tare is given up where frames stay away
    rig.show(REST, REST)
    rig.sensor.tare(force=True)
    until(lambda: rig.show(REST, REST) and rig.sensor.pipeline.tares.done)
    rig.stale_after(0.3)
    page.keep(lambda: rig.show(X, Y, PRESSED), f"parseFloat({RESTORED_KEY}.innerText) > 0.5")
    image = page.show(rig, X, Y, PRESSED)
    assert inked(page.pixels("restored-shear")).sum() > 60
    largest = np.hypot(*image.traction).max()
    shown = float(page.evaluate(f"{RESTORED_KEY}.innerText").removesuffix(" kPa"))
    assert largest <= shown < 2.6 * largest
    frame = page.box("#raw")
    for column, row, words in (
        (1, 3, re.compile(r"shear −600, 600 counts, −?[\d.]+, −?[\d.]+ kPa \(taxel r1 c0\)")),
        (5, 3, re.compile(r"restored [\d.]+ kPa, shear −?[\d.]+, −?[\d.]+ kPa \(taxel r1 c2, dead\)")),
    ):
        page.mouse.click(frame["x"] + column * frame["width"] / 6, frame["y"] + row * frame["height"] / 4)
        page.locator("#probe", has_text=words).wait_for()
    with Image.open(page.download("s")) as sheet:
        assert inked(np.array(sheet.convert("RGBA")).astype(int))[: sheet.height // 2].sum() > 60
    for on, action in ((False, page.locator("#shear-on").uncheck), (True, lambda: page.press("v"))):
        with page.expect_websocket() as opened:
            action()
        assert ("kinds=raw,restored,shear,traction" in opened.value.url) == on
        page.show(rig, X, Y, PRESSED)
        page.wait(f"document.getElementById('shear-key').hidden === {str(not on).lower()}")
        assert page.evaluate(f"{RESTORED_KEY}.hidden") != on
        assert all(inked(page.pixels(name)).any() == on for name in ("raw-shear", "restored-shear"))


def test_the_wall_has_arrows_on_the_same_socket_and_a_sensor_without_shear_has_none(request, open_page):
    with rigged(request.node.name, PALM) as rig, running(rig.service) as url:
        rig.stale_after(0.3)
        page = open_page(f"{url}/#/wall", ready=f"!!{TILE_KEY}")
        page.keep(lambda: rig.show(REST, REST), f"{TILE_KEY}.innerText === '50 counts'")
        page.keep(lambda: rig.show(X, Y), f"{TILE_KEY}.innerText === '1000 counts'")
        assert "tactiled_streams 1.0" in ask("GET", url + "/metrics").text.splitlines()
        canvases = (
            "[...document.querySelectorAll('.tile')].map(each => each.querySelectorAll('.frame canvas').length)"
        )
        assert page.evaluate(canvases) == [2, 1]
        page.evaluate("document.querySelectorAll('.tile .frame canvas')[1].id = 'tile-shear'")
        assert inked(page.pixels("tile-shear")).sum() > 100
        page.inspect()
        page.resize(320, 420)
        page.keep(lambda: rig.show(X, Y), "document.querySelector('.tile .warning').clientWidth >= 100")
        assert all(scale.evaluate(FITS) for scale in page.locator(".tile .scale").all())
        page.press("1")
        page.wait("!document.getElementById('shear-key').hidden")
        for key in ("v", "w"):
            with page.expect_websocket() as opened:
                page.press(key)
            assert "shear" not in opened.value.url
        with page.expect_websocket() as opened:
            page.press("2")
        assert "palm" in opened.value.url
        assert "shear" not in opened.value.url
        page.wait(NO_CHOICE)
        assert not page.pixels("raw-shear").any()
        page.press("v")
        assert not page.locator("#shear-on").is_checked()
        page.finish()
