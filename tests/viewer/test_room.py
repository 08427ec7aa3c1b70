"""What the page makes of its room, and what it shows of a sensor that is left or has nothing to show."""

import itertools
import re

import pytest

from tactiled.web.server import running
from tests.conftest import meanwhile, pressed
from tests.skin import X, Y, rigged
from tests.viewer.conftest import PHONE, THUMB, Pair, turned, wait
from tests.viewer.test_viewer import PAINTINGS, painted

FINGERS = "".join(
    THUMB.replace("thumb", name).replace("array_id = 1", f"array_id = {number}")
    for number, name in enumerate(("thumb", "index", "middle", "ring"), 1)
)
ROOM = "({ scrollWidth, clientWidth }) => scrollWidth <= clientWidth"
WHOLE = f"({ROOM})(document.getElementById('probe'))"
DESK = {"width": 1280, "height": 860}


@pytest.fixture
def hand(request):
    """A palm that is pressed and four fingers of which nothing has come."""
    with meanwhile(Pair(re.sub(r"\W", "-", request.node.name), FINGERS)) as made, running(made.service) as url:
        made.show(pressed())
        yield made, url


def box(page, name):
    return page.locator(name).bounding_box()


def test_the_contacts_of_a_sensor_that_is_left_are_not_shown_for_another(hand, open_page):
    page = open_page(hand[1])
    rows = page.locator("#contact-list tbody tr:visible")
    rows.first.wait_for()
    page.keyboard.press("2")
    page.get_by_text("no frame yet on can0").first.wait_for()
    page.wait_for_timeout(500)  # more than two updates of the words
    assert rows.count() == 0


def test_the_tab_of_the_sensor_that_is_shown_can_be_seen_whole(hand, open_page):
    page = open_page(hand[1], **PHONE)
    for key, name in (("5", "ring"), ("1", "palm"), ("4", "middle")):
        page.keyboard.press(key)
        tab = page.get_by_role("tab", name=name, selected=True)
        tab.wait_for()
        left = tab.bounding_box()["x"]
        assert left >= 0
        assert left + tab.bounding_box()["width"] <= PHONE["width"]
    assert page.evaluate("scrollY") == 0


@pytest.mark.parametrize("size", [DESK, PHONE], ids=["desk", "phone"])
def test_the_wall_fills_the_window_and_no_more(hand, open_page, size):
    page = open_page(hand[1], **size)
    page.keyboard.press("w")
    wait(page, "[...document.querySelectorAll('.tile .force')].filter(each => each.innerText).length === 5")
    wait(page, "document.documentElement.scrollHeight <= innerHeight")
    last, legend = page.locator(".tile").last.bounding_box(), box(page, "#wall-legend")
    assert last["y"] + last["height"] < legend["y"]
    assert legend["y"] + legend["height"] <= size["height"]
    assert legend["y"] + legend["height"] > 0.9 * size["height"]
    tools = box(page, ".tools")
    assert size["width"] - tools["x"] - tools["width"] < 20


def test_a_sensor_of_another_shape_leaves_no_room_empty_and_takes_none_from_the_next(pair, open_page):
    page = open_page(pair[1], **DESK)
    square = box(page, "#raw-frame")
    page.keyboard.press("2")
    wait(page, f"document.getElementById('raw-frame').clientHeight < {square['height'] - 20}")
    turned(page, 10)
    under, charts = box(page, "#under"), box(page, "#charts")
    wide = box(page, "#raw-frame")
    assert under["y"] - wide["y"] - wide["height"] < 30
    assert charts["y"] + charts["height"] == pytest.approx(DESK["height"] - 12, abs=2)
    page.keyboard.press("1")
    wait(page, f"document.getElementById('raw-frame').clientHeight === {square['height']}")
    assert box(page, "#raw-frame") == square


@pytest.mark.parametrize("size", [{"width": 900, "height": 640}, {"width": 1024, "height": 768}, DESK])
def test_nothing_covers_anything_else(pair, open_page, size):
    page = open_page(pair[1], **size)
    for key in ("2", "1"):
        before = painted(page)
        page.keyboard.press(key)
        wait(page, f"{PAINTINGS} > {before}")
        turned(page, 10)
        parts = [box(page, each) for each in ("#raw-frame", "#probe", "#range", "#playback", "#charts")]
        for above, below in itertools.pairwise(parts):
            beside = above["x"] + above["width"] <= below["x"]
            assert beside or above["y"] + above["height"] <= below["y"], (above, below)
        assert parts[-1]["y"] + parts[-1]["height"] <= size["height"]


