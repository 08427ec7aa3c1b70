"""The main view, playback and regions in Firefox."""

from base64 import b64decode
from io import BytesIO

import numpy as np
import pytest
from PIL import Image

from tests.conftest import ask, pressed, until
from tests.viewer.conftest import LIVE, PAINTINGS
from tests.viewer.firefox import firefox
from tests.viewer.test_playback import FRAME, PLAYS, WHEN, recorded  # noqa: F401, a fixture

ROW = "[...document.querySelectorAll('#recordings li')].find(row => row.innerText.includes('grasp.log'))"
SCROLL_WIDTH = "document.documentElement.scrollWidth"
TO_THE_END = """(scrub => {
  scrub.value = scrub.max;
  scrub.dispatchEvent(new Event("input", { bubbles: true }));
  return true;
})(document.getElementById("scrub"))"""


@pytest.fixture(scope="module")
def browser():
    with firefox() as page:
        yield page


def test_maps_show_the_data_in_the_colours_of_the_range(rig, url, browser):
    image = rig.show(pressed(2))
    browser.open(url, 1440, 900)
    browser.wait(f"{LIVE} && {PAINTINGS}", lambda: rig.show(pressed(2)))
    colors = np.array(ask("GET", f"{url}/api/v1/colormap").json()["colors"])

    def painted():
        high, address = browser.evaluate(
            "[document.getElementById('range-high').value, document.getElementById('restored').toDataURL()]"
        )
        expected = colors[np.clip(np.floor(image.restored * 256 / float(high)), 0, 255).astype(int)]
        loaded = image.restored > 0.05 * float(high)
        with Image.open(BytesIO(b64decode(address.split(",")[1]))) as picture:
            got = np.array(picture.convert("RGB")).astype(int)
        return loaded.any() and (np.abs(got - expected)[loaded] <= 4).all()

    until(painted)
    assert browser.evaluate(SCROLL_WIDTH) <= 1440
    for width in (1024, 390):
        browser.open(url, width, 844)
        browser.wait(LIVE, lambda: rig.show(pressed(2)))
        assert browser.evaluate(SCROLL_WIDTH) <= width
    assert browser.errors == []


def test_a_region_is_drawn_and_measured(rig, url, browser):
    browser.open(url, 1440, 900)
    browser.wait(f"{LIVE} && {PAINTINGS}", lambda: rig.show(pressed(3, force=3000)))
    browser.wait("document.body.dataset.level === 'stale'")  # from then on nothing moves on the page
    browser.click("#region-ellipse")
    browser.wait("document.body.classList.contains('drawing')")
    browser.drag("#restored-frame", (-0.25, -0.25), (0.25, 0.25))
    browser.wait("document.getElementById('region').open")
    browser.evaluate("(document.getElementById('region-name').value = 'heel')")
    browser.evaluate("document.getElementById('region-save').click()")
    browser.wait("document.querySelectorAll('#regions tbody tr').length === 1")
    (region,) = ask("GET", f"{url}/api/v1/sensors/palm/regions").json()["regions"]
    assert (region["name"], region["shape"]) == ("heel", "ellipse")
    middle = (rig.sensor.array.shape[0] - 1) / 2 * rig.sensor.array.pitch
    assert np.mean(region["points_mm"], axis=0) == pytest.approx((middle, middle), abs=0.1)
    assert browser.errors == []


def test_a_recording_plays_and_is_sought(recorded, browser):  # noqa: F811
    url, _ = recorded
    browser.open(url, 1440, 900)
    # A socket that is closed while it connects is an error to Firefox.
    browser.wait(f"!!({ROW}) && document.body.dataset.level !== 'connecting'")
    browser.evaluate(f"({ROW}).querySelectorAll('button')[0].click()")
    browser.wait(f"{PLAYS} && {WHEN} === '0:00.0 / 0:01.0'")
    browser.evaluate(TO_THE_END)
    browser.wait(f"{FRAME} === '49'")
    assert browser.errors == []
