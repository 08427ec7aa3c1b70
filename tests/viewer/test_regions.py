"""Regions drawn on the maps, their values, thresholds and series, and the series of contacts."""

import numpy as np
import pytest

from tactiled.live.region_monitor import MIN_GAP_S
from tests.conftest import ask, pressed, until
from tests.viewer.conftest import PHONE, TOUCH, WATCH_TEXTS

# Pixels of the chart that have the first line's colour: how many, and how far right the last is.
PIXELS = """(canvas => {
  const [r, g, b] = [0x00, 0x72, 0xb2];
  const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
  let count = 0, end = 0;
  for (let i = 0; i < data.length; i += 4) {
    const off = Math.abs(data[i] - r) + Math.abs(data[i + 1] - g) + Math.abs(data[i + 2] - b);
    if (data[i + 3] <= 200 || off >= 20) continue;
    count += 1;
    end = Math.max(end, i / 4 % canvas.width);
  }
  return [count, end];
})(document.getElementById("plot-chart"))"""
INK, END = f"{PIXELS}[0]", f"{PIXELS}[1]"


DRAWN = "window.drawn"


def drag(page, box, start, end):
    page.mouse.move(box["x"] + start[0] * box["width"], box["y"] + start[1] * box["height"])
    page.mouse.down()
    page.mouse.move(box["x"] + end[0] * box["width"], box["y"] + end[1] * box["height"], steps=3)
    page.mouse.up()


def test_a_region_is_drawn_named_measured_and_deleted(rig, url, open_page):
    rig.show(pressed(3, force=3000))
    page = open_page(url)
    box = page.box("#restored-frame")
    page.get_by_role("button", name="Ellipse").click()
    drag(page, box, (0.25, 0.25), (0.75, 0.75))
    page.get_by_label("Name").fill("heel")
    assert not page.locator("#notice").is_visible()  # how to draw is of no use now
    page.locator("#region-limit").select_option("peak")
    page.wait("/^Now it is [0-9.]+ kPa[.]$/.test(document.getElementById('region-now').innerText)")
    page.locator("#region-above").fill("5")
    assert page.get_by_role("button", name="Cancel").is_visible()
    page.get_by_role("button", name="Save").click()
    page.wait("document.querySelectorAll('#regions tbody tr').length === 1")
    assert page.text("notice")[0].startswith("Drag")  # and no fault came after it
    (region,) = ask("GET", f"{url}/api/v1/sensors/palm/regions").json()["regions"]
    assert (region["name"], region["shape"]) == ("heel", "ellipse")
    assert region["threshold"] == {"quantity": "peak", "above": 5.0, "below": 4.5}
    pitch, side = rig.sensor.array.pitch, rig.sensor.array.shape[0]
    corners = np.array(region["points_mm"])
    expected = (np.array([0.25, 0.75]) * side - 0.5) * pitch
    assert corners == pytest.approx(np.column_stack([expected, expected]), abs=0.1)
    page.get_by_role("button", name="Polygon").click()
    for x, y in ((0.1, 0.1), (0.5, 0.1), (0.1, 0.5)):
        page.mouse.click(box["x"] + x * box["width"], box["y"] + y * box["height"])
    page.press("Enter")
    page.get_by_label("Name").fill("toe")
    page.get_by_role("button", name="Save").click()
    page.wait("document.querySelectorAll('#regions tbody tr').length === 2")
    page.keep(lambda: rig.show(pressed(3, force=3000)), "document.querySelector('#regions tr.some')")  # over 5 kPa
    told = "document.getElementById('notice').innerText.includes('palm: peak in region heel is above 5 kPa')"
    page.keep(lambda: rig.show(pressed(3, force=3000)), told)
    page.keep(lambda: rig.show(pressed(3, force=0)), "!document.querySelector('#regions tr.some')")
    # What it said holds no more.
    page.keep(lambda: rig.show(pressed(3, force=0)), "!document.getElementById('notice').getClientRects().length")
    page.keep(lambda: rig.show(pressed(3, force=3000)), "document.querySelector('#regions tr.some')")
    assert not page.locator("#notice").is_visible()  # it has just been said
    page.locator("#pause").click()  # a frame that is above it stays so, whatever comes
    rig.show(pressed(3, force=0))
    looked_at = f"{url}/api/v1/sensors/palm/regions"
    until(lambda: not ask("GET", looked_at).json()["regions"][0]["exceeded"])
    for _ in range(3):
        page.wait_for_event("response", lambda response: response.url == looked_at)
    assert page.locator("#regions tr.some").count() == 1
    page.locator("#pause").click()
    page.keep(lambda: rig.show(pressed(3, force=3000)), "document.querySelector('#regions tr.some')")
    page.get_by_role("button", name="heel").click()
    page.wait("document.getElementById('region-peak').textContent.endsWith('kPa')")
    link = page.locator("#region-csv").get_attribute("href")
    assert ask("GET", url + link).text.startswith(
        "# sensor: palm\n# region: heel\n# time_s: Unix time\ntime_s,force_N"
    )
    for size in ({"width": 1280, "height": 860}, PHONE):
        page.resize(**size)
        assert page.violations() == []
    for name in ("Delete", "Really delete"):
        page.get_by_role("button", name=name, exact=True).click()
    page.wait("document.querySelectorAll('#regions tbody tr').length === 1")
    page.get_by_role("button", name="Rectangle").click()
    active = "[...document.querySelectorAll('.draw [aria-pressed=true]')].map(each => each.id).join()"
    assert page.evaluate(active) == "region-rectangle"
    page.press("Escape")
    assert page.evaluate(active) == ""
    page.resize(1280, 860)
    page.evaluate(WATCH_TEXTS)
    page.show(rig, pressed(3, force=2900))
    label = page.wait(f"{DRAWN}.findLast(each => each.id === 'raw-marks')?.box")
    side, edge = page.box("#raw-frame")["width"], rig.sensor.array.shape[0]  # CSS px, mm
    under = (label[1] - 2) / side * edge - 0.5  # where a region ends whose name stands in the contact's label
    left = label[0] / side * edge - 0.5
    row = {"shape": "rectangle", "points_mm": [[left, under - 1], [left + 2, under]]}
    ask("PUT", f"{url}/api/v1/sensors/palm/regions/row", json=row)
    name = page.wait(f"{DRAWN}.find(each => each.text === 'row')?.box")
    layers = page.evaluate(f"{DRAWN}.filter(each => each.text === 'row').map(each => each.layer)")
    page.evaluate("window.drawn = []")
    page.show(rig, pressed(3, force=2800))
    label = page.wait(f"{DRAWN}.findLast(each => each.id === 'raw-marks')?.box")
    of_maps = [each for n, each in enumerate(layers) if n % 3 < 2]  # the difference has no shear below its names
    assert min(of_maps) > page.evaluate(
        f"{DRAWN}.findLast(each => each.id === 'raw-marks').layer"
    )  # names lie over the outlines of contacts
    assert label[2] <= name[0] or name[2] <= label[0] or label[3] <= name[1] or name[3] <= label[1]
    drag(page, box, (0.1, 0.1), (0.4, 0.4))  # draws nothing any more
    assert not page.locator("#region").is_visible()
    page.get_by_role("button", name="Rectangle").click()
    page.mouse.click(box["x"] + 4.3 / 8 * box["width"], box["y"] + 2.4 / 8 * box["height"])
    page.get_by_role("button", name="Save").click()
    page.get_by_role("button", name="cell r2 c4").wait_for()


