"""The cross-section, along x or along y: what it draws are the cells of that line, by the pixels."""

import numpy as np
import pytest

from tests.conftest import NO_LOAD, ask, until
from tests.viewer.conftest import PAINTINGS, THUMB, one_more

LEFT_PX, TOP_PX, BOTTOM_PX, RIGHT_PX = 46, 20, 34, 12  # px that a chart keeps free
HIGH = 500  # kPa, the top of the range
DEEP = 0.4  # of the range, that the axis reaches below it where a line does, and a while after
RESTORED = (11, 98, 168, 255)  # the light theme's; the band is the same, seen through
BLOCK = np.full((8, 8), NO_LOAD)
BLOCK[1:7, 2:5] += 400  # neither its rows nor its columns mirror the other
STRIP = one_more("strip", 2, "rows = 12, columns = 2, pitch_mm = 1.0")
WHERE = "document.getElementById('section-where').innerText"
# Counts requests for the deviation in `window.requests`.
WATCH_REQUESTS = """() => {
  window.requests = 0;
  const real = window.fetch.bind(window);
  window.fetch = (path, ...more) => {
    if (String(path).includes("deviation")) window.requests += 1;
    return real(path, ...more);
  };
}"""


def digits(mm):
    """A length as the page writes it."""
    return f"{mm:.2f}" if abs(mm) < 1 else f"{mm:#.3g}"


def line_kpa(page, cells):
    """Pressure (kPa) of the restored line in the middle of each cell; NaN where it is hidden."""
    got = page.pixels("section")[TOP_PX:-BOTTOM_PX, LEFT_PX:-RIGHT_PX]
    height, width = got.shape[:2]
    values = []
    for i in range(cells):
        rows = np.flatnonzero((abs(got[:, round((i + 0.5) / cells * width)] - RESTORED) < 5).all(axis=1))
        at = 1 - (rows.mean() + 0.5) / height if len(rows) else np.nan
        values.append(HIGH * (at * (1 + DEEP) - DEEP))
    return np.array(values)


def test_it_runs_along_either_axis_through_the_peak_or_a_pinned_probe_on_every_layout(serve, open_page):
    rig, url = serve(THUMB + STRIP)
    _, thumb = rig.both(BLOCK)
    x, y = rig.service.sensor("thumb").cells.positions[np.nanargmax(thumb.restored)]
    rig.send_to("strip", 100 + 40 * np.arange(24))
    page = open_page(url)
    page.locator("#contacts-on").uncheck()
    page.set_range(0, HIGH)
    restored = rig.sensor.hub.latest().restored
    row, column = np.unravel_index(restored.argmax(), (8, 8))
    for along, across, at, values in (("x", "y", row, restored[row]), ("y", "x", column, restored[:, column])):
        page.wait(f"{WHERE} === '{across} {digits(at)} mm'")
        page.refreshed()
        np.testing.assert_allclose(line_kpa(page, 8), values, atol=5)
        assert page.locator("#section").get_attribute("aria-label").startswith(f"Pressure along {along}, ")
        marked = page.pixels("raw-marks")[..., 3] > 0
        ways = marked if along == "x" else marked.T
        assert not ways.all(axis=1).any()  # its ends alone are drawn
        for side in (0, -1):
            assert np.flatnonzero(ways[:, side]).mean() == pytest.approx(len(marked) * (at + 0.5) / 8, abs=2)
        page.get_by_role("button", name=f"Cross-section along {along}. Change").click()
    page.press("x", "p")
    page.wait(f"{WHERE}.endsWith(', pinned')")
    page.refreshed()
    assert (page.pixels("raw-marks")[..., 3] > 0).all(axis=0).any()
    before = float(page.evaluate(WHERE).split()[1])
    for key in ("Alt+ArrowRight", "Alt+ArrowDown"):
        page.press(key)
        page.wait(f"{WHERE} === 'x {digits(before + 1)} mm, pinned'")
    for key, where in (
        ("2", f"y {digits(y)} mm"),  # no grid: through the cell with the highest pressure
        ("x", f"x {digits(x)} mm"),
        ("3", "x 1.00 mm"),  # much taller than wide: along y at first
        ("x", "y 11.0 mm"),
        ("1", f"y {digits(row)} mm"),
    ):
        page.press(key)
        page.wait(f"{WHERE} === '{where}'")
    # Its band is two deviations to either side, and is requested only while it can be seen.
    page.press("x")
    deviation = np.array(ask("GET", f"{url}/api/v1/sensors/palm/frames/deviation").json()["values"])
    value, spread = float(restored[1, column]), float(deviation[1, column])
    page.set_range(f"{value - 5 * spread:.3f}", f"{value + 5 * spread:.3f}")

    def fits():
        """The band's height in the second cell is four of the range's ten deviations."""
        rig.show(BLOCK)
        got = page.pixels("section")[TOP_PX:-BOTTOM_PX, LEFT_PX:-RIGHT_PX]
        cell = got[:, round((1 + 0.5 - 0.3) / 8 * got.shape[1])]  # off the cell's middle
        blue = cell[:, 2] > cell[:, 0] + 40  # the restored line and its band
        return abs(blue.sum() - 4 / 10 / (1 + DEEP) * len(blue)) <= 2

    page.evaluate("document.getElementById('section').scrollIntoView()")
    until(fits)
    page.resize(390, 360)
    page.evaluate("window.scrollTo(0, 0)")
    page.refreshed(4)
    page.evaluate(WATCH_REQUESTS)
    before = page.painted()
    page.keep(lambda: rig.show(BLOCK), f"{PAINTINGS} > {before + 15}")
    assert page.evaluate("window.requests") == 0
    page.evaluate("document.getElementById('section').scrollIntoView()")
    page.keep(lambda: rig.show(BLOCK), "window.requests")
