"""What keys do, what takes them from the page, how they are switched off, and what is said aloud."""

import pytest

from tests.conftest import pressed
from tests.viewer.conftest import keep, turned, wait
from tests.viewer.test_access import TILES, found
from tests.viewer.test_viewer import show

WHEN = "document.getElementById('when').innerText"
PAUSED = "document.body.classList.contains('paused')"
THEME = "document.documentElement.dataset.theme ?? ''"
TOLD = "document.getElementById('told').textContent"
NOTICE = "document.getElementById('notice').innerText"


@pytest.fixture
def page(rig, url, open_page):
    """The page with three frames."""
    rig.show(pressed(0))
    page = open_page(url)
    for at in (1, 2):
        show(rig, page, pressed(at))
    wait(page, "document.getElementById('scrub').max === '2'")
    return page


def scrubbed(page):
    """Click at the slider's left end, which keeps the focus."""
    page.locator("#scrub").click(position={"x": 2, "y": 8})
    wait(page, PAUSED)
    assert page.evaluate("document.activeElement.id") == "scrub"


def test_keys_act_while_the_slider_has_the_focus_and_its_own_still_move_it(page):
    scrubbed(page)
    page.keyboard.press("ArrowRight")
    wait(page, "document.getElementById('scrub').value === '1'")
    page.keyboard.press("End")
    wait(page, "document.getElementById('scrub').value === '2'")
    with page.expect_download():
        page.keyboard.press("s")
    page.keyboard.press("Space")
    wait(page, f"!{PAUSED}")
    scrubbed(page)
    page.keyboard.press("l")
    wait(page, f"!{PAUSED}")


def test_what_is_typed_into_a_field_is_no_shortcut(page):
    field = page.locator("#range-high")
    field.focus()
    page.keyboard.press("d")
    page.keyboard.press("Space")
    turned(page)
    assert page.evaluate(THEME) == ""
    assert not page.evaluate(PAUSED)


def test_escape_leaves_the_list_of_methods_and_the_next_letter_chooses_none(rig, page):
    page.keyboard.press("m")
    wait(page, "document.activeElement.id === 'method'")
    page.keyboard.press("Escape")
    wait(page, "document.activeElement === document.body")
    with page.expect_download():
        page.keyboard.press("s")
    page.keyboard.press("r")
    turned(page)
    assert rig.sensor.method == "wiener"


@pytest.mark.parametrize("how", ["key", "button"])
def test_forward_of_the_newest_frame_does_not_pause(page, how):
    def forward():
        if how == "key":
            page.keyboard.press("ArrowRight")
        else:
            page.get_by_role("button", name="One frame forward").click()
        turned(page)

    forward()
    assert not page.evaluate(PAUSED)
    page.keyboard.press("ArrowLeft")
    wait(page, PAUSED)
    forward()
    wait(page, f"{WHEN} === 'newest'")


def test_keys_of_one_character_can_be_switched_off_and_stay_so(page):
    page.keyboard.press("?")
    page.get_by_label("Keyboard shortcuts on").focus()
    page.keyboard.press("Space")
    page.keyboard.press("Escape")
    wait(page, "document.activeElement === document.body")  # until then keys are the dialog's
    for key in ("d", "?", "Space"):
        page.keyboard.press(key)
    turned(page)
    assert page.evaluate(THEME) == ""
    assert not page.evaluate(PAUSED)
    assert not page.get_by_role("dialog").is_visible()
    page.keyboard.press("ArrowLeft")
    wait(page, PAUSED)
    page.reload()
    wait(page, "document.getElementById('keys-on').checked === false")
    page.keyboard.press("d")
    turned(page)
    assert page.evaluate(THEME) == ""
    page.get_by_role("button", name="Keyboard and marks").click()
    page.get_by_label("Keyboard shortcuts on").check()
    page.keyboard.press("Escape")
    wait(page, "!document.activeElement.closest('dialog')")
    page.keyboard.press("d")
    wait(page, f"{THEME} === 'light'")


def test_the_wall_says_that_saving_needs_one_sensor(pair, open_page):
    page = open_page(f"{pair[1]}/#/wall", ready=TILES)
    for key in ("s", "c"):
        page.keyboard.press(key)
        wait(page, f"{NOTICE} === 'To save a frame, choose one sensor.'")
        page.evaluate("document.getElementById('notice').textContent = ''")


def test_the_probe_is_read_out_where_it_is_pinned_or_moved_by_keys_and_not_where_it_is_pointed(page):
    box = page.locator("#raw-frame").bounding_box()
    for part in (0.3, 0.5):
        page.mouse.move(box["x"] + part * box["width"], box["y"] + 5)
        turned(page)
    wait(page, "document.getElementById('probe').innerText.startsWith('x ')")
    assert page.evaluate(TOLD) == ""
    page.keyboard.press("p")
    first = wait(page, TOLD)
    assert first.startswith("x ")
    assert "restored" in first
    page.keyboard.press("Alt+ArrowRight")
    second = wait(page, f"{TOLD} !== '{first}' && {TOLD}")
    page.keyboard.press("Alt+ArrowDown")
    wait(page, f"{TOLD} !== '{second}' && {TOLD}")
    wait(page, f"{TOLD} === document.getElementById('probe').textContent")
    page.keyboard.press("Escape")
    wait(page, f"{TOLD} === 'Probe released.'")
    page.keyboard.press("x")
    wait(page, f"{TOLD} === 'Cross-section along y.'")
    assert page.locator("#told").get_attribute("role") == "status"


COLOURS = """() => {
  const keys = [...document.querySelectorAll("#charts section:first-child .key span")].map((each) => {
    const { backgroundColor, backgroundImage } = getComputedStyle(each, "::before");
    return `${backgroundColor} ${backgroundImage}`;
  });
  return { keys, ground: getComputedStyle(document.body).backgroundColor };
}"""


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_colours_that_the_system_forces_leave_raw_and_restored_apart(rig, url, open_page, scheme):
    rig.show(pressed())
    page = open_page(url, color_scheme=scheme)
    page.emulate_media(forced_colors="active")
    turned(page)
    told = page.evaluate(COLOURS)
    assert len(set(told["keys"])) == 2  # the band's is the restored line's, paler
    assert not [each for each in told["keys"] if each.startswith(told["ground"]) and each.endswith("none")]
    inks = page.evaluate("async () => (await import('/static/dom.js')).themeColors()")
    assert len({inks["raw"], inks["restored"], told["ground"]}) == 3
    keep(lambda: rig.show(pressed()), page, "document.body.dataset.level === 'live'")
    assert found(page) == []
