"""The cross-section, along x or along y: what it draws are the cells of that line, by the pixels."""

import re

import numpy as np
import pytest

from tactiled.web.server import running
from tests.conftest import NO_LOAD, ask, meanwhile
from tests.viewer.conftest import THUMB, Pair, one_more, turned, wait
from tests.viewer.test_viewer import pixels

SIDE, HEAD, FOOT, TAIL = 46, 20, 34, 12  # px that a chart keeps free
HIGH = 500  # kPa, the top of the range
LITTLE, DEEP = 0.06, 0.4  # of the range, that the axis reaches below it: the more where a line does
RESTORED = (11, 98, 168, 255)  # the light theme's; the band is the same, seen through
BLOCK = np.full((8, 8), NO_LOAD)
BLOCK[1:7, 2:5] += 400  # neither its rows nor its columns mirror the other
STRIP = one_more("strip", 2, "rows = 12, columns = 2, pitch_mm = 1.0")
WHERE = "document.getElementById('section-where').innerText"
SAID = "document.getElementById('section').getAttribute('aria-label')"


@pytest.fixture
def hand(request):
    """A square palm, a thumb of no grid, and a strip much taller than wide."""
    rig = Pair(re.sub(r"\W", "-", request.node.name), THUMB + STRIP)
    with meanwhile(rig), running(rig.service) as url:
        rig.both(BLOCK)
        yield rig, url


def strip(rig):
    sensor = rig.service.sensor("strip")
    counts = 100 + 40 * np.arange(24, dtype=np.uint16)
    for message in sensor.codec.encode(counts, rig.sequence % 256, 0.0):
        rig.bus.send(message)


def fixed_range(page):
    page.locator("#range-low").fill("0")
    page.locator("#range-high").fill(str(HIGH))
    page.locator("#maps").focus()
    turned(page)


def drawn(page, cells, below):
    """Pressure (kPa) of the restored line in the middle of each cell; NaN where it is not seen."""
    got = pixels(page, "section").astype(int)
    height, width = got.shape[0] - HEAD - FOOT, got.shape[1] - SIDE - TAIL
    bottom = -below * HIGH
    told = []
    for i in range(cells):
        column = got[HEAD : HEAD + height, SIDE + round((i + 0.5) / cells * width)]
        rows = np.flatnonzero((abs(column - RESTORED) < 5).all(axis=1))
        at = 1 - (rows.mean() + 0.5) / height if len(rows) else np.nan
        told.append(bottom + at * (HIGH - bottom))
    return np.array(told)


def line(page):
    """Where the line on the raw map is: of rows, of columns that are marked from end to end (px of the canvas)."""
    marked = pixels(page, "raw-marks")[..., 3] > 0
    return np.flatnonzero(marked.all(axis=1)), np.flatnonzero(marked.all(axis=0))


