"""Clients in the manner of the public ones of XELA's server, with the library that they use.

Each reads the fields that its public counterpart reads, by the types that it needs, and fails where that would.
"""

import io
import json
import re
import socket
import threading
import time
from contextlib import ExitStack
from dataclasses import replace
from urllib.parse import urlsplit

import jsonschema
import numpy as np
import pytest
import websocket
from pydantic import SecretStr
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from tactiled.config import Server
from tactiled.errors import TactileError
from tactiled.frames import MISSING, Message
from tactiled.runtime.pipeline import TARE_FRAMES
from tactiled.web import server
from tactiled.web.server import running, serve, xela_clients
from tests.conftest import BUSY_S, Rig, ask, meanwhile, problem, until

MODULE = """
[sensor.{name}]
bus = "can0"
method = "raw"
stale_after_s = 600
codec = {{ name = "xela", controller = {controller}, rows = {rows}, columns = {columns} {more} }}
array = {{ rows = 4, columns = {width}, pitch_mm = 5.0 }}
cover = {{ thickness_mm = 0.8, young_mpa = 0.6, poisson = 0.48 }}
kernel = {{ model = "layered" }}
calibration = {{ {calibration} }}
"""
RAW = "no_load = 36000, noise_kpa = 5"
SCALED = "kpa_per_count = 0.02, no_load = 36000, noise_kpa = 5, shear_n_per_count = 0.0006"
NEWTON = np.array([0.0006, 0.0006, 0.02 * 5.0**2 * 1e-3])  # N a count of X, Y and Z
SDAS = [4, 3, 2, 1]


def module(name, controller, width, calibration, more=""):
    columns = list(range(width - 1, -1, -1))
    return MODULE.format(
        name=name,
        controller=controller,
        rows=SDAS,
        columns=columns,
        width=width,
        calibration=calibration,
        more=more,
    )


class Skins(Rig):
    """A service with XELA's modules, {name: (controller, width)}, and who plays them."""

    def __init__(self, channel, modules, calibration, more=""):
        parts = [module(name, *each, calibration, more) for name, each in modules.items()]
        super().__init__(channel, "".join(parts))
        self.modules = modules

    def send(self, step=0):
        """One frame of every module."""
        for controller, width in self.modules.values():
            ids = [sda << 8 | taxel << 4 | controller for sda in SDAS for taxel in range(width - 1, -1, -1)]
            for id_, xyz in zip(ids, axes(width, step), strict=True):
                data = bytes((0x93, *np.asarray(xyz, ">u2").tobytes(), 0x0C))
                self.bus.send(Message(time.time(), id_, data))

    def rest(self):
        """As many frames of step 0 as a tare takes, each restored before the next."""
        sensors = [self.service.sensor(name) for name in self.modules]
        for _ in range(TARE_FRAMES):
            seen = [each.hub.latest() for each in sensors]
            self.send()
            until(lambda seen=seen: all(a.hub.latest() is not b for a, b in zip(sensors, seen, strict=True)))

    def tare(self):
        """Take the counts of step 0 as no load."""
        self.send()
        until(lambda: all(self.service.sensor(name).hub.latest() for name in self.modules))
        for name in self.modules:
            self.service.sensor(name).tare()
        self.rest()


def axes(width, step=0):
    """(taxels, 3) counts; no two taxels rest at the same, and each is pressed and sheared by its own amount."""
    each = np.arange(4 * width)
    rest = np.column_stack([0x8000 + 3 * each, 0x8010 - 2 * each, 36000 + 7 * each])
    return rest + step * np.column_stack([20 - each, each, 30 + 10 * each])


def made(request, modules, calibration=RAW, more=""):
    return meanwhile(Skins(re.sub(r"\W", "-", f"{request.node.name}{calibration}"), modules, calibration, more))


@pytest.fixture(scope="module")
def rig(request):
    """One 4 x 6 module, its forces known: scaled, and tared."""
    with made(request, {"skin": (1, 6)}, SCALED) as skins:
        skins.tare()
        yield skins


@pytest.fixture(scope="module")
def url(rig):
    with running(rig.service) as address:
        yield address


