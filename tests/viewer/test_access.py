"""axe-core finds nothing in the page, whatever is open, in either theme, at either size; the keyboard does all."""

import re
import threading
from contextlib import contextmanager

import pytest
from axe_playwright_python.sync_playwright import Axe
from pydantic import SecretStr

from tactiled.config import Server
from tactiled.web.server import running
from tests.conftest import pressed
from tests.viewer.conftest import PHONE, wait

READ, CONTROL = "r" * 16, "c" * 16
SIZES = pytest.mark.parametrize("size", [{"width": 1440, "height": 900}, PHONE], ids=["desk", "phone"])
SCHEMES = pytest.mark.parametrize("scheme", ["light", "dark"])
TILES = "document.querySelectorAll('.tile').length === 2"


@contextmanager
def live(rig):
    stop = threading.Event()
    sender = rig.play(20, stop)
    try:
        yield
    finally:
        stop.set()
        sender.join()


def found(page):
    """What axe-core has against the page: rule and elements."""
    told = Axe().run(page).response
    assert len(told["passes"]) > 15  # it did look
    return [(each["id"], [node["target"] for node in each["nodes"]]) for each in told["violations"]]


@SIZES
@SCHEMES
def test_nothing_is_found(rig, url, open_page, scheme, size):
    rig.show(pressed())
    page = open_page(url, color_scheme=scheme, **size)
    with live(rig):
        page.locator('[data-level="live"]').wait_for()
        assert found(page) == []


@SCHEMES
def test_nothing_is_found_in_a_page_that_is_stale_nor_in_its_help(rig, url, open_page, scheme):
    rig.show(pressed())
    page = open_page(url, color_scheme=scheme)
    page.get_by_text(re.compile("^stale$", re.IGNORECASE)).first.wait_for()
    assert found(page) == []
    page.keyboard.press("?")
    wait(page, "document.getElementById('help').open")
    assert found(page) == []


def test_a_fault_is_found(rig, url, open_page):
    rig.show(pressed())
    page = open_page(url)
    page.evaluate("document.querySelector('label[for=method]').remove()")
    assert [rule for rule, _ in found(page)] == ["select-name"]


@SIZES
@SCHEMES
def test_nothing_is_found_on_the_wall(pair, open_page, scheme, size):
    rig, url = pair
    page = open_page(f"{url}/#/wall", ready=TILES, color_scheme=scheme, **size)
    with live(rig):
        page.locator('.tile[data-level="live"]').wait_for()
        page.locator('.tile[data-level="stale"]').wait_for()
        assert found(page) == []


@pytest.fixture
def kept(rig, tmp_path):
    """A service that records and wants tokens."""
    at = Server(port=0, recordings=tmp_path, read_token=SecretStr(READ), control_token=SecretStr(CONTROL))
    rig.show(pressed())
    with running(rig.service, at) as url:
        yield f"{url}/?token={READ}"


def forgive(page):
    """What the page was refused is no fault of it; the browser reports it."""
    page.faults[:] = [each for each in page.faults if "403" not in each]


OPEN = "document.getElementById('token').open"
FOCUSED = "document.activeElement.id"


@SIZES
@SCHEMES
def test_nothing_is_found_in_the_dialog_for_a_token_nor_beside_a_recording_and_a_pinned_probe(
    rig, kept, open_page, scheme, size
):
    page = open_page(kept, color_scheme=scheme, **size)
    with live(rig):
        page.keyboard.press("r")
        wait(page, OPEN)
        assert found(page) == []
        page.keyboard.type(CONTROL)
        page.keyboard.press("Enter")
        page.locator("#recordings li").wait_for()
        page.keyboard.press("p")
        assert found(page) == []
        page.keyboard.press("r")
        page.locator("#recordings li a").wait_for()
        page.keyboard.press("Space")
        assert found(page) == []
    forgive(page)


def test_the_dialog_for_a_token_keeps_the_focus_and_gives_it_back(kept, open_page):
    page = open_page(kept)
    page.locator("#tare").focus()
    page.keyboard.press("Enter")
    wait(page, OPEN)
    assert page.evaluate(FOCUSED) == "token-field"
    for _ in range(8):
        page.keyboard.press("Tab")
        assert page.evaluate(
            "document.activeElement === document.body || !!document.activeElement.closest('#token')"
        )
    page.keyboard.press("Escape")
    wait(page, f"!{OPEN}")
    assert page.evaluate(FOCUSED) == "tare"
    forgive(page)


REACHED = """(() => {
  const { outlineStyle, outlineWidth } = getComputedStyle(document.activeElement);
  document.activeElement.dataset.reached = outlineStyle !== "none" && parseFloat(outlineWidth) >= 2;
  return document.activeElement === document.body;
})()"""
UNREACHED = """[...document.querySelectorAll('a[href], button, input, select, [tabindex="0"]')]
  .filter((each) => each.checkVisibility() && !each.disabled && each.tabIndex >= 0)
  .filter((each) => each.dataset.reached !== 'true')
  .map((each) => each.outerHTML)"""


@pytest.mark.parametrize("place", ["palm", "/wall"])
def test_every_control_is_reached_by_the_tab_key_and_shows_that_it_has_the_focus(pair, open_page, place):
    _rig, url = pair
    page = open_page(
        f"{url}/#{place}", ready=TILES if "wall" in place else "!!document.querySelector('#method option')"
    )
    for _ in range(60):
        page.keyboard.press("Tab")
        if page.evaluate(REACHED):
            break
    assert page.evaluate(UNREACHED) == []
    assert page.evaluate("document.querySelectorAll('[data-reached=true]').length") >= (
        6 if "wall" in place else 15
    )


def test_the_keyboard_leads_from_the_wall_to_a_sensor_and_its_maps(pair, open_page):
    _rig, url = pair
    page = open_page(f"{url}/#/wall", ready=TILES)
    page.keyboard.press("Tab")
    page.keyboard.press("Enter")  # skip
    page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement === document.querySelector('.tile')")
    page.keyboard.press("Enter")
    page.locator("#main").wait_for()
    assert page.evaluate(FOCUSED) == "maps"
    assert page.evaluate("document.getElementById('skip').hash") == "#maps"
