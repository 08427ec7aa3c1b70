"""Readers, routers and servers as they run: processes of their own where one is killed or cut off."""

import json
import subprocess

import numpy as np
import pytest
from websockets.sync.client import connect

from tactiled.config import Server, Zenoh, parse
from tactiled.errors import ConfigError, TactileError
from tactiled.interop.zenoh.app import create as create_for_fleet
from tactiled.interop.zenoh.reader import Requests
from tactiled.interop.zenoh.session import open_session
from tactiled.web.app import create
from tactiled.web.server import on_thread
from tactiled.wire import unpack
from tests.conftest import BUSY_S, CONFIG, ask, pressed, problem, until
from tests.interop.zenoh_kit import NAME, detail, fleet_at, kinds, pass_on, published, state
from tests.process import free_port


def test_one_who_comes_late_gets_the_newest_frame_and_all_that_is_known(rig, served):
    image = rig.show(pressed())
    fleet, url = served(user="hand", password="hunter2hunter2")
    until(lambda: fleet.sensors[NAME].hub.latest())
    got = fleet.sensors[NAME].hub.latest()
    np.testing.assert_array_equal(got.restored, image.restored)
    np.testing.assert_array_equal(got.raw, image.raw)
    assert (got.sequence, got.time, got.why, got.method) == (image.sequence, image.time, image.why, image.method)
    assert (got.warnings, got.noise_gain) == (image.warnings, pytest.approx(image.noise_gain))
    one = f"{url}/sensors/r1"
    assert ask("GET", f"{one}/palm/geometry").json()["raw"]["rows"] == 8
    assert ask("GET", f"{one}%2Fpalm/kernel").json()["model"] == "layered"
    assert ask("GET", f"{one}/palm/method").json()["method"] == "wiener"
    config = ask("GET", f"{url}/config")
    assert config.json()["sensor"][NAME]["bus"] == "r1/can0"
    assert "hunter2" not in config.text
    assert ask("GET", f"{url}/sensors").json()["sensors"][0]["name"] == NAME
    frame = ask("GET", f"{one}/palm/frames/raw").json()
    assert (frame["sensor"], frame["sequence"]) == (NAME, image.sequence)
    deviation = ask("GET", f"{one}/palm/frames/deviation").json()["values"]
    np.testing.assert_allclose(deviation, rig.sensor.pipeline.deviation(image), atol=1e-4)
    until(
        lambda: state(fleet) == "stale" and "no frame for" in detail(fleet)
    )  # a silent skin, not a silent reader
    assert "no such sensor" in problem(ask("GET", f"{url}/sensors/r1/tip"), 404)


def test_images_pass_bit_for_bit_and_the_stream_bears_the_joint_name(rig, served):
    fleet, url = served()
    rig.stale_after(BUSY_S)
    rig.show(pressed())
    until(lambda: fleet.sensors[NAME].hub.latest())
    address = f"{url.replace('http', 'ws')}/stream?sensors={NAME}&kinds=restored&flow=credit"
    with connect(address, open_timeout=BUSY_S) as socket_:
        for at in range(3):
            image = pass_on(rig, fleet, pressed(at))
            socket_.send(json.dumps({"type": "next", "sensor": NAME}))
            while isinstance(message := socket_.recv(timeout=BUSY_S), str):
                pass
            part = unpack(message)
            assert (part.sensor, part.sequence, part.timestamp) == (NAME, image.sequence, image.time)
            np.testing.assert_array_equal(part.values, image.restored)
    with connect(f"{url.replace('http', 'ws')}/sensors/r1%2Fpalm/stream", open_timeout=BUSY_S) as socket_:
        assert json.loads(socket_.recv(timeout=BUSY_S))["sensor"] == NAME
    page = ask("GET", f"{url}/sensors/{NAME}/frames?last=60s").json()
    assert page["frames"][-1]["sequence"] == image.sequence


