"""Comparing the maps: difference, slider, colours, what is beyond the range, and the address of it all."""

import re

import numpy as np
import pytest

from tactiled.web.server import running
from tests.conftest import Rig, ask, meanwhile, pressed
from tests.viewer.conftest import CONTACTS, DESK, PAINTINGS, PAUSED, PHONE, SCROLL_WIDTH, TOUCH, WATCH_TEXTS

ABOVE = (0, 229, 255)
ABOVE_DIFFERENCE = (255, 196, 0)  # beside the red of the differences
FRAMES = "['raw-frame', 'restored-frame'].map(id => document.getElementById(id).getBoundingClientRect().toJSON())"


def colors_of(url, name):
    return np.array(ask("GET", f"{url}/api/v1/colormap?name={name}").json()["colors"])


def test_an_address_keeps_a_view_of_the_difference_and_on_the_slider_raw_ends_where_restored_begins(
    rig, url, open_page
):
    rig.show(pressed())
    page = open_page(f"{url}/#palm?view=difference&colors=viridis&range=0:5")
    image = page.show(rig, pressed(5))
    label = page.locator("#difference-colorbar").get_attribute("aria-label").replace("\u2212", "-")
    low, high = (float(number) for number in re.findall(r"-?[\d.]+", label))
    assert low == -high
    difference = image.restored - image.raw
    assert high == 5  # as the address fixes it for the maps
    low_text, high_text = (f"{each:+.1f}".replace("-", "\u2212") for each in (difference.min(), difference.max()))
    row, column = np.unravel_index(difference.argmax(), difference.shape)
    extremes = f": {low_text} to {high_text} kPa at x {column:.2f}, y {row:.2f} mm"
    page.wait(f"document.getElementById('difference-extremes').textContent === '{extremes}'")
    levels = np.clip(np.floor((difference + high) * 128 / high), 0, 255).astype(int)
    signed = page.pixels("difference")[..., :3]
    within = np.abs(difference) < high
    assert (np.abs(signed - colors_of(url, "RdBu_r")[levels])[within] <= 6).all()
    assert (signed[difference > high] == ABOVE_DIFFERENCE).all()
    assert (difference > high).any()
    assert not page.locator("#raw").is_visible()
    page.evaluate(WATCH_TEXTS)
    page.download("s")
    saved = page.evaluate("window.drawn.filter(each => each.saved).map(each => each.text)")
    assert extremes.removeprefix(": ") in saved
    page.locator("#difference-frame").click()
    probe = page.locator("#probe", has_text="difference")
    row, column = map(int, re.search(r"taxel r(\d+) c(\d+)", probe.inner_text()).groups())
    signed_text = f"{difference[row, column]:+.1f}".replace("-", "\u2212")
    assert f", difference {signed_text} kPa (" in probe.inner_text()
    assert page.pixels("difference-marks")[..., 3].any()
    restored, above = page.pixels("restored")[..., :3], image.restored > 5
    assert above.any()
    assert (restored[above] == ABOVE).all()
    levels = np.clip(np.floor(image.restored * 256 / 5), 0, 255).astype(int)
    clear = ~above & (image.restored > 0)
    assert (np.abs(restored - colors_of(url, "viridis")[levels])[clear] <= 4).all()
    page.get_by_label("View").select_option("slider")
    page.wait("location.hash.includes('view=slider') && location.hash.includes('range=0:5')")
    page.locator("#range-auto").check()
    page.get_by_label("View").select_option("both")
    page.get_by_label("Colours").select_option("magma")
    page.wait("location.hash === '#palm'")
    page.locator("#hold").select_option("peak")
    page.locator("#path-on").check()
    other = page.show(rig, pressed(1))
    page.locator("#restored-sub", has_text="highest since").wait_for()
    colors = page.pixels("restored")[..., :3]
    for one in (image, other):
        row, column = np.unravel_index(one.restored.argmax(), one.restored.shape)
        assert colors[row, column].sum() > 300
    page.resize(**DESK)
    beside = page.box("#raw-frame")["height"]
    page.get_by_label("View").select_option("slider")
    for size, least in ((DESK, beside), (PHONE, 150)):
        page.resize(**size)
        raw, restored = page.evaluate(FRAMES)  # at one moment: a line above them comes and goes
        assert raw == restored
        assert raw["height"] >= least
        for share in (25, 75):
            page.locator("#split").fill(str(share))
            for x, name in ((share - 10, "raw"), (share + 10, "restored")):
                at = f"{raw['x'] + raw['width'] * x / 100}, {raw['y'] + raw['height'] / 2}"
                assert page.evaluate(f"document.elementFromPoint({at}).closest('.frame').id") == f"{name}-frame"
        assert page.violations() == []
    page.resize(**DESK)
    frame, handle = page.box("#restored-frame"), page.box("#split-handle")
    page.mouse.move(handle["x"] + handle["width"] / 2, handle["y"] + handle["height"] / 2)
    page.mouse.down()
    page.mouse.move(frame["x"] + 0.25 * frame["width"], frame["y"] + 5)
    page.mouse.up()
    page.wait("document.getElementById('split').value === '25'")
    assert frame["height"] > 0.6 * DESK["height"]
    page.locator("#split").focus()
    page.press("ArrowRight")
    page.wait(f"document.getElementById('split').value === '26' && !{PAUSED}")


