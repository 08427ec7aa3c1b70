from tests.conftest import pressed
from tests.viewer.conftest import PHONE, wait

PROBE = "document.getElementById('probe').innerText"


def swipe(page, x, y, up):
    """Move a finger up over the page, px, in steps."""
    send = page.context.new_cdp_session(page).send
    send("Input.dispatchTouchEvent", {"type": "touchStart", "touchPoints": [{"x": x, "y": y}]})
    for gone in range(0, up + 1, 15):
        send("Input.dispatchTouchEvent", {"type": "touchMove", "touchPoints": [{"x": x, "y": y - gone}]})
        page.wait_for_timeout(16)
    send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})


def middle(page, name):
    box = page.locator(f"#{name}").bounding_box()
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


def test_a_swipe_that_begins_on_a_map_scrolls_the_page_and_asks_about_nothing(rig, url, open_page):
    rig.show(pressed())
    page = open_page(url, **PHONE)
    before = page.evaluate(PROBE)
    swipe(page, *middle(page, "raw"), 150)
    wait(page, "window.scrollY > 100")
    page.wait_for_timeout(300)
    assert page.evaluate(PROBE) == before


def test_a_tap_on_a_map_reads_it_until_the_next_tap_there(rig, url, open_page):
    rig.show(pressed())
    page = open_page(url, **PHONE)
    before = page.evaluate(PROBE)
    x, y = middle(page, "raw")
    page.touchscreen.tap(x, y)
    page.locator("#probe", has_text="taxel 4, 4").wait_for()
    page.touchscreen.tap(x, y)
    page.locator("#probe", has_text=before).wait_for()


def test_the_help_begins_at_its_beginning(rig, url, open_page):
    rig.show(pressed())
    page = open_page(url, **PHONE)
    page.tap("#help-open")
    wait(page, "document.activeElement.id === 'help-close'")
    assert page.evaluate(
        "(({ scrollHeight, clientHeight }) => scrollHeight > clientHeight)(document.getElementById('help'))"
    )
    title = page.locator("#help-title").bounding_box()
    assert 0 < title["y"] < 100
