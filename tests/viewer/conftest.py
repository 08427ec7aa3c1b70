import shutil
import time
from urllib.parse import urlsplit

import pytest
from playwright.sync_api import sync_playwright

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
        page.set_default_timeout(60_000)  # a busy machine is no fault of the page
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


def wait(page, true, seconds=60.0):
    """Wait until an expression is true in the page (the page's own policy forbids Playwright's way)."""
    end = time.monotonic() + seconds
    while not page.evaluate(true):
        assert time.monotonic() < end, f"never: {true}"
        page.wait_for_timeout(20)


def local(address, url):
    """Whether a request stays with the service."""
    there = urlsplit(url).netloc
    return address.startswith(("blob:", "data:")) or urlsplit(address).netloc == there
