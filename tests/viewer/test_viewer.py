import re
import threading

import numpy as np
import pytest

from tactiled.config import Server
from tactiled.web.server import running
from tests.conftest import ask, meanwhile, pressed, until
from tests.viewer.conftest import THUMB, Pair, keep, wait

PIXELS = """id => {
  const canvas = document.getElementById(id);
  const { data } = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height);
  return { width: canvas.width, height: canvas.height, data: Array.from(data) };
}"""


def pixels(page, name):
    """(rows, columns, 4) of a map's canvas, which has one pixel a cell."""
    got = page.evaluate(PIXELS, name)
    return np.array(got["data"]).reshape(got["height"], got["width"], 4)


# Whether anything is drawn on a canvas.
INKED = """(id => {
  const canvas = document.getElementById(id);
  return canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data.some(each => each);
})"""
PAINTINGS = "Number(document.documentElement.dataset.painted)"


def painted(page):
    return page.evaluate(PAINTINGS)


def show(rig, page, counts):
    """Send a frame and wait until the page has painted it."""
    before = painted(page)
    image = rig.show(counts)
    wait(page, f"{PAINTINGS} > {before}")
    return image


def test_both_maps_paint_the_data_in_the_colours_of_the_scale_and_change_with_it(rig, url, open_page):
    rig.show(pressed(2))
    page = open_page(url)
    colors = np.array(ask("GET", f"{url}/api/v1/colormap").json()["colors"])
    seen = []
    for at in (1, 5):
        image = show(rig, page, pressed(at))
        label = page.locator('[aria-label^="Colour scale"]').get_attribute("aria-label")
        low, high = (float(number) for number in re.findall(r"[\d.]+", label))
        assert low == 0
        assert high >= image.restored.max()
        for name, values in (("raw", image.raw), ("restored", image.restored)):
            expected = colors[np.clip(np.floor(values * 256 / high), 0, 255).astype(int)]
            got = pixels(page, name)
            assert (got[..., 3] == 255).all()
            off = np.abs(got[..., :3] - expected).max(axis=-1) > 4  # one step of the colours for rounding
            assert not off.any(), name
        seen.append(pixels(page, "restored"))
    assert (seen[0] != seen[1]).any()


def test_it_keeps_painting_a_live_sensor(rig, url, open_page):
    stop = threading.Event()
    sender = rig.play(100, stop)
    page = open_page(url)
    began = painted(page)
    wait(page, f"{PAINTINGS} >= {began + 20}")
    stop.set()
    sender.join()


def test_what_is_unknown_is_not_painted_as_pressure(rig, url, open_page):
    rig.show(pressed())
    page = open_page(url)
    before = painted(page)
    rig.send(pressed(), drop=[0])
    wait(page, f"{PAINTINGS} > {before}")
    alpha = pixels(page, "raw")[..., 3].ravel()
    taxels = rig.sensor.codec.taxels
    assert (alpha[:taxels] == 0).all()
    assert (alpha[taxels:] == 255).all()
    assert (pixels(page, "restored")[..., 3] == 255).all()


def test_a_sensor_that_falls_silent_cannot_look_alive(rig, url, open_page):
    rig.show(pressed())
    page = open_page(url)
    page.get_by_text(re.compile("stale", re.IGNORECASE)).first.wait_for()
    wait(page, "/[1-9][.,]?\\d* s/.test(document.body.innerText)")


def test_the_method_is_picked_and_what_runs_is_shown(rig, url, open_page):
    rig.show(pressed())
    page = open_page(url)
    page.get_by_label(re.compile("method", re.IGNORECASE)).first.select_option("raw")
    until(lambda: rig.sensor.method == "raw")
    image = show(rig, page, pressed())
    np.testing.assert_array_equal(image.raw, image.restored)
    np.testing.assert_array_equal(pixels(page, "raw"), pixels(page, "restored"))


def test_pause_holds_the_image_and_going_on_shows_the_newest(rig, url, open_page):
    rig.show(pressed(1))
    page = open_page(url)
    show(rig, page, pressed(2))
    page.keyboard.press("Space")
    held = pixels(page, "raw")
    rig.show(pressed(5))
    page.wait_for_timeout(300)
    np.testing.assert_array_equal(pixels(page, "raw"), held)
    page.keyboard.press("Space")
    show(rig, page, pressed(5))
    assert (pixels(page, "raw") != held).any()


def test_it_finds_the_service_again(rig, open_page):
    with running(rig.service) as url:
        rig.show(pressed())
        page = open_page(url)
        port = int(url.rsplit(":", 1)[1])
    page.get_by_text(re.compile("disconnected|unreachable|lost|retry", re.IGNORECASE)).first.wait_for()
    page.faults.clear()  # the browser itself reports every attempt that fails
    with running(rig.service, Server(port=port)) as again:
        assert again == url
        keep(lambda: rig.show(pressed()), page, f"{PAINTINGS} > {painted(page)}")
        page.close()
        page.faults.clear()


def test_the_button_that_tries_again_says_so(rig, open_page):
    with running(rig.service) as url:
        rig.show(pressed())
        page = open_page(url)
    page.locator("#banner").get_by_role("button", name="Retry now", exact=True).wait_for()
    assert page.locator("#banner-action").inner_text() == "Retry now"
    page.close()
    page.faults.clear()  # the browser itself reports every attempt that fails


def test_a_sensor_left_while_the_service_is_away_leaves_nothing_behind(open_page):
    with meanwhile(Pair("left", THUMB)) as pair:
        pair.stale_after(600)
        with running(pair.service) as url:
            for _ in range(3):
                pair.both()
            page = open_page(url)
            charts = ("section", "forces", "latencies", "colorbar", "kernel")
            for name in charts:
                wait(page, f"{INKED}('{name}')")
            wait(page, "/[µm]s/.test(document.getElementById('jitter').innerText)")
        page.locator("#banner").get_by_text(re.compile("disconnected", re.IGNORECASE)).wait_for()
        page.keyboard.press("2")
        page.locator("#notice", has_text="thumb").wait_for()
        for name in charts[:-1]:
            assert not page.evaluate(f"{INKED}('{name}')"), name
        told = {name: page.locator(f"#{name}").inner_text() for name in ("jitter", "skew", "rate", "force-raw")}
        assert set(told.values()) == {"\u2013"}, told
        page.faults.clear()  # the browser itself reports every attempt that fails
        page.close()
        page.faults.clear()


@pytest.mark.parametrize("address", ["#%zz", "#nobody", "#palm"])
def test_whatever_the_address_names_a_sensor_is_shown(rig, url, open_page, address):
    rig.show(pressed())
    page = open_page(f"{url}/{address}")
    assert page.url == f"{url}/#palm"


@pytest.mark.parametrize(("width", "height"), [(1440, 900), (1024, 768), (390, 844)])
def test_nothing_is_cut_off_at_any_width(rig, url, open_page, width, height):
    rig.show(pressed())
    page = open_page(url, width, height)
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    for name in ("raw", "restored"):
        box = page.locator(f"#{name}").bounding_box()
        assert box["x"] >= 0
        assert box["x"] + box["width"] <= width
        assert box["width"] >= 120
