"""The page shows the present: a range that does not flicker, a tab that stood still, themes, files."""

import csv
import threading

import numpy as np
import pytest

from tactiled.web import answers
from tests.conftest import BUSY_S, pressed
from tests.viewer.conftest import turned, wait
from tests.viewer.test_viewer import pixels, show

FOLLOW = """async peaks => {
  const { DisplayRange } = await import("/static/display_range.js");
  const scale = new DisplayRange();
  return peaks.map((peak, i) => { scale.follow(peak, 0.5, i / 50); return scale.high; });
}"""


def test_the_automatic_range_holds_every_peak_and_does_not_flicker(rig, url, open_page):
    rig.show(pressed())
    page = open_page(url)
    rng = np.random.default_rng(1)
    steady = 100 * (1 + 0.1 * rng.normal(size=1500)).clip(0.7, 1.3)  # half a minute about one peak
    highs = np.array(page.evaluate(FOLLOW, steady.tolist()))
    assert (highs >= steady).all()
    assert np.count_nonzero(np.diff(highs[50:])) <= 1
    rising = np.array(page.evaluate(FOLLOW, np.linspace(1, 1000, 500).tolist()))
    assert (np.diff(rising) >= 0).all()
    gone = page.evaluate(FOLLOW, [1000.0] * 10 + [10.0] * 1500)
    assert gone[9] == 1000
    assert 10 <= gone[-1] <= 15


def test_a_fixed_range_holds_whatever_comes(rig, url, open_page):
    rig.show(pressed())
    page = open_page(url)
    page.locator("#range-high").fill("50")
    page.keyboard.press("Enter")
    show(rig, page, pressed(1))
    assert not page.locator("#range-auto").is_checked()
    label = page.locator('#colorbar[aria-label$="50 kPa"]')
    label.wait_for()
    show(rig, page, pressed(2, force=2000))
    label.wait_for()
    page.locator("#range-high").fill("-1")
    page.keyboard.press("Enter")
    show(rig, page, pressed(1))
    label.wait_for()


STAND = """setTimeout(() => {
  const question = new XMLHttpRequest();
  question.open("GET", "/api/v1/sensors/palm/calibration", false);
  question.send();
}, 0)"""


def test_a_tab_that_stood_still_goes_on_with_the_newest_frame(rig, url, open_page, monkeypatch):
    rig.show(pressed())
    page = open_page(url)
    frames = []
    session = page.context.new_cdp_session(page)
    session.send("Network.enable")
    session.on("Network.webSocketFrameReceived", lambda seen: frames.append(seen["response"]["opcode"]))
    show(rig, page, pressed(1))
    calibration, standing, go_on = answers.calibration, threading.Event(), threading.Event()

    def in_the_end(sensor):
        standing.set()
        assert go_on.wait(BUSY_S)
        return calibration(sensor)

    monkeypatch.setattr(answers, "calibration", in_the_end)
    page.evaluate(STAND)
    assert standing.wait(BUSY_S)
    before = len([code for code in frames if code == 2])
    for at in range(40):
        rig.show(pressed(at % 6))
    image = rig.show(pressed(5))
    go_on.set()
    wait(page, f"document.getElementById('sequence').innerText === '{image.sequence}'")
    got = len([code for code in frames if code == 2]) - before
    turned(page)
    assert got <= 2 * 2 + 2  # two pairs that were on their way, and the newest; not the forty between
    assert pixels(page, "raw")[3, 5, :3].sum() > pixels(page, "raw")[3, 0, :3].sum()


def test_stepping_back_shows_what_was_shown(rig, url, open_page):
    rig.show(pressed(0))
    page = open_page(url)
    page.locator("#range-high").fill("500")  # the range forgets in time
    page.locator("#maps").focus()
    seen = []
    for at in (1, 3, 5):
        show(rig, page, pressed(at))
        seen.append(pixels(page, "restored"))
    for back in (1, 0):
        page.keyboard.press("ArrowLeft")
        turned(page)
        np.testing.assert_array_equal(pixels(page, "restored"), seen[back])
    page.keyboard.press("ArrowRight")
    turned(page)
    np.testing.assert_array_equal(pixels(page, "restored"), seen[1])
    page.keyboard.press("l")
    wait(page, "document.getElementById('when').innerText !== 'newest'")


