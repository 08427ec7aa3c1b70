"""What is told of a frame that is shown still: its own, or said to be of another moment."""

import re
import threading

from tactiled.restore.methods import METHODS
from tactiled.wire import RAN
from tests.conftest import pressed, until
from tests.viewer.conftest import turned, wait
from tests.viewer.test_contacts import LISTED, SWITCH, two
from tests.viewer.test_viewer import PAINTINGS, painted, show

ANOTHER = re.compile(r"of \d+ ms (before|after)$")
OWN = "in the restored image"


def test_the_page_knows_every_method_by_the_number_that_images_bear(rig, url, open_page):
    rig.show(pressed())
    known = open_page(url).evaluate("async () => (await import('/static/wire.js')).RAN")
    assert tuple(known) == RAN


def said(page, *names):
    """What stands at these places."""
    return [page.locator(f"#{name}").inner_text() for name in names]


def test_a_frame_shown_still_is_told_with_its_own_method_and_reason_or_with_none(rig, url, open_page):
    rig.show(pressed())
    page = open_page(url)
    titles = {
        each: page.locator(f"#method option[value={each}]").inner_text() for each in METHODS if each != "auto"
    } | {"idle": "idle"}
    images = {}
    for method, drop in 3 * [("raw", ()), ("nnls", (0,)), ("wiener", ()), ("auto", ())]:
        rig.sensor.pipeline.set_method(method)
        before = painted(page)
        rig.send(pressed(), drop=drop)
        wait(page, f"{PAINTINGS} > {before}")
        until(lambda: (image := rig.sensor.hub.latest()) and image.sequence == rig.sequence)
        images[rig.sequence] = rig.sensor.hub.latest()
    wait(page, f"document.getElementById('ran').innerText === '{titles[images[rig.sequence].method]}'")
    page.keyboard.press("Space")
    owned = 0
    for back in range(len(images)):
        sequence, ran, why, warnings, of = said(page, "sequence", "ran", "why", "warnings", "made-of")
        image = images.pop(int(sequence))
        assert ran == titles[image.method]
        if back % 4 == 1:
            with page.expect_download() as download:
                page.keyboard.press("c")
            assert f", method {image.method}\n" in download.value.path().read_text()
        if of:
            assert ANOTHER.search(of) or of == "words not told"
        else:
            assert (why, warnings) == (image.why, "\n".join(each.text for each in image.warnings))
            owned += 1
        page.keyboard.press("ArrowLeft")
        turned(page)
    assert not images
    assert owned > 1


def test_contacts_of_another_moment_are_said_to_be(rig, url, open_page):
    rig.show(pressed())
    page = open_page(url)
    stop = threading.Event()
    sender = rig.play(30, stop)
    wait(page, "Number(document.getElementById('scrub').max) > 60")
    page.keyboard.press("Space")
    stop.set()
    sender.join()
    seen = {"own": 0, "another": 0}
    for _ in range(40):
        page.keyboard.press("ArrowLeft")
        turned(page)
        of, x = said(page, "contacts-of", "x-restored")
        listed = page.evaluate(LISTED)
        if not listed:
            continue
        ((*_, at, _y),) = listed
        seen["own" if of == OWN else "another"] += 1
        if of == OWN:
            assert abs(float(at) - float(x)) < 0.3
        else:
            assert ANOTHER.match(of)
    assert all(seen.values()), seen


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