@pytest.fixture(scope="module")
def raw(request):
    """One 4 x 6 module, its forces not known."""
    with made(request, {"skin": (1, 6)}) as skins:
        yield skins


class Client:
    """What all have in common: ws://IP:PORT and no path, a welcome, and then messages."""

    def __init__(self, url):
        self.app = websocket.create_connection(
            f"ws://{urlsplit(url).hostname}:{urlsplit(url).port}", timeout=BUSY_S
        )
        self.welcomed = json.loads(self.app.recv())
        assert self.welcomed["message"] == "Welcome"

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.app.close()

    def seen(self, skins, step):
        """What it reads of the frame of a step, and of what comes before it."""
        data = {
            str(number): ",".join(f"{each:04X}" for each in axes(width, step).ravel())
            for number, (_, width) in enumerate(skins.modules.values(), 1)
        }
        while True:
            self.told = json.loads(self.app.recv())
            read = self.read(self.told)
            if all(self.told.get(key, {}).get("data") == each for key, each in data.items()):
                return read


class RosNode(Client):
    """XELA's nodes for ROS and ROS 2: numbered keys alone; messages whose fields take one type each."""

    def read(self, data):
        sensors = {}
        for key in (key for key in data if key.isdigit()):
            said = data[key]
            values = [int(each, 16) for each in said.get("data", "").split(",")]
            assert len(values) == 3 * said.get("taxels", -1)
            forces = said.get("calibrated", None)
            forces = [] if forces is None else forces
            assert all(isinstance(each, float) for each in forces)
            assert isinstance(said.get("time"), float)
            assert isinstance(said.get("model"), str)
            number = int(said.get("sensor", "0"))
            sensors[number] = np.reshape(values, (-1, 3)), np.reshape(forces, (-1, 3))
        assert isinstance(data["message"], int)
        return sensors


class ArrayNode(Client):
    """C++ nodes for ROS 2: every field is there with its type, or the whole message is dropped."""

    known = ("uSPa46", "uSPa44")

    def read(self, data):
        assert type(data["message"]) is int
        modules = {int(key): each for key, each in data.items() if key.isdigit()}
        assert data["sensors"] == len(modules) > 0
        read = {}
        for number, said in modules.items():
            assert type(said["time"]) is float
            assert said["model"] in self.known
            assert int(said["sensor"]) == number
            assert all(type(each) is int and 0 <= each <= 0xFFFF for each in said["integer"])
            if "calibrated" in said:
                assert isinstance(said["calibrated"], list)
                assert all(type(each) is float for each in said["calibrated"])
                assert len(said["calibrated"]) == 3 * said["taxels"]
            assert all(type(each) is float for each in said["temp"])
            assert len(said["temp"]) == len(said["integer"]) / 3 == said["taxels"]
            read[number] = np.reshape(said["integer"], (-1, 3)), np.reshape(said.get("calibrated", []), (-1, 3))
        return read


class RobotLearner(Client):
    """A recorder of episodes: one sensor of the model that it was told, messages in order."""

    sensor, model, last = "1", "uSPa46", -1

    def read(self, data):
        said = data[self.sensor]
        assert said["model"] == self.model
        values = np.array([int(each, 16) for each in said["data"].split(",")], np.float32)
        assert values.size == 3 * int(said["taxels"])
        number, at = int(data["message"]), float(data["time"])
        assert number > self.last
        assert at == said["time"]
        self.last = number
        forces = said.get("calibrated")
        return values, None if forces is None else np.asarray(forces, np.float32)


class ForceReader(Client):
    """Scripts that count sensors from 1 and take forces apart, without which they end."""

    def read(self, data):
        read = {}
        for number in range(1, data["sensors"] + 1):
            said = data.get(str(number))
            assert len(said.get("data").split(",")) == 3 * said.get("taxels")
            forces = said.get("calibrated")
            read[number] = [forces[at : at + 3] for at in range(0, len(forces), 3)]
        return read


class GridReader(Client):
    """Forces as a grid of 4 x 6, of messages that are routine."""

    def read(self, data):
        if data.get("type") != "routine":
            return None
        return {key: np.array(data[key]["calibrated"]).reshape(4, 6, 3) for key in data if key.isdigit()}


