"""What is told of a frame that is shown still: its own, or said to be of another moment."""

from tests.conftest import pressed
from tests.viewer.conftest import wait
from tests.viewer.test_contacts import LISTED, SWITCH, two
from tests.viewer.test_viewer import show


def test_contacts_switched_off_and_on_while_paused_come_back(rig, url, open_page):
    rig.show(two())
    page = open_page(url)
    wait(page, f"{LISTED}.length === 2")
    page.keyboard.press("Space")
    before = page.evaluate(LISTED)
    for count in (0, 2):
        with page.expect_websocket():
            page.evaluate(SWITCH)
        wait(page, f"{LISTED}.length === {count}")
    assert page.evaluate(LISTED) == before
    page.keyboard.press("l")
    show(rig, page, pressed(5))
    wait(page, f"{LISTED}.length === 1")
