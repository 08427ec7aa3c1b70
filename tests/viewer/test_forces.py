"""A force reads the same wherever it is told, however small it is."""

import pytest

from tests.conftest import ask, pressed
from tests.viewer.conftest import keep, wait
from tests.viewer.test_contacts import LISTED

FORCES = """async forces => {
  const { newtons } = await import("/static/format.js");
  return forces.map(force => newtons(force));
}"""
WATCH = """(() => {
  window.drawn = [];
  const { fillText } = CanvasRenderingContext2D.prototype;
  CanvasRenderingContext2D.prototype.fillText = function (text, ...at) {
    window.drawn.push(text);
    fillText.call(this, text, ...at);
  };
})()"""


@pytest.fixture
def page(rig, url, open_page):
    rig.show(pressed())
    return open_page(url)


@pytest.mark.parametrize(
    ("force", "text"),
    [
        (0, "0.00"),
        (1e-9, "0.00"),
        (-1e-9, "0.00"),
        (0.00123456, "0.00123"),
        (-0.00456, "\u22120.00456"),
        (0.009999, "0.0100"),
        (0.09994, "0.0999"),
        (0.09996, "0.10"),
        (0.1, "0.10"),
        (12.345, "12.35"),
        (-1.234, "\u22121.23"),
    ],
)
def test_a_force_has_two_decimals_and_a_small_one_three_digits(page, force, text):
    assert page.evaluate(FORCES, [force]) == [text]


def written(force):
    return f"{force:.2f}" if force >= 0.1 else f"{force:#.3g}"


def test_a_light_contact_s_force_reads_the_same_in_words_on_the_maps_and_in_a_saved_picture(rig, url, page):
    page.evaluate(WATCH)
    keep(lambda: rig.show(pressed(force=6)), page, f"{LISTED}.length === 1 && Number({LISTED}[0][1]) < 0.05")
    page.keyboard.press("Space")
    wait(page, "document.body.classList.contains('paused')")
    (contact,) = ask("GET", f"{url}/api/v1/sensors/palm/contacts").json()["contacts"]
    image = rig.sensor.hub.latest()
    raw, restored = (float(kpa.sum()) * 1e-3 for kpa in (image.raw, image.restored))  # cells of 1 mm2
    assert contact["force_n"] < 0.05
    wait(page, f"{LISTED}[0][1] === '{written(contact['force_n'])}'")
    wait(page, f"document.getElementById('force-raw').innerText === '{written(raw)}'")
    wait(page, f"document.getElementById('force-restored').innerText === '{written(restored)}'")
    with page.expect_download():
        page.keyboard.press("s")
    drawn = page.evaluate("window.drawn")
    assert f"{contact['id']}: {written(contact['force_n'])} N" in drawn
    for force in (raw, restored):
        assert any(text.startswith(f"force {written(force)} N ") for text in drawn)


def test_a_tile_tells_a_light_force_in_three_digits(pair, open_page):
    rig, url = pair
    text = "document.querySelector('.tile .force').innerText"
    page = open_page(f"{url}/#/wall", ready="document.querySelectorAll('.tile').length === 2")
    light = pressed(force=6)
    told = keep(lambda: rig.both(palm=light), page, f"/^0\\.0\\d+ N$/.test({text}) && {text}")
    assert told == f"{written(float(rig.sensor.hub.latest().restored.sum()) * 1e-3)} N"