class Gripper(Client):
    """Two pads, both in every message, and when it was made and sent."""

    def read(self, data):
        if "1" not in data or "2" not in data:
            return None
        pads = [np.reshape([int(each, 16) for each in data[key]["data"].split(",")], (-1, 3)) for key in "12"]
        made, sent = data["time"], data["sendtime"]
        assert max(data["1"]["time"], data["2"]["time"]) == made <= sent <= time.time()
        return pads


class Middleware(Client):
    """XELA's library for programs in between: keeps whatever comes, and can say something."""

    def read(self, data):
        return data

    def say(self, data):
        self.app.send(json.dumps(data))


class TaxelLog(Client):
    """Keeps counts and the last of a taxel's special numbers as arrays in a file, to be read without pickles."""

    def read(self, data):
        special = np.asarray(data["1"]["special"])
        file = io.BytesIO()
        np.save(file, np.hstack((special[:, :3], special[:, -1:])))
        return np.load(io.BytesIO(file.getvalue()))


class FeatureExtractor(Client):
    """Takes counts from the first three of a taxel's special numbers."""

    def read(self, data):
        special = np.array(data["1"]["special"])
        assert special.shape == (24, 12)
        touch = np.abs((special[:, :3] - np.full((24, 3), 32000.0)) / 2.0)
        return round(np.max(touch[:, 2]), 2)


class ClusterMonitor(Client):
    """Prints clusters, where there are any."""

    def read(self, data):
        return [float(x) for x, *_ in data["1"].get("extradots", [])]


def reads(client, skins, url, step=5):
    """What a client reads of one frame."""
    with client(url) as reader:
        skins.send(step)
        return reader.seen(skins, step)


def newtons(step, width=6):
    """(taxels, 3): what the modules are loaded with, from the counts that they rest at."""
    return (axes(width, step) - axes(width)) * NEWTON


@pytest.mark.parametrize("client", [RosNode, ArrayNode])
def test_nodes_of_ros_read_counts_and_forces(rig, url, client):
    counts, forces = reads(client, rig, url)[1]
    np.testing.assert_array_equal(counts, axes(6, 5))
    np.testing.assert_allclose(forces, newtons(5), atol=1e-5)


@pytest.mark.parametrize("client", [RosNode, ArrayNode])
def test_nodes_of_ros_read_counts_where_forces_are_not_known(raw, client):
    with running(raw.service) as url:
        counts, forces = reads(client, raw, url)[1]
    np.testing.assert_array_equal(counts, axes(6, 5))
    assert forces.size == 0


def test_a_recorder_of_episodes_reads_counts_in_order_and_forces(rig, url):
    with RobotLearner(url) as reader:
        for step in range(1, 4):
            rig.send(step)
            values, forces = reader.seen(rig, step)
            np.testing.assert_array_equal(values, axes(6, step).ravel())
            np.testing.assert_allclose(forces.reshape(-1, 3), newtons(step), atol=1e-5)


def test_a_recorder_of_episodes_finds_no_forces_where_none_are_known(raw):
    with running(raw.service) as url:
        values, forces = reads(RobotLearner, raw, url)
    np.testing.assert_array_equal(values, axes(6, 5).ravel())
    assert forces is None


@pytest.mark.parametrize(
    ("codec", "model"),
    [('model = "XR1946"', "XR1946"), ('profile = "current"', "uSPa46"), ('model = "x-1"', "x-1")],
)
def test_a_recorder_of_episodes_finds_the_model_that_it_was_told(request, codec, model):
    class Told(RobotLearner):
        pass

    Told.model = model
    with made(request, {"skin": (1, 6)}, more=", " + codec) as skins, running(skins.service) as url:
        values, _ = reads(Told, skins, url)
    np.testing.assert_array_equal(values, axes(6, 5).ravel())


def test_scripts_take_forces_apart(rig, url):
    np.testing.assert_allclose(reads(ForceReader, rig, url)[1], newtons(5), atol=1e-5)


def test_forces_lie_as_the_taxels_do(rig, url):
    grid = reads(GridReader, rig, url)["1"]
    np.testing.assert_allclose(grid, newtons(5).reshape(4, 6, 3), atol=1e-5)


