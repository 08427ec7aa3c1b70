"""Regions drawn on the maps, their values, thresholds and series."""

import numpy as np
import pytest

from tests.conftest import ask, pressed
from tests.viewer.conftest import PHONE


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
    page.get_by_label("Report when it exceeds").select_option("peak")
    page.get_by_label("above").fill("5")
    page.get_by_label("until below").fill("4")
    page.get_by_role("button", name="Save").click()
    page.wait("document.querySelectorAll('#regions tbody tr').length === 1")
    assert page.text("notice")[0].startswith("Drag")  # and no fault came after it
    (region,) = ask("GET", f"{url}/api/v1/sensors/palm/regions").json()["regions"]
    assert (region["name"], region["shape"]) == ("heel", "ellipse")
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
    page.get_by_role("button", name="heel").click()
    page.wait("document.getElementById('region-peak').textContent.endsWith('kPa')")
    link = page.locator("#region-csv").get_attribute("href")
    assert ask("GET", url + link).text.startswith("time_s,force_N")
    for size in ({"width": 1280, "height": 860}, PHONE):
        page.resize(**size)
        assert page.violations() == []
    page.get_by_role("button", name="Delete").click()
    page.wait("document.querySelectorAll('#regions tbody tr').length === 1")
    page.get_by_role("button", name="Rectangle").click()
    page.press("Escape")
    page.resize(1280, 860)
    drag(page, box, (0.1, 0.1), (0.4, 0.4))  # draws nothing any more
    assert not page.locator("#region").is_visible()
