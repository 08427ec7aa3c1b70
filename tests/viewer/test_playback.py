"""Recordings that play in the page."""

import re

import pytest

from tactiled.config import Server
from tactiled.web.server import running
from tests.cli.recordings import write
from tests.conftest import ask, pressed, until
from tests.viewer.conftest import LEVEL, WATCH_TEXTS
from tests.viewer.test_regions import drag

FRAMES, RATE_HZ = 50, 50.0
WHEN = "document.getElementById('when').innerText"
FRAME = "document.getElementById('sequence').innerText"
DROP = """([name, text]) => {
  const dataTransfer = new DataTransfer();
  dataTransfer.items.add(new File([text], name));
  document.body.dispatchEvent(new DragEvent("drop", { dataTransfer, bubbles: true, cancelable: true }));
}"""
PLAYS = f"{LEVEL} === 'playback'"
WHY = "document.getElementById('why').innerText === 'selected by hand'"
RAN_RAW = "document.getElementById('method-used').innerText === 'None, as measured'"
# The automatic range, which the field has, is that of the frame that is shown, paused as it is.
FITTED = """(([peak, high]) => peak < high && high < 2 * peak)(
  [document.getElementById("peak-restored").innerText, document.getElementById("range-high").value].map(Number))"""
SUMMARY = "document.querySelector('#alerts summary')"
OF_LIVE = "#tare", "#record"
SAVED = "PNG", "CSV", "Report", "Film"
BANNER = "document.getElementById('banner').checkVisibility()"


@pytest.fixture
def recorded(rig, tmp_path):
    """A service whose folder has a recording of one second, and the counts of each of its frames."""
    frames = [pressed(n % 6) for n in range(FRAMES)]
    frames[30] = pressed(2, force=3950)  # saturated
    messages = [
        each
        for n, counts in enumerate(frames)
        for each in rig.sensor.codec.encode(counts.astype("u2").ravel(), n, 1.6e9 + n / RATE_HZ)
    ]
    del messages[2 * 20]  # of frame 20
    write(tmp_path / "grasp.log", messages)
    rig.show(pressed(0))
    with running(rig.service, Server(port=0, recordings=tmp_path, control_per_minute=0)) as url:
        wait_until_read(url, "grasp.log")
        yield url, tmp_path


def wait_until_read(url, name):
    """Until a recording's file is read: no frame is next to the first while it is the only one."""
    until(lambda: not ask("GET", f"{url}/api/v1/recordings/{name}/playback?sensor=palm").json()["reading"])


def open_recording(page, name="grasp.log"):
    row = page.locator("#recordings li", has_text=name)
    row.get_by_role("button", name="Open", exact=True).click()
    page.wait(f"{PLAYS} && {FRAME} === '0'")


def test_a_recording_plays_is_sought_and_stepped_through_and_the_live_view_is_back(recorded, rig, open_page):
    url, _ = recorded
    page = open_page(url)
    page.locator("#tare").wait_for()
    assert not page.locator("#series-measure").is_visible()
    assert page.locator("#series-measure").is_disabled()  # nothing can be measured before there is a frame
    open_recording(page)
    for name in ("#tare", "#record", "#calibrate-open", "#banner", "#latencies"):
        assert not page.locator(name).is_visible(), name
    assert page.locator("#series-measure").is_enabled()
    page.wait(f"{WHEN} === '0:00.0 / 0:01.0'")
    assert page.get_by_role("button", name="Play", exact=True).get_attribute("title") == "Play (space)"
    page.get_by_role("img", name=re.compile("raw and restored$")).wait_for()  # no band: that is live
    page.wait(FITTED)
    page.get_by_role("slider", name="Position in the recording").wait_for()
    assert page.text("pill-text", "recorded-name") == ["recording", "grasp.log"]
    page.get_by_role("img", name="Total raw force over the whole recording").wait_for()
    page.press("t")
    page.wait("document.getElementById('notice').innerText === 'A recording plays: go back to live to tare.'")
    assert rig.sensor.pipeline.zero.time is None
    page.locator("#scrub").focus()
    for _ in range(2):
        page.press("PageUp")  # a tenth of it
    page.evaluate("document.activeElement.blur()")
    page.wait(f"Number({FRAME}) >= 8")
    assert page.evaluate(f"{SUMMARY}.tabIndex") == -1  # nothing to open
    page.press("Home", *["ArrowRight"] * 2, "Shift+ArrowRight", "ArrowRight", "ArrowLeft")
    page.wait(f"{FRAME} === '12'")
    page.wait(FITTED)
    page.wait("document.querySelector('#contact-list tbody tr')")
    page.press("Shift+ArrowRight", *["ArrowLeft"] * 2)
    page.wait(f"{FRAME} === '20'")
    page.wait("/taxels did not arrive/.test(document.getElementById('warnings').textContent)")
    page.wait("document.getElementById('losses').innerText !== 'none'")
    assert page.evaluate(f"{SUMMARY}.tabIndex") == 0
    page.inspect()
    page.get_by_label("Method").select_option("raw")
    page.wait(RAN_RAW)
    assert rig.sensor.method == "wiener"  # live it is as before
    page.press("End")
    page.wait(f"{FRAME} === '{FRAMES - 1}'")
    page.press("<")
    with page.expect_download() as film:
        page.locator("#film").click()  # plays it, from its beginning as it is at its end
        page.wait("document.getElementById('pause').innerText === 'Pause'")
    assert film.value.path().read_bytes()[:4] == b"\x1a\x45\xdf\xa3"  # EBML, as WebM begins
    page.wait(f"document.getElementById('pause').innerText === 'Play' && {FRAME} === '{FRAMES - 1}'")
    with page.expect_download() as report:
        page.locator("#save-report").click()
    html = report.value.path().read_text()
    assert html.count("data:image/png") == 3
    assert re.findall(r"</svg>(.*?)</li>", html) == ["raw, kPa", "restored, kPa", "raw, N"]  # no band, one force
    assert "grasp.log at 0:01.0" in html
    page.press("l")
    page.wait(f"{LEVEL} === 'stale' && {FRAME} === '{rig.sequence}'")
    assert page.locator("#tare").is_visible()
    page.get_by_role("slider", name="Kept frames, newest at the right").wait_for()
    assert "recording=" not in page.url


