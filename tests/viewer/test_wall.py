import itertools
import re
import threading
import time

import numpy as np
import pytest

from tactiled.config import Server
from tactiled.web import answers
from tactiled.web.server import running
from tactiled.web.ws.feed import Feed
from tests.conftest import NO_LOAD, SIDE, ask, meanwhile, pressed, until
from tests.viewer.conftest import PHONE, THUMB, Pair, keep, turned, wait

TILES = "[...document.querySelectorAll('.tile')].map(tile => tile.innerText)"
FORCES = f"{TILES}.map(text => parseFloat(text.match(/([\\d.]+) N/)?.[1]))"
FILTERS = "[...document.querySelectorAll('.tile canvas')].map(canvas => getComputedStyle(canvas).filter)"
WALL_SEEN = f"{TILES}.length === 2 && {TILES}.every(text => text.includes(' N'))"


BRIGHTEST = """(() => {
  const { data } = document.querySelector('.tile canvas').getContext('2d').getImageData(0, 0, 8, 8);
  let most = 0;
  for (let i = 0; i < data.length; i += 4) most = Math.max(most, data[i] + data[i + 1] + data[i + 2]);
  return most;
})()"""


def force(text):
    return float(re.search(r"([\d.]+) N", text)[1])


def keep_showing(rig, page, true, **what):
    """Send frames of both until something is true in the page; gives it."""
    return keep(lambda: rig.both(**what), page, true)


def test_the_wall_shows_every_sensor_with_its_force_and_a_click_opens_it(pair, open_page):
    rig, url = pair
    page = open_page(f"{url}/#/wall", ready=f"{TILES}.length === 2")
    palm, thumb = keep_showing(rig, page, f"{WALL_SEEN} && {BRIGHTEST} > 0 && {TILES}")
    image, other = rig.both()
    assert palm.startswith("palm")
    assert thumb.startswith("thumb")
    assert force(palm) == pytest.approx(image.restored.sum() * 1e-3, abs=0.006)  # cells of 1 mm2
    areas = rig.service.sensor("thumb").plan.cells.areas
    assert force(thumb) == pytest.approx((other.restored * areas).sum() * 1e-3, abs=0.006)
    colors = page.evaluate(
        "[...document.querySelector('.tile canvas').getContext('2d').getImageData(0, 0, 8, 8).data]"
    )
    seen = np.array(colors).reshape(8, 8, 4)[..., :3].sum(axis=-1)
    assert seen[3:5, 3:5].min() > 3 * seen[:2].max()
    page.get_by_role("button", name=re.compile("thumb")).first.click()
    wait(page, "Number(document.documentElement.dataset.painted) > 0")
    assert page.evaluate("location.hash") == "#thumb"
    assert not page.locator("#wall").is_visible()


def test_a_tile_whose_sensor_falls_silent_cannot_look_alive(pair, open_page):
    rig, url = pair
    page = open_page(f"{url}/#/wall", ready=f"{TILES}.length === 2")
    keep_showing(rig, page, WALL_SEEN)
    wait(page, f"{TILES}.every(text => /stale/i.test(text) && / s ago/.test(text))")
    assert "grayscale(1)" in page.evaluate(FILTERS)[0]


def test_the_range_holds_a_peak_over_looks_at_the_list_of_sensors(pair, open_page):
    rig, url = pair
    page = open_page(f"{url}/#/wall", ready=f"{TILES}.length === 2")
    none = (100, 100, 100, 100)
    keep_showing(rig, page, f"{FORCES}[0] > 5", palm=pressed(force=3800), thumb=none)
    turned(page)
    bright = page.evaluate(BRIGHTEST)
    with page.expect_response(lambda answer: "/events" in answer.url):  # which it looks at next
        pass
    keep_showing(rig, page, f"{FORCES}[0] < 1", palm=pressed(force=100), thumb=none)
    turned(page)
    assert page.evaluate(BRIGHTEST) < 0.5 * bright


def test_a_tile_whose_shape_could_not_be_had_asks_again(pair, open_page, monkeypatch):
    rig, url = pair
    geometry, asked = answers.geometry, []

    def once_not(sensor):
        asked.append(sensor.name)
        if asked.count(sensor.name) == 1:
            raise RuntimeError("not yet")
        return geometry(sensor)

    monkeypatch.setattr(answers, "geometry", once_not)
    page = open_page(f"{url}/#/wall", ready=f"{TILES}.length === 2")
    keep_showing(rig, page, WALL_SEEN)
    page.close()
    page.faults.clear()  # the browser itself reports every failure


