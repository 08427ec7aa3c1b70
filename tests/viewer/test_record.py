"""Recordings of the bus from the page."""

import os
import re

import pytest

from tactiled.bus.recording import read
from tactiled.cli.replay import replaying
from tactiled.config import Server
from tactiled.web.server import running
from tests.conftest import pressed

LIST = "document.getElementById('recordings').innerText"
FOCUSED = "document.activeElement.innerText"
CLICK = "all => all.forEach(each => each.click())"
SEQUENCE = "document.getElementById('sequence').innerText"
ROW = "document.activeElement.closest('li')?.innerText"


@pytest.fixture
def recording(rig, tmp_path):
    """A service that may record, and the folder."""
    with running(rig.service, Server(port=0, recordings=tmp_path)) as url:
        rig.show(pressed(0))
        yield url, tmp_path


def start(page, folder):
    """Record from the page; gives the file."""
    before = set(folder.iterdir())
    page.get_by_role("button", name="Record", exact=True).click()
    page.wait(f"{LIST}.includes('recording can0')")
    (path,) = set(folder.iterdir()) - before
    return path


def test_what_is_recorded_is_what_was_sent_and_replays_as_it_was(recording, rig, open_page):
    url, folder = recording
    page = open_page(url)
    path = start(page, folder)
    for at in (1, 3):
        page.show(rig, pressed(at))
    image = page.pixels("raw")
    page.locator("#record", has_text="Stop").click()
    page.wait(f"/Delete/.test({LIST})")
    page.locator("#notice").get_by_role("button", name="Open").click()
    page.wait(f"document.body.dataset.level === 'playback' && {SEQUENCE} === '0'")
    page.press("l")
    payloads = [
        message.data
        for sequence, at in ((1, 1), (2, 3))
        for message in rig.sensor.codec.encode(pressed(at).ravel().astype("u2"), sequence, 0.0)
    ]
    assert [message.data for message in read(path)] == payloads
    with page.expect_download() as saved:
        page.get_by_role("link", name=path.name).click()
    assert saved.value.path().read_bytes() == path.read_bytes()
    copy = folder / "a.log"
    copy.write_bytes(path.read_bytes())
    row = page.locator("#recordings li", has_text=path.name)
    row.get_by_role("button", name="Delete").click()
    assert path.exists()  # once is not enough
    delete = row.get_by_role("button", name=re.compile("delete", re.IGNORECASE))  # asks again after a while
    page.keep(lambda: delete.evaluate_all(CLICK), f"!{LIST}.includes('{path.name}')")
    assert not path.exists()
    service = replaying(rig.config, copy, 1.0)
    service.start()
    with running(service, Server(port=0, recordings=folder)) as other:
        replayed = open_page(other)
        replayed.wait(f"{SEQUENCE} === '1'")
        replayed.refreshed()
        assert (replayed.pixels("raw") == image).all()
        replayed.locator("#recordings li", has_text="a.log").wait_for()
        assert not replayed.locator("#record").is_visible()
        assert replayed.locator("#recordings-replay").is_visible()
        assert not replayed.locator("#recordings-hint").is_visible()
        replayed.keyboard.press("r")
        replayed.get_by_role("button", name="Delete").wait_for()
        assert replayed.locator("#notice").inner_text() == "This is a replay: no bus is open to record."
        assert [each.name for each in folder.iterdir()] == ["a.log"]
        replayed.wait("document.body.dataset.level === 'ended'")
        replayed.refreshed(20)
        assert replayed.text("pill-text", "when") == ["end of recording", "end"]
        assert not replayed.locator("#banner").is_visible()
        assert not replayed.locator("#latencies").is_visible()
        replayed.inspect()
        replayed.finish()
    service.stop()
    assert page.painted() >= 3


def test_a_recording_beyond_the_first_page_and_whose_file_was_moved_can_be_stopped(recording, open_page):
    url, folder = recording
    for name in "abc":
        (folder / f"{name}.log").touch()
    page = open_page(url)
    page.route("**/recordings?limit=1000&*", lambda it: it.continue_(url=it.request.url.replace("1000", "2")))
    path = start(page, folder)
    path.rename(folder / "moved.log")
    page.wait(f"{LIST}.includes('recording can0, file moved or removed')")
    page.locator("#record", has_text="Stop").click()
    words = f"{path.name}: file moved or removed, 0 messages."
    page.wait(f"document.getElementById('notice').innerText === '{words}'")
    page.locator("#record", has_text="Record").wait_for()
    page.wait(f"!{LIST}.includes('file moved') && {LIST}.includes('moved.log')")


def delete(page, expected):
    """Press what has the focus twice, and wait."""
    for words in ("Delete", "Really delete"):
        assert page.evaluate(FOCUSED) == words
        page.press("Enter")
    page.wait(expected)


def test_the_focus_goes_from_a_deleted_recording_to_its_neighbour(recording, open_page):
    url, folder = recording
    for time, name in enumerate("abc"):
        (folder / f"{name}.log").touch()
        os.utime(folder / f"{name}.log", (time, time))  # newest first, they are c, b, a
    page = open_page(url)
    page.locator("#recordings li", has_text="b.log").get_by_role("button", name="Delete").focus()
    delete(page, f"{ROW}?.startsWith('a.log')")
    assert page.locator("#notice").inner_text() == "Deleted: b.log."
    delete(page, f"{ROW}?.startsWith('c.log')")
    (folder / "d.log").touch()
    page.wait(f"{LIST}.includes('d.log')")
    assert page.evaluate(ROW).startswith("c.log")
    (folder / "d.log").unlink()
    page.wait(f"!{LIST}.includes('d.log')")
    delete(page, "document.activeElement.id === 'record'")
    page.press("Enter")
    page.locator("#recordings").get_by_role("button", name="Stop").focus()
    page.press("Enter")
    page.wait(f"{FOCUSED} === 'Delete'")