def test_details_that_come_late_or_again_and_another_recording_begins_with_the_method_of_the_sensor(
    recorded, open_page
):
    url, folder = recorded
    (folder / "second.log").write_bytes((folder / "grasp.log").read_bytes())
    page = open_page(f"{url}/#palm?recording=grasp.log", ready=PLAYS)
    page.wait(WHY)

    def answer_late(route):
        answer = route.fetch()
        page.get_by_label("Method").select_option("raw")
        page.wait(RAN_RAW)
        route.fulfill(response=answer)

    # Details that were requested before another method are dropped.
    page.route("**/grasp.log/frames/1?*", answer_late, times=1)
    page.press("ArrowRight")
    page.wait(f"{WHY} && {RAN_RAW}")
    # The banner goes once details come again.
    page.route("**/grasp.log/frames/2?*", lambda route: route.abort())
    page.press("ArrowRight")
    page.wait(f"{BANNER} && {LEVEL} === 'disconnected'")
    page.unroute("**/grasp.log/frames/2?*")
    page.wait(f"{PLAYS} && {WHY} && !{BANNER}")
    assert page.get_by_label("Method").input_value() == "raw"
    open_recording(page, "second.log")
    page.wait("document.getElementById('method-used').innerText === 'Wiener filter'")
    assert page.get_by_label("Method").input_value() == "wiener"
    page.finish("ERR_FAILED")


def test_the_chart_reaches_the_recordings_end_a_loop_begins_again_and_a_link_keeps_the_position(
    recorded, open_page
):
    url, _ = recorded
    page = open_page(url)
    looks, opening = [], []

    def answer(route):
        looks.append(route.fetch())
        body = looks[-1].json()
        if len(looks) == 1:  # as if nothing had been read
            body |= {"reading": True, "frames": 0}
            opening[:] = [page.text("recorded-text"), *(page.locator(each).is_visible() for each in OF_LIVE)]
            opening.append([page.get_by_role("button", name=each, exact=True).is_disabled() for each in SAVED])
        if len(looks) == 2:  # as if no more had been read
            body |= {"reading": True, "frames": 10, "duration_s": 0.2, "positions_s": [0, 0.2], "force": [1, 1]}
        route.fulfill(response=looks[-1], json=body)

    page.route("**/grasp.log/playback?*", answer)
    page.evaluate(WATCH_TEXTS)
    open_recording(page)
    page.wait(f"{WHEN} === '0:00.0 / 0:01.0'")
    last = "Number(all[i - 1].text) >= 0.5"  # which tick is last is the chart's width
    page.wait(f"window.drawn.some(({{ text }}, i, all) => text === 'position, s' && {last})")
    assert opening == [["reading …"], False, False, [True] * 4]
    assert page.get_by_role("button", name="Film").is_enabled()
    page.get_by_label("Loop").check()
    page.locator("#speed").select_option("10")
    page.locator("#pause").click()
    page.evaluate("window.seen = []")
    page.wait(f"window.seen.push(Number({FRAME})), window.seen.some((each, i) => each < window.seen[i - 1])")
    page.locator("#pause").click()
    page.press("Home", *["ArrowRight"] * 5)
    page.wait(f"{FRAME} === '5' && location.hash.includes('recording=grasp.log&at=0.1')")
    other = open_page(page.url, ready=PLAYS)
    other.wait(f"{FRAME} === '5'")


