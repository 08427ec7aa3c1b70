"""Both maps: their colours, the frames kept, contacts, forces, and what is said of a still image."""

import re
from datetime import UTC, datetime

import can
import numpy as np
import pytest
from PIL import Image

from tactiled.restore.methods import METHODS
from tests.conftest import ask, pressed, until
from tests.viewer.conftest import CONTACTS, LIVE, PAINTINGS, PAUSED, WATCH_TEXTS

BELOW_ZERO = (122, 140, 255)
OFFSET = re.compile(r"from \d+ ms (earlier|later)$")


def roundest(value):
    """The least round number that is not below a value."""
    return min(
        step * 10**n for n in range(5) for step in (1, 1.2, 1.5, 2, 2.5, 3, 4, 5, 6, 8) if step * 10**n >= value
    )


def test_maps_show_the_data_in_the_colours_of_the_range(rig, url, open_page):
    rig.show(pressed(2))
    page = open_page(f"{url}/#%zz")
    assert page.url == f"{url}/#palm"  # whatever the address names
    colors = np.array(ask("GET", f"{url}/api/v1/colormap").json()["colors"])
    page.evaluate(WATCH_TEXTS)
    for at in (1, 5):
        page.evaluate("window.drawn = []")
        image = page.show(rig, pressed(at))
        written = page.evaluate("window.drawn.filter(each => !each.id).map(each => each.text)")
        assert {f"{peak.max():.3g}" for peak in (image.raw, image.restored)} <= {*written}
        label = page.locator("#colorbar").get_attribute("aria-label")
        low, high = (float(number) for number in re.findall(r"[\d.]+", label))
        assert low == 0
        assert high >= image.restored.max()
        for name, values in (("raw", image.raw), ("restored", image.restored)):
            expected = colors[np.clip(np.floor(values * 256 / high), 0, 255).astype(int)]
            expected[values < -max(5 * image.noise * max(1, image.noise_gain), 0.02 * high)] = BELOW_ZERO
            got = page.pixels(name)
            assert (got[..., 3] == 255).all()
            assert (np.abs(got[..., :3] - expected) <= 4).all(), name  # one step of the colours for rounding
    assert roundest(image.raw.max()) < high
    page.get_by_label("View").select_option("raw")  # the range is of what is in view
    page.wait(f"document.getElementById('range-high').value === '{roundest(image.raw.max()):g}'")
    page.get_by_label("View").select_option("both")
    before = page.painted()
    rig.send(pressed(), drop=[0])
    page.wait(f"{PAINTINGS} > {before}")
    alpha, taxels = page.pixels("raw")[..., 3].ravel(), rig.sensor.codec.taxels
    assert (alpha[:taxels] == 0).all()  # without data
    assert (alpha[taxels:] == 255).all()
    known = np.isfinite(rig.sensor.hub.latest().restored)
    assert known.any()
    np.testing.assert_array_equal(page.pixels("restored")[..., 3] == 255, known)
    page.get_by_label("Method").select_option("raw")
    until(lambda: rig.sensor.method == "raw")
    image = page.show(rig, pressed())
    np.testing.assert_array_equal(image.raw, image.restored)
    np.testing.assert_array_equal(page.pixels("raw"), page.pixels("restored"))


def test_a_paused_page_shows_kept_frames_and_goes_on_with_the_newest(rig, url, open_page):
    rig.show(pressed(0))
    page = open_page(url)
    page.set_range(0, 500)  # an automatic one forgets in time
    images = []
    for at in (1, 3, 5):
        page.show(rig, pressed(at))
        images.append(page.pixels("restored"))
    page.press("ArrowRight")  # nothing is newer
    page.refreshed()
    assert not page.evaluate(PAUSED)
    for key, at in (("ArrowLeft", 1), ("ArrowLeft", 0), ("ArrowRight", 1)):
        page.press(key)
        page.refreshed()
        np.testing.assert_array_equal(page.pixels("restored"), images[at])
    for _ in range(3):
        rig.show(pressed(0))
    page.get_by_role("button", name="One frame forward").click()
    page.wait("document.getElementById('when').innerText === 'newest'")
    page.refreshed()
    np.testing.assert_array_equal(page.pixels("restored"), images[2])
    with page.expect_download() as saved:  # at once, before the screen's next turn
        page.evaluate(
            "['ArrowLeft', 's'].forEach(key => document.dispatchEvent(new KeyboardEvent('keydown', { key })))"
        )
    page.refreshed()
    at_once, later = (np.array(Image.open(each))[:700] for each in (saved.value.path(), page.download("s")))
    np.testing.assert_array_equal(at_once, later)  # above the state
    page.press("l")
    image = page.show(rig, pressed(0))
    page.wait(f"document.getElementById('sequence').innerText === '{image.sequence}'")
    rows = [line.split(",") for line in page.download("c").read_text().splitlines() if line[0] != "#"][1:]
    for kind, values in (("raw", image.raw), ("restored", image.restored)):
        np.testing.assert_allclose([float(row[5]) for row in rows if row[0] == kind], values.ravel(), atol=1e-4)
    assert [float(row[3]) for row in rows[:8]] == list(range(8))


