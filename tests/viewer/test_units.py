"""What the page says of an uncalibrated sensor is in counts, and in kPa and N as soon as it is calibrated."""

import re
from dataclasses import replace

import numpy as np

from tests.calibrate.files import calibration_file, gain_section
from tests.viewer.conftest import PHONE, THUMB, TILES, WATCH_TEXTS

COUNTED = THUMB.replace("kpa_per_count = 0.5, ", "")
CLAIM = re.compile(r"kPa|\bN\b")
LABELS = (
    "[...document.querySelectorAll('#main [aria-label], #main [title]')].map(e => e.ariaLabel + ' ' + e.title)"
)
PEAK = "document.getElementById('calibrate-peak').innerText"
LEGENDS = "[...document.querySelectorAll('#wall-legend .scale')].map(e => !e.hidden && e.innerText)"


def seen(page):
    """Every text of the page: of its elements, their labels, and what is drawn."""
    page.evaluate("window.drawn = []")
    size = page.viewport_size
    page.resize(size["width"] - 40, size["height"])
    page.resize(**size)
    on_canvases = page.evaluate("window.drawn.map(each => each.text)")
    return "\n".join([page.locator("#main").inner_text(), *page.evaluate(LABELS), *on_canvases])


def test_the_page_follows_the_unit_of_the_sensor(serve, open_page):
    rig, url = serve(COUNTED)
    thumb = rig.service.sensor("thumb")
    for sensor in (rig.sensor, thumb):
        sensor.plan = replace(sensor.plan, stale_after_s=600)
    _, image = rig.both()
    assert image.unit == "counts"
    page = open_page(f"{url}/#thumb?range=0:10000", **PHONE)
    page.evaluate(WATCH_TEXTS)
    page.keep(rig.both, "document.querySelectorAll('#contact-list tbody tr').length === 2")
    text = seen(page)
    assert CLAIM.findall(text) == []
    lines = text.splitlines()
    assert lines.count("counts") > 4  # headers, and both sizes of the section's axis
    assert lines.count("counts·mm²") > 2
    restored = round(float(np.nansum(image.restored)) * thumb.cells.side**2)
    assert {f"force counts·mm²\t14448\t{restored}", "peak counts\t800\t800"} <= set(lines)
    assert "Colour scale from 0 to 10000 counts" in text
    assert page.text("peak-raw", "noise") == ["800", "0.29 counts"]
    lines = page.download("c").read_text().splitlines()
    assert next(line for line in lines if line[0] != "#").split(",")[5] == "counts"
    ends = page.wait("window.drawn.filter(each => each.id === 'colorbar' && each.text === '10000')")
    assert ends[-1]["box"][2] <= ends[-1]["width"]
    page.press("1")
    page.wait("document.getElementById('about').innerText.startsWith('8')")
    page.keep(rig.both, "document.getElementById('peak-raw').innerText === '200'")
    assert {"kPa", "N"} <= set(CLAIM.findall(seen(page)))
    assert page.locator("#range-auto").is_checked()  # the range of the address is in counts
    page.press("w")
    page.locator("#wall-scale").select_option("same")
    page.keep(rig.both, f"{TILES}.every(each => /\\d (N|counts·mm²)/.test(each))")
    assert page.evaluate(LEGENDS) == ["kPa", "counts"]
    page.press("2")
    page.keep(rig.both, "Number(document.getElementById('scrub').max) > 2")
    page.press("k")
    page.wait(f"{PEAK} === 'peak 800 counts'")
    brightest = page.pixels("calibrate-raw").max(axis=(0, 1))
    file = calibration_file(sensor="thumb", taxels=4, gain=gain_section(np.full(4, 0.25)))
    with page.expect_request("**/sensors/thumb/kernel"):  # which the calibration may have changed
        rig.service.apply_calibration("thumb", file)
        rig.both()
    page.wait("document.getElementById('scrub').max === '0'")  # no frame in counts is left
    page.keep(rig.both, "document.getElementById('peak-raw').innerText === '200'")
    page.wait(f"{PEAK} === 'peak 200 kPa'")
    assert (page.pixels("calibrate-raw").max(axis=(0, 1)) >= brightest).all()
    assert page.locator("#readings-title + table .force-unit").inner_text() == "N"
