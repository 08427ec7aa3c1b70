import base64
import json
import re
import socket
import struct
import subprocess
import sys
from contextlib import ExitStack, contextmanager

import numpy as np
import pytest
from mcap.records import Schema
from mcap_protobuf.decoder import DecoderFactory
from typer.testing import CliRunner
from websockets.sync.client import connect

from tactiled.cli import app as door
from tactiled.errors import ConfigError, TactileError
from tactiled.interop import foxglove
from tactiled.interop.foxglove_live import bridge
from tests.conftest import BUSY_S, CONFIG, ask, pressed, until
from tests.skin import X, Y, rigged

TOPICS = {f"/palm/{name}" for name in ("raw", "restored", "status", "state", "contacts")}


class App:
    """What Foxglove's app does: subscribes to topics, decodes what comes by the schemas that it was sent."""

    def __init__(self, socket, topics, offered=TOPICS):
        self.socket = socket
        assert socket.subprotocol == "foxglove.sdk.v1"
        assert json.loads(socket.recv(timeout=BUSY_S))["op"] == "serverInfo"
        self.channels = {}
        while len(self.channels) < len(offered):
            told = json.loads(socket.recv(timeout=BUSY_S))
            assert told["op"] == "advertise"
            self.channels |= {each["topic"]: each for each in told["channels"]}
        self.decoders = {self.channels[topic]["id"]: self.decoder(self.channels[topic]) for topic in topics}
        asked = [{"id": 100 + id_, "channelId": id_} for id_ in self.decoders]
        socket.send(json.dumps({"op": "subscribe", "subscriptions": asked}))

    @staticmethod
    def decoder(channel):
        if channel["encoding"] == "json":
            assert json.loads(channel["schema"])["type"] == "object"
            return json.loads
        schema = Schema(1, base64.b64decode(channel["schema"]), channel["schemaEncoding"], channel["schemaName"])
        return DecoderFactory().decoder_for(channel["encoding"], schema)

    def next(self, topic):
        """The next message of a topic, and its log time (ns)."""
        while True:
            data = self.socket.recv(timeout=BUSY_S)
            code, subscription, at = struct.unpack_from("<BIQ", data)
            assert code == 1
            if subscription == 100 + self.channels[topic]["id"]:
                return self.decoders[subscription - 100](data[13:]), at


@contextmanager
def app(rig, topics=TOPICS, offered=TOPICS):
    with ExitStack() as stack:
        port = stack.enter_context(bridge(rig.service, 0))
        yield App(
            stack.enter_context(connect(f"ws://127.0.0.1:{port}", subprotocols=["foxglove.sdk.v1"])),
            topics,
            offered,
        )


def pressures(grid, name="pressure_kpa"):
    """(rows, columns) of a decoded Grid."""
    (field,) = [each for each in grid.fields if each.name == name]
    form = {"offsets": [field.offset], "formats": ["<f4"], "names": ["it"], "itemsize": grid.cell_stride}
    return np.frombuffer(grid.data, form)["it"].reshape(-1, grid.column_count)


def test_the_images_are_those_of_rest_and_to_scale(rig, url):
    with app(rig) as client:
        assert set(client.channels) == TOPICS
        assert client.next("/palm/state")[0]["state"] == "silent"  # subscribed
        image = rig.show(pressed())
        for kind in ("raw", "restored"):
            grid, at = client.next(f"/palm/{kind}")
            told = ask("GET", f"{url}/api/v1/sensors/palm/frames/{kind}").json()
            np.testing.assert_allclose(pressures(grid), told["values"], atol=1e-4)
            assert at == round(told["timestamp"] * 1e9)
            assert (grid.frame_id, grid.cell_size.x, grid.cell_size.y) == ("palm", 0.001, 0.001)
            assert (grid.pose.position.x, grid.pose.position.y) == (-0.0005, -0.0005)
        status, _ = client.next("/palm/status")
        assert (status["sequence"], status["method"]) == (image.sequence, "wiener")


def test_a_skin_that_feels_shear_has_a_topic_of_it(request):
    offered = {f"/skin/{name}" for name in ("raw", "restored", "status", "shear", "state", "contacts")}
    with rigged(request.node.name) as rig, app(rig, {"/skin/shear", "/skin/state"}, offered) as client:
        assert set(client.channels) == offered
        client.next("/skin/state")  # subscribed
        image = rig.show(X, Y)
        grid, at = client.next("/skin/shear")
        for axis, felt in zip("xy", image.shear, strict=True):
            np.testing.assert_array_equal(pressures(grid, f"shear_{axis}_counts"), felt)
    assert at == round(image.time * 1e9)


