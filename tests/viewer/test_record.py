import re

import can
import pytest
from pydantic import SecretStr

from tactiled.bus.recording import read
from tactiled.cli.replay import replaying
from tactiled.config import Server
from tactiled.web.server import running
from tests.conftest import ask, pressed, until
from tests.viewer.conftest import turned, wait
from tests.viewer.test_viewer import painted, pixels, show

LIST = "document.getElementById('recordings').innerText"
READ, CONTROL = "r" * 16, "c" * 16


@pytest.fixture
def recording(rig, tmp_path):
    """A service that may record, and the folder."""
    with running(rig.service, Server(port=0, recordings=tmp_path)) as url:
        yield url, tmp_path


def test_what_was_recorded_from_the_page_is_what_was_sent_and_replays_as_it_was(recording, rig, open_page):
    url, folder = recording
    rig.show(pressed(0))
    page = open_page(url)
    page.get_by_role("button", name="Record", exact=True).click()
    wait(page, f"{LIST}.includes('recording can0')")
    (path,) = folder.iterdir()
    for at in (1, 3):
        show(rig, page, pressed(at))
    shown = pixels(page, "raw")
    page.locator("#record", has_text="Stop").click()
    wait(page, f"/Delete/.test({LIST})")
    sent = [
        message.data
        for sequence, at in ((1, 1), (2, 3))
        for message in rig.sensor.codec.encode(pressed(at).ravel().astype("u2"), sequence, 0.0)
    ]
    assert [message.data for message in read(path)] == sent
    with page.expect_download() as download:
        page.get_by_role("link", name=path.name).click()
    assert download.value.path().read_bytes() == path.read_bytes()
    copy = folder / "kept" / path.name
    copy.parent.mkdir()
    copy.write_bytes(path.read_bytes())
    page.get_by_role("button", name="Delete").click()
    assert path.exists()  # once is not enough
    page.get_by_role("button", name="Really delete").click()
    until(lambda: not path.exists())
    service = replaying(rig.config, copy, 1.0)
    service.start()
    try:
        with running(service) as other:
            replayed = open_page(other)
            wait(replayed, "document.getElementById('sequence').innerText === '1'")
            turned(replayed)
            assert (pixels(replayed, "raw") == shown).all()
            replayed.close()
    finally:
        service.stop()
    assert painted(page) >= 3


@pytest.mark.parametrize(
    ("size", "told"), [(0, "0 B"), (999, "999 B"), (1500, "1.50 kB"), (12_340_000, "12.3 MB")]
)
def test_a_recording_s_size_is_told_in_whole_bytes_or_three_digits(recording, rig, open_page, size, told):
    url, folder = recording
    with (folder / "a.log").open("wb") as file:
        file.truncate(size)
    rig.show(pressed())
    page = open_page(url)
    page.locator("#recordings .sub", has_text="B").wait_for()
    assert page.locator("#recordings .sub").inner_text() == told


def test_what_is_recorded_can_be_ended_however_many_there_are(recording, rig, open_page):
    url, folder = recording
    for number in range(1001):
        (folder / f"a{number:04}.log").touch()
    rig.show(pressed())
    page = open_page(url)
    page.get_by_role("button", name="Record", exact=True).click()
    page.locator("#record", has_text="Stop").click()
    page.locator("#record", has_text="Record").wait_for()
    assert "can0-" in page.locator("#recordings li").last.inner_text()


def test_without_a_folder_there_is_no_button_but_a_hint(rig, url, open_page):
    rig.show(pressed())
    page = open_page(url)
    assert not page.locator("#record").is_visible()
    assert "server.recordings" in page.locator("#side").inner_text()


def test_a_replay_lists_what_was_recorded_and_offers_to_record_nothing(recording, rig, open_page):
    url, folder = recording
    ask("POST", f"{url}/api/v1/recordings", json={"bus": "can0", "name": "a.log"})
    rig.show(pressed())
    ask("POST", f"{url}/api/v1/recordings/a.log/stop")
    service = replaying(rig.config, folder / "a.log", 1.0)
    service.start()
    try:
        with running(service, Server(port=0, recordings=folder)) as other:
            page = open_page(other)
            page.locator("#recordings li", has_text="a.log").wait_for()
            assert not page.locator("#record").is_visible()
            assert "This is a replay: no bus is open to record." in page.locator("#side").inner_text()
            assert "server.recordings" not in page.locator("#side").inner_text()
            page.keyboard.press("r")
            page.get_by_role("button", name="Delete").wait_for()
            assert [each.name for each in folder.iterdir()] == ["a.log"]
            page.close()
    finally:
        service.stop()


