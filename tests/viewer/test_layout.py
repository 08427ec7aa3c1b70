"""What the page makes of its window and of arrays of every shape, and the picture that a frame is saved as."""

import itertools
import re

import numpy as np
import pytest

from tests.conftest import pressed
from tests.viewer.conftest import CONTACTS, FITS, PAINTINGS, PHONE, SCROLL_WIDTH, THUMB, WATCH_TEXTS, one_more

DESK = {"width": 1280, "height": 860}
NAME = "a_long_name_of_a_fingertip"
SHAPES = [(1, 40), (40, 2), (12, 6), (9, 9), (2, 2)]
ODD = "".join(
    one_more(f"{NAME}_{number}", number, f"rows = {rows}, columns = {columns}, pitch_mm = 1.0")
    for number, (rows, columns) in enumerate(SHAPES, 1)
)
LABELS = {1: ("1: ", 0.5), 2: ("1", 0.3), 5: ("1: ", 0.2)}  # of a contact on raw, and where, of the map's height


def choose(page, key):
    """Watch another sensor and wait until its newest frame is painted and laid out."""
    before = page.painted()
    page.keyboard.press(str(key))
    page.wait(f"{PAINTINGS} > {before}")
    page.refreshed(4)


def test_on_arrays_of_every_shape_all_texts_have_room_on_the_maps_and_in_the_picture(serve, open_page):
    rig, url = serve(ODD)
    rig.show(pressed())
    for number, (rows, columns) in enumerate(SHAPES, 1):
        row, column = np.mgrid[:rows, :columns]
        counts = 100 + 800 * np.exp(-((column - columns / 3) ** 2 + (row - rows / 3) ** 2) / 6)
        rig.send_to(f"{NAME}_{number}", counts)
    page = open_page(url)
    page.evaluate(WATCH_TEXTS)
    for number in range(1, len(SHAPES) + 1):
        page.evaluate("window.drawn = []")
        choose(page, number + 1)
        if number in LABELS:
            words, y = LABELS[number]
            label = page.wait("window.drawn.find(each => each.id === 'raw-marks')")
            assert label["text"].startswith(words)
            assert abs(label["y"] / label["height"] - y) < 0.25
        page.wait("document.body.dataset.level === 'stale'")
        for each in page.evaluate("window.drawn.filter(each => !each.id && !each.saved)"):  # of the axes
            assert each["box"][2] <= each["width"] + 1, each
        page.evaluate("window.drawn = []")
        assert page.download("s").read_bytes().startswith(b"\x89PNG")
        texts = page.evaluate("window.drawn.filter(each => each.saved && each.height > 300)")
        assert texts[0]["text"] == f"{NAME}_{number}, frame 0"
        assert re.search(r"Z, stale, method \w+, unit kPa", " ".join(each["text"] for each in texts))
        assert {"Raw", "Restored", "kPa", "0"} <= {each["text"] for each in texts}
        for each in texts:
            x, y, to_x, to_y = each["box"]
            assert 0 <= x < to_x <= each["width"], each
            assert 0 <= y < to_y <= each["height"], each
        for one, other in itertools.combinations(texts, 2):
            (x, y, to_x, to_y), (x2, y2, to_x2, to_y2) = one["box"], other["box"]
            apart = to_x <= x2 or to_x2 <= x or to_y <= y2 or to_y2 <= y
            assert apart, (one, other)


def test_nothing_is_cut_off_or_covered_at_any_size_and_a_layout_that_is_no_grid_is_true_to_scale(pair, open_page):
    rig, url = pair
    page = open_page(url, **DESK)
    square = page.box("#raw-frame")
    for size in ({"width": 900, "height": 640}, {"width": 1024, "height": 768}, DESK):
        page.set_viewport_size(size)
        for key in (2, 1):
            choose(page, key)
            parts = [page.box(each) for each in ("#raw-frame", "#probe", "#range", "#playback")]
            for above, below in itertools.pairwise(parts):
                beside = above["x"] + above["width"] <= below["x"]
                assert beside or above["y"] + above["height"] <= below["y"], (above, below)
            assert parts[-1]["y"] + parts[-1]["height"] <= size["height"]
    choose(page, 2)  # lower than the square: it leaves no room empty
    frame, under, playback, side = (page.box(each) for each in ("#raw-frame", "#under", "#playback", "#side"))
    assert frame["height"] < square["height"] - 20
    assert under["y"] - frame["y"] - frame["height"] < 20 + 30  # its axis and a gap
    assert side["y"] - playback["y"] - playback["height"] == pytest.approx(12, abs=2)
    ink, cells = page.pixels("raw")[..., 3] > 128, rig.service.sensor("thumb").cells
    (rows, columns), corner = cells.shape, cells.corner - cells.side / 2
    zoom = ink.shape[1] / (columns * cells.side)
    assert zoom == pytest.approx(ink.shape[0] / (rows * cells.side), rel=0.01)
    places = np.moveaxis(np.indices(ink.shape)[::-1], 0, -1) / zoom + corner
    distance = np.min(
        [np.linalg.norm(places - at, axis=-1) for at in ((0, 0), (3, 0), (1.5, 2), (4.5, 2.5))], axis=0
    )
    assert ink[distance < 0.7].all()
    assert not ink[distance > 0.8].any()
    choose(page, 1)
    page.wait(f"document.getElementById('raw-frame').clientHeight === {square['height']}")
    assert page.box("#raw-frame") == square
    rig.show(pressed(force=3000))
    for width in (1280, 1366, 1440, 1920):
        page.resize(width, 860)
        at = page.box("#raw-frame")
        page.mouse.move(at["x"] + 0.55 * at["width"], at["y"] + 0.5 * at["height"])
        page.get_by_text(re.compile(r"restored [\d.]+ kPa \(taxel r\d c\d\)")).wait_for()
        assert page.locator("#probe").evaluate(FITS)
    page.locator("#raw-frame").click()
    page.locator("#section-where", has_text="pinned").wait_for()
    sizes = ((1024, 768), (768, 1024), (960, 540), (1161, 800), (1241, 800), (1440, 900), (390, 844))
    for width, height in sizes:
        page.resize(width, height)
        for title in page.locator(".chart h2").all():
            assert title.evaluate(FITS)
        if width == 1440:
            assert min(page.box(each)["width"] for each in ("#raw", "#restored")) >= 560
        assert page.evaluate(SCROLL_WIDTH) <= width
        for name in ("#raw", "#restored"):
            canvas = page.box(name)
            assert canvas["x"] >= 0
            assert canvas["x"] + canvas["width"] <= width
            assert canvas["width"] >= 120