def test_contacts_lie_where_they_are(rig):
    with app(rig, {"/palm/contacts", "/palm/state"}) as client:
        client.next("/palm/state")
        rig.show(pressed(2))
        scene, _ = client.next("/palm/contacts")
        (contact,) = rig.sensor.contacts()[1]
    (entity,) = scene.entities
    (deletion,) = scene.deletions
    assert (entity.id, entity.frame_id, deletion.type) == (
        str(contact.id),
        "palm",
        1,
    )  # 1: all that was there before
    (disc,), (label,) = entity.cylinders, entity.texts
    assert (disc.pose.position.x, disc.pose.position.y) == pytest.approx(
        (contact.x_mm * 1e-3, contact.y_mm * 1e-3)
    )
    assert (disc.size.x, disc.size.y) == pytest.approx((contact.major_mm * 4e-3, contact.minor_mm * 4e-3))
    assert 2 * np.arctan2(disc.pose.orientation.z, disc.pose.orientation.w) == pytest.approx(contact.angle_rad)
    assert label.text == f"{contact.force_n:.2f} N"


def test_the_state_comes_without_frames(rig):
    with app(rig, {"/palm/state"}) as client:
        told = [client.next("/palm/state")[0]]
        rig.show(pressed())
        while told[-1]["state"] != "stale":
            told.append(client.next("/palm/state")[0])
    assert [told[0]["state"], told[-1]["detail"][:12]] == ["silent", "no frame for"]
    assert "age_s" not in told[0]
    assert told[-1]["age_s"] > 0.3


def test_the_last_image_comes_though_its_sensor_had_fallen_silent(rig):
    with bridge(rig.service, 0) as port:
        image = rig.show(pressed())
        until(lambda: rig.sensor.status().state == "stale")
        with connect(f"ws://127.0.0.1:{port}", subprotocols=["foxglove.sdk.v1"]) as late:
            assert App(late, {"/palm/raw"}).next("/palm/raw")[1] == round(image.time * 1e9)


def test_nothing_is_made_that_nobody_looks_at(rig, monkeypatch):
    made = []
    monkeypatch.setattr(foxglove.Topics, "messages", lambda _, image: made.append(image) or (b"", b"", b"{}"))
    with app(rig, {"/palm/state"}) as client:
        client.next("/palm/state")
        rig.show(pressed())
        client.next("/palm/state")
        assert made == []
    with app(rig) as client:
        client.next("/palm/state")
        rig.show(pressed())
        until(lambda: made)
    assert not rig.sensor.hub._listeners


def test_a_fault_is_told_and_the_next_image_comes(rig, url, monkeypatch, caplog):
    with app(rig) as client:
        client.next("/palm/state")
        with monkeypatch.context() as broken:
            broken.setattr(foxglove.Topics, "messages", lambda *_: 1 / 0)
            rig.show(pressed())
            until(lambda: rig.service.faults.now)
        told = ask("GET", url + "/api/v1/health").json()
        assert told["faults"] == {"foxglove of palm": "ZeroDivisionError: division by zero"}
        assert told["status"] == "degraded"
        assert "fault_raised" in {each.kind for each in rig.service.events.after(0)}
        image = rig.show(pressed())
        assert client.next("/palm/raw")[1] == round(image.time * 1e9)
    assert "ZeroDivisionError" in caplog.text


def test_a_port_in_use_and_an_sdk_that_is_not_there_are_told_in_one_line(rig, monkeypatch):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(TactileError, match=f"server.foxglove = {port}: .*in use.*: choose another port"):
            bridge(rig.service, port).__enter__()
    monkeypatch.setattr(foxglove, "messages", None)
    with pytest.raises(
        ConfigError, match=re.escape("server.foxglove needs Foxglove's SDK: pip install 'tactiled[fox")
    ):
        bridge(rig.service, 0).__enter__()


def test_without_the_extra_all_else_runs():
    program = (
        "import sys; sys.modules['foxglove'] = None; "
        "import tactiled.cli, tactiled.interop.foxglove as f; f.need('It')"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.stderr.splitlines()[-1].endswith("It needs Foxglove's SDK: pip install 'tactiled[foxglove]'")


def test_run_takes_the_port_from_the_configuration_or_the_command(tmp_path, monkeypatch):
    seen = []
    monkeypatch.setattr("tactiled.cli.run.serve", lambda _, at: seen.append(at.foxglove))
    for name, more in (("a", ""), ("b", "[server]\nfoxglove = 8765\n")):
        (tmp_path / f"{name}.toml").write_text(more + CONFIG.format(channel=f"bridge-{name}"))
    for arguments in (["a.toml"], ["b.toml"], ["b.toml", "--foxglove", "0"]):
        path, *more = arguments
        assert CliRunner().invoke(door.app, ["run", str(tmp_path / path), *more]).exit_code == 0
    assert seen == [None, 8765, 0]
