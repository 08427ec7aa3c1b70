"""The picture that a frame is saved as, for arrays of every shape."""

import itertools
import re
from contextlib import contextmanager

import numpy as np
import pytest

from tactiled.web.server import running
from tests.conftest import Rig, meanwhile, until
from tests.viewer.conftest import one_more, wait

NAME = "a_long_name_of_a_fingertip"
# The texts of the canvas that is saved: the page may write on others of its own meanwhile.
WRITTEN = """() => {
  const { fillText } = CanvasRenderingContext2D.prototype;
  const { toBlob } = HTMLCanvasElement.prototype;
  const texts = new WeakMap();
  CanvasRenderingContext2D.prototype.fillText = function (text, x, y) {
    const { canvas } = this;
    const { width, height } = canvas;
    const one = { text, x, y, end: x + this.measureText(text).width, width, height };
    texts.set(canvas, [...(texts.get(canvas) ?? []), one]);
    fillText.call(this, text, x, y);
  };
  HTMLCanvasElement.prototype.toBlob = function (...how) {
    window.written = texts.get(this);
    toBlob.apply(this, how);
  };
}"""


@contextmanager
def odd(rows, columns, request):
    """A rig with one sensor more, of this shape; gives how to send it counts, and its page."""
    more = one_more(NAME, 2, f"rows = {rows}, columns = {columns}, pitch_mm = 1.0")
    with meanwhile(Rig(re.sub(r"\W", "-", request.node.name), more)) as rig, running(rig.service) as url:
        sensor = rig.service.sensor(NAME)

        def send(counts):
            for message in sensor.codec.encode(counts.astype(np.uint16).ravel(), 0, 0.0):
                rig.bus.send(message)
            until(lambda: sensor.hub.latest() is not None)

        yield send, f"{url}/#{NAME}"


@pytest.mark.parametrize(("rows", "columns"), [(1, 40), (40, 2), (12, 6), (9, 9)])
def test_nothing_that_is_written_on_it_leaves_it_or_covers_another(rows, columns, request, open_page):
    with odd(rows, columns, request) as (send, address):
        send(np.full(rows * columns, 900))
        page = open_page(address)
        page.evaluate(WRITTEN)
        with page.expect_download():
            page.keyboard.press("s")
        written = page.evaluate("window.written")
        page.close()
    texts = [each["text"] for each in written]
    assert texts[0] == f"{NAME}, frame 0"
    assert {"Raw", "Restored", "kPa", "0"} <= set(texts)
    for each in written:
        assert 0 <= each["x"] < each["end"] <= each["width"], each
        assert 12 <= each["y"] <= each["height"], each
    for one, other in itertools.combinations(written, 2):
        apart = one["end"] <= other["x"] or other["end"] <= one["x"] or abs(one["y"] - other["y"]) >= 14
        assert apart, (one, other)


def test_a_frame_that_is_old_and_stands_still_is_both(rig, url, open_page):
    rig.stale_after(0.2)
    rig.show(np.full((8, 8), 300))
    page = open_page(url)
    until(lambda: rig.sensor.status().state == "stale")
    page.locator("#banner-title", has_text="STALE").wait_for()
    page.keyboard.press("Space")
    page.evaluate(WRITTEN)
    with page.expect_download():
        page.keyboard.press("s")
    assert page.evaluate("window.written.some(each => each.text.endsWith(', paused, stale'))")


def test_the_legend_has_both_its_ends_and_large_and_small_numbers_fit(rig, url, open_page):
    rig.show(np.full((8, 8), 300))
    page = open_page(url)
    told = page.evaluate("""async () => {
      const { endsAndTicks, tickText } = await import("/static/ticks.js");
      const texts = (low, high) => endsAndTicks(low, high, 8).map(each => tickText(each, high - low));
      return [texts(0, 150), texts(0, 1234567), texts(0, 1e-5), texts(123000, 123500), texts(-2, 10)];
    }""")
    assert told[0] == ["0", "20", "40", "60", "80", "100", "120", "150"]
    assert told[1][-1] == "1.23e6"
    assert told[2][:2] == ["0", "2e−6"]
    for each in told:
        assert len(set(each)) == len(each)
        assert max(map(len, each)) <= 8
    assert told[4][0] == "−2"


LABELS = """() => {
  const all = window.labels = [];
  const { fillText } = CanvasRenderingContext2D.prototype;
  CanvasRenderingContext2D.prototype.fillText = function (text, x, y) {
    if (this.canvas.id === "raw-marks") all.push([text, x / this.canvas.width, y / this.canvas.height]);
    fillText.call(this, text, x, y);
  };
}"""


@pytest.mark.parametrize(
    ("rows", "columns", "says", "y"), [(40, 2, "1", 0.3), (2, 2, "1: ", 0.2), (1, 40, "1: ", 0.5)]
)
def test_a_contact_is_labelled_on_or_near_it_on_arrays_of_every_shape(rows, columns, says, y, request, open_page):
    row, column = np.mgrid[:rows, :columns]
    counts = 100 + 800 * np.exp(-((column - columns / 3) ** 2 + (row - rows / 3) ** 2) / 6)
    with odd(rows, columns, request) as (send, address):
        page = open_page(address, ready="document.readyState === 'complete'")
        page.evaluate(LABELS)
        send(counts)
        text, _, at = wait(page, "window.labels[0]")
        page.close()
    assert text.startswith(says)
    assert abs(at - y) < 0.25