def test_panels_are_folded_enlarged_and_put_beside_the_maps_and_a_browser_keeps_that(rig, url, open_page):
    rig.show(pressed())
    page = open_page(url, **DESK)
    below = page.box("#raw-frame")["width"]
    page.get_by_role("button", name="Fold Regions").click()
    page.get_by_role("button", name="Enlarge Total force").click()
    page.refreshed()
    page.get_by_role("button", name="Zoom out").click()
    page.locator("#force-span", has_text="last 15 s").wait_for()
    page.locator("#forces").hover()
    page.mouse.wheel(0, -400)
    page.locator("#force-span", has_text="to").wait_for()  # a part that stays where it is
    page.mouse.dblclick(*(page.box("#forces")[each] + 100 for each in "xy"))
    page.locator("#force-span", has_text="last 10 s").wait_for()
    page.get_by_role("separator", name="Height of Cross-section").press("ArrowDown")
    tall = page.box("#section")["height"]
    assert page.box("#forces")["height"] > 400
    page.get_by_role("button", name="Panels: put them beside the maps").click()
    page.get_by_role("separator", name="Width of the panels").press("ArrowLeft")
    width = page.box("#side")["width"]
    for _ in range(2):
        page.refreshed(4)
        assert (page.box("#side")["width"], page.box("#section")["height"]) == (width, tall)
        frame, side = page.box("#restored-frame"), page.box("#side")
        assert frame["x"] + frame["width"] <= side["x"]
        assert frame["width"] < below
        assert side["y"] + side["height"] <= DESK["height"]
        assert not page.locator("#region-rectangle").is_visible()
        assert page.box("#forces")["height"] > 400
        page.reload()
        page.wait(f"{PAINTINGS} > 0")


FINGERS = "".join(
    THUMB.replace("thumb", name).replace("array_id = 1", f"array_id = {number}")
    for number, name in enumerate(("thumb", "index", "middle", "ring"), 1)
)
FLAT = "".join(
    one_more(name, number, f"rows = {rows}, columns = {columns}, pitch_mm = 7, aperture_mm = 5")
    for name, number, rows, columns in (("wide", 5, 3, 5), ("flat", 6, 4, 16))
)


BOXES = """["raw-frame", "restored-frame", "playback"].map(
  id => document.getElementById(id).getBoundingClientRect().toJSON()
)"""  # all at one time: a line of warnings may come and move them


def test_sensors_without_a_frame_show_nothing_of_another_and_maps_stand_as_they_are_larger(serve, open_page):
    rig, url = serve(FINGERS + FLAT)
    rig.show(pressed())
    page = open_page(url, 1440, 900)
    page.wait(f"{CONTACTS}.length")
    page.press("2")
    page.get_by_text("no frame yet on can0").first.wait_for()
    page.wait(f"{CONTACTS}.length === 0")
    for key, width, stacked in (("6", 450, False), ("7", 570, True)):
        page.press(key)
        page.wait(f"document.getElementById('raw-frame').clientWidth > {width}")
        page.wait(f"document.getElementById('boxes').classList.contains('stacked') === {str(stacked).lower()}")
        page.refreshed(4)
        raw, restored, last = page.evaluate(BOXES)
        assert (raw["y"] < restored["y"]) == stacked
        assert (raw["x"] < restored["x"]) != stacked
        assert last["y"] + last["height"] <= 900
    page.set_viewport_size(PHONE)
    for key, name in (("5", "ring"), ("1", "palm"), ("4", "middle")):
        page.press(key)
        tab = page.get_by_role("tab", name=name, selected=True)
        tab.wait_for()
        place = tab.bounding_box()
        assert place["x"] >= 0
        assert place["x"] + place["width"] <= PHONE["width"]
    assert page.evaluate("scrollY") == 0