def test_two_pads_are_in_every_message_with_the_times_it_was_made_and_sent(request):
    with made(request, {"left": (1, 4), "right": (2, 4)}) as skins, running(skins.service) as url:
        left, right = reads(Gripper, skins, url)
    np.testing.assert_array_equal(left, axes(4, 5))
    np.testing.assert_array_equal(right, axes(4, 5))


def test_special_numbers_are_numbers_in_a_file(rig, url):
    kept = reads(TaxelLog, rig, url)
    np.testing.assert_array_equal(kept[:, :3], axes(6, 5))
    assert not kept[:, 3].any()


def test_counts_are_among_the_special_numbers(rig, url):
    assert reads(FeatureExtractor, rig, url) == round(np.max(np.abs(axes(6, 5)[:, 2] - 32000.0) / 2.0), 2)


def test_a_monitor_of_clusters_finds_none(rig, url):
    assert reads(ClusterMonitor, rig, url) == []


def test_a_frame_is_made_into_a_message_once_for_all_clients(rig, url, monkeypatch):
    sensor, made = rig.service.sensor("skin"), []
    monkeypatch.setattr(sensor.pipeline, "forces", lambda frame: made.append(frame) or np.ones((24, 3)))
    with ExitStack() as stack:
        readers = [stack.enter_context(Middleware(url)) for _ in range(5)]
        for step in (31, 32):
            rig.send(step)
            parts = [reader.seen(rig, step)["1"] for reader in readers]
            assert parts == [parts[0]] * 5
            assert sum(frame is sensor.newest for frame in made) == 1


@pytest.mark.parametrize("said", [{"command": "calibrate"}, {}, ["reset"], "stop", None])
def test_what_a_client_says_is_not_heard(rig, url, said):
    with Middleware(url) as reader:
        reader.say(said)
        rig.send(5)
        assert reader.seen(rig, 5)["type"] == "routine"
        rig.rest()  # what a tare asked for would take
    assert rig.service.sensor("skin").pipeline.tared == 1


@pytest.mark.parametrize("missing", ["shear_n_per_count", "tare", "taxel"])
def test_forces_are_left_out_unless_all_are_known(request, missing):
    said = {"shear_n_per_count": SCALED.rpartition(",")[0], "tare": SCALED, "taxel": SCALED + ", dead = [7]"}[
        missing
    ]
    with made(request, {"skin": (1, 6)}, said) as skins, running(skins.service) as url:
        if missing != "tare":
            skins.tare()
        told = reads(Middleware, skins, url)["1"]
        assert "calibrated" not in told
        if missing == "tare":
            skins.tare()
            assert len(reads(Middleware, skins, url)["1"]["calibrated"]) == 72


def test_a_taxel_that_no_frame_of_the_tare_had_has_no_known_force(request):
    with made(request, {"skin": (1, 6)}, SCALED) as skins:
        sensor = skins.service.sensor("skin")
        skins.send(0)
        until(lambda: sensor.hub.latest() is not None)
        sensor.tare()
        lost = sensor.newest.flags.copy()
        lost[7] = MISSING
        for number in range(TARE_FRAMES + 1):
            sensor.restore(replace(sensor.newest, flags=lost, sequence=100 + number))
        assert sensor.pipeline.tared
        assert sensor.pipeline.forces(replace(sensor.newest, flags=np.zeros_like(lost))) is None


def test_asyncapi_describes_what_is_sent(rig, url):
    document = ask("GET", url + "/api/v1/asyncapi.json").json()
    messages, schemas = document["components"]["messages"], {"components": document["components"]}
    with Middleware(url) as reader:
        rig.send(5)
        told = reader.seen(rig, 5)
    for name, one in (("welcome", reader.welcomed), ("routine", told)):
        jsonschema.Draft202012Validator(messages[name]["payload"] | schemas).validate(one)
    spoilt = told | {"1": {"sensor": "1"}}
    assert not jsonschema.Draft202012Validator(messages["routine"]["payload"] | schemas).is_valid(spoilt)
    assert document["channels"]["xela"]["address"] == "/xela"


