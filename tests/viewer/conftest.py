import re
import shutil
import time
from urllib.parse import urlsplit

import numpy as np
import pytest
from playwright.sync_api import sync_playwright

from tactiled.web.server import running
from tests.conftest import BUSY_S, Rig, meanwhile, pressed, until

PAINTED = "Number(document.documentElement.dataset.painted) > 0"
PHONE = {"width": 390, "height": 844, "has_touch": True, "is_mobile": True}


@pytest.fixture(scope="session")
def launch():
    """Starts a browser with these arguments."""
    path, browsers = shutil.which("chromium"), []
    assert path, "no chromium: sh tests/run installs it"

    def launch(*arguments):
        browsers.append(playwright.chromium.launch(executable_path=path, args=["--no-sandbox", *arguments]))
        return browsers[-1]

    with sync_playwright() as playwright:
        yield launch
        for browser in browsers:
            browser.close()


@pytest.fixture(scope="session")
def browser(launch):
    return launch()


@pytest.fixture
def open_page(browser):
    """Opens the viewer; at the end, nothing may have gone wrong in the page."""
    contexts, faults = [], []

    def open_page(url, width=1280, height=860, ready=PAINTED, browser=browser, **options):
        context = browser.new_context(viewport={"width": width, "height": height}, **options)
        contexts.append(context)
        page = context.new_page()
        page.set_default_timeout(1000 * BUSY_S)  # a busy machine is no fault of the page
        page.on("pageerror", lambda error: faults.append(str(error)))
        page.on("console", lambda said: faults.append(said.text) if said.type == "error" else None)
        page.on("request", lambda request: faults.append(request.url) if not local(request.url, url) else None)
        page.faults = faults
        page.goto(url)
        wait(page, ready)
        return page

    yield open_page
    for context in contexts:
        context.close()
    assert faults == []


def wait(page, true, seconds=BUSY_S):
    """Wait until an expression is true in the page; gives it (the page's own policy forbids Playwright's way)."""
    end = time.monotonic() + seconds
    while not (found := page.evaluate(true)):
        assert time.monotonic() < end, f"never: {true}"
        page.wait_for_timeout(20)
    return found


def keep(send, page, true):
    """Send frames until an expression is true in the page; gives it, as what holds of a live sensor passes."""
    end = time.monotonic() + BUSY_S
    send()
    while not (found := page.evaluate(true)):
        assert time.monotonic() < end, f"never: {true}"
        page.wait_for_timeout(50)
        send()
    return found


def turned(page, times=2):
    """Wait for turns of the screen: what the page knew before is painted by then, and laid out."""
    page.evaluate(
        """times => new Promise(done => {
          const turn = () => (times-- ? requestAnimationFrame(turn) : done());
          turn();
        })""",
        times,
    )


def local(address, url):
    """Whether a request stays with the service."""
    there = urlsplit(url).netloc
    return address.startswith(("blob:", "data:")) or urlsplit(address).netloc == there


def one_more(name, number, array):
    """The configuration of one more sensor on the palm's bus."""
    return f"""
[sensor.{name}]
bus = "can0"
method = "raw"
stale_after_s = 0.3
codec = {{ name = "packed", bits = 12, fd = true, array_id = {number} }}
array = {{ {array} }}
cover = {{ thickness_mm = 0.8, young_mpa = 0.6, poisson = 0.48 }}
kernel = {{ model = "layered" }}
calibration = {{ kpa_per_count = 0.5, no_load = 100, noise_kpa = 0.5 }}
"""


CORNERS = "positions_mm = [[0, 0], [3, 0], [1.5, 2], [4.5, 2.5]]"
THUMB = one_more("thumb", 1, f'{CORNERS}, aperture_mm = 1.5, aperture = "round"')


class Pair(Rig):
    """The palm, a grid, and the thumb, four taxels of no grid."""

    def both(self, palm=None, thumb=(500, 100, 100, 900)):
        """A frame of each; waits for their images."""
        self.show(pressed() if palm is None else palm)
        sensor = self.service.sensor("thumb")
        for message in sensor.codec.encode(np.array(thumb, np.uint16), self.sequence % 256, time.time()):
            self.bus.send(message)
        until(lambda: (image := sensor.hub.latest()) and image.sequence == self.sequence)
        return self.sensor.hub.latest(), sensor.hub.latest()


@pytest.fixture
def pair(request):
    with meanwhile(Pair(re.sub(r"\W", "-", request.node.name), THUMB)) as made, running(made.service) as url:
        made.both()
        yield made, url
