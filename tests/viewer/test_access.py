"""axe-core finds nothing in the page, whatever is open, in either theme, at either size; the keyboard does all."""

import re
from contextlib import ExitStack, closing
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread

import pytest

from tactiled.config import Server
from tactiled.web.server import running
from tests.conftest import CONTROL, READ, TOKENS, pressed
from tests.viewer.conftest import COLOUR_RULES, LEVELS, LIVE, PAINTINGS, PAUSED, TILES

GUIDE = Path(__file__).parents[2] / "tactiled/docs/streams.md"
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


def test_the_wall_is_accessible_its_keys_lead_to_a_sensor_and_every_control_is_reached_by_tab(pair, open_page):
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
    page.resize(1280, 860)
    complete = "document.querySelector('#method option') && document.querySelector('#contact-list button:enabled')"
    for key, ready, controls in (("1", complete, 15), ("w", READY, 7)):
        page.evaluate("document.activeElement.blur()")
        page.press(key)
        page.keep(rig.both, ready)
        page.evaluate("document.querySelectorAll('[data-reached]').forEach(each => delete each.dataset.reached)")
        ends = 0
        while ends < 2:  # once to the end of the page, and once through it
            page.press("Tab")
            ends += page.evaluate(REACHED)
        assert page.evaluate(UNREACHED) == []
        assert page.evaluate("document.querySelectorAll('[data-reached=true]').length") >= controls


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
        assert "control token" in page.locator("#token-why").inner_text()
        page.inspect()
        page.keyboard.type("x" * 16)
        page.press("Enter")
        page.locator("#token-why", has_text="does not know").wait_for()
        assert not list(tmp_path.iterdir())
        page.get_by_label("Token", exact=True).fill(CONTROL)
        page.press("Enter")
        page.locator("#recordings li").wait_for()
        assert not page.get_by_role("dialog").is_visible()
        page.press("p")
        page.inspect()
        page.press("r")
        page.locator("#recordings li a").wait_for()
        page.press("ArrowLeft")
        page.wait(PAUSED)
        page.inspect()
        page.finish("401", "403")


class Elsewhere(SimpleHTTPRequestHandler):
    """An empty page at any path."""

    def do_GET(self):
        self.send_response(200)
        self.send_header("Content-Type", "text/html")
        self.end_headers()

    def log_message(self, *_):
        """Nothing."""


@pytest.fixture
def elsewhere():
    """Addresses of pages of two other sites."""
    with ExitStack() as stack:
        servers = [stack.enter_context(ThreadingHTTPServer(("127.0.0.1", 0), Elsewhere)) for _ in range(2)]
        for each in servers:
            Thread(target=each.serve_forever, daemon=True).start()
            stack.callback(each.shutdown)
        yield [f"http://localhost:{each.server_port}" for each in servers]


def test_a_person_types_the_token_and_a_page_of_an_allowed_site_streams(rig, browser, open_page, elsewhere):
    rig.show(pressed())
    (code,) = re.findall(r"```javascript\n(.*?)```", GUIDE.read_text(), re.DOTALL)
    at = Server(port=0, allowed_origins=(elsewhere[0],), **TOKENS)
    with running(rig.service, at) as url, rig.playing(20):
        page = open_page(f"{url}/#palm?view=slider", ready="document.activeElement.id === 'token'")
        page.inspect()
        page.keyboard.type("no" * 8)
        page.press("Enter")
        page.get_by_text("This token is unknown").wait_for()
        page.keyboard.type(READ)
        page.press("Enter")
        page.locator("#maps").wait_for()
        page.wait(f"{PAINTINGS} > 0")
        assert READ not in page.url
        assert page.url.endswith("/#palm?view=slider")  # the link that led here
        code = code.replace("127.0.0.1:8000", url.removeprefix("http://")).replace("TOKEN", READ)
        show = f"{{headers: {{Authorization: 'Bearer {READ}'}}}}"
        fetched = f"fetch('{url}/api/v1/health', {show}).then(({{ status }}) => status).catch(() => 0)"
        allowed, refused = (browser.new_page() for _ in elsewhere)
        with closing(allowed), closing(refused):
            allowed.goto(elsewhere[0])
            refused.goto(elsewhere[1])
            with allowed.expect_console_message(lambda entry: re.fullmatch(r"\d+ 8 8 [\d.]+ kPa", entry.text)):
                allowed.evaluate(f"() => {{{code}}}")
            with refused.expect_console_message(lambda entry: entry.text.startswith("4403 Origin: ")):
                refused.evaluate(f"() => {{{code}}}")
            assert (allowed.evaluate(fetched), refused.evaluate(fetched)) == (200, 0)
        page.finish("401")