def test_a_tile_whose_sensor_has_another_shape_than_before_asks_again(pair, open_page, monkeypatch):
    rig, url = pair
    geometry, asked = answers.geometry, []

    def before(sensor):
        asked.append(sensor.name)
        other = "palm" if sensor.name == "thumb" else "thumb"
        return geometry(rig.service.sensor(other) if asked.count(sensor.name) == 1 else sensor)

    monkeypatch.setattr(answers, "geometry", before)
    page = open_page(f"{url}/#/wall", ready=f"{TILES}.length === 2")
    keep_showing(rig, page, f"{FORCES}[0] > 0 && {FORCES}[1] > 0")
    assert sorted(asked) == ["palm", "palm", "thumb", "thumb"]


def test_tabs_and_keys_lead_to_the_wall_and_back(pair, open_page):
    _rig, url = pair
    page = open_page(url)
    assert page.get_by_role("tab").all_inner_texts()[0] == "All"
    page.keyboard.press("w")
    page.locator("#wall").wait_for()
    assert page.get_by_role("tab", selected=True).inner_text() == "All"
    page.keyboard.press("2")
    page.locator("#main").wait_for()
    assert page.get_by_role("tab", selected=True).inner_text().startswith("thumb")


def test_a_layout_that_is_no_grid_is_drawn_true_to_scale(pair, open_page):
    rig, url = pair
    page = open_page(f"{url}/#thumb")
    width, height = page.evaluate("[...['width', 'height']].map(side => document.getElementById('raw')[side])")
    seen = page.evaluate(
        f"[...document.getElementById('raw').getContext('2d').getImageData(0, 0, {width}, {height}).data]"
    )
    drawn = np.array(seen).reshape(height, width, 4)[..., 3] > 128
    pitch = rig.service.sensor("thumb").array.pitch
    zoom = width / (4.5 + 2 * pitch)
    assert zoom == pytest.approx(height / (2.5 + 2 * pitch), rel=0.01)
    assert drawn.sum() == pytest.approx(4 * np.pi * (0.75 * zoom) ** 2, rel=0.02)
    for x, y in ((0, 0), (3, 0), (1.5, 2), (4.5, 2.5)):
        column, row = round((x + pitch) * zoom), round((y + pitch) * zoom)
        reach = round(0.7 * zoom)
        assert drawn[row, column - reach : column + reach].all()
        assert not drawn[row, column + round(0.8 * zoom)]


LEVELS = "[...document.querySelectorAll('.tile')].map(tile => tile.dataset.level)"


def test_all_sensors_come_on_one_socket(pair, open_page):
    rig, url = pair
    page = open_page(f"{url}/#/wall", ready=f"{TILES}.length === 2")
    keep_showing(rig, page, WALL_SEEN)
    assert "tactiled_streams 1" in ask("GET", url + "/metrics").text.splitlines()
    page.keyboard.press("2")
    page.locator("#main").wait_for()
    page.keyboard.press("w")
    keep_showing(rig, page, WALL_SEEN)
    until(lambda: "tactiled_streams 1" in ask("GET", url + "/metrics").text.splitlines())


def test_a_sensor_that_falls_silent_dims_its_own_tile_only(pair, open_page):
    rig, url = pair
    page = open_page(f"{url}/#/wall", ready=f"{TILES}.length === 2")
    keep_showing(rig, page, WALL_SEEN)
    stop = threading.Event()
    sender = rig.play(30, stop)
    alive, silent = wait(page, f"{LEVELS}.join() === 'live,stale' && {FILTERS}")
    stop.set()
    sender.join()
    assert alive == "none"
    assert "grayscale(1)" in silent


def test_a_fault_of_the_service_at_one_sensor_shows_at_its_own_tile_only(pair, open_page, monkeypatch, caplog):
    rig, url = pair
    page = open_page(f"{url}/#/wall", ready=f"{TILES}.length === 2")
    keep_showing(rig, page, WALL_SEEN)
    works, thumb = Feed.binary, rig.service.sensor("thumb")
    with monkeypatch.context() as broken:
        broken.setattr(Feed, "binary", lambda feed, *of: works(feed, *of) if feed.sensor is not thumb else 1 / 0)
        said = f"{TILES}[1].includes('though frames come in')"
        keep_showing(rig, page, f"{LEVELS}.join() === 'live,stale' && {said}")
    keep_showing(rig, page, f"{LEVELS}.join() === 'live,live'")
    assert "ZeroDivisionError" in caplog.text