def test_a_region_is_drawn_and_saved_by_keys_and_the_dialog_says_what_it_lacks(rig, url, open_page):
    rig.show(pressed(3, force=3000))
    page = open_page(url)
    page.press("p")
    for key in ("Alt+ArrowLeft", "Alt+ArrowUp"):
        page.press(key)
    page.locator("#region-rectangle").focus()
    page.press("Enter")
    page.press("Enter")  # the first corner
    for key in ("Alt+ArrowRight", "Alt+ArrowDown", "Alt+ArrowDown", "Enter"):
        page.press(key)
    page.locator("#region-title").get_by_text("New region: rectangle").wait_for()
    page.press("Enter")
    assert page.evaluate("document.getElementById('region-name').validity.valueMissing")
    page.get_by_label("Name").fill("-")
    page.press("Enter")
    page.get_by_text("Region not saved: region = '-': give 1 to 40 letters").wait_for()
    assert page.evaluate("document.querySelector('dialog #notice') !== null")  # else it lies behind the dialog
    page.get_by_label("Name").fill("heel")
    page.locator("#region-limit").select_option("force")
    page.locator("#region-above").fill("5")
    page.locator("#region-below").fill("9")
    page.press("Enter")
    assert "not above" in page.evaluate("document.getElementById('region-below').validationMessage")
    page.locator("#region-below").fill("")
    page.press("Enter")
    page.wait("!document.querySelector('dialog[open]')")
    (region,) = ask("GET", f"{url}/api/v1/sensors/palm/regions").json()["regions"]
    (left, top), (right, bottom) = region["points_mm"]
    assert (right - left, bottom - top) == pytest.approx((1, 2))
    assert region["threshold"] == {"quantity": "force", "above": 5.0, "below": 4.5}
    page.finish("status of 422")


def test_a_polygon_is_closed_by_touch_at_its_first_corner_or_by_a_button(rig, url, open_page):
    rig.show(pressed(3, force=3000))
    page = open_page(url, **TOUCH)
    side = page.box("#raw-frame")["width"]
    button, title = page.locator("#region-polygon"), page.locator("#region-title")
    for close in (lambda: page.tap("#raw-frame", position={"x": 18, "y": 2}), button.tap):
        assert button.inner_text() == "Polygon"
        button.tap()
        assert button.inner_text() == "Cancel"
        for x, y in ((0, 0), (0.5, 0), (0, 0.5)):
            page.tap("#raw-frame", position={"x": 3 + x * side, "y": 3 + y * side})
        page.wait("document.getElementById('region-polygon').innerText === 'Done'")
        assert not title.is_visible()
        close()
        title.get_by_text("New region: polygon").wait_for()
        page.get_by_label("Name").fill("toe")
        page.get_by_role("button", name="Save").tap()
        page.wait("!document.querySelector('dialog[open]')")
        (region,) = ask("GET", f"{url}/api/v1/sensors/palm/regions").json()["regions"]
        assert len(region["points_mm"]) == 3
        ask("DELETE", f"{url}/api/v1/sensors/palm/regions/toe").raise_for_status()
        page.wait("!document.querySelector('#regions tbody tr')")