def test_what_the_probe_reads_is_not_cut_off(rig, url, open_page):
    rig.show(pressed(force=3000))
    for width in (1280, 1366, 1440, 1920):
        page = open_page(url, width)
        at = box(page, "#raw-frame")
        page.mouse.move(at["x"] + 0.55 * at["width"], at["y"] + 0.5 * at["height"])
        page.get_by_text(re.compile(r"restored [\d.]+ kPa \(taxel \d, \d\)")).wait_for()
        assert page.evaluate(WHOLE)


@pytest.mark.parametrize("width", [900, 1280, 1440, 1600])
def test_what_the_probe_reads_of_shear_is_not_cut_off(request, open_page, width):
    with rigged(request.node.name) as rig, running(rig.service) as url:
        rig.stale_after(0.3)
        rig.show(X, Y)
        page = open_page(url, width)
        at = box(page, "#raw-frame")
        page.mouse.move(at["x"] + 0.05 * at["width"], at["y"] + 0.1 * at["height"])
        page.get_by_text(re.compile(r"shear 100, 1 counts \(taxel 0, 0\)")).wait_for()
        assert page.evaluate(WHOLE)
        page.close()  # which else misses the service


def test_numbers_of_the_past_are_set_in_italics(rig, url, open_page):
    rig.show(pressed())
    page = open_page(url)
    page.locator("#contact-list tbody tr:visible").first.wait_for()
    page.locator('[data-level="stale"]').wait_for()
    for each in ("#force-restored", "#contact-list tbody td", "#contact-list tbody th"):
        assert page.locator(each).first.evaluate("each => getComputedStyle(each).fontStyle") == "italic"


@pytest.mark.parametrize("size", [(1024, 768), (768, 1024), (960, 540), (1161, 800), (1241, 800)])
def test_where_the_cross_section_lies_is_not_cut_off(rig, url, open_page, size):
    rig.show(pressed())
    page = open_page(url, *size)
    page.locator("#raw-frame").click()
    page.locator("#section-where", has_text="pinned").wait_for()
    for title in page.locator("#charts h2").all():
        assert title.evaluate(ROOM)


@pytest.mark.parametrize(("rows", "columns", "stacked"), [(3, 5, False), (4, 16, True)])
def test_the_maps_stand_as_they_are_larger(request, open_page, rows, columns, stacked):
    array = f"array = {{ rows = {rows}, columns = {columns}, pitch_mm = 7, aperture_mm = 5 }}"
    sensor = re.sub("array = .*", array, THUMB)
    name = re.sub(r"\W", "-", request.node.name)
    with meanwhile(Pair(name, sensor)) as made, running(made.service) as url:
        made.show(pressed())
        page = open_page(url, 1440, 900)
        page.keyboard.press("2")
        wait(page, f"document.getElementById('raw-frame').clientWidth > {480 if not stacked else 600}")
        raw, restored = box(page, "#raw-frame"), box(page, "#restored-frame")
        assert (raw["y"] < restored["y"]) == stacked
        assert (raw["x"] < restored["x"]) != stacked
        assert box(page, "#charts")["y"] + box(page, "#charts")["height"] <= 900
        page.close()  # which else misses the service


def test_what_stands_above_the_maps_is_not_cut_off_on_a_small_phone(request, open_page):
    with rigged(request.node.name) as rig, running(rig.service) as url:
        rig.show(X, Y)
        page = open_page(url, **{**PHONE, "width": 320, "height": 640})
        page.locator("#shear-key", has_text="counts").wait_for()
        for caption in page.locator("#boxes figcaption").all():
            assert caption.evaluate(ROOM)
        page.close()  # which else misses the service


HELD = """async () => {
  const { Warnings } = await import("/static/warnings.js");
  const real = performance.now, held = new Warnings();
  const at = (ms, ...told) => ((performance.now = () => ms), held.hold(told));
  const dead = (text) => ({ code: "dead", text, taxels: null });
  const said = [at(0, dead("2 taxels dead")), at(1000, dead("1 taxel dead")), at(3900), at(4001)];
  performance.now = real;
  return said;
}"""


def test_a_warning_stays_for_a_while_after_it_was_last_told(rig, url, open_page):
    rig.show(pressed())
    page = open_page(url)
    assert page.evaluate(HELD) == [["2 taxels dead"], ["1 taxel dead"], ["1 taxel dead"], []]
