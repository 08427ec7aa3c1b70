import base64
import json
import re
import socket
import struct
import subprocess
import sys
from contextlib import ExitStack, contextmanager
from dataclasses import replace

import numpy as np
import pytest
from mcap.records import Schema
from mcap_protobuf.decoder import DecoderFactory
from typer.testing import CliRunner
from websockets.sync.client import connect

from tactiled.cli import app as cli
from tactiled.errors import ConfigError, TactileError
from tactiled.interop.foxglove import Foxglove
from tactiled.messages import foxglove
from tests.conftest import BUSY_S, CONFIG, ask, pressed, until
from tests.skin import SCALE, X, Y, Z, rigged

TOPICS = {f"/palm/{name}" for name in ("raw", "restored", "status", "state", "contacts")}
PROTOCOL = "foxglove.sdk.v1"


class App:
    """A stand-in for Foxglove's app: subscribes to topics, and decodes messages by the schemas that it gets."""

    def __init__(self, socket, topics, offered=TOPICS):
        self.socket = socket
        assert socket.subprotocol == PROTOCOL
        assert json.loads(socket.recv(timeout=BUSY_S))["op"] == "serverInfo"
        self.channels = {}
        while len(self.channels) < len(offered):
            message = json.loads(socket.recv(timeout=BUSY_S))
            assert message["op"] == "advertise"
            self.channels |= {each["topic"]: each for each in message["channels"]}
        assert set(self.channels) == offered
        self.decoders = {self.channels[topic]["id"]: self.decoder(self.channels[topic]) for topic in topics}
        subscriptions = [{"id": 100 + id_, "channelId": id_} for id_ in self.decoders]
        socket.send(json.dumps({"op": "subscribe", "subscriptions": subscriptions}))

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
    """An app that has subscribed: the first state says so, unless an image came before."""
    with ExitStack() as stack:
        address = stack.enter_context(Foxglove(0).running(rig.host)).removeprefix("Foxglove at ")
        client = stack.enter_context(connect(address, subprotocols=[PROTOCOL]))
        yield App(client, topics, offered)


def pressures(grid, name="pressure_kpa"):
    """(rows, columns) of a decoded Grid."""
    (field,) = [each for each in grid.fields if each.name == name]
    form = {"offsets": [field.offset], "formats": ["<f4"], "names": ["it"], "itemsize": grid.cell_stride}
    return np.frombuffer(grid.data, form)["it"].reshape(-1, grid.column_count)


def test_images_are_those_of_rest_and_contacts_lie_to_scale_on_them(rig, url):
    with app(rig) as client:
        assert client.next("/palm/state")[0]["state"] == "silent"  # subscribed
        image = rig.show(pressed(2))
        for kind in ("raw", "restored"):
            grid, at = client.next(f"/palm/{kind}")
            frame = ask("GET", f"{url}/api/v1/sensors/palm/frames/{kind}").json()
            np.testing.assert_allclose(pressures(grid), frame["values"], atol=1e-4)
            assert at == round(frame["timestamp"] * 1e9)
            assert (grid.frame_id, grid.cell_size.x, grid.cell_size.y) == ("palm", 0.001, 0.001)
            assert (grid.pose.position.x, grid.pose.position.y) == (-0.0005, -0.0005)
        status, _ = client.next("/palm/status")
        assert (status["sequence"], status["method"]) == (image.sequence, "wiener")
        scene, _ = client.next("/palm/contacts")
    (contact,) = rig.sensor.contacts()[1]
    (entity,), (deletion,) = scene.entities, scene.deletions
    assert (entity.id, entity.frame_id) == (str(contact.id), "palm")
    assert deletion.type == 1  # all contacts before
    (disc,), (label,) = entity.cylinders, entity.texts
    assert disc.pose.position.x == pytest.approx(contact.x_mm * 1e-3)
    assert disc.pose.position.y == pytest.approx(contact.y_mm * 1e-3)
    assert (disc.size.x, disc.size.y) == pytest.approx((contact.major_mm * 4e-3, contact.minor_mm * 4e-3))
    assert 2 * np.arctan2(disc.pose.orientation.z, disc.pose.orientation.w) == pytest.approx(contact.angle_rad)
    assert label.text == f"{contact.force:.2f} N"


def test_a_skin_that_feels_shear_has_a_topic_of_it(request):
    offered = {f"/skin/{name}" for name in ("raw", "restored", "status", "shear", "traction", "state", "contacts")}
    wanted = {"/skin/shear", "/skin/traction", "/skin/state"}
    with rigged(request.node.name, scale=SCALE) as rig, app(rig, wanted, offered) as client:
        client.next("/skin/state")  # subscribed
        image = rig.show(X, Y)
        grid, at = client.next("/skin/shear")
        for axis, counts in zip("xy", image.shear, strict=True):
            np.testing.assert_array_equal(pressures(grid, f"shear_{axis}_counts"), counts)
        assert at == round(image.time * 1e9)
        rig.sensor.tare(force=True)
        until(lambda: rig.show(X, Y) and rig.sensor.pipeline.tares.done)
        image = rig.show(X + 2000, Y, Z + 9000)
        restored = [client.next("/skin/traction")]
        while restored[-1][1] != round(image.time * 1e9):  # those of frames without load come first
            restored.append(client.next("/skin/traction"))
        for axis, load in zip("xy", image.traction, strict=True):
            np.testing.assert_array_equal(pressures(restored[-1][0], f"shear_{axis}_kpa"), load)
        assert image.traction[0].max() > 0.5