def test_a_frame_is_saved_as_numbers_and_as_a_picture(rig, url, open_page):
    image = rig.show(pressed(2))
    page = open_page(url)
    with page.expect_download() as download:
        page.keyboard.press("c")
    lines = download.value.path().read_text().splitlines()
    rows = list(csv.DictReader(line for line in lines if not line.startswith("#")))
    for kind, values in (("raw", image.raw), ("restored", image.restored)):
        mine = [row for row in rows if row["image"] == kind]
        np.testing.assert_allclose([float(row["kpa"]) for row in mine], values.ravel(), atol=1e-4)
        assert [float(row["x_mm"]) for row in mine[:8]] == list(range(8))
    with page.expect_download() as download:
        page.keyboard.press("s")
    assert download.value.path().read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_the_theme_is_the_systems_until_another_is_chosen(rig, url, open_page, scheme):
    rig.show(pressed())
    page = open_page(url, color_scheme=scheme)
    ground = "getComputedStyle(document.body).backgroundColor"
    colors = {"light": "rgb(238, 241, 244)", "dark": "rgb(14, 18, 22)"}
    assert page.evaluate(ground) == colors[scheme]
    page.keyboard.press("d")
    assert page.evaluate(ground) == colors["light"]
    page.keyboard.press("d")
    assert page.evaluate(ground) == colors["dark"]
    page.reload()
    wait(page, f"{ground} === '{colors['dark']}'")


def test_a_tare_from_the_page_takes_the_load_away(rig, url, open_page):
    rig.stale_after(600)
    rig.show(pressed(2))
    page = open_page(url)
    page.keyboard.press("t")
    ask = page.get_by_role("dialog", name="The array is loaded")
    ask.get_by_text("palm: contact of 200 kPa on 4 taxels.").wait_for()
    ask.get_by_role("button", name="Tare anyway").click()
    page.locator("#notice", has_text="Tare").wait_for()
    for _ in range(20):
        rig.show(pressed(2))
    image = show(rig, page, pressed(2))
    assert abs(image.raw).max() < 1
    wait(page, "parseFloat(document.getElementById('peak-raw').innerText) < 1")
    page.faults.clear()  # the browser itself reports every refusal


@pytest.mark.parametrize("key", ["Enter", "Escape"])
def test_a_tare_under_load_that_is_cancelled_takes_nothing(rig, url, open_page, key):
    rig.stale_after(600)
    rig.show(pressed(2))
    page = open_page(url)
    page.keyboard.press("t")
    page.get_by_role("dialog", name="The array is loaded").wait_for()
    assert page.evaluate("document.activeElement.innerText") == "Cancel"
    page.keyboard.press(key)
    wait(page, "!document.querySelector('dialog[open]')")
    for _ in range(20):
        image = rig.show(pressed(2))
    assert (rig.sensor.pipeline.tared, abs(image.raw).max()) == (0, 200)
    assert page.locator("#notice").is_hidden()
    page.faults.clear()  # the browser itself reports every refusal


def test_a_tare_of_an_unloaded_array_asks_nothing(rig, url, open_page):
    rig.stale_after(600)
    rig.show(pressed(force=0) + 60)
    page = open_page(url)
    page.keyboard.press("t")
    page.locator("#notice", has_text="Tare: the next frames").wait_for()
    image = [rig.show(pressed(force=0) + 60) for _ in range(20)][-1]
    assert abs(image.raw).max() == 0


def test_it_keeps_its_maps_still_where_nothing_changes_their_size(rig, url, open_page):
    rig.show(pressed())
    page = open_page(url, 1280, 860)
    page.locator("#banner").wait_for()
    page.evaluate(
        """() => {
          window.widths = new Set();
          const frame = document.getElementById("raw-frame");
          new ResizeObserver(() => window.widths.add(frame.style.width)).observe(frame);
        }"""
    )
    box = page.locator("#raw-frame").bounding_box()
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    page.locator("#probe", has_text="taxel 4, 4").wait_for()
    page.mouse.move(5, 5)
    page.locator("#probe", has_text="Point at a map").wait_for()
    assert page.evaluate("window.widths.size") == 1