@pytest.fixture(scope="module")
def certificates(tmp_path_factory):
    """Settings of TLS, by whose authority signed this side's certificate."""
    folder, settings = tmp_path_factory.mktemp("tls"), {}
    new = ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2"]
    names = ["-addext", "subjectAltName=IP:127.0.0.1", "-addext", "basicConstraints=critical,CA:FALSE"]
    for name in ("ours", "theirs"):
        root, root_key, one, key = (folder / f"{name}{end}" for end in (".ca", ".ca.key", ".pem", ".key"))
        signed = ["-CA", root, "-CAkey", root_key, *names]
        for subject, out, keyout, more in ((name, root, root_key, []), ("palm", one, key, signed)):
            command = [*new, "-subj", f"/CN={subject}", "-out", out, "-keyout", keyout, *more]
            subprocess.run(command, check=True, capture_output=True)
        trusted = folder / "ours.ca"
        settings[name] = {"tls_root_certificate": trusted, "tls_certificate": one, "tls_key": key}
    return settings


def test_over_mutual_tls_an_authority_lets_readers_in_and_no_other(rig, certificates):
    endpoint = f"tls/127.0.0.1:{free_port()}"
    with fleet_at("", mode="peer", connect=[], listen=[endpoint], **certificates["ours"]) as fleet:
        for more in (
            certificates["theirs"],
            {"tls_root_certificate": certificates["ours"]["tls_root_certificate"]},
        ):
            with pytest.raises(TactileError, match=endpoint):
                open_session(Zenoh(mode="client", connect=[endpoint], **more))
        with published(rig, endpoint, **certificates["ours"]):
            until(lambda: NAME in fleet.sensors)
            image = pass_on(rig, fleet, pressed())
            np.testing.assert_array_equal(fleet.sensors[NAME].hub.latest().restored, image.restored)


def test_a_tare_through_the_server_is_done_and_reported_there(rig, routed):
    fleet, url, _ = routed()
    with rig.playing(50):
        until(lambda: state(fleet) == "live")
        answer = ask("POST", f"{url}/sensors/{NAME}/tare?force=true")
        assert answer.status_code == 202
        until(lambda: kinds(fleet, "tare_done"))
    assert rig.sensor.pipeline.tares.done == 1


def test_a_request_for_a_stopped_reader_is_refused_with_its_reason(rig):
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    listening = fleet_at("", mode="peer", connect=[], listen=[endpoint])
    with listening as fleet, on_thread(create_for_fleet(fleet, Server(port=0)), Server(port=0)) as url:
        with published(rig, endpoint):
            until(lambda: NAME in fleet.sensors)
        until(lambda: state(fleet) == "down" and "was stopped" in fleet.sensors[NAME].status().detail)
        assert "was stopped" in problem(ask("GET", f"{url}/api/v1/sensors/{NAME}/kernel"), 503)


def test_an_interrupted_reader_closes_what_its_resources_have_open(rig):
    app, closed = create(rig.service, Server()), []
    app.state.closing.append(lambda: closed.append(True))
    settings = Zenoh(connect=["tcp/127.0.0.1:7447"], robot="r1")
    with pytest.raises(KeyboardInterrupt), Requests(app, Server(), settings).running():
        raise KeyboardInterrupt
    assert closed


@pytest.mark.parametrize(
    ("table", "error"),
    [
        ("", "connect and listen are missing"),
        ('connect = ["127.0.0.1:7447"]', r"zenoh.connect\[0\] = '127.0.0.1:7447'"),
        ('mode = "client"\nlisten = ["tcp/127.0.0.1:7447"]', "give connect, the router's endpoint"),
        ('connect = ["tcp/127.0.0.1:7447"]\nuser = "hand"', "user and password: give both or neither"),
    ],
)
def test_a_wrong_table_is_refused_by_its_key(table, error):
    with pytest.raises(Exception, match=error):
        parse(CONFIG.format(channel="x") + f"\n[zenoh]\n{table}\n")


def test_a_servers_file_is_for_tactiled_serve():
    with pytest.raises(ConfigError, match="bus, sensor: missing: only `tactiled serve` needs neither"):
        parse('[zenoh]\nlisten = ["tcp/127.0.0.1:7447"]\n')