def test_a_file_from_this_computer_is_added_and_plays(recorded, tmp_path_factory, open_page):
    url, folder = recorded
    file = tmp_path_factory.mktemp("own") / "left hand.log"
    file.write_bytes((folder / "grasp.log").read_bytes())
    page = open_page(url)
    page.locator("#recording-file").set_input_files(file)
    page.wait(f"{PLAYS} && document.getElementById('recorded-name').innerText === 'left-hand.log'")
    assert (folder / "left-hand.log").read_bytes() == file.read_bytes()
    (folder / "bad.log").write_text("(1.0) can0 123#00 R\n")
    page.evaluate(DROP, ["dropped.log", file.read_text()])
    page.wait(f"{PLAYS} && document.getElementById('recorded-name').innerText === 'dropped.log'")
    page.press("l")
    row = page.locator("#recordings li", has_text="bad.log")
    row.get_by_role("button", name="Open", exact=True).click()
    page.wait("document.getElementById('notice').innerText === 'bad.log: no frame of this sensor'")
    page.wait(f"{LEVEL} === 'stale'")  # as before


def test_a_region_is_drawn_on_a_recording_and_its_highest_force_is_read_seen_and_saved(recorded, open_page):
    url, _ = recorded
    page = open_page(f"{url}/#palm?recording=grasp.log&at=0.6", ready=PLAYS)
    page.get_by_role("button", name="Rectangle").click()
    drag(page, page.box("#restored-frame"), (0.05, 0.05), (0.7, 0.95))
    page.get_by_label("Name").fill("heel")
    page.get_by_role("button", name="Save").click()
    page.wait("Number(document.querySelector('#regions td')?.textContent) > 0")
    force = page.evaluate("Number(document.querySelector('#regions td').textContent)")
    address = "/api/v1/recordings/grasp.log"
    (heel,) = ask("GET", f"{url}{address}/frames/30?sensor=palm").json()["regions"]
    assert force == pytest.approx(heel["force"], rel=0.01)
    page.get_by_role("button", name="Find the highest values").click()
    page.wait("document.querySelectorAll('#series tbody tr').length === 2")
    series = ask("GET", f"{url}{address}/series?sensor=palm").json()
    highest = series["regions"][0]["highest"]["force"]
    assert highest["number"] == 30
    page.press("Home")
    page.wait(f"{FRAME} === '0'")
    row = page.locator("#series tbody tr", has_text="heel")
    assert row.locator("td").all_inner_texts()[:2] == [f"{highest['value']:.2f}", "0:00.6"]
    row.get_by_role("button", name="0:00.6").first.click()
    page.wait(f"{FRAME} === '30' && document.getElementById('force-span').innerText === 'restored'")
    label = "document.getElementById('forces').ariaLabel"
    assert page.evaluate(label) == "heel, force over the whole recording"
    at = f"{url}/api/v1/sensors/palm/regions"
    (shape,) = ({key: each[key] for key in ("shape", "points_mm")} for each in ask("GET", at).json()["regions"])
    limit = {"quantity": "force", "above": 0.99 * highest["value"], "below": 0.5 * highest["value"]}
    ask("PUT", f"{at}/heel", json=shape | {"threshold": limit})
    page.wait(f"{label} === 'heel, force over the whole recording, above the threshold from 0:00.6'")
    assert page.locator("#force-above").is_visible()
    page.wait("document.querySelector('#regions tbody tr.some')")  # the frame that is shown is above it
    assert "# state: grasp.log at 0:00.6" in page.download("c").read_text().splitlines()
    page.evaluate(WATCH_TEXTS)
    page.locator("#series-of").select_option("total, peak")
    page.wait("window.drawn.some(({ saved, text }) => saved && text === 'kPa')")
    page.inspect()
    page.evaluate("document.getElementById('forces').parentElement.style.height = '500px'")
    assert page.box("#forces")["height"] > 350  # it takes the room beside a taller panel
    page.resize(1280, 860)
    with page.expect_download() as saved:
        page.get_by_role("link", name="CSV of every frame").click()
    lines = saved.value.path().read_text().splitlines()
    assert lines[:3] == ["# recording: grasp.log", "# sensor: palm", "# method: wiener"]
    assert (len(lines), lines[5].split(",")[6]) == (6 + FRAMES, "heel_force_N")
    page.get_by_role("button", name="heel").click()
    for _ in range(2):  # the first press asks
        page.locator("#region-delete").click()
    page.wait("document.querySelectorAll('#series tbody tr').length === 1")  # measured again without it
