"""A service that goes away and comes back, its tokens, and the page of its REST API."""

from tactiled.config import Server
from tactiled.web.server import running
from tests.conftest import CONFIG, CONTROL, ask, meanwhile, pressed
from tests.viewer.conftest import LEVELS, PAINTINGS, THUMB, Pair

# Whether anything is drawn on a canvas.
INKED = """(id => {
  const canvas = document.getElementById(id);
  return canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data.some(each => each);
})"""
TABS = "[...document.querySelectorAll('[role=tab] span:not(.dot, .sub)')].map(each => each.innerText).join()"
CHARTS = ("section", "forces", "latencies", "kernel")


def test_a_page_without_its_service_says_so_and_finds_it_again(request, open_page):
    with meanwhile(Pair(request.node.name, THUMB)) as rig:
        rig.stale_after(600)
        with running(rig.service) as url:
            for _ in range(3):
                rig.both()
            page = open_page(url)
            for name in CHARTS:
                page.wait(f"{INKED}('{name}')")
            page.wait("/[µm]s/.test(document.getElementById('jitter').textContent)")
        page.locator("#banner", has_text="DISCONNECTED").get_by_role(
            "button", name="Retry now", exact=True
        ).wait_for()
        server = Server(port=int(url.rsplit(":", 1)[1]))
        with running(rig.service, server):
            page.keep(rig.both, f"{PAINTINGS} > {page.painted()} && document.body.dataset.level === 'live'")
        page.locator("#banner", has_text="DISCONNECTED").wait_for()
        page.press("2")  # nothing of the palm is left behind
        page.locator("#notice", has_text="thumb").wait_for()
        for name in CHARTS[:-1]:  # the kernel's keeps its axes
            assert not page.evaluate(f"{INKED}('{name}')"), name
        page.wait("document.getElementById('jitter').textContent === '\u2013'")
        assert set(page.text("skew", "rate", "force-raw")) == {"\u2013"}
        with running(rig.service, server):
            page.press("w")
            page.keep(rig.both, f"{LEVELS} === 'live,live'")
        page.wait(f"{LEVELS} === 'disconnected,disconnected'")
        with running(rig.service, server):
            page.keep(rig.both, f"{LEVELS} === 'live,live'")
            page.finish()


def test_a_page_follows_sensors_that_a_reload_adds_restarts_and_removes(serve, open_page, tmp_path):
    rig, url = serve(THUMB)
    rig.stale_after(600)
    for _ in range(3):
        rig.both()
    page, rig.service.path = open_page(url), tmp_path / "rig.toml"
    bus, palm = CONFIG.format(channel=rig.config.bus["can0"].channel).split("[sensor.palm]")
    wide = "[sensor.palm]" + palm.replace("pitch_mm = 1.0", "pitch_mm = 3.0").replace("0.3\n", "600\n")
    tip = THUMB.replace("thumb", "tip")

    def reload(*sensors):
        rig.service.path.write_text(bus + "".join(sensors))
        rig.service.reload()

    assert page.evaluate(TABS) == "All,palm,thumb"
    reload(wide, tip)
    page.wait(f"{TABS} === 'All,palm,tip'")
    rig.sensor, rig.sequence = rig.service.sensor("palm"), -1
    with page.page.expect_request("**/palm/geometry"):  # its places may be others now
        rig.show(pressed())
    page.show(rig, pressed())
    reload(tip)
    page.wait(f"{TABS} === 'tip'")
    page.finish("404", "503")  # of the sensor that is gone, and of one without a frame


def test_the_page_of_the_api_shows_every_route_and_its_requests_carry_the_cookie(guarded, open_page):
    for path in ("/docs", "/static/swagger/swagger-ui.css"):
        assert ask("GET", guarded + path).status_code == 401, path
    page = open_page(f"{guarded}/?token={CONTROL}", ready="document.title")
    page.goto(f"{guarded}/docs")
    page.wait("document.querySelectorAll('.opblock').length")
    paths = ask("GET", f"{guarded}/api/v1/openapi.json?token={CONTROL}").json()["paths"]
    routes = page.evaluate(
        """[...document.querySelectorAll('.opblock')].map(each => [
          each.querySelector('.opblock-summary-method').textContent,
          each.querySelector('.opblock-summary-path').dataset.path].join(' '))"""
    )
    assert sorted(routes) == sorted(f"{verb.upper()} {path}" for path, verbs in paths.items() for verb in verbs)
    route = page.locator(".opblock", has=page.locator("[data-path='/api/v1/sensors']"))
    for button in (".opblock-summary-control", ".try-out__btn", ".execute"):
        route.locator(button).click()
    answer = route.locator(".live-responses-table tr.response")
    answer.wait_for()
    assert "200" in answer.inner_text()
    assert '"name": "palm"' in answer.inner_text()
