import ssl

import httpx

from tactiled.config import Server
from tactiled.web.server import running
from tests.conftest import CONFIG, HTTP, ask, problem
from tests.process import self_signed
from tests.skin import TIP

RELOAD = "/api/v1/config/reload"


def test_a_reload_answers_with_what_it_changed_and_every_list_follows(rig, url, tmp_path):
    rig.service.path = tmp_path / "rig.toml"
    palm = CONFIG.format(channel=rig.config.bus["can0"].channel)
    rig.service.path.write_text(palm + TIP)
    answer = ask("POST", url + RELOAD)
    assert answer.status_code == 200
    none = {"added": [], "removed": [], "restarted": []}
    sensors = none | {"added": ["tip"], "unchanged": ["palm"]}
    buses = none | {"unchanged": ["can0"]}
    assert answer.json() == {"sensors": sensors, "buses": buses, "certificate": None}
    with httpx.Client(**HTTP, base_url=url) as client:
        api = "/api/v1"
        assert [each["name"] for each in client.get(api + "/sensors").json()["sensors"]] == ["palm", "tip"]
        assert list(client.get(api + "/config").json()["sensor"]) == ["palm", "tip"]
        assert client.get(api + "/health").json()["sensors"].keys() == {"palm", "tip"}
        assert 'sensor="tip"' in client.get("/metrics").text
        assert client.get(api + "/sensors/tip/geometry").status_code == 200
        rig.service.path.write_text(palm)
        assert client.post(RELOAD).json()["sensors"]["removed"] == ["tip"]
        assert 'sensor="tip"' not in client.get("/metrics").text
        assert "there are palm" in problem(client.get(api + "/sensors/tip"), 404)


def test_a_wrong_file_is_refused_in_the_words_of_check_without_its_path(rig, url, tmp_path):
    rig.service.path = path = tmp_path / "rig.toml"
    path.write_text(CONFIG.format(channel="x").replace("pitch_mm = 1.0", "pitch_mm = 0"))
    detail = problem(ask("POST", url + RELOAD), 422)
    assert detail.startswith("rig.toml: sensor.palm.array.pitch_mm = 0: ")
    path.write_text(CONFIG.format(channel="/nowhere/tty").replace('"virtual"', '"slcan"'))
    assert problem(ask("POST", url + RELOAD), 503).startswith("bus slcan /nowhere/tty: ")
    rig.service.path = None
    assert "no configuration file" in problem(ask("POST", url + RELOAD), 409)


def test_a_reload_reads_the_certificate_again_and_names_one_that_was_renewed(rig, tmp_path):
    rig.service.path = tmp_path / "rig.toml"
    rig.service.path.write_text(CONFIG.format(channel=rig.config.bus["can0"].channel))
    certificate, key = self_signed(tmp_path)
    first = certificate.read_text()
    with running(rig.service, Server(port=0, tls_certificate=certificate, tls_key=key)) as url:
        at = "127.0.0.1", int(url.rpartition(":")[2])
        assert ssl.get_server_certificate(at) == first
        same = ask("POST", url + RELOAD, verify=False)
        self_signed(tmp_path)
        second = certificate.read_text()
        renewed = ask("POST", url + RELOAD, verify=False)
        assert [same.json()["certificate"], renewed.json()["certificate"]] == [None, "certificate.pem"]
        assert ssl.get_server_certificate(at) == second != first
        key.write_text("")
        assert problem(ask("POST", url + RELOAD, verify=False), 422).startswith("certificate.pem, key.pem: ")
        assert ssl.get_server_certificate(at) == second
    events = [each.text for each in rig.service.events.after(0) if each.kind == "config_reloaded"]
    unchanged = "sensors: 1 unchanged; buses: 1 unchanged"
    assert events == [unchanged, unchanged + "; TLS: certificate.pem renewed"]
