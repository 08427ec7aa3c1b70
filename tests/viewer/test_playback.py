"""Recordings that play in the page."""

import pytest

from tactiled.config import Server
from tactiled.web.server import running
from tests.cli.recordings import write
from tests.conftest import pressed

FRAMES, RATE_HZ = 50, 50.0
WHEN = "document.getElementById('when').innerText"
FRAME = "document.getElementById('sequence').innerText"
LEVEL = "document.body.dataset.level"
DROP = """([name, text]) => {
  const dataTransfer = new DataTransfer();
  dataTransfer.items.add(new File([text], name));
  document.body.dispatchEvent(new DragEvent("drop", { dataTransfer, bubbles: true, cancelable: true }));
}"""
PLAYS = f"{LEVEL} === 'playback'"


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
        yield url, tmp_path


def open_recording(page, name="grasp.log"):
    row = page.locator("#recordings li", has_text=name)
    row.get_by_role("button", name="Play", exact=True).click()
    page.wait(f"{PLAYS} && {FRAME} === '0'")


def test_a_recording_plays_is_sought_and_stepped_through_and_the_live_view_is_back(recorded, rig, open_page):
    url, _ = recorded
    page = open_page(url)
    open_recording(page)
    for name in ("#tare", "#record", "#calibrate-open", "#banner", "#latencies"):
        assert not page.locator(name).is_visible(), name
    page.wait(f"{WHEN} === '0:00.0 / 0:01.0'")
    assert page.text("pill-text", "recorded-name") == ["recording", "grasp.log"]
    page.press("t")
    page.wait("document.getElementById('notice').innerText === 'A recording plays: go back to live to tare.'")
    assert rig.sensor.pipeline.zero.time is None
    page.locator("#scrub").focus()
    for _ in range(2):
        page.press("PageUp")  # a tenth of it
    page.evaluate("document.activeElement.blur()")
    page.wait(f"Number({FRAME}) >= 8")
    page.press("Home", *["ArrowRight"] * 2, "Shift+ArrowRight", "ArrowRight", "ArrowLeft")
    page.wait(f"{FRAME} === '12'")
    page.wait("document.querySelector('#contact-list tbody tr')")
    page.press("Shift+ArrowRight", *["ArrowLeft"] * 2)
    page.wait(f"{FRAME} === '20'")
    page.wait("/taxels did not arrive/.test(document.getElementById('warnings').textContent)")
    page.wait("document.getElementById('losses').innerText !== 'none'")
    page.inspect()
    page.get_by_label("Method").select_option("raw")
    page.wait("document.getElementById('method-used').innerText === 'None, as measured'")
    assert rig.sensor.method == "wiener"  # live it is as before
    page.press("End")
    page.wait(f"{FRAME} === '{FRAMES - 1}'")
    page.press("<", " ")
    page.wait("document.getElementById('pause').innerText === 'Pause'")
    page.wait(f"document.getElementById('pause').innerText === 'Play' && {FRAME} === '{FRAMES - 1}'")
    page.press("l")
    page.wait(f"{LEVEL} === 'stale' && {FRAME} === '{rig.sequence}'")
    assert page.locator("#tare").is_visible()
    assert "recording=" not in page.url


def test_a_link_keeps_recording_and_position_and_a_loop_begins_again(recorded, open_page):
    url, _ = recorded
    page = open_page(f"{url}/#palm?recording=grasp.log&at=0.5", ready=PLAYS)
    page.wait(f"{FRAME} === '25'")
    page.get_by_label("Loop").check()
    page.locator("#speed").select_option("10")
    page.locator("#pause").click()
    page.evaluate("window.seen = []")
    page.wait(f"window.seen.push(Number({FRAME})), window.seen.some((each, i) => each < window.seen[i - 1])")
    page.locator("#pause").click()
    page.press("Home", *["ArrowRight"] * 5)
    page.wait(f"{FRAME} === '5' && location.hash.includes('at=0.1')")
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
    row.get_by_role("button", name="Play", exact=True).click()
    page.wait("document.getElementById('notice').innerText === 'bad.log: no frame of this sensor'")
    page.wait(f"{LEVEL} === 'stale'")  # as before
