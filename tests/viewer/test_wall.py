"""All sensors at once: a tile each, on one socket."""

import re

import numpy as np
import pytest

from tactiled.web import answers
from tactiled.web.ws.feed import Feed
from tests.conftest import CONFIG, ask, pressed, until
from tests.viewer.conftest import LEVELS, PAINTINGS, SCROLL_WIDTH, THUMB, TILES

FORCES = f"{TILES}.map(text => parseFloat(text.match(/([\\d.]+) N/)?.[1]))"
FILTERS = "[...document.querySelectorAll('.tile canvas')].map(canvas => getComputedStyle(canvas).filter)"
READY = f"{TILES}.length === 2"
BOTH = f"{FORCES}.every(force => force > 0)"
NOTICE = "document.getElementById('notice').innerText"
ONE_SOCKET = "tactiled_streams 1.0"
# The brightness of each cell of the first tile.
BRIGHTNESS = """(() => {
  const { data } = document.querySelector('.tile canvas').getContext('2d').getImageData(0, 0, 8, 8);
  return Array.from({ length: 64 }, (_, i) => data[4 * i] + data[4 * i + 1] + data[4 * i + 2]);
})()"""


def brightness(page):
    page.refreshed()
    return np.reshape(page.evaluate(BRIGHTNESS), (8, 8))


def test_every_sensor_has_a_tile_with_its_map_and_force_on_one_socket(pair, open_page):
    rig, url = pair
    page = open_page(f"{url}/#/wall", ready=READY)
    page.keep(rig.both, f"{BOTH} && {BRIGHTNESS}.some(each => each)")
    assert ONE_SOCKET in ask("GET", url + "/metrics").text.splitlines()
    image, other = rig.both()
    areas = rig.service.sensor("thumb").plan.cells.side ** 2
    forces = [image.restored.sum() * 1e-3, np.nansum(other.restored * areas) * 1e-3]  # the palm's cells are 1 mm2
    assert page.evaluate(FORCES) == pytest.approx(forces, abs=0.006)
    assert [each.split()[0] for each in page.evaluate(TILES)] == ["palm", "thumb"]
    cells = brightness(page)
    assert cells[3:5, 3:5].min() > 3 * cells[:2].max()
    for key in ("s", "c"):
        page.press(key)
        page.wait(f"{NOTICE} === 'To save a frame, choose one sensor.'")
        page.evaluate("document.getElementById('notice').textContent = ''")
    page.get_by_role("button", name=re.compile("thumb")).first.click()
    page.wait(f"location.hash === '#thumb' && {PAINTINGS} > 0")
    assert not page.locator("#wall").is_visible()
    page.press("w")
    page.keep(rig.both, BOTH)
    until(lambda: ONE_SOCKET in ask("GET", url + "/metrics").text.splitlines())
    for key, place, tab in (("1", "#main", "palm"), ("w", "#wall", "All")):
        page.press(key)
        page.locator(place).wait_for()
        assert page.get_by_role("tab", selected=True).inner_text().startswith(tab)
    routes = []  # a sensor that is left before it is there has nothing more requested
    page.route("**/sensors/thumb/geometry*", lambda route: routes.append(route))
    with page.expect_request("**/sensors/thumb/geometry*"):
        page.get_by_role("button", name=re.compile("thumb")).first.click()
    page.press("w")
    page.wait("location.hash.startsWith('#/wall')")
    with page.expect_response("**/sensors/thumb/geometry*"):
        routes[0].continue_()
    with page.expect_response(lambda answer: "/events" in answer.url):
        pass


SCALES = "[...document.querySelectorAll('.tile .scale')].map(each => each.textContent)"
TOPS = f"{SCALES}.map(text => Number(text.match(/^restored0(\\d+) kPa$/)?.[1]))"
LIT = (
    "[...document.querySelectorAll('.tile canvas')].map(each => each.getContext('2d')"
    ".getImageData(0, 0, each.width, each.height)"
    ".data.reduce((most, value, i) => (i % 4 || value < most ? most : value), 0))"
)


def test_a_weak_sensor_shows_beside_a_strong_one_by_a_scale_that_is_kept_and_its_range_holds_a_peak(
    pair, open_page
):
    rig, url = pair

    def press(force=3800):
        rig.both(pressed(force=force), (120, 100, 100, 100))

    page = open_page(f"{url}/#/wall", ready=READY)
    page.keep(press, f"{TOPS}[0] > 10 * {TOPS}[1] && {LIT}[1] > 150")
    assert not page.locator("#wall-legend canvas").first.is_visible()
    page.locator("#wall-scale").select_option("same")
    page.keep(press, f"{TOPS}[0] > 100 && {TOPS}[0] === {TOPS}[1] && {LIT}[1] < 80")
    page.wait("location.hash === '#/wall?scale=same'")
    for address, same in (("#/wall", "true"), ("#/wall?scale=own", "false")):
        with page.expect_event("load"):  # a link that is opened in this tab
            page.evaluate("hash => { location.hash = hash; }", address)
        page.wait(READY)
        page.keep(press, f"{TOPS}[0] > 100 && {TOPS}[0] === {TOPS}[1] === {same}")
    page.keep(press, f"{FORCES}[0] > 5")
    before, force = brightness(page).max(), page.evaluate(f"{FORCES}[0]")
    with page.expect_response(lambda answer: "/events" in answer.url):  # the list of sensors is polled meanwhile
        pass
    page.keep(lambda: press(1750), f"{FORCES}[0] < {0.6 * force}")
    assert brightness(page).max() < 0.9 * before


