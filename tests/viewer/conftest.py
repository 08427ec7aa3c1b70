import re
import shutil
import time
from base64 import b64decode
from collections import Counter
from contextlib import ExitStack
from io import BytesIO

import numpy as np
import pytest
from axe_playwright_python.base import AXE_SCRIPT
from PIL import Image
from playwright.sync_api import sync_playwright

from tactiled.web.rest import openapi
from tactiled.web.server import running
from tests.conftest import BUSY_S, CONFIG, Rig, meanwhile, pressed, until

CHROMIUM = "chromium-headless-shell"  # a page costs half of what it does in `chromium --headless`
DESK, PHONE = {"width": 1440, "height": 900}, {"width": 390, "height": 844}
TOUCH = {**PHONE, "has_touch": True, "is_mobile": True}
PAINTINGS = "Number(document.documentElement.dataset.painted)"
LEVEL = "document.body.dataset.level"
LIVE = f"{LEVEL} === 'live'"
PAUSED = "document.body.classList.contains('paused')"
TILES = "[...document.querySelectorAll('.tile')].map(tile => tile.innerText)"
LEVELS = "[...document.querySelectorAll('.tile')].map(tile => tile.dataset.level).join()"
CONTACTS = (
    "[...document.querySelectorAll('#contact-list tbody tr')].map(row => [...row.cells].map(c => c.innerText))"
)
SCROLL_WIDTH = "document.documentElement.scrollWidth"
FITS = "({ scrollWidth, clientWidth }) => scrollWidth <= clientWidth"
# From then on `window.drawn` has the texts and places that canvases are given, by the canvas' id.
WATCH_TEXTS = """() => {
  window.drawn = [];
  const { fillText } = CanvasRenderingContext2D.prototype;
  CanvasRenderingContext2D.prototype.fillText = function (text, x, y) {
    const { width, height, id, isConnected, parentElement } = this.canvas;
    const layer = [...parentElement?.children ?? []].indexOf(this.canvas);
    const size = this.measureText(text), { a } = this.getTransform();
    const box = [x - size.actualBoundingBoxLeft, y - size.actualBoundingBoxAscent,
      x + size.actualBoundingBoxRight, y + size.actualBoundingBoxDescent].map(each => a * each);
    window.drawn.push({
      id, layer, saved: !isConnected, text, x: a * x, y: a * y, box, end: a * (x + size.width), width, height,
      color: this.fillStyle,
    });
    fillText.call(this, text, x, y);
  };
}"""

AXE = """async rules => {
  const options = rules.length ? { runOnly: rules } : {};
  const part = document.querySelector("dialog[open]") ?? document; // what is behind it is inspected without it
  const { passes, violations } = await axe.run(part, { resultTypes: ["violations"], ...options });
  return [passes.length, violations.map(({ id, nodes }) => [id, nodes.map(({ target }) => target)])];
}"""
COLOUR_RULES = "color-contrast", "link-in-text-block"  # of axe-core, all that the theme can break


class ViewerPage:
    """A page of the browser with the viewer in it; what is not here is Playwright's."""

    def __init__(self, page, faults):
        self.page, self.faults = page, faults

    def __getattr__(self, name):
        return getattr(self.page, name)

    def finish(self, *reported):
        """Close; failed requests with these texts, or any if none is given, are no faults of the page."""
        self.close()
        self.faults[:] = [each for each in self.faults if reported and not any(text in each for text in reported)]

    def wait(self, true):
        """Wait until an expression is true; gives it (the page's own policy forbids Playwright's way)."""
        return self.keep(lambda: None, true)

    def keep(self, send, true):
        """Send frames until an expression is true; gives it, as a sensor is live for a while only."""
        end = time.monotonic() + BUSY_S
        send()
        while not (value := self.evaluate(true)):
            assert time.monotonic() < end, f"never: {true}"
            self.wait_for_timeout(20)
            send()
        return value

    def refreshed(self, times=2):
        """Wait for refreshes of the screen: what the page knew before is painted by then, and laid out."""
        for _ in range(times):
            self.evaluate("() => new Promise(requestAnimationFrame)")

    def press(self, *keys):
        for key in keys:
            self.keyboard.press(key)

    def resize(self, width, height):
        self.set_viewport_size({"width": width, "height": height})
        self.refreshed(4)

    def painted(self):
        return self.evaluate(PAINTINGS)

    def show(self, rig, *frame):
        """Send a frame and wait until it is painted."""
        before = self.painted()
        image = rig.show(*frame)
        self.wait(f"{PAINTINGS} > {before}")
        return image

    def pixels(self, name):
        """(rows, columns, 4) of a canvas; a grid's map has one pixel a cell."""
        address = self.evaluate("id => document.getElementById(id).toDataURL()", name)
        with Image.open(BytesIO(b64decode(address.split(",")[1]))) as picture:
            return np.array(picture.convert("RGBA")).astype(int)

    def text(self, *names):
        """What stands in these elements, in folded ones, too."""
        return [self.locator(f"#{name}").text_content() for name in names]

    def box(self, selector):
        return self.locator(selector).first.bounding_box()

    def set_range(self, low, high):
        self.locator("#range-low").fill(str(low))
        self.locator("#range-high").fill(str(high))
        self.locator("#maps").focus()
        self.refreshed()

    def download(self, key):
        """The file that a key saves."""
        with self.expect_download() as saved:
            self.keyboard.press(key)
        return saved.value.path()

    def violations(self, *rules):
        """What axe-core has against the page, by all its rules or these: rule and elements."""
        if not self.evaluate("'axe' in window"):
            self.evaluate(AXE_SCRIPT)
        passes, violations = self.evaluate(AXE, list(rules))
        assert passes > (0 if rules else 10)  # it did look
        return violations

    def swipe(self, x, y, dx, dy):
        """Move a finger over the page from (x, y), px, in steps."""
        send = self.context.new_cdp_session(self.page).send
        for step in range(11):
            points = [] if step == 10 else [{"x": x + step / 9 * dx, "y": y + step / 9 * dy}]
            kind = "touchEnd" if step == 10 else "touchMove" if step else "touchStart"
            send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})
            self.refreshed()

    def inspect(self):
        """Nothing is inaccessible or cut off, light or dark, on a desk or a phone: no size has its own colours."""
        for size, scheme, rules in ((DESK, "light", ()), (DESK, "dark", COLOUR_RULES), (PHONE, "dark", ())):
            self.set_viewport_size(size)
            self.emulate_media(color_scheme=scheme)
            self.refreshed()
            assert self.violations(*rules) == []
            assert self.evaluate(SCROLL_WIDTH) <= size["width"]