def test_the_wall_comes_back_with_the_service(pair, open_page):
    rig, _url = pair
    with running(rig.service) as other:
        page = open_page(f"{other}/#/wall", ready=f"{TILES}.length === 2")
        keep_showing(rig, page, WALL_SEEN)
    wait(page, f"{LEVELS}.join() === 'disconnected,disconnected'")
    with running(rig.service, Server(port=int(other.rsplit(":", 1)[1]))):
        keep_showing(rig, page, f"{LEVELS}.join() === 'live,live'")
        page.close()
    page.faults.clear()  # the browser itself reports every failure


def test_a_tile_tells_the_warnings_of_its_sensor(pair, open_page):
    rig, url = pair
    page = open_page(f"{url}/#/wall", ready=f"{TILES}.length === 2")
    said = f"{TILES}[0].includes('1 warning: 23 taxels did not arrive')"
    dots = "[...document.querySelectorAll('.tile .dot')].map(dot => getComputedStyle(dot))"
    looks = f"{dots}.map(({{ backgroundColor, clipPath }}) => [backgroundColor, clipPath])"

    def send():
        rig.both()
        rig.send(pressed(), drop=(1,))

    palm, thumb = keep(send, page, f"{said} && {LEVELS}.join() === 'live,live' && {looks}")
    assert palm[0] != thumb[0]
    assert palm[1] != thumb[1] == "none"
    whole = "23 taxels did not arrive: restored from their neighbours"
    assert page.get_by_role("button", name=re.compile(f"^palm.*1 warning: {whole}")).count() == 1
    assert page.locator(".tile .doubt").first.get_attribute("title") == whole


def test_nothing_touches_what_is_known_where_taxels_are_unknown(rig, url, open_page):
    none = np.full((SIDE, SIDE), NO_LOAD)
    rig.show(none)
    page = open_page(url)
    page.get_by_text("No contact").wait_for()
    said = "document.getElementById('contact-list').innerText"
    known = "Nothing touches the 41 of 64 taxels that are known."
    keep(lambda: rig.send(none, drop=(1,)), page, f"{said}.includes('{known}')")


LONG = ("left_index_fingertip", "left_index_finger_distal_phalanx_skin_revision_b")
NAMES = "[...document.querySelectorAll('.tile b')]"


@pytest.fixture
def long(request):
    """Sensors with long names."""
    more = (THUMB.replace("thumb", name).replace("id = 1", f"id = {at}") for at, name in enumerate(LONG, 1))
    channel = re.sub(r"\W", "-", request.node.name)
    with meanwhile(Pair(channel, "".join(more))) as made, running(made.service) as url:
        yield made, url


@pytest.mark.parametrize("size", [PHONE, {**PHONE, "width": 320, "height": 640}, {"width": 1024, "height": 768}])
def test_long_names_take_no_room_from_what_stands_beside_them(long, open_page, size):
    _rig, url = long
    page = open_page(f"{url}/#/wall", ready=f"{TILES}.filter(text => /silent/.test(text)).length === 3", **size)
    assert page.evaluate("document.documentElement.scrollWidth") <= size["width"]
    assert page.evaluate(f"{NAMES}.map(name => name.title)") == ["palm", *LONG]
    assert page.evaluate(f"{NAMES}.slice(0, 2).every(name => name.scrollHeight <= name.clientHeight)")
    tiles, maps = page.locator(".tile").all(), page.locator(".tile .box").all()
    places = [(tile.bounding_box(), box.bounding_box()) for tile, box in zip(tiles, maps, strict=True)]
    for (tile, box), (other, beside) in itertools.combinations(places, 2):
        assert tile["y"] != other["y"] or box["y"] == beside["y"]


def test_an_event_of_a_sensor_with_a_long_name_is_not_cut(long, open_page):
    rig, url = long
    sensor = rig.service.sensor(LONG[1])
    for message in sensor.codec.encode(np.full(4, 100, np.uint16), 0, time.time()):
        rig.bus.send(message)
    page = open_page(f"{url}/#{LONG[1]}")
    page.locator("#events").get_by_text(f"{LONG[1]}: sensor live").wait_for()
    assert page.locator("#events").evaluate("({ scrollWidth, clientWidth }) => scrollWidth <= clientWidth")
