import time

import numpy as np

from tests.conftest import BUSY_S, NO_LOAD, ask, pressed
from tests.viewer.conftest import turned
from tests.viewer.test_viewer import painted, pixels

NOTE = """() => {
  window.asked = [];
  const real = window.fetch.bind(window);
  window.fetch = (path, ...more) => {
    if (String(path).includes("deviation")) window.asked.push(path);
    return real(path, ...more);
  };
}"""
SIDE, HEAD, FOOT, TAIL = 46, 20, 34, 12  # px that a chart keeps free
BROAD = np.full((8, 8), NO_LOAD)
BROAD[1:6, 1:6] += 400  # no few small spots, which might be elsewhere


def keep(rig, page, true):
    """Send the same frame over and over until something is true."""
    end = time.monotonic() + BUSY_S
    while not true():
        assert time.monotonic() < end, "it did not happen in time"
        page.wait_for_timeout(50)
        rig.show(BROAD)


def test_the_band_is_two_deviations_to_either_side(rig, url, open_page):
    image = rig.show(BROAD)
    page = open_page(url)
    deviation = np.array(ask("GET", f"{url}/api/v1/sensors/palm/frames/deviation").json()["values"])
    row = int(image.restored.max(axis=1).argmax())
    value, spread = float(image.restored[row, 3]), float(deviation[row, 3])
    low, high = value - 5 * spread, value + 5 * spread
    page.locator("#range-low").fill(f"{low:.3f}")
    page.locator("#range-high").fill(f"{high:.3f}")
    page.locator("#maps").focus()

    def band():
        got = pixels(page, "section").astype(int)
        at = SIDE + round((3 + 0.5 - 0.3) / 8 * (got.shape[1] - SIDE - TAIL))  # inside the cell, off its middle
        column = got[HEAD : got.shape[0] - FOOT, at]
        return (column[:, 2] > column[:, 0] + 40).sum(), column.shape[0]  # bluish: the restored line and its band

    def shown():
        tall, height = band()
        whole = 1.4 * (high - low)  # other cells lie below the range, so that the axis reaches deep
        return abs(tall - 4 * spread / whole * height) <= 2

    keep(rig, page, shown)


def test_the_deviation_is_asked_for_only_while_the_cross_section_can_be_seen(rig, url, open_page):
    rig.show(pressed())
    page = open_page(url, width=390, height=360)
    turned(page)  # what is asked before the page knows what can be seen
    page.evaluate(NOTE)
    before = painted(page)
    keep(rig, page, lambda: painted(page) > before + 15)
    assert page.evaluate("window.asked") == []
    page.evaluate("document.getElementById('section').scrollIntoView()")
    keep(rig, page, lambda: page.evaluate("window.asked"))


def test_a_band_of_another_time_is_not_drawn(rig, url, open_page):
    rig.show(pressed())
    page = open_page(url)
    kept = page.evaluate(
        """async () => {
          const { DeviationCache } = await import("/static/deviation.js");
          const kept = new DeviationCache("palm", { restored: { count: 64 } });
          const now = (await (await fetch("/api/v1/sensors/palm/frames/raw")).json()).timestamp;
          await kept._fetch(0);
          return [0, 1.4, 1.6, -1.6].map(away => kept.at(now + away)?.length);
        }"""
    )
    assert kept == [64, 64, None, None]
