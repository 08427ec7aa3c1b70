"""`tactiled run` as a process of its own: what it does at SIGHUP, after kill -9, and at SIGTERM."""

import signal
from contextlib import contextmanager

import pytest

from tactiled.build import make_codec
from tactiled.config import load
from tactiled.web.http.protocols import ENDS
from tests.conftest import CONFIG, ask, until
from tests.process import Running
from tests.skin import TIP
from tests.web.ws.clients import closed, stream, text

SERVER = '[server]\nport = 0\nstate = "{folder}/state.json"\n'
BUS = 'interface = "udp_multicast"\nport = {port}\nhop_limit = 0'


@pytest.fixture
def config(multicast, udp_port, tmp_path):
    path, bus = tmp_path / "palm.toml", BUS.format(port=udp_port)
    text = CONFIG.format(channel=multicast).replace('interface = "virtual"', bus)
    path.write_text(SERVER.format(folder=tmp_path) + text.replace("stale_after_s = 0.3", "stale_after_s = 600"))
    return path


@contextmanager
def started(config, tmp_path):
    service = Running(config, XDG_CACHE_HOME=str(tmp_path / "cache"))
    try:
        yield service
    finally:
        service.kill()


def test_it_reloads_at_sighup_and_closes_streams_at_sigterm(config, tmp_path):
    with started(config, tmp_path) as service, stream(service.url) as client:
        right = config.read_text()
        config.write_text(right.replace('"wiener"', '"sharpen"'))
        service.signal(signal.SIGHUP)
        line = service.line("config_refused: ")
        assert "sensor.palm: method = 'sharpen'" in line
        config.write_text(right + TIP)
        service.signal(signal.SIGHUP)
        assert "sensors: added tip; 1 unchanged; buses: 1 unchanged" in service.line("config_reloaded: ")
        health = ask("GET", service.url + "/api/v1/health").json()
        assert health["sensors"].keys() == {"palm", "tip"}
        assert text(client)["state"] == "silent"
        assert service.end() == 0
        assert closed(client) == (1012, ENDS)


def test_after_kill_9_it_goes_on_with_the_method_tare_and_kernel_that_it_had(config, tmp_path, playing):
    settings = load(config)
    playing(settings.bus["can0"].settings(), make_codec(settings.sensor["palm"]))
    api = "/api/v1/sensors/palm"

    def events(service):
        return {each["kind"]: each["text"] for each in ask("GET", service.url + "/api/v1/events").json()["events"]}

    with started(config, tmp_path) as service:
        until(lambda: ask("GET", service.url + api).json()["state"] == "live")
        method = {"method": "raw", "keep": True}
        ask("PUT", service.url + api + "/method", json=method).raise_for_status()
        ask("POST", service.url + api + "/tare?force=true").raise_for_status()
        until(lambda: "tare_done" in events(service))
        tared_at = ask("GET", service.url + api).json()["tared_at"]
        service.kill()
    cache = {path: path.stat().st_mtime_ns for path in (tmp_path / "cache").rglob("*") if path.is_file()}
    assert cache
    with started(config, tmp_path) as service:
        until(lambda: ask("GET", service.url + api).json()["state"] == "live")
        status = ask("GET", service.url + api).json()
        assert (status["method"], status["tared_at"]) == ("raw", tared_at)
        assert {"method_kept", "tare_kept"} <= events(service).keys()
        assert not any("computed again" in line for line in service.lines)
    for path, changed_at in cache.items():
        assert path.stat().st_mtime_ns == changed_at
