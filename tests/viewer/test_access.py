"""axe-core finds nothing serious in the page, in either theme, at either size, with live data."""

import re
import threading
from contextlib import contextmanager

import pytest
from axe_playwright_python.sync_playwright import Axe

from tests.conftest import pressed
from tests.viewer.conftest import PHONE, wait

SERIOUS = ("serious", "critical")


@contextmanager
def live(rig):
    stop = threading.Event()
    sender = rig.play(20, stop)
    try:
        yield
    finally:
        stop.set()
        sender.join()


def serious(page):
    """What axe-core calls serious or critical: rule and elements."""
    found = Axe().run(page).response
    assert len(found["passes"]) > 15  # it did look
    return [
        (each["id"], [node["target"] for node in each["nodes"]])
        for each in found["violations"]
        if each["impact"] in SERIOUS
    ]


@pytest.mark.parametrize("size", [{"width": 1440, "height": 900}, PHONE], ids=["desk", "phone"])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_nothing_serious_is_found(rig, url, open_page, scheme, size):
    rig.show(pressed())
    page = open_page(url, color_scheme=scheme, **size)
    with live(rig):
        page.locator('[data-level="live"]').wait_for()
        assert serious(page) == []


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_nothing_serious_is_found_in_a_page_that_is_stale_nor_in_its_help(rig, url, open_page, scheme):
    rig.show(pressed())
    page = open_page(url, color_scheme=scheme)
    page.get_by_text(re.compile("^stale$", re.IGNORECASE)).first.wait_for()
    assert serious(page) == []
    page.keyboard.press("?")
    wait(page, "document.getElementById('help').open")
    assert serious(page) == []


def test_a_fault_is_found(rig, url, open_page):
    rig.show(pressed())
    page = open_page(url)
    page.evaluate("document.querySelector('label[for=method]').remove()")
    assert [rule for rule, _ in serious(page)] == ["select-name"]
