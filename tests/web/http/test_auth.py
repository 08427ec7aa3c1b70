"""Tokens, foreign pages and foreign host names."""

import secrets
from itertools import product

import httpx
import pytest
from pydantic import ValidationError
from websockets.sync.client import connect

from tactiled.config import Server, parse
from tactiled.errors import ConfigError
from tactiled.web.http.auth import Tokens
from tactiled.web.server import running
from tests.conftest import BUSY_S, CONFIG, CONTROL, HTTP, READ, TOKENS, ask, pressed, problem
from tests.process import self_signed
from tests.web.http.raw import send_raw, websocket_url
from tests.web.ws.clients import closed

METHOD, TARE = "/api/v1/sensors/palm/method", "/api/v1/sensors/palm/tare"
RAW = {"method": "raw"}


def bearer(token):
    return {"Authorization": f"Bearer {token}"}


FOREIGN_HOSTS = (
    "elsewhere.example", "localhost.elsewhere.example", "127.0.0.1.elsewhere.example", "localhost@elsewhere",
    "elsewhere@localhost", "localhost:80@elsewhere", "[::1", "[::1]x", "::1", "localhost:", "localhost:x", "",
    "127.0.0.2", "0x7f000001", "2130706433", "localhost\tx", "localhost, elsewhere", "l\xf6calhost",
)  # fmt: skip


def test_loopback_is_served_under_its_own_names_only(rig, url):
    for host in FOREIGN_HOSTS:
        assert send_raw(url, "GET /api/v1/health", f"Host: {host}")[0] in (400, 403), host
        body = f"Host: {host}", "Content-Type: application/json", "Content-Length: 17"
        assert send_raw(url, f"PUT {METHOD}", *body, data=b'{"method": "raw"}')[0] in (400, 403), host
    assert rig.sensor.method == "wiener"
    assert send_raw(url, "GET /api/v1/health", "Host: localhost", "Host: elsewhere")[0] == 400  # RFC 9112, 3.2
    for host in ("localhost", "LocalHost:1", "127.0.0.1", "[::1]", "[::1]:8000"):
        assert send_raw(url, "GET /api/v1/health", f"Host: {host}")[0] == 200


def test_with_a_token_loopback_is_served_under_the_name_of_its_proxy(guarded):
    proxied = {"Host": "robot.example:8443", "X-Forwarded-For": "192.0.2.1", "X-Forwarded-Proto": "https"}
    origin = {"Origin": "https://robot.example:8443"}

    def put(headers):
        return ask("PUT", guarded + METHOD, headers=proxied | headers, json=RAW)

    problem(put(origin), 401)  # as a page does that has its name lead here: no cookie is for that name
    for foreign in ("https://elsewhere.example", "https://norobot.example:8443"):
        problem(put(bearer(CONTROL) | {"Origin": foreign}), 403)
    assert put(bearer(CONTROL) | origin).status_code == 200


FOREIGN_ORIGINS = ("https://elsewhere.example", "null", "", "http://localhost:1", "file://")
FOREIGN = (
    *({"Origin": origin} for origin in FOREIGN_ORIGINS),
    {"Sec-Fetch-Site": "cross-site"},
    {"Sec-Fetch-Site": "same-site", "Sec-Fetch-Mode": "no-cors"},
)
LINK = {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "navigate"}


def test_a_page_of_another_site_is_refused(rig, tmp_path):
    server = Server(port=0, recordings=tmp_path)
    with running(rig.service, server) as url, httpx.Client(**HTTP, base_url=url) as client:
        paths = client.get("/api/v1/openapi.json").json()["paths"].items()
        verbs = [(verb, path) for path, operations in paths for verb in set(operations) - {"get"}]
        assert len(verbs) >= 6
        for headers, (verb, path) in product((*FOREIGN, LINK), verbs):
            path = path.format(name="palm", number=1, region="heel")
            problem(client.request(verb, path, headers=headers, json=RAW), 403)
        for headers in FOREIGN:
            problem(client.get("/api/v1/health", headers=headers), 403)
        for headers, path in product((*FOREIGN, LINK), ("/api/v1/sensors/palm/stream", "/api/v1/stream")):
            with connect(websocket_url(url, path), additional_headers=headers) as stream:
                assert closed(stream)[0] == 4403
        assert client.get("/api/v1/health", headers={"Origin": url}).status_code == 200
        assert client.get("/", headers=LINK).status_code == 200  # it opens the viewer
    assert rig.sensor.method == "wiener"
    assert {each.kind for each in rig.service.events.after(0)} <= {"sensor_silent"}


def test_every_resource_needs_a_token(guarded):
    paths = ("/", "/api/v1/health", "/api/v1/openapi.json", "/static/app.js")
    for path, token in product(paths, ("", "r", "x" * 16, READ + "r", READ.upper(), "ü" * 16)):
        answer = ask("GET", guarded + path, params={"token": token})
        assert answer.headers["www-authenticate"] == "Bearer"
        assert problem(answer, 401).startswith("this token is unknown" if token else "a token is needed")
        assert ask("HEAD", guarded + path, headers=bearer("x" * 16)).status_code == 401
    with connect(websocket_url(guarded)) as client:
        assert closed(client)[0] == 4401
    with connect(websocket_url(guarded, f"/api/v1/stream?token={READ}")) as client:
        assert client.recv(timeout=BUSY_S)
    with connect(websocket_url(guarded), additional_headers=bearer(CONTROL)) as client:
        assert client.recv(timeout=BUSY_S)