def test_what_forces_and_that_port_come_from_is_told(rig, url):
    api = url + "/api/v1"
    assert ask("GET", api + "/sensors/skin/calibration").json()["shear_n_per_count"] == 0.0006
    assert ask("GET", api + "/sensors/palm/calibration").json()["shear_n_per_count"] is None
    told = ask("GET", api + "/config").json()["server"]
    assert (told["xela"], told["xela_host"]) == (None, "127.0.0.1")
    with running(rig.service, GUARDED) as guarded:
        headers = {"Authorization": "Bearer " + "r" * 16}
        assert ask("GET", guarded + "/api/v1/config", headers=headers).json()["server"]["xela"] == 0


GUARDED = Server(port=0, xela=0, read_token=SecretStr("r" * 16), control_token=SecretStr("c" * 16))


def test_a_port_of_their_own_asks_clients_for_no_token(rig):
    with running(rig.service, GUARDED) as url, xela_clients(rig.service, GUARDED) as address:
        _, forces = reads(RosNode, rig, address)[1]
        np.testing.assert_allclose(forces, newtons(5), atol=1e-5)
        with connect(url.replace("http", "ws", 1)) as closed, pytest.raises(ConnectionClosed) as caught:
            closed.recv(timeout=BUSY_S)
        assert caught.value.rcvd.code == 4401


def test_that_port_has_nothing_else(rig):
    with xela_clients(rig.service, GUARDED) as address:
        here = address.replace("ws", "http", 1)
        for path in ("/", "/xela", "/api/v1/health", "/api/v1/openapi.json", "/metrics", "/static/app.js"):
            assert problem(ask("GET", here + path), 404) == f"GET {path}: not found"
        problem(ask("PUT", here + "/api/v1/sensors/skin/method", json={"method": "raw"}), 404)
        for path in ("/api/v1/stream", "/api/v1/sensors/skin/stream"):
            with connect(address + path) as closed, pytest.raises(ConnectionClosed) as caught:
                closed.recv(timeout=BUSY_S)
            assert (caught.value.rcvd.code, caught.value.rcvd.reason) == (
                4404, f"{path}: no stream: see /xela"
            )  # fmt: skip


def test_that_port_is_closed_to_pages_of_another_site(rig):
    with xela_clients(rig.service, GUARDED) as address:
        with connect(address, origin="http://x") as client, pytest.raises(ConnectionClosed) as caught:
            client.recv(timeout=BUSY_S)
        assert caught.value.rcvd.code == 4403


def test_that_port_may_be_open_to_other_machines_though_the_service_is_not(rig):
    at = GUARDED.model_copy(update={"xela_host": "0.0.0.0"})
    with xela_clients(rig.service, at) as address:
        port = urlsplit(address).port
        outer = socket.gethostbyname(socket.gethostname())
        for host in {"127.0.0.1", outer}:
            assert 1 in reads(RosNode, rig, f"ws://{host}:{port}")


def test_without_a_port_there_is_none(rig):
    with xela_clients(rig.service, Server()) as address:
        assert address is None


def test_a_port_that_is_taken_is_named(rig):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with (
            pytest.raises(TactileError, match=f"address 127.0.0.1:{port}: in use"),
            xela_clients(rig.service, Server(xela=port)),
        ):
            pass


def test_the_service_says_where_that_port_is_and_ends_with_it(rig, capsys, monkeypatch):
    made, real = [], server._server
    monkeypatch.setattr(server, "_server", lambda app, at: made.append(real(app, at)) or made[-1])
    thread = threading.Thread(target=serve, args=(rig.service, GUARDED), daemon=True)
    thread.start()
    until(lambda: len(made) == 2 and all(each.started for each in made))
    (address,) = re.findall(
        r", for XELA's clients at (ws://127\.0\.0\.1:[0-9]+) \(stop: Ctrl-C\)", capsys.readouterr().out
    )
    np.testing.assert_array_equal(reads(RosNode, rig, address)[1][0], axes(6, 5))
    made[0].should_exit = True
    thread.join(BUSY_S)
    assert not thread.is_alive()
    with pytest.raises(ConnectionRefusedError):
        reads(RosNode, rig, address)