LABEL = "document.getElementById('restored-surface').ariaLabel"
VIEW = rf"{LABEL}.match(/by (-?\d+)°, seen from (\d+)°/).slice(1).map(Number)"


def test_surfaces_are_turned_by_pointer_and_keys_and_a_link_restores_the_view(pair, open_page):
    rig, url = pair
    page = open_page(f"{url}/#palm?range=0:5", **DESK)
    page.get_by_label("View").select_option("surface")
    page.wait("location.hash === '#palm?view=surface&range=0:5'")
    page.refreshed()
    assert not page.locator("#restored").is_visible()
    first = page.pixels("restored-surface")
    assert page.evaluate(VIEW) == [-30, 35]
    box = page.box("#raw-surface")
    page.mouse.move(box["x"] + 150, box["y"] + 150)
    page.mouse.down()
    page.mouse.move(box["x"] + 130, box["y"] + 170)
    page.mouse.up()
    page.wait(f"{VIEW}.join() === '-20,45'")  # both are
    assert (page.pixels("restored-surface") != first).any()
    page.locator("#restored-surface").focus()
    page.press("ArrowLeft", "ArrowUp")  # which would show an older frame
    page.wait(f"{VIEW}.join() === '-15,40' && !document.body.classList.contains('paused')")
    page.get_by_role("button", name="Turn back").click()
    page.wait(f"{VIEW}.join() === '-30,35'")
    np.testing.assert_array_equal(page.pixels("restored-surface"), first)
    page.inspect()
    page.locator("#restored-surface").focus()
    page.press(*["ArrowDown"] * 12)
    page.wait(f"{VIEW}.join() === '-30,90'")  # from above, where no column hides another
    above = page.pixels("restored-surface").reshape(-1, 4)
    colors = {tuple(each) for each in above[above[:, 3] > 0]}
    assert colors == {tuple(each) for each in page.pixels("restored").reshape(-1, 4)}
    assert (*ABOVE, 255) in colors
    rig.both()
    page.press("2", "a")  # of no grid: its taxels have the columns of the cells around them
    page.wait(f"location.hash.startsWith('#thumb') && !{LABEL}.includes('0 to 5 ')")
    page.refreshed()
    for name in ("raw", "restored"):
        above = page.pixels(f"{name}-surface").reshape(-1, 4)
        columns = {tuple(each) for each in above[above[:, 3] > 0]}
        assert columns <= {tuple(each) for each in page.pixels(name).reshape(-1, 4)}
        assert len(columns) > 2
    page.press("1")
    page.wait("location.hash.startsWith('#palm')")
    page.context.grant_permissions(["clipboard-read", "clipboard-write"])
    page.get_by_role("button", name="Link").click()
    page.locator("#notice", has_text="Link copied.").wait_for()
    link = page.evaluate("navigator.clipboard.readText()")
    assert "colors=magma" in link  # which another browser may have chosen others than
    phone = open_page(link, **TOUCH)
    phone.wait(f"{VIEW}.join() === '-30,90'")
    box = phone.box("#raw-surface")
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    phone.swipe(x, y, 80, 0)
    phone.wait(f"{VIEW}[0] < -45 && scrollY === 0")
    phone.swipe(x, y, 0, -150)
    phone.wait("scrollY > 50")  # the page's own
    assert phone.evaluate(VIEW)[1] == 90