def test_a_browser_keeps_the_token_of_each_service_in_a_cookie_that_no_script_reads(rig, guarded):
    with httpx.Client(**HTTP, base_url=guarded) as browser:
        answer = browser.get("/", params={"token": READ})
        assert (answer.status_code, answer.headers["location"]) == (303, "/")
        port = guarded.rpartition(":")[2]
        assert answer.headers["set-cookie"] == f"tactiled-{port}={READ}; HttpOnly; SameSite=Strict; Path=/"
        assert browser.get("/api/v1/health").status_code == 200
        assert browser.post(TARE).status_code == 403
        with running(rig.service, Server(port=0, control_token=VALID)) as other:  # of one host
            browser.get(other, params={"token": VALID})
            assert [browser.get(url + "/api/v1/health").status_code for url in (guarded, other)] == [200, 200]


@pytest.mark.parametrize(
    ("server", "error"),
    [
        ('host = "0.0.0.0"', "server: other machines could reach it: give control_token"),
        ('read_token = "0123456789abcdef"', "server: read_token without control_token"),
        ('control_token = "short"', "server.control_token: "),
        ("control_token = 'short; of sixteen'", "server.control_token: holds what a client cannot show"),
        ('tls_key = "key.pem"', "server: tls_certificate and tls_key: give both or neither"),
        ('allowed_origins = ["https://app.example"]', "server: allowed_origins without control_token"),
    ],
)
def test_a_server_that_is_open_by_mistake_is_refused(server, error):
    with pytest.raises(ConfigError) as caught:
        parse(f"[server]\n{server}\n{CONFIG.format(channel='none')}")
    assert error in str(caught.value)
    assert "short" not in str(caught.value).removeprefix("config: server.control_token")


VALID = "".join(set(map(chr, range(33, 127))) - set('"#%&+,;\\'))


def test_a_valid_token_can_be_sent_unencoded_in_header_address_and_cookie(rig):
    with running(rig.service, Server(port=0, control_token=VALID)) as url:
        line = "GET /api/v1/health"
        assert send_raw(url, f"{line}?token={VALID}")[0] == 200
        assert send_raw(url, line, f"Authorization: Bearer {VALID}")[0] == 200
        assert send_raw(url, line, f"Authorization: Basic {VALID}")[0] == 401
        assert send_raw(url, line, f"Cookie: a=b; tactiled={VALID}; c=d")[0] == 200  # of a host without a port
        assert send_raw(url, line, f"Cookie: tactiled=x{VALID}")[0] == 401
        answer = ask("GET", url, params={"token": VALID})
        assert f"={VALID}; " in answer.headers["set-cookie"]


@pytest.mark.parametrize("character", ["ü", "\u2028", " ", "\t", "\0", "\x7f", *'"#%&+,;\\'])
def test_a_token_that_a_client_cannot_show_is_refused(character):
    with pytest.raises(ValidationError, match="holds what a client cannot show"):
        Server(control_token="x" * 16 + character)


def test_every_token_is_compared_in_constant_time(monkeypatch):
    tokens = Tokens(Server(**TOKENS))
    compared, compare = [], secrets.compare_digest
    monkeypatch.setattr(secrets, "compare_digest", lambda a, b: compared.append(b) or compare(a, b))
    for token, rights in {"": set(), "r": set(), READ: {"read"}, CONTROL: {"read", "control"}, "ü": set()}.items():
        compared.clear()
        assert tokens.rights(token) == rights
        assert compared == [b"r" * 16, b"c" * 16]


def test_no_answer_has_a_token(rig, tmp_path):
    rig.show(pressed())
    count, options = 0, HTTP | {"headers": bearer(CONTROL)}
    server = Server(port=0, recordings=tmp_path, **TOKENS)
    with running(rig.service, server) as url, httpx.Client(**options, base_url=url) as client:
        for path, operations in client.get("/api/v1/openapi.json").json()["paths"].items():
            if "get" in operations:
                address = path.format(name="palm", kind="raw", number=0, region="heel")
                for query in ("", f"?token={CONTROL}", f"?limit={READ[:4]}"):
                    answer = client.get(address + query)
                    text = answer.text + str(answer.headers)
                    assert READ not in text, address
                    assert CONTROL not in text, address
                    count += 1
    assert count >= 30


def test_a_slash_at_the_end_of_an_address_redirects_no_token(url):
    for path in ("sensors/", "health/", "sensors/palm/"):
        answer = ask("GET", f"{url}/api/v1/{path}", params={"token": "hush"}, headers={"Host": "localhost"})
        assert problem(answer, 404) == f"GET /api/v1/{path}: not found"
        assert "location" not in answer.headers