@pytest.mark.parametrize("way", ["key", "button"])
def test_it_runs_along_y_as_along_x_and_back(hand, open_page, way):
    rig, url = hand
    page = open_page(url)
    page.locator("#contacts-on").uncheck()
    fixed_range(page)
    image = rig.sensor.hub.latest()
    row, column = np.unravel_index(image.restored.argmax(), (8, 8))

    def turn():
        if way == "key":
            page.keyboard.press("x")
        else:
            page.get_by_role("button", name=re.compile("^Cross-section along")).click()
        turned(page)

    feet, shown = [], (("y", row, image.restored[row]), ("x", column, image.restored[:, column]))
    for across, at, values in shown * 2:
        wait(page, f"{WHERE} === '{across} {at:.1f} mm'")
        along = "x" if across == "y" else "y"
        assert page.evaluate(SAID).startswith(f"Pressure along {along}, ")
        assert page.locator("#section-turn").get_attribute("aria-label") == f"Cross-section along {along}. Change"
        np.testing.assert_allclose(drawn(page, 8, DEEP), values, atol=5)
        feet.append(pixels(page, "section")[-FOOT // 2 :])
        rows, columns = line(page)
        assert (len(rows) > 0, len(columns) > 0) == (along == "x", along == "y")
        middle = pixels(page, "raw-marks").shape[0] * (at + 0.5) / 8
        assert np.mean(rows if along == "x" else columns) == pytest.approx(middle, abs=2)
        turn()
    assert (feet[0] != feet[1]).any()  # the axis is named
    assert (feet[0] == feet[2]).all()


def test_its_band_is_of_the_same_cells(hand, open_page):
    rig, url = hand
    page = open_page(url)
    page.keyboard.press("x")
    restored = rig.sensor.hub.latest().restored
    deviation = np.array(ask("GET", f"{url}/api/v1/sensors/palm/frames/deviation").json()["values"])
    column = int(restored.argmax()) % 8
    value, spread = float(restored[1, column]), float(deviation[1, column])
    page.locator("#range-low").fill(f"{value - 5 * spread:.3f}")
    page.locator("#range-high").fill(f"{value + 5 * spread:.3f}")
    page.locator("#maps").focus()

    def off():
        """How much taller than two deviations to either side the band is in the second cell, px."""
        got = pixels(page, "section").astype(int)
        at = SIDE + round((1 + 0.5 - 0.3) / 8 * (got.shape[1] - SIDE - TAIL))  # inside the cell, off its middle
        blue = got[HEAD : got.shape[0] - FOOT, at]
        blue = blue[:, 2] > blue[:, 0] + 40
        return blue.sum() - 4 * spread / (1.4 * 10 * spread) * len(blue)

    for _ in range(100):
        rig.show(BLOCK)
        page.wait_for_timeout(50)
        if abs(off()) <= 2:
            return
    assert abs(off()) <= 2


def test_it_goes_through_a_pinned_probe_and_follows_it(hand, open_page):
    page = open_page(hand[1])
    page.keyboard.press("x")
    page.keyboard.press("p")
    wait(page, f"{WHERE}.endsWith(', pinned')")
    before = float(page.evaluate(WHERE).split()[1])
    page.keyboard.press("Alt+ArrowRight")
    wait(page, f"{WHERE} === 'x {before + 1:.1f} mm, pinned'")
    page.keyboard.press("Alt+ArrowDown")
    turned(page)
    assert page.evaluate(WHERE) == f"x {before + 1:.1f} mm, pinned"
    x = before + 1.5  # from the left edge
    assert np.mean(line(page)[1]) == pytest.approx(pixels(page, "raw-marks").shape[1] * x / 8, abs=2)


def test_of_an_array_much_taller_than_wide_it_runs_along_y_at_first(hand, open_page):
    rig, url = hand
    strip(rig)
    page = open_page(f"{url}/#strip")
    wait(page, f"{WHERE} === 'x 1.0 mm'")
    fixed_range(page)
    turned(page)
    np.testing.assert_allclose(drawn(page, 12, LITTLE), 20 * (1 + 2 * np.arange(12)), atol=8)
    page.keyboard.press("x")
    wait(page, f"{WHERE} === 'y 11.0 mm'")
    turned(page)
    np.testing.assert_allclose(drawn(page, 2, LITTLE), [440, 460], atol=8)
    page.keyboard.press("1")
    wait(page, f"{WHERE}.startsWith('y ')")


def test_of_a_layout_that_is_no_grid_it_runs_along_either_axis(hand, open_page):
    page = open_page(hand[1])
    page.keyboard.press("2")
    wait(page, f"{WHERE} === 'y 2.5 mm'")  # of the hardest pressed
    page.keyboard.press("x")
    wait(page, f"{WHERE} === 'x 4.5 mm'")


def test_where_colours_are_forced_the_raw_line_is_dashed_in_a_colour_of_its_own(hand, open_page):
    page = open_page(hand[1])
    fixed_range(page)
    page.emulate_media(forced_colors="active")
    turned(page)
    inks = page.evaluate("async () => (await import('/static/dom.js')).themeColors()")
    lengths = []
    for ink in ("raw", "restored"):
        colour = [int(each) for each in re.findall(r"\d+", inks[ink])] + [255]
        got = pixels(page, "section").astype(int)
        width = got.shape[1] - SIDE - TAIL
        cell = got[HEAD:-FOOT, SIDE + 4 + width * 3 // 8 : SIDE - 4 + width * 4 // 8]  # where the two lie apart
        lengths.append((abs(cell - colour) < 5).all(axis=2).sum(axis=1).max() / cell.shape[1])
    assert 0.4 < lengths[0] < 0.8
    assert lengths[1] == 1