@pytest.fixture(scope="session")
def launch():
    """Starts a browser with these arguments."""
    path, browsers = shutil.which(CHROMIUM), []
    assert path, f"no {CHROMIUM}: sh tests/run installs it"

    def launch(*arguments):
        browsers.append(playwright.chromium.launch(executable_path=path, args=["--no-sandbox", *arguments]))
        return browsers[-1]

    with sync_playwright() as playwright:
        yield launch
        for browser in browsers:
            browser.close()


@pytest.fixture(scope="session", autouse=True)
def descriptions():
    """Of each kind of service one: every page asks for it, and to make one takes a tenth of a second."""
    made, complete = {}, openapi.complete

    def once(app, guarded):
        make = complete(app, guarded)
        kind = guarded, len(app.routes)  # with recordings or without
        return lambda: made.get(kind) or made.setdefault(kind, make())

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(openapi, "complete", once)
        yield


@pytest.fixture(scope="session")
def browser(launch):
    return launch()


@pytest.fixture
def open_page(browser):
    """Opens the viewer; at the end, nothing may have gone wrong in the page."""
    contexts, faults = [], []

    def open_page(url, width=1280, height=860, ready=f"{PAINTINGS} > 0", browser=browser, **options):
        context = browser.new_context(viewport={"width": width, "height": height}, **options)
        contexts.append(context)
        page = context.new_page()
        page.set_default_timeout(1000 * BUSY_S)  # a busy machine is no fault of the page
        page.on("pageerror", lambda error: faults.append(str(error)))
        page.on("console", lambda entry: faults.append(entry.text) if entry.type == "error" else None)
        home = ("blob:", "data:", "/".join(url.split("/")[:3]))
        page.on("request", lambda request: None if request.url.startswith(home) else faults.append(request.url))
        page.goto(url)
        view = ViewerPage(page, faults)
        view.wait(ready)
        return view

    yield open_page
    for context in contexts:
        context.close()
    assert faults == []


def one_more(name, number, array):
    """The configuration of one more sensor on the palm's bus."""
    palm = CONFIG[CONFIG.index("[sensor.palm]") :].replace('"wiener"', '"raw"').replace("palm", name)
    palm = palm.replace("fd = true", f"fd = true, array_id = {number}").replace(", saturation = 4000", "")
    return palm.replace("rows = 8, columns = 8, pitch_mm = 1.0", array).replace("{{", "{").replace("}}", "}")


CORNERS = "positions_mm = [[0, 0], [3, 0], [1.5, 2], [4.5, 2.5]]"
THUMB = one_more("thumb", 1, f'{CORNERS}, aperture_mm = 1.5, aperture = "round"')


class Pair(Rig):
    """The palm, a grid, and the thumb, four taxels of no grid."""

    def __init__(self, *arguments):
        super().__init__(*arguments)
        self.sequences = Counter()  # frames that each sensor beside the palm was sent

    def both(self, palm=None, thumb=(500, 100, 100, 900)):
        """A frame of each; waits for their images."""
        self.show(pressed() if palm is None else palm)
        sensor = self.service.sensor("thumb")
        self.send_to("thumb", thumb)
        until(lambda: (image := sensor.hub.latest()) and image.sequence == self.sequences["thumb"] - 1)
        return self.sensor.hub.latest(), sensor.hub.latest()

    def send_to(self, name, counts):
        """A frame of a sensor beside the palm."""
        counts = np.asarray(counts, np.uint16).ravel()
        for message in self.service.sensor(name).codec.encode(counts, self.sequences[name], time.time()):
            self.bus.send(message)
        self.sequences[name] += 1


@pytest.fixture
def serve(request):
    """Serves a palm and further sensors of this configuration."""
    with ExitStack() as stack:

        def serve(more):
            rig = stack.enter_context(meanwhile(Pair(re.sub(r"\W", "-", request.node.name), more)))
            return rig, stack.enter_context(running(rig.service))

        yield serve


@pytest.fixture
def pair(serve):
    rig, url = serve(THUMB)
    rig.both()
    return rig, url


@pytest.fixture
def page(rig, url, open_page):
    """The viewer on a palm of which one frame came."""
    rig.show(pressed())
    return open_page(url)
