import numpy as np
import pytest

from tests.conftest import ask, pressed
from tests.viewer.conftest import wait
from tests.viewer.test_viewer import PAINTINGS, painted, pixels, show

LISTED = (
    "[...document.querySelectorAll('#contact-list tbody tr')].map(row => [...row.cells].map(c => c.innerText))"
)
SWITCH = "document.getElementById('contacts-on').click()"


def two(at=1):
    """Two contacts, the second one weaker."""
    counts = pressed(at)
    counts[0:2, 6:8] += 150
    return counts


def at(page, marks, contact):
    """RGBA of the marks at a contact's centre, and of its outline on the right."""
    got, side = pixels(page, marks), 8.0  # mm, of the map; taxels are 1 mm, the first one's centre is 0, 0
    rows, columns = got.shape[:2]
    angle, reach = contact["angle_rad"], max(2 * contact["major_mm"], 6 * side / columns)
    places = [
        (contact["x_mm"], contact["y_mm"]),
        (contact["x_mm"] + reach * np.cos(angle), contact["y_mm"] + reach * np.sin(angle)),
    ]
    return [got[int((y + 0.5) / side * rows), int((x + 0.5) / side * columns)] for x, y in places]


@pytest.mark.parametrize("marks", ["raw-marks", "restored-marks"])
def test_contacts_are_outlined_on_both_maps_and_listed_with_their_force(rig, url, open_page, marks):
    rig.show(two())
    page = open_page(url)
    wait(page, f"{LISTED}.length === 2")
    told = ask("GET", f"{url}/api/v1/sensors/palm/contacts").json()["contacts"]
    listed = page.evaluate(LISTED)
    assert [int(row[0]) for row in listed] == [each["id"] for each in told]
    assert [float(row[1]) for row in listed] == [round(each["force_n"], 2) for each in told]
    assert float(listed[0][1]) > float(listed[1][1])
    for contact in told:
        centre, outline = at(page, marks, contact)
        assert (centre > 240).all()  # white, but for the smoothing of its edge
        assert outline[3] > 0


def test_contacts_follow_what_moves_under_the_same_number(rig, url, open_page):
    rig.show(pressed(1))
    page = open_page(url)
    wait(page, f"{LISTED}.length === 1")
    number, *_, x, _y = page.evaluate(LISTED)[0]
    show(rig, page, pressed(3))
    wait(page, f"{LISTED}.length === 1 && {LISTED}[0][4] !== '{x}'")
    assert page.evaluate(LISTED)[0][0] == number
    assert float(page.evaluate(LISTED)[0][4]) == pytest.approx(float(x) + 2, abs=0.2)


def test_contacts_switched_off_are_neither_drawn_nor_asked_for(rig, url, open_page):
    rig.show(pressed(1))
    page = open_page(url)
    wait(page, f"{LISTED}.length === 1")
    (told,) = ask("GET", f"{url}/api/v1/sensors/palm/contacts").json()["contacts"]
    before = painted(page)
    with page.expect_websocket() as opened:
        page.evaluate(SWITCH)
    assert "contacts" not in opened.value.url
    assert "contacts=1" not in opened.value.url
    wait(page, f"{PAINTINGS} > {before}")
    wait(page, f"{LISTED}.length === 0")
    assert "switched off" in page.locator("#contact-list").inner_text()
    assert at(page, "restored-marks", told)[0][3] == 0  # inside the ring about the centre of pressure
    with page.expect_websocket() as opened:
        page.evaluate(SWITCH)
    assert "contacts=1" in opened.value.url
    wait(page, f"{LISTED}.length === 1")
