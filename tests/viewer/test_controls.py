"""Keys, fields, themes, tares, touch, and what is announced aloud."""

import re

from tests.conftest import pressed
from tests.viewer.conftest import FITS, PAUSED, SCROLL_WIDTH, TOUCH

THEME = "(document.documentElement.dataset.theme ?? '')"
ANNOUNCED = "document.getElementById('announce-politely').textContent"
NOTICE = "document.getElementById('notice').innerText"
BACKGROUND = "getComputedStyle(document.body).backgroundColor"
LIGHT, DARK = "rgb(238, 241, 244)", "rgb(14, 18, 22)"
# Whether this key is left to the browser, which goes back by it.
BACK = """document.body.dispatchEvent(
  new KeyboardEvent("keydown", { key: "ArrowLeft", altKey: true, bubbles: true, cancelable: true }))"""
NO_DIALOG = "!document.activeElement.closest('dialog')"


def test_keys_act_but_not_in_fields_lists_and_dialogs_and_can_be_switched_off(rig, page):
    for at in (1, 2):
        page.show(rig, pressed(at))
    page.wait("document.getElementById('scrub').max === '2'")
    page.locator("#scrub").click(position={"x": 2, "y": 8})  # pauses, and keeps the focus
    page.wait(PAUSED)
    for key, value in (("ArrowRight", "1"), ("End", "2")):  # the slider's own
        page.press(key)
        page.wait(f"document.getElementById('scrub').value === '{value}'")
    page.download("s")
    page.press("Space")
    page.wait(f"!{PAUSED}")
    page.locator("#range-high").focus()
    page.press("d", "Space")
    page.refreshed()
    assert not page.evaluate(f"{THEME} || {PAUSED}")
    page.locator("#maps").focus()
    page.press("m")
    page.wait("document.activeElement.id === 'method'")
    page.press("Escape")
    page.wait("document.activeElement === document.body")
    page.press("r", "?")  # the first would choose a method in the list
    page.get_by_label("Keyboard shortcuts on").focus()
    page.press("Space", "Escape")
    page.wait(NO_DIALOG)
    page.press("d", "?", "Space")
    page.refreshed()
    assert rig.sensor.method == "wiener"
    assert not page.evaluate(f"{THEME} || {PAUSED} || document.getElementById('help').open")
    page.press("ArrowLeft")
    page.wait(PAUSED)
    page.reload()
    page.wait("document.getElementById('keys-on').checked === false")
    page.get_by_role("button", name="Keyboard and marks").click()
    page.get_by_label("Keyboard shortcuts on").check()
    page.press("Escape")
    page.wait(NO_DIALOG)
    page.press("d")
    page.wait(f"{THEME} === 'dark'")


def test_the_probe_is_announced_by_keys_alone_and_a_typed_range_is_taken_or_refused_with_the_reason(rig, page):
    frame = page.box("#raw-frame")
    page.mouse.move(frame["x"] + frame["width"] / 2, frame["y"] + frame["height"] / 2)
    page.locator("#probe", has_text="taxel r4 c4").wait_for()
    page.mouse.move(5, 5)
    page.locator("#probe", has_text="Point at a map").wait_for()
    assert page.box("#raw-frame") == frame  # the maps stay still
    assert page.evaluate(ANNOUNCED) == ""
    assert page.evaluate(BACK)
    last = ""
    for key in ("p", "Alt+ArrowRight", "Alt+ArrowDown"):
        page.press(key)
        last = page.wait(f"{ANNOUNCED} !== '{last}' && {ANNOUNCED}")
        assert re.match(r"x .* restored", last)
    assert not page.evaluate(BACK)
    page.wait(f"{ANNOUNCED} === document.getElementById('probe').textContent")
    for key, words in (("Escape", "Probe released."), ("x", "Cross-section along y.")):
        page.press(key)
        page.wait(f"{ANNOUNCED} === '{words}'")

    def enter(name, number, last="Enter"):
        field = page.get_by_label(name, exact=True)
        field.fill("")
        field.press_sequentially(number)
        if last:
            field.press(last)

    def shows(low, high, *fields):
        page.refreshed()
        assert page.locator("#colorbar").get_attribute("aria-label") == f"Colour scale from {low} to {high} kPa"
        assert [page.locator(f"#range-{end}").input_value() for end in ("low", "high")] == list(
            fields or (low, high)
        )

    enter("to", "50")
    shows("0", "50")
    for name, number in (("from", "60"), ("to", "-1")):
        enter(name, number)
        page.wait(f"{NOTICE} === 'The maximum must exceed the minimum; range unchanged.'")
        shows("0", "50")
        page.evaluate("document.getElementById('notice').textContent = ''")
    enter("from", "12", last=None)
    shows("0", "50", "12", "50")
    page.locator("#maps").focus()
    shows("12", "50")
    page.show(rig, pressed(2, force=2000))
    shows("12", "50")
    for width, number in ((390, "1234567"), (1280, "50.00000125")):
        page.resize(width, 860)
        enter("to", number)
        page.evaluate("document.getElementById('probe').textContent = ''")
        page.wait("document.getElementById('probe').textContent")  # the texts came again
        assert page.locator("#range-high").input_value() == number
        assert page.locator("#range-high").evaluate(FITS)
        assert page.evaluate(SCROLL_WIDTH) <= width


