"""The guided calibration: every step from loads and presses to what is applied."""

import pytest

from tactiled.config import Server
from tactiled.web.server import running
from tests.calibrating import TIP_MM, TRUE_FACTOR, CalibratedSkin
from tests.conftest import CONTROL, READ, TOKENS
from tests.viewer.conftest import SCROLL_WIDTH

VISIBLE = "document.getElementById('calibrate-{}').checkVisibility()"
MESSAGE = "document.getElementById('calibrate-message').innerText"
ADVICE = "document.getElementById('calibrate-advice').innerText"
ROW = "[...document.querySelectorAll('#calibrate-result tbody tr td')].map(each => each.innerText)"
SLOW = """() => {
  window.quick = window.fetch;
  window.fetch = async (...all) => {
    await new Promise(done => setTimeout(done, 700));
    return window.quick(...all);
  };
}"""
USELESS = "[...document.querySelectorAll('#calibrate .discard, #calibrate-again')].map(each => each.disabled)"
LATE_ANSWER = """() => {
  window.quick = window.fetch;
  window.fetch = async (...all) => {
    const answer = await window.quick(...all);
    if (String(all[0]).endsWith("/calibration")) await new Promise(done => { window.release = done; });
    return answer;
  };
}"""


@pytest.fixture
def skin(rig):
    rig.stale_after(600)
    skin = CalibratedSkin(rig)
    skin.level(0)
    return skin


def test_a_gain_is_fitted_step_by_step_and_applied(rig, skin, url, open_page):
    page = open_page(url)
    page.press("k")
    page.get_by_text("Take everything off the array.").wait_for()
    page.wait("document.getElementById('calibrate-load').innerText === 'none'")
    page.inspect()
    page.get_by_role("button", name="Next").press("Enter")
    page.get_by_role("radio", name="Even pressure").wait_for()
    page.inspect()
    page.get_by_role("button", name="Start").click()
    page.wait(VISIBLE.format("collect"))  # frames count from then on
    for kpa in (0, 150, 300):
        skin.level(kpa)
        page.get_by_label("The array is under").fill(str(kpa))
        page.get_by_role("button", name="Take").click()
        page.wait(f"{MESSAGE} === 'Taken: {kpa} kPa.'")
    page.wait(f"{ADVICE} === '3 loads: enough (0, 150, 300 kPa)'")
    page.inspect()
    page.get_by_role("button", name="Fit", exact=True).click()
    page.wait(VISIBLE.format("result"))
    fitted, interval, before = page.evaluate(ROW)[:3]
    assert before == "0.5"
    low, high = map(float, interval.split(" to "))
    assert low < float(fitted) < high
    page.inspect()
    assert page.evaluate(SCROLL_WIDTH) <= 390
    page.evaluate(SLOW)
    page.get_by_role("button", name="Apply").click()
    assert page.evaluate(USELESS) == [True, True, True]
    page.wait(f"{MESSAGE}.startsWith('The gain is applied.')")
    assert page.evaluate(USELESS) == [False, False, False]
    page.evaluate("window.fetch = window.quick")
    assert rig.sensor.plan.file.gain is not None
    page.get_by_role("button", name="Undo the gain").click()
    page.wait(f"{MESSAGE} === 'Undone: the calibration before holds again.'")
    assert not page.evaluate(VISIBLE.format("undo"))
    assert rig.sensor.plan.file is None
    assert rig.service.events.after(0)[-1].text == "configured: the values of the configuration hold"
    page.press("Escape")
    assert not page.evaluate("document.getElementById('calibrate').open")
    page.finish("404")  # of a look at what was just applied


@pytest.mark.usefixtures("rig")
def test_a_late_look_ends_nothing_and_what_has_failed_is_said_once_and_covers_no_later_message(
    skin, url, open_page
):
    page = open_page(url)
    page.press("k")
    page.get_by_role("button", name="Gain").click()
    page.evaluate(LATE_ANSWER)
    page.wait("!!window.release")
    page.get_by_role("button", name="Start").click()
    page.wait(VISIBLE.format("collect"))
    page.evaluate("() => { window.fetch = window.quick; window.release(); }")
    for _ in range(2):
        with page.expect_response(lambda answer: answer.url.endswith("/calibration/session")):
            pass
    assert page.evaluate(MESSAGE) == ""
    for kpa in (0, 150):
        skin.level(kpa)
        page.get_by_label("The array is under").fill(str(kpa))
        page.get_by_role("button", name="Take").click()
        page.wait(f"{MESSAGE} === 'Taken: {kpa} kPa.'")
        if not kpa:
            page.get_by_role("button", name="Fit", exact=True).click()
            page.wait(f"{MESSAGE}.startsWith('pressure_kpa: 1 load: ')")
    for _ in range(2):
        with page.expect_response(lambda answer: answer.url.endswith("/calibration/session")):
            pass
    assert page.evaluate(MESSAGE) == "Taken: 150 kPa."
    page.route("**/sensors/palm/calibration", lambda route: route.abort(), times=1)
    page.wait(f"{MESSAGE} !== 'Taken: 150 kPa.'")
    page.wait(f"{MESSAGE} === ''")
    page.finish("ERR_FAILED")


def test_a_cover_is_fitted_to_presses_after_the_token_was_given_and_discarded(rig, skin, open_page):
    skin.gain[:] = 0.5
    with running(rig.service, Server(port=0, **TOKENS)) as url:
        page = open_page(f"{url}/?token={READ}")
        page.get_by_role("button", name="Calibrate").click()
        page.get_by_role("button", name="Cover thickness").click()
        page.get_by_label("Diameter of its flat end").fill(str(TIP_MM))
        page.get_by_role("button", name="Start").click()
        page.wait("document.activeElement.id === 'token-field'")
        page.keyboard.type(CONTROL)
        page.press("Enter")
        page.wait(VISIBLE.format("collect"))
        assert page.locator("#calibrate-fit").is_disabled()
        skin.press(12)
        skin.level(0)
        page.wait(f"{ADVICE}.startsWith('12 of 20 presses')")
        zones = page.evaluate("[...document.querySelectorAll('#calibrate-zones li')].map(each => each.innerText)")
        assert sum(int(each.removeprefix("✓ ").split()[0]) for each in zones) == 12
        page.inspect()
        page.evaluate(SLOW)
        page.wait_for_timeout(600)  # a look is under way when it is closed
        page.press("Escape", "k")  # another look, as by another viewer: it goes on
        page.wait(VISIBLE.format("collect"))
        page.evaluate("window.fetch = window.quick")
        page.get_by_role("button", name="Fit", exact=True).click()
        page.wait(VISIBLE.format("result"))
        fitted, interval, before = page.evaluate(ROW)
        low, high = map(float, interval.split(" to "))
        assert low < float(fitted) < high
        assert float(fitted) == pytest.approx(TRUE_FACTOR * 0.8, rel=0.03)
        assert before == "0.80"
        page.inspect()
        page.get_by_role("button", name="Discard").click()
        page.wait(f"{MESSAGE} === 'Discarded: nothing was changed.'")
        assert rig.sensor.plan.file is None
        page.finish("403", "404")  # of a look at what was just discarded
