"""The page of the REST API: Swagger UI from an installed package, under the service's own policy."""

import pytest
from pydantic import SecretStr

from tactiled.config import Server
from tactiled.web.server import running
from tests.conftest import ask
from tests.viewer.conftest import wait

ROUTES = "document.querySelectorAll('.opblock').length"
TOKEN = "c" * 16


@pytest.fixture
def guarded(rig):
    with running(rig.service, Server(port=0, control_token=SecretStr(TOKEN))) as url:
        yield url


def test_it_shows_every_route_of_the_description(url, open_page):
    page = open_page(f"{url}/docs", ready=ROUTES)
    paths = ask("GET", f"{url}/api/v1/openapi.json").json()["paths"]
    described = {f"{verb.upper()} {path}" for path, verbs in paths.items() for verb in verbs}
    shown = page.evaluate(
        """[...document.querySelectorAll('.opblock')].map(each => [
          each.querySelector('.opblock-summary-method').textContent,
          each.querySelector('.opblock-summary-path').dataset.path].join(' '))"""
    )
    assert sorted(shown) == sorted(described)


def test_a_request_from_it_is_answered_to_the_cookie(guarded, open_page):
    page = open_page(f"{guarded}/?token={TOKEN}", ready="document.title")
    page.goto(f"{guarded}/docs")
    wait(page, ROUTES)
    route = page.locator(".opblock", has=page.locator("[data-path='/api/v1/sensors']"))
    route.locator(".opblock-summary-control").click()
    route.locator(".try-out__btn").click()
    route.locator(".execute").click()
    answer = route.locator(".live-responses-table tr.response")
    answer.wait_for()
    assert "200" in answer.inner_text()
    assert '"name": "palm"' in answer.inner_text()


def test_it_asks_for_a_token_where_one_is_needed(guarded):
    for path in ("/docs", "/static/swagger/swagger-ui.css"):
        assert ask("GET", guarded + path).status_code == 401, path