def test_a_silent_or_faulty_sensor_or_one_with_warnings_shows_at_its_own_tile_only(
    pair, open_page, monkeypatch, caplog
):
    rig, url = pair
    page = open_page(f"{url}/#/wall", ready=READY)
    page.keep(rig.both, BOTH)
    with rig.playing(30):
        alive, silent = page.wait(f"{LEVELS} === 'live,stale' && {FILTERS}")
        page.wait(f"/stale/i.test({TILES}[1]) && / s ago/.test({TILES}[1])")
    assert alive == "none"
    assert "grayscale(1)" in silent
    binary, thumb = Feed.binary, rig.service.sensor("thumb")
    with monkeypatch.context() as broken:
        broken.setattr(Feed, "binary", lambda feed, *of: binary(feed, *of) if feed.sensor is not thumb else 1 / 0)
        page.keep(rig.both, f"{LEVELS} === 'live,stale' && {TILES}[1].includes('though frames come in')")
    assert "ZeroDivisionError" in caplog.text

    def lose():
        rig.both()
        rig.send(pressed(), drop=(1,))

    words = "23 taxels did not arrive: restored from their neighbours"
    dots = "[...document.querySelectorAll('.tile .dot')].map(dot => getComputedStyle(dot))"
    looks = f"{dots}.map(({{ backgroundColor, clipPath }}) => [backgroundColor, clipPath])"
    warned = f"/\\d warnings?: .*{words}/.test({TILES}[0]) && {LEVELS} === 'live,live' && {looks}"
    palm, thumb_dot = page.keep(lose, warned)
    assert palm[0] != thumb_dot[0]
    assert palm[1] != thumb_dot[1] == "none"
    assert page.get_by_role("button", name=re.compile(f"^palm.*warnings?: .*{words}")).count() == 1
    assert page.locator(f".tile [title*='{words}']").count() == 1


def test_a_tile_whose_sensor_had_no_shape_or_another_one_asks_again(pair, open_page, monkeypatch):
    rig, url = pair
    geometry, requests = answers.geometry, []

    def answer(sensor):
        requests.append(sensor.name)
        if requests.count(sensor.name) > 1:
            return geometry(sensor)
        if sensor.name == "palm":
            raise RuntimeError("not yet")
        return geometry(rig.sensor)

    monkeypatch.setattr(answers, "geometry", answer)
    page = open_page(f"{url}/#/wall", ready=READY)
    page.keep(rig.both, BOTH)
    assert sorted(requests) == ["palm", "palm", "thumb", "thumb"]
    page.finish("500")


def test_a_tile_takes_the_pitch_that_a_reload_changed(pair, open_page, tmp_path):
    rig, url = pair
    rig.stale_after(600)
    page = open_page(f"{url}/#/wall", ready=f"{FORCES}[0] > 0")
    assert rig.sequence == 0  # only a status says that another frame 0 is of the restarted sensor
    rig.service.path = tmp_path / "rig.toml"
    palm = CONFIG.format(channel=rig.config.bus["can0"].channel)
    rig.service.path.write_text(palm.replace("pitch_mm = 1.0", "pitch_mm = 3.0") + THUMB)
    rig.service.reload()
    page.wait(f"/silent/i.test({TILES}[0])")
    rig.sensor, rig.sequence = rig.service.sensor("palm"), -1
    force = 9e-3 * rig.show(pressed()).restored.sum()
    page.keep(lambda: rig.show(pressed()), f"Math.abs({FORCES}[0] - {force}) < 0.006")


LONG = ("left_index_fingertip", "left_index_finger_distal_phalanx_skin_revision_b")
NAMES = "[...document.querySelectorAll('.tile b')]"


def test_it_fills_the_window_and_long_names_take_no_room_from_others(serve, open_page):
    names = (*LONG, "index")
    more = (THUMB.replace("thumb", name).replace("id = 1", f"id = {at}") for at, name in enumerate(names, 1))
    rig, url = serve("".join(more))
    rig.send_to(LONG[1], (100, 100, 100, 100))
    page = open_page(f"{url}/#/wall", ready=f"{TILES}.filter(text => /silent|stale/.test(text)).length === 4")
    for width, height in ((900, 860), (390, 844), (320, 640), (1024, 768)):
        page.resize(width, height)
        assert page.evaluate(SCROLL_WIDTH) <= width
        assert page.evaluate(f"{NAMES}.map(name => name.title)") == ["palm", *names]
        assert page.evaluate(f"{NAMES}.slice(0, 2).every(name => name.scrollHeight <= name.clientHeight)")
        tiles = [tile.bounding_box()["y"] for tile in page.locator(".tile").all()]
        maps = [each.bounding_box()["y"] for each in page.locator(".tile .box").all()]
        assert len(set(zip(tiles, maps, strict=True))) == len(set(tiles))  # those of a row begin at one height
        last, legend = page.locator(".tile").last.bounding_box(), page.box("#wall-legend")
        assert last["y"] + last["height"] < legend["y"]
        if height > 800:
            assert (0.9 if width > 800 else 0.7) * height < legend["y"] + legend["height"] <= height
    page.press("3")
    page.locator("#events").get_by_text(f"{LONG[1]}: sensor").first.wait_for()  # live, or stale by now
    assert page.locator("#events").evaluate("({ scrollWidth, clientWidth }) => scrollWidth <= clientWidth")
