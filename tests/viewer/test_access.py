"""axe-core finds nothing in the page, whatever is open, in either theme, at either size; the keyboard does all."""

import pytest

from tactiled.config import Server
from tactiled.web.server import running
from tests.conftest import CONTROL, READ, TOKENS, pressed
from tests.viewer.conftest import COLOUR_RULES, LEVELS, LIVE, PAUSED, TILES

READY = f"{TILES}.length === 2"
TOKEN_OPEN = "document.getElementById('token').open"
FOCUSED = "document.activeElement.id"
REACHED = """(() => {
  const { outlineStyle, outlineWidth } = getComputedStyle(document.activeElement);
  document.activeElement.dataset.reached = outlineStyle !== "none" && parseFloat(outlineWidth) >= 2;
  return document.activeElement === document.body;
})()"""
UNREACHED = """[...document.querySelectorAll('a[href], button, input, select, [tabindex="0"]')]
  .filter((each) => each.checkVisibility() && !each.disabled && each.tabIndex >= 0)
  .filter((each) => each.dataset.reached !== 'true')
  .map((each) => each.outerHTML)"""


def test_a_page_that_is_live_or_stale_and_its_help_are_accessible(rig, page):
    with rig.playing(20):
        page.wait(LIVE)
        page.inspect()
    page.wait("/STALE[^]*last frame [1-9][.\\d]* s ago/.test(document.getElementById('banner').innerText)")
    assert "grayscale(1)" in page.evaluate("getComputedStyle(document.getElementById('raw')).filter")
    page.inspect()
    page.press("?")
    page.wait("document.getElementById('help').open")
    page.inspect()
    page.press("Escape")
    page.evaluate("document.querySelector('label[for=method]').remove()")
    assert [rule for rule, _ in page.violations()] == ["select-name"]  # a fault is found
    page.evaluate(
        "document.querySelector('header h1').style.color = getComputedStyle(document.body).backgroundColor"
    )
    assert [rule for rule, _ in page.violations(*COLOUR_RULES)] == ["color-contrast"]


def test_the_wall_is_accessible_and_its_keys_lead_to_a_sensor(pair, open_page):
    rig, url = pair
    page = open_page(f"{url}/#/wall", ready=READY)
    with rig.playing(20):
        page.wait(f"{LEVELS} === 'live,stale'")
        page.inspect()
    page.evaluate("document.activeElement.blur()")
    page.press("Tab", "Enter", "Tab")
    assert page.evaluate("document.activeElement === document.querySelector('.tile')")
    page.press("Enter")
    page.locator("#main").wait_for()
    assert page.evaluate(FOCUSED) == "maps"
    assert page.evaluate("document.getElementById('skip').hash") == "#maps"


def test_the_token_dialog_keeps_the_focus_and_is_accessible_as_are_recordings(rig, tmp_path, open_page):
    at = Server(port=0, recordings=tmp_path, **TOKENS)
    rig.show(pressed())
    with running(rig.service, at) as url, rig.playing(20):
        page = open_page(f"{url}/?token={READ}")
        page.locator("#tare").focus()
        page.press("Enter")
        page.wait(TOKEN_OPEN)
        assert page.evaluate(FOCUSED) == "token-field"
        for _ in range(8):
            page.press("Tab")
            assert page.evaluate(
                "document.activeElement === document.body || !!document.activeElement.closest('#token')"
            )
        page.press("Escape")
        page.wait(f"!{TOKEN_OPEN}")
        assert page.evaluate(FOCUSED) == "tare"
        page.press("r")
        page.wait(TOKEN_OPEN)
        page.inspect()
        page.keyboard.type(CONTROL)
        page.press("Enter")
        page.locator("#recordings li").wait_for()
        page.press("p")
        page.inspect()
        page.press("r")
        page.locator("#recordings li a").wait_for()
        page.press("ArrowLeft")
        page.wait(PAUSED)
        page.inspect()
        page.finish("403")


@pytest.mark.parametrize(("place", "controls"), [("palm", 15), ("/wall", 7)])
def test_every_control_is_reached_by_the_tab_key_and_shows_that_it_has_the_focus(pair, open_page, place, controls):
    _rig, url = pair
    complete = "document.querySelector('#method option') && document.querySelector('#contact-list button:enabled')"
    page = open_page(f"{url}/#{place}", ready=READY if place == "/wall" else complete)
    page.refreshed()
    for _ in range(60):
        page.press("Tab")
        if page.evaluate(REACHED):
            break
    assert page.evaluate(UNREACHED) == []
    assert page.evaluate("document.querySelectorAll('[data-reached=true]').length") >= controls
