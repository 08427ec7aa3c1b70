import httpx
import pytest
from pydantic import SecretStr, ValidationError
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from tactiled.config import Server, parse
from tactiled.errors import ConfigError
from tactiled.web.server import running
from tests.conftest import BUSY_S, CONFIG, HTTP, ask, pressed
from tests.web.http.test_attacks import raw

READ, CONTROL = "r" * 16, "c" * 16


@pytest.fixture
def guarded(rig):
    rig.show(pressed())
    with running(rig.service, Server(port=0, read_token=SecretStr(READ), control_token=SecretStr(CONTROL))) as url:
        yield url


def bearer(token):
    return {"Authorization": f"Bearer {token}"}


@pytest.mark.parametrize("token", ["", "r", "x" * 16, READ + "r", "ü" * 16])
@pytest.mark.parametrize("path", ["/", "/api/v1/health", "/api/v1/openapi.json", "/static/app.js"])
def test_nothing_is_seen_without_a_token(guarded, path, token):
    answer = ask("GET", guarded + path, params={"token": token})
    assert answer.status_code == 401
    assert answer.headers["www-authenticate"] == "Bearer"
    assert answer.json()["detail"].startswith("a token is needed")


def test_the_read_token_reads_and_the_control_token_controls(guarded, rig):
    method = guarded + "/api/v1/sensors/palm/method"
    asked = {"method": "raw"}
    assert ask("GET", method, headers=bearer(READ)).status_code == 200
    answer = ask("PUT", method, json=asked, headers=bearer(READ))
    assert (answer.status_code, rig.sensor.method) == (403, "wiener")
    assert "control token" in answer.json()["detail"]
    assert ask("PUT", method, json=asked, headers=bearer(CONTROL)).status_code == 200
    assert rig.sensor.method == "raw"


def test_a_browser_keeps_the_token_where_no_script_reads_it(guarded):
    with httpx.Client(**HTTP, base_url=guarded) as browser:
        answer = browser.get("/", params={"token": READ})
        assert (answer.status_code, answer.headers["location"]) == (303, "/")
        cookie = answer.headers["set-cookie"]
        assert "HttpOnly" in cookie
        assert "SameSite=Strict" in cookie
        assert browser.get("/api/v1/health").status_code == 200
        assert browser.post("/api/v1/sensors/palm/tare").status_code == 403


def test_streams_need_a_token_too(guarded):
    address = guarded.replace("http", "ws", 1) + "/api/v1/sensors/palm/stream"
    with connect(address) as client:
        with pytest.raises(ConnectionClosed) as caught:
            client.recv(timeout=BUSY_S)
        assert caught.value.rcvd.code == 4401
    with connect(f"{address}?token={READ}") as client:
        assert client.recv(timeout=BUSY_S)
    with connect(address, additional_headers=bearer(CONTROL)) as client:
        assert client.recv(timeout=BUSY_S)


@pytest.mark.parametrize(
    ("server", "says"),
    [
        ('host = "0.0.0.0"', "server: other machines could reach it: give control_token"),
        ('read_token = "0123456789abcdef"', "server: read_token without control_token"),
        ('control_token = "short"', "server.control_token: "),
        ("control_token = 'short; of sixteen'", "server.control_token: holds what a client cannot show"),
        ('tls_key = "key.pem"', "server: tls_certificate and tls_key: give both or neither"),
    ],
)
def test_a_server_that_is_open_by_mistake_is_refused(server, says):
    with pytest.raises(ConfigError) as caught:
        parse(f"[server]\n{server}\n{CONFIG.format(channel='none')}")
    assert says in str(caught.value)
    assert "short" not in str(caught.value).removeprefix("config: server.control_token")


WORKS = "".join(set(map(chr, range(33, 127))) - set('"#%&+,;\\'))


def test_a_token_that_is_accepted_can_be_shown_in_every_way(rig):
    """As it is: not even encoded in an address."""
    with running(rig.service, Server(port=0, control_token=SecretStr(WORKS))) as url:
        line = "GET /api/v1/health"
        assert raw(url, f"{line}?token={WORKS}")[0] == 200
        assert raw(url, line, f"Authorization: Bearer {WORKS}")[0] == 200
        assert raw(url, line, f"Cookie: a=b; tactiled={WORKS}; c=d")[0] == 200
        assert raw(url, line, f"Cookie: tactiled=x{WORKS}")[0] == 401
        answer = ask("GET", url, params={"token": WORKS})
        assert answer.headers["set-cookie"].startswith(f"tactiled={WORKS}; ")


@pytest.mark.parametrize("character", ["ü", "\u2028", " ", "\t", "\0", "\x7f", *'"#%&+,;\\'])
def test_a_token_that_could_not_be_shown_is_refused(character):
    with pytest.raises(ValidationError, match="holds what a client cannot show"):
        Server(control_token=SecretStr("x" * 16 + character))