def test_a_saved_picture_and_table_say_where_they_are_from(rig, page):
    rig.stale_after(600)
    page.set_range(0, 500)  # an automatic one changes in time
    before = page.painted()
    rig.send(pressed(), drop=[0])
    page.wait(f"document.body.dataset.warnings === '1' && {LIVE} && {PAINTINGS} > {before}")
    page.press("Space")
    page.evaluate(WATCH_TEXTS)
    page.download("s")
    texts = [each["text"] for each in page.evaluate("window.drawn") if each["saved"]]
    assert texts.count("mm") == 2
    ticks = [texts.count(str(tick)) for tick in (2, 4, 6, 250)]
    assert ticks == [4, 4, 4, 1]  # two axes a map, and the colour bar
    comments, rows = [], []
    for line in page.download("c").read_text().splitlines():
        (comments if line.startswith("#") else rows).append(line)
    values = dict(line[2:].split(": ", 1) for line in comments)
    image = rig.sensor.hub.latest()
    time = datetime.fromtimestamp(image.time, UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
    assert values["sensor"] == "palm"
    assert values["frame"] == str(image.sequence)
    assert values["time"][:22] == time[:22]
    assert (values["state"], values["method"], values["unit"]) == ("paused", "wiener", "kPa")
    assert (values["calibration"], values["pitch_mm"]) == ("configured", "1")
    assert "did not arrive" in next(text for name, text in values.items() if name.startswith("warnings"))
    assert rows[0].startswith("image,row,column,x_mm,y_mm,kpa,flags")
    text = " ".join(texts)
    for each in (values["time"], "paused", "method wiener", "unit kPa", "calibration configured", "arrive"):
        assert each in text


def marks_at(page, marks, contact):
    """RGBA of the marks at a contact's centre."""
    got, side = page.pixels(marks), 8.0  # mm, of the map; taxels are 1 mm, the first one's centre is 0, 0
    rows, columns = got.shape[:2]
    return got[int((contact["y_mm"] + 0.5) / side * rows), int((contact["x_mm"] + 0.5) / side * columns)]


def edges(pressed):
    """Rows and columns of the corners, in cells, between which a mask's outline runs."""
    padded = np.pad(pressed, 1)
    across, down = padded[:, 1:] != padded[:, :-1], padded[1:] != padded[:-1]
    return np.argwhere(across[1:-1]) + np.array([0.5, 0]), np.argwhere(down[:, 1:-1]) + np.array([0, 0.5])


def test_contacts_are_outlined_and_listed_follow_what_moves_and_can_be_switched_off(rig, url, open_page):
    counts = pressed(1)
    counts[0:2, 6:8] += 150
    rig.show(counts)
    page = open_page(url)
    page.wait(f"{CONTACTS}.length === 2")
    page.refreshed()
    contacts = ask("GET", f"{url}/api/v1/sensors/palm/contacts").json()["contacts"]
    listed = page.evaluate(CONTACTS)
    assert [int(row[0]) for row in listed] == [each["id"] for each in contacts]
    assert [row[1][0] == "≥" for row in listed] == [each["cut_off"] for each in contacts] == [False, True]
    forces = [[float(each) for each in row[1].removeprefix("≥ ").split(" ± ")] for row in listed]
    assert forces == [
        [float(f"{each['force_n']:.3g}"), float(f"{2 * each['force_deviation']:.2g}")] for each in contacts
    ]
    assert forces[0][0] > forces[1][0]
    for contact in contacts:
        for marks in ("raw-marks", "restored-marks"):
            assert (marks_at(page, marks, contact) > 240).all()  # white, but for the smoothing of its edge
    switch = page.locator("#contacts-on")
    page.press("Space")
    for count, action in ((0, switch.uncheck), (2, switch.check)):  # on a still image too
        with page.expect_websocket() as opened:
            action()
        assert ("contacts=1" in opened.value.url) == (count > 0)
        page.wait(f"{CONTACTS}.length === {count}")
        if not count:
            assert "Contacts are switched off." in page.locator("#contact-list").inner_text()
            page.refreshed()
            assert marks_at(page, "restored-marks", contacts[0])[3] == 0  # inside the ring of the centre
    assert page.evaluate(CONTACTS) == listed
    page.press("l")
    page.show(rig, pressed(3))
    number, *_, x, _ = page.keep(lambda: rig.show(pressed(3)), f"{CONTACTS}.length === 1 && {CONTACTS}[0]")
    assert number == listed[0][0]
    assert float(x) == pytest.approx(float(listed[0][4]) + 2, abs=0.2)
    none = pressed(force=0)
    page.keep(lambda: rig.show(none), "document.body.innerText.includes('No contact')")
    partial = "/No contact on the [0-9]+ of 64 cells that are known/.test(document.body.innerText)"
    page.keep(lambda: rig.send(none, drop=(1,)), partial)
    ring = np.zeros((8, 8), bool)
    ring[1:7, 1:7], ring[3:5, 3:5] = True, False
    page.keep(lambda: rig.show(none + 300 * ring), f"{CONTACTS}.length === 1")
    page.locator("#maps").focus()
    page.press("Space")
    page.wait(f"{PAUSED} && {CONTACTS}.length === 1")
    page.refreshed()
    for marks in ("raw-marks", "restored-marks"):
        got = page.pixels(marks)
        size = np.array(got.shape[:2])
        for places in edges(ring):
            at = np.minimum((places / 8 * size).round().astype(int), size - 1)
            assert (got[at[:, 0], at[:, 1], 3] > 0).all()
        row, column = (3.4 / 8 * size).astype(int)
        assert got[row, column, 3] == 0  # in the hole


def test_a_still_image_has_its_own_method_and_details_of_another_moment_say_so(rig, page):
    titles = {
        each: page.locator(f"#method option[value={each}]").inner_text() for each in METHODS if each != "auto"
    } | {"idle": "idle"}
    images = {}
    for method, drop in 3 * [("raw", ()), ("nnls", (0,)), ("wiener", ()), ("auto", ())]:
        rig.sensor.pipeline.set_method(method)
        before = page.painted()
        rig.send(pressed(), drop=drop)
        page.wait(f"{PAINTINGS} > {before}")
        until(lambda: (image := rig.sensor.hub.latest()) and image.sequence == rig.sequence)
        images[rig.sequence] = rig.sensor.hub.latest()
    page.wait(f"document.getElementById('method-used').innerText === '{titles[images[rig.sequence].method]}'")
    page.press("Space")
    own = 0
    for _ in range(len(images)):
        page.refreshed()
        sequence, method, why = page.text("sequence", "method-used", "why")
        source, contacts_source = page.text("details-from", "contacts-of")
        assert contacts_source == "in the restored image" or OFFSET.match(contacts_source)
        image = images.pop(int(sequence))
        assert method == titles[image.method]
        if source:
            assert OFFSET.search(source) or source == "details not reported"
        else:
            warnings = page.locator("#warnings li").all_text_contents()
            assert (why, warnings) == (
                image.why,
                [each.text for each in image.warnings if each.code != "cut_short"],
            )
            own += 1
        page.press("ArrowLeft")
    assert own > 1


def test_numbers_of_the_bus_and_its_losses_are_shown(rig, url, page):
    rig.send(pressed(), drop=[0])
    for _ in range(3):
        rig.show(pressed())
    loss = ask("GET", f"{url}/api/v1/sensors/palm").json()["loss"]
    assert loss["lost"] == 1
    page.wait("document.getElementById('losses').innerText !== 'none'")
    page.locator("#signal-more summary").click()
    page.wait("/\\nlost\\s+1\\n/.test('\\n' + document.getElementById('loss').innerText)")
    side = page.locator("#side").inner_text()
    for count in ("dropped", "error frames", "bus-off", "incomplete", "unsent"):
        assert re.search(rf"{count}\s+\d", side), count
    assert page.locator("#loss dd").count() == len(loss)
    rig.bus._bus.send(can.Message(is_error_frame=True))
    page.wait("/error frames\\s+1\\s[^]*\\bother 1$/.test(document.getElementById('loss').innerText)")
    assert not page.locator("#record").is_visible()  # no folder is configured
    assert "server.recordings" in page.locator("#recordings-hint").inner_text()
    page.wait("/skew\\s+[\\d.]+ (µs|ms)/.test(document.getElementById('side').innerText)")
    page.wait("/\\d+:\\d\\d:\\d\\d\\s+palm: sensor stale/.test(document.getElementById('events').innerText)")
    for each in ("#force-restored", "#contact-list tbody td", "#contact-list tbody th"):
        assert page.locator(each).first.evaluate("each => getComputedStyle(each).fontStyle") == "italic"