def test_a_calibration_that_is_applied_gives_new_topics_with_their_unit(rig):
    with app(rig, {"/palm/state"}) as client:
        image = rig.show(pressed())
        rig.sensor.hub.publish(replace(image, unit="counts"))
        topics = {}
        while "/palm/status" not in topics:
            message = client.socket.recv(timeout=BUSY_S)
            if isinstance(message, str) and (answer := json.loads(message))["op"] == "advertise":
                topics |= {each["topic"]: each["id"] for each in answer["channels"]}
    assert topics["/palm/status"] != client.channels["/palm/status"]["id"]


def test_the_state_comes_without_frames_and_a_late_client_gets_the_last_image(rig, monkeypatch):
    made, make = [], foxglove.Topics.messages
    monkeypatch.setattr(foxglove.Topics, "messages", lambda one, image: (made.append(image), make(one, image))[1])
    with app(rig, {"/palm/state"}) as client:
        states = [client.next("/palm/state")[0]]
        image = rig.show(pressed())
        while states[-1]["state"] != "stale":
            states.append(client.next("/palm/state")[0])
        assert [states[0]["state"], states[-1]["detail"][:12]] == ["silent", "no frame for"]
        assert "age_s" not in states[0]
        assert states[-1]["age_s"] > 0.3
        assert made == []  # for no subscriber
    with app(rig, {"/palm/raw"}) as late:
        assert late.next("/palm/raw")[1] == round(image.time * 1e9)
        assert made == [image]
    assert not rig.sensor.hub._listeners


def test_topics_follow_a_reload(rig, tmp_path):
    rig.service.path, palm = tmp_path / "rig.toml", CONFIG.format(channel=rig.config.bus["can0"].channel)
    with app(rig, {"/palm/raw"}) as client:
        for text, op in ((palm.replace("sensor.palm", "sensor.tip"), "unadvertise"), (palm, "advertise")):
            rig.service.path.write_text(text)
            rig.service.reload()
            topics = set()
            while len(topics) < len(TOPICS):
                message = json.loads(client.socket.recv(timeout=BUSY_S))
                if message["op"] == op == "unadvertise":
                    topics |= set(message["channelIds"])
                elif message["op"] == op:
                    topics |= {each["topic"] for each in message["channels"]} & TOPICS


def test_a_fault_is_in_the_health_and_the_next_image_comes(rig, url, monkeypatch, caplog):
    with app(rig) as client:
        client.next("/palm/state")
        with monkeypatch.context() as broken:
            failed, health = [], {}
            broken.setattr(foxglove.Topics, "messages", lambda _, image: failed.append(image.sequence) or 1 / 0)

            def look():
                """With one more error: a fault ends a second after the last one."""
                sequence = rig.show(pressed()).sequence
                until(lambda: sequence in failed)
                health.update(ask("GET", url + "/api/v1/health").json())
                return health["faults"]

            until(look)
        assert health["faults"] == {"foxglove of palm": "ZeroDivisionError: division by zero"}
        assert health["status"] == "degraded"
        image = rig.show(pressed())
        assert client.next("/palm/raw")[1] == round(image.time * 1e9)
    assert "ZeroDivisionError" in caplog.text


def test_a_port_in_use_and_a_missing_sdk_are_one_line_each(rig, monkeypatch):
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        with pytest.raises(TactileError, match=f"server.foxglove = {port}: .*in use.*: choose another port"):
            Foxglove(port).running(rig.host).__enter__()
    monkeypatch.setattr(foxglove, "messages", None)
    with pytest.raises(
        ConfigError, match=re.escape("server.foxglove needs Foxglove's SDK: pip install 'tactiled[")
    ):
        Foxglove(0).running(rig.host).__enter__()


def test_without_the_extra_all_else_runs():
    program = (
        "import sys; sys.modules['foxglove'] = None; "
        "import tactiled.cli, tactiled.messages.foxglove as f; f.need('It')"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.stderr.splitlines()[-1].endswith("It needs Foxglove's SDK: pip install 'tactiled[foxglove]'")


def test_run_takes_the_port_from_the_configuration_or_the_command(tmp_path, monkeypatch):
    ports = []
    monkeypatch.setattr("tactiled.cli.run.serve", lambda _, at: ports.append(at.foxglove))
    (tmp_path / "a.toml").write_text("[server]\nfoxglove = 8765\n" + CONFIG.format(channel="bridge"))
    for more in ([], ["--foxglove", "0"]):
        assert CliRunner().invoke(cli.app, ["run", str(tmp_path / "a.toml"), *more]).exit_code == 0
    assert ports == [8765, 0]