def rows(page):
    """The lines of the series' CSV that hold values, and the others.

    A browser starts ten downloads a second at most, and drops the others without a word.
    """
    page.wait_for_timeout(150)
    with page.expect_download() as saved:
        page.locator("#plot-csv").press("Enter")  # a click may miss it: contacts that come or end move the panel
    lines = saved.value.path().read_text().splitlines()
    values = [line for line in lines if line[0].isdigit()]
    return values, [line for line in lines if line not in values]


def test_the_series_of_a_contact_is_drawn_beside_a_region_and_saved(rig, url, open_page):
    shape = {"shape": "rectangle", "points_mm": [[1.5, 1.5], [5.5, 5.5]]}
    ask("PUT", f"{url}/api/v1/sensors/palm/regions/heel", json=shape).raise_for_status()
    rig.stale_after(600)  # a contact of a stale sensor has no button
    rig.show(pressed(3, force=3000))
    page = open_page(url)
    page.keep(lambda: rig.show(pressed(3, force=3000)), "!!document.querySelector('#contact-list button:enabled')")
    page.evaluate(WATCH_TEXTS)
    page.locator("#contact-list tbody td").first.click()
    page.wait("window.drawn.some(each => each.text.startsWith('1: ') && each.color === '#56b4e9')")  # as its line
    page.wait("document.querySelector('#contact-list button').getAttribute('aria-pressed') === 'true'")
    page.wait("[...document.querySelectorAll('#plot-add option')].some(each => each.value === 'region heel')")
    page.get_by_label("Add a region or contact").select_option("region heel")
    assert page.locator("#plot-key").inner_text().split("\n") == ["contact 1 ✕", "heel ✕"]
    page.locator("#plot-quantity").select_option("mean")  # whose lines are apart
    page.get_by_role("button", name="Enlarge Series").click()
    for _ in range(2):  # to the last 4.4 s
        page.locator("#plot-chart").locator("..").get_by_role("button", name="Zoom in").click()
    page.keep(lambda: rig.show(pressed(3, force=3000)), f"{INK} > 5")
    page.keyboard.press("Space")  # a pause keeps what is drawn, however long it lasts, and its series end
    until_s = rig.sensor.hub.latest().time
    page.wait(f"{INK} > 5")
    drawn = page.evaluate("performance.now()")
    page.keep(lambda: rig.show(pressed(3, force=3000)), f"performance.now() > {drawn} + 6500")
    page.wait(f"{INK} > 5")  # not at every moment: a busy page may be drawing it anew
    assert max(float(line.split(",")[0]) for line in rows(page)[0]) < until_s + 1e-5
    page.press("l")
    page.wait_for_timeout(2e3 * MIN_GAP_S)  # a series leaves images out that follow at once
    image = rig.show(pressed(3, force=3000))
    until(lambda: float(rows(page)[0][-1].split(",")[0]) == pytest.approx(image.time, abs=1e-5))
    values, comments = rows(page)
    assert comments[-1] == "time_s,kind,name,force_N,mean_kPa,peak_kPa,area_mm2,x_mm,y_mm"
    assert {"# sensor: palm", "# calibration: configured"} <= set(comments)
    assert any(line.startswith("# warnings") for line in comments)
    assert {tuple(line.split(",")[1:3]) for line in values} == {("contact", "1"), ("region", "heel")}
    (contact,) = ask("GET", f"{url}/api/v1/sensors/palm/contacts").json()["contacts"]
    newest = [line.split(",") for line in values if ",contact," in line][-1]
    expected = [contact[key] for key in ("force", "peak", "area_mm2", "x_mm", "y_mm")]
    assert [float(newest[i]) for i in (3, 5, 6, 7, 8)] == pytest.approx(expected, rel=1e-4)
    for size in ({"width": 1280, "height": 860}, PHONE):
        page.resize(**size)
        assert page.violations() == []
    page.resize(1280, 860)
    page.locator("#plot-chart").locator("..").get_by_role("button", name="Show all").click()
    end = page.keep(lambda: rig.show(pressed(3, force=3000)), f"{INK} > 5 && {END}")
    page.route("**/regions/heel/series*", lambda _: None)  # while no answer comes, its line moves on with the time
    page.keep(lambda: rig.show(pressed(3, force=3000)), f"{END} < {end} - 60")
    page.get_by_role("button", name="Remove contact 1").click()
    assert "contact" not in page.locator("#plot-key").inner_text()