KEY_COLORS = """[...document.querySelectorAll(".chart:first-child .key span")].map(each => {
  const { backgroundColor, backgroundImage } = getComputedStyle(each, "::before");
  return `${backgroundColor} ${backgroundImage}`;
})"""


def test_the_theme_is_the_systems_until_another_is_chosen_and_forced_colors_differ(rig, page):
    for scheme, color in (("dark", DARK), ("light", LIGHT)):
        page.emulate_media(color_scheme=scheme)
        assert page.evaluate(BACKGROUND) == color
    for color in (DARK, LIGHT):  # the first press changes what is seen
        page.press("d")
        assert page.evaluate(BACKGROUND) == color
    page.reload()
    page.wait(f"{BACKGROUND} === '{LIGHT}'")
    page.press("d")
    block = pressed(force=0)
    block[1:7, 2:5] += 400
    for scheme in ("dark", "light"):
        page.emulate_media(color_scheme=scheme, forced_colors="active")
        page.refreshed()
        keys, background = page.evaluate(KEY_COLORS), page.evaluate(BACKGROUND)
        assert len(set(keys)) == 2  # the band's is the restored line's, paler
        assert not [each for each in keys if each.startswith(background) and each.endswith("none")]
        colors = page.evaluate("async () => (await import('/static/shell/dom.js')).themeColors()")
        assert len({colors["raw"], colors["restored"], background}) == 3
        page.keep(lambda: rig.show(block), "document.body.dataset.level === 'live'")
        assert page.violations() == []
    page.set_range(0, 500)
    cell = page.pixels("section")[20:-34, 46:-12]  # without the axes
    cell = cell[:, 4 + cell.shape[1] * 3 // 8 : cell.shape[1] * 4 // 8 - 4]  # where the two lines lie apart
    raw, restored = (
        (abs(cell - [*map(int, re.findall(r"\d+", colors[name])), 255]) < 5).all(axis=2).mean(axis=1).max()
        for name in ("raw", "restored")
    )
    assert 0.4 < raw < 0.8  # dashed
    assert restored == 1


def test_a_tare_asks_where_the_array_is_loaded(rig, page):
    rig.stale_after(600)
    page.show(rig, pressed())
    question = page.get_by_role("dialog", name="The array is loaded")
    for key in ("Enter", "Escape"):
        page.press("t")
        question.get_by_text("palm: contact of 200 kPa on 4 taxels.").wait_for()
        assert page.evaluate("document.activeElement.innerText") == "Cancel"
        page.press(key)
        page.wait("!document.querySelector('dialog[open]')")
    images = [rig.show(pressed()) for _ in range(20)]
    assert (rig.sensor.pipeline.tares.done, abs(images[-1].raw).max()) == (0, 200)
    assert page.locator("#notice").is_hidden()
    page.press("t")
    question.get_by_role("button", name="Tare anyway").click()
    notice = page.locator("#notice")
    for _ in range(2):
        notice.get_by_text("Tare: the next frames").wait_for()
        assert abs(rig.show_until_tared(pressed()).raw).max() < 1
        page.keep(lambda: rig.show(pressed()), "parseFloat(document.getElementById('peak-raw').innerText) < 1")
        notice.get_by_text("palm: tare complete.").wait_for()
        page.get_by_role("button", name="Undo tare").wait_for()  # the notice ends before somebody sees the mistake
        zero = rig.sensor.pipeline.zero
        page.press("t")  # unloaded now: nothing is asked
    notice.get_by_text("Tare: the next frames").wait_for()
    rig.show_until_tared(pressed())
    notice.get_by_role("button", name="Undo").wait_for()
    page.get_by_role("button", name="Undo tare").click()
    notice.get_by_text("palm: the zero before is back.").wait_for()
    page.wait("document.getElementById('tare-undo').hidden")
    assert rig.sensor.pipeline.zero is zero
    page.finish("409")


def test_on_a_phone_a_tap_reads_a_map_a_swipe_scrolls_and_the_help_begins_at_its_top(rig, url, open_page):
    rig.show(pressed())
    page = open_page(f"{url}/#nobody", **TOUCH)
    assert page.url == f"{url}/#palm"  # whatever the address names
    page.locator("#restored-caption", has_text="peak").wait_for()
    (hint,) = page.text("probe")
    frame = page.box("#raw")
    x, y = frame["x"] + frame["width"] / 2, frame["y"] + frame["height"] / 2
    page.swipe(x, y, 0, -150)
    page.wait("window.scrollY > 100")
    assert page.text("probe") == [hint]
    page.evaluate("window.scrollTo(0, 0)")
    for words in ("taxel r4 c4", hint):
        page.touchscreen.tap(x, y)
        page.locator("#probe", has_text=words).wait_for()
    page.tap("#help-open")
    page.wait("document.activeElement.id === 'help-close'")
    assert page.evaluate("(help => help.scrollHeight > help.clientHeight)(document.getElementById('help'))")
    assert 0 < page.box("#help-title")["y"] < 100