def test_the_axes_of_a_surface_have_room_however_it_is_turned(rig, url, open_page):
    rig.show(pressed())
    page = open_page(f"{url}/#palm?view=surface&range=0:500", **PHONE)
    page.evaluate(WATCH_TEXTS)
    page.locator("#restored-surface").focus()
    for turn in range(24):
        if turn == 12:
            page.resize(**DESK)
        page.evaluate("window.drawn = []")
        page.press(*["ArrowLeft"] * 6)
        page.refreshed()
        texts = page.evaluate("window.drawn.filter(each => each.id === 'restored-axes')")
        assert {"x, mm", "y, mm", "kPa", "500"} <= {each["text"] for each in texts}
        for each in texts:
            x, y, to_x, to_y = each["box"]
            assert 0 <= x < to_x <= each["width"], each
            assert 0 <= y < to_y <= each["height"], each
        assert page.evaluate(f"{SCROLL_WIDTH} <= innerWidth")


def test_values_stand_in_cells_that_are_large_enough(rig, url, open_page):
    image = rig.show(pressed())
    page = open_page(f"{url}/#palm?range=0:500", **DESK)
    page.wait(f"{CONTACTS}.length > 0")
    page.evaluate("document.querySelector('#restored ~ .values').id = 'values'")
    page.press("Space")
    page.evaluate(WATCH_TEXTS)
    page.resize(1280, 900)
    peak = f"{image.restored.max():.3g}"
    written = f"window.drawn.filter(each => each.id === 'values' && each.text === '{peak}')"
    page.wait(f"{written}.length > 0")
    row, column = np.argwhere(image.restored == image.restored.max())[0]
    at = page.evaluate(f"{written}[0]")
    assert at["x"] / at["width"] == pytest.approx((column + 0.5) / 8, abs=0.01)
    assert int(at["y"] / at["height"] * 8) == row
    label = page.evaluate("window.drawn.findLast(each => each.id === 'restored-marks')")  # a resize may draw twice
    from_x, from_y, end_x, end_y = label["box"]
    texts = page.evaluate("window.drawn.filter(each => each.id === 'values')")
    boxes = [each["box"] for each in texts if each["width"] == label["width"]]
    assert boxes
    for x, y, to_x, to_y in boxes:
        assert to_x < from_x or x > end_x or to_y < from_y or y > end_y  # none under the contact's label
    some = "document.getElementById('values').getContext('2d').getImageData(0, 0, 999, 999).data.some(Boolean)"
    page.wait(some)
    page.resize(390, 844)  # cells of 20 px
    page.wait(f"!{some}")


def test_the_demo_says_what_to_look_at_until_that_is_closed(page, open_page):
    assert not page.locator("#demo").is_visible()
    with meanwhile(Rig("demo")) as rig, running(rig.service) as url:
        rig.show(pressed())
        first = open_page(url)
        assert first.locator("#demo").is_visible()
        first.inspect()
        first.get_by_role("button", name="Close").click()
        assert not first.locator("#demo").is_visible()
        first.reload()
        first.wait(f"{PAINTINGS} > 0")
        assert not first.locator("#demo").is_visible()
        first.finish()