@pytest.mark.parametrize("host", ["127.0.0.1", "0.0.0.0"])
def test_a_browser_keeps_to_tls_except_on_loopback(rig, tmp_path, host):
    """On loopback every other server of this machine would need it."""
    files = dict(zip(("tls_certificate", "tls_key"), self_signed(tmp_path), strict=True))
    for tls in (files, {}):
        with running(rig.service, Server(host=host, port=0, **TOKENS, **tls)) as url:
            answer = ask("GET", url, headers=bearer(READ), params={"token": READ}, verify=False)
            assert answer.headers["set-cookie"].endswith("; Secure") == bool(tls)
            transport = answer.headers.get("strict-transport-security")
            assert transport == ("max-age=31536000" if tls and host == "0.0.0.0" else None)
            plain = not tls and host == "0.0.0.0"  # where browsers complain of what they do not keep
            assert ("cross-origin-opener-policy" in answer.headers) == (not plain)


PAGE = "https://app.example:8443"


def test_pages_of_allowed_origins_use_the_service_with_a_token_and_no_others_do(rig):
    """Requests, streams, and what a browser asks before."""
    rig.show(pressed())
    allowed = Server(port=0, allowed_origins=(PAGE,), **TOKENS)
    cross = {"Origin": PAGE, "Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "cors"}
    asked = cross | {"Access-Control-Request-Method": "PUT", "Access-Control-Request-Headers": "authorization"}
    with running(rig.service, allowed) as url, httpx.Client(**HTTP, base_url=url) as client:
        before = client.options(METHOD, headers=asked)
        assert (before.status_code, before.headers["access-control-allow-origin"]) == (204, PAGE)
        assert "PUT" in before.headers["access-control-allow-methods"]
        assert "Authorization" in before.headers["access-control-allow-headers"]
        answer = client.get("/api/v1/sensors/palm/frames/raw", headers=cross | bearer(READ))
        assert (answer.status_code, answer.headers["access-control-allow-origin"]) == (200, PAGE)
        assert {each.strip() for each in answer.headers["vary"].split(",")} == {"Accept", "Origin"}
        assert client.put(METHOD, headers=cross | bearer(CONTROL), json=RAW).status_code == 200
        assert rig.sensor.method == "raw"
        assert client.get("/api/v1/config", headers=bearer(READ)).json()["server"]["allowed_origins"] == [PAGE]
        for verb, path in (("PUT", METHOD), ("POST", TARE), ("DELETE", TARE)):
            assert "control token" in problem(client.request(verb, path, headers=cross | bearer(READ)), 403)
        assert problem(client.get(METHOD, headers=cross), 401).startswith("a token is needed")
        for origin in ("https://app.example", "http://app.example:8443", "null"):
            refused = client.get(METHOD, headers=cross | bearer(CONTROL) | {"Origin": origin})
            assert "access-control-allow-origin" not in refused.headers
            problem(refused, 403)
            problem(client.options(METHOD, headers=asked | {"Origin": origin}), 403)
        for query, code in ((f"?token={READ}", None), ("", 4401)):
            with connect(websocket_url(url, f"/api/v1/stream{query}"), additional_headers=cross) as stream:
                assert stream.recv(timeout=BUSY_S) if code is None else closed(stream)[0] == code


@pytest.mark.parametrize("origin", ["app.example", "https://app.example/", "*", "null", "https://App.example"])
def test_what_is_no_origin_is_refused_by_name(origin):
    with pytest.raises(ValidationError, match=r"allowed_origins.0[^']*give a page's origin"):
        Server(allowed_origins=[origin], **TOKENS)


HTML = {"Accept": "text/html,application/xhtml+xml"}
FORM = {"Content-Type": "application/x-www-form-urlencoded"}


def test_a_browser_without_a_token_gets_a_form_and_a_program_an_error(guarded, caplog):
    for path in ("/", "/docs"):
        page = ask("GET", guarded + path, headers=HTML)
        assert (page.status_code, page.headers["content-type"]) == (401, "text/html; charset=utf-8")
        assert 'type="password" autocomplete="current-password"' in page.text
        assert '<form method="post">' in page.text  # goes where the page is
        assert "form-action 'self'" in page.headers["content-security-policy"]
        assert page.headers["referrer-policy"] == "same-origin"
        own = FORM | {"Origin": guarded}
        wrong = ask("POST", guarded + path, headers=own, data={"token": "no" * 8})
        assert (wrong.status_code, "This token is unknown" in wrong.text) == (401, True)
        assert "set-cookie" not in wrong.headers
        right = ask("POST", guarded + path, headers=own, data={"username": "tactiled", "token": READ})
        assert (right.status_code, right.headers["location"]) == (303, path)
        assert READ in right.headers["set-cookie"]
        problem(ask("POST", guarded + path, headers=own | {"Origin": "null"}, data={"token": READ}), 403)
    assert "This token is unknown" in ask("GET", f"{guarded}/?token={'x' * 16}", headers=HTML).text
    problem(ask("GET", guarded + "/api/v1/health", headers=HTML), 401)
    problem(ask("POST", guarded + METHOD, headers=own, data={"token": READ}), 401)
    assert READ not in caplog.text