def test_what_the_read_token_may_not_do_asks_for_the_control_token(rig, open_page):
    rig.show(pressed())
    at = Server(port=0, read_token=SecretStr(READ), control_token=SecretStr(CONTROL))
    with running(rig.service, at) as url:
        page = open_page(f"{url}/?token={READ}")
        page.get_by_label("Method").select_option("raw")
        page.get_by_role("dialog").wait_for()
        assert "control token" in page.locator("#token-why").inner_text()
        page.get_by_label("Token", exact=True).fill("x" * 16)
        page.keyboard.press("Enter")
        page.locator("#token-why", has_text="does not know").wait_for()
        assert rig.sensor.method == "wiener"
        page.get_by_label("Token", exact=True).fill(CONTROL)
        page.keyboard.press("Enter")
        until(lambda: rig.sensor.method == "raw")
        assert not page.get_by_role("dialog").is_visible()
        page.close()
        page.faults.clear()  # the browser itself reports every refusal


def test_counts_events_and_times_of_the_bus_are_shown(rig, url, open_page):
    rig.show(pressed())
    page = open_page(url)
    rig.send(pressed(), drop=[0])
    for _ in range(3):
        rig.show(pressed())
    state = ask("GET", f"{url}/api/v1/sensors/palm").json()
    assert state["loss"]["lost"] == 1
    wait(page, "/\\nlost\\s+1\\n/.test('\\n' + document.getElementById('loss').innerText)")
    text = page.locator("#side").inner_text()
    for count in ("dropped", "error frames", "bus-off", "incomplete", "unsent"):
        assert re.search(rf"{count}\s+\d", text), count
    assert page.locator("#loss dd").count() == len(state["loss"])
    rig.bus._bus.send(can.Message(is_error_frame=True))
    wait(page, "/error frames\\s+1\\s[^]*\\bother 1$/.test(document.getElementById('loss').innerText)")
    wait(page, "/skew\\s+[\\d.]+ (µs|ms)/.test(document.getElementById('side').innerText)")
    wait(page, "/\\d+:\\d\\d:\\d\\d\\s+palm: sensor stale/.test(document.getElementById('events').innerText)")


def test_a_recording_whose_file_was_moved_away_says_so_and_can_be_ended(recording, rig, open_page):
    url, folder = recording
    rig.show(pressed())
    page = open_page(url)
    page.get_by_role("button", name="Record", exact=True).click()
    wait(page, f"{LIST}.includes('recording can0')")
    (path,) = folder.iterdir()
    path.rename(folder / "kept.log")
    wait(page, f"{LIST}.includes('recording can0, file moved or removed')")
    page.locator("#record", has_text="Stop").click()
    says = f"{path.name}: file moved or removed, 0 messages."
    wait(page, f"document.getElementById('notice').innerText === '{says}'")
    page.locator("#record", has_text="Record").wait_for()
    wait(page, f"!{LIST}.includes('moved') && {LIST}.includes('kept.log')")


FOCUSED = "document.activeElement.innerText"
ROW = "document.activeElement.closest('li')?.innerText"


def delete(page, wait_for):
    """Press what has the focus twice, and wait."""
    for text in ("Delete", "Really delete"):
        assert page.evaluate(FOCUSED) == text
        page.keyboard.press("Enter")
    wait(page, wait_for)


def test_the_focus_goes_from_a_recording_that_is_deleted_to_its_neighbour_and_the_loss_is_told(
    recording, rig, open_page
):
    url, folder = recording
    for name in ("a", "b", "c"):
        (folder / f"{name}.log").touch()
    rig.show(pressed())
    page = open_page(url)
    page.locator("#recordings li", has_text="b.log").get_by_role("button").focus()
    delete(page, f"{ROW}?.startsWith('c.log')")
    assert page.locator("#notice").inner_text() == "Deleted: b.log."
    delete(page, f"{ROW}?.startsWith('a.log')")
    (folder / "d.log").touch()
    wait(page, f"{LIST}.includes('d.log')")
    assert page.evaluate(ROW).startswith("a.log")
    (folder / "d.log").unlink()
    wait(page, f"!{LIST}.includes('d.log')")
    delete(page, "document.activeElement.id === 'record'")
    page.keyboard.press("Enter")
    page.locator("#recordings").get_by_role("button", name="Stop").focus()
    page.keyboard.press("Enter")
    wait(page, f"{FOCUSED} === 'Delete'")
