"""XELA's modules, as the public clients of XELA's server read them, with the library that they use."""

import json
import re
import socket
import threading
import time
from contextlib import ExitStack, contextmanager
from urllib.parse import urlsplit

import numpy as np
import pytest
import websocket
from websockets.sync.client import connect

from tactiled.config import Server
from tactiled.frames import Message
from tactiled.interop.xela import XelaClients
from tactiled.web import server
from tactiled.web.app import create
from tactiled.web.bridge import Host
from tactiled.web.server import serve
from tests.conftest import BRIDGES, BUSY_S, CONFIG, TOKENS, Rig, ask, meanwhile, problem, running, until
from tests.web.http.raw import websocket_url
from tests.web.ws.clients import closed

BUS = CONFIG.partition("[sensor.palm]")[0]
MODULE = """
[sensor.{name}]
bus = "can0"
method = "raw"
stale_after_s = 600
codec = {{ name = "xela", controller = {controller}, rows = [4, 3, 2, 1], columns = {columns} {codec} }}
array = {{ rows = 4, columns = {width}, pitch_mm = 5.0 }}
cover = {{ thickness_mm = 0.8, young_mpa = 0.6, poisson = 0.48 }}
kernel = {{ model = "layered" }}
calibration = {{ {calibration} }}
"""
RAW = "no_load = 36000, noise_kpa = 5"
UNSHEARED = f"kpa_per_count = 0.02, {RAW}"
SCALED = f"{UNSHEARED}, shear_n_per_count = 0.0006"
NEWTON = np.array([0.0006, 0.0006, 0.02 * 5.0**2 * 1e-3])  # N a count of X, Y and Z
ONE = {"skin": (1, 6)}


class Modules(Rig):
    """A service with XELA's modules, {name: (controller, width)}, and the other end of their bus."""

    def __init__(self, channel, modules, calibration, codec):
        texts = [
            MODULE.format(
                name=name, controller=controller, width=width, columns=[*reversed(range(width))],
                calibration=calibration, codec=codec,
            )
            for name, (controller, width) in modules.items()
        ]  # fmt: skip
        super().__init__(channel, "".join(texts), BUS)
        self.modules = modules

    def send(self, step=0, drop=()):
        """One frame of every module: ids SDA << 8 | taxel << 4 | controller, SDAs and taxels downwards."""
        for controller, width in self.modules.values():
            ids = [
                sda << 8 | taxel << 4 | controller for sda in (4, 3, 2, 1) for taxel in range(width - 1, -1, -1)
            ]
            for at, (id_, xyz) in enumerate(zip(ids, axes(width, step), strict=True)):
                if at not in drop:
                    data = bytes((0x93, *np.asarray(xyz, ">u2").tobytes(), 0x0C))
                    self.bus.send(Message(time.time(), id_, data))

    def send_whole(self, step):
        """A frame of a step, again where a busy machine sent it in two pieces."""

        def complete():
            before = self.sensor.newest
            self.send(step)
            until(lambda: self.sensor.newest is not before)
            return not self.sensor.newest.flags.any()

        until(complete)

    def rest(self):
        """A frame of step 0, restored."""
        before = self.sensor.hub.latest()
        self.send()
        until(lambda: self.sensor.hub.latest() is not before)

    def tare(self):
        """Take the counts of step 0 as no load."""
        self.send()
        until(self.sensor.hub.latest)
        self.sensor.tare()
        while not self.sensor.pipeline.tares.done:
            self.rest()


def axes(width=6, step=0):
    """(taxels, 3) counts; no two taxels rest at the same, and each is pressed and sheared by its own amount."""
    each = np.arange(4 * width)
    rest = np.column_stack([0x8000 + 3 * each, 0x8010 - 2 * each, 36000 + 7 * each])
    return rest + step * np.column_stack([20 - each, each, 30 + 10 * each])


def newtons(step):
    """(taxels, 3): the load of a 4 x 6 module, from the counts that it rests at."""
    return (axes(6, step) - axes()) * NEWTON


def started(request, modules=ONE, calibration=RAW, codec=""):
    channel = re.sub(r"\W", "-", f"{request.node.name}{calibration}")
    return meanwhile(Modules(channel, modules, calibration, codec))


@pytest.fixture(scope="module")
def rig(request):
    """One 4 x 6 module, its forces known: scaled, and tared."""
    with started(request, calibration=SCALED) as modules:
        modules.tare()
        yield modules


@pytest.fixture(scope="module")
def url(rig):
    with running(rig.service) as address:
        yield address


class Client:
    """Connects to ws://IP:PORT without a path, and needs each field that some public client reads, by its type."""

    def __init__(self, url, path=""):
        parts = urlsplit(url)
        self.app = websocket.create_connection(f"ws://{parts.hostname}:{parts.port}{path}", timeout=BUSY_S)
        assert json.loads(self.app.recv()) == {"message": "Welcome"}
        self.number = 0

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.app.close()

    def read(self):
        """The counts and forces, or None, of each module in the next message."""
        message = json.loads(self.app.recv())
        modules = {key: message[key] for key in message if key.isdigit()}
        assert set(message) == {"message", "time", "sensors", "type", "sendtime", *modules}
        assert (message["type"], message["sensors"]) == ("routine", len(modules))
        assert type(message["message"]) is int
        assert message["message"] == self.number + 1
        self.number, self.models = message["message"], [each["model"] for each in modules.values()]
        assert (
            message["time"] == max(each["time"] for each in modules.values()) <= message["sendtime"] <= time.time()
        )
        return {key: _parse(key, module) for key, module in modules.items()}

    def until(self, step, modules=ONE):
        """The first message with the counts of a step of all modules."""
        while True:
            parts = self.read()
            if [*parts] == [str(n + 1) for n in range(len(modules))] and all(
                np.array_equal(counts, axes(width, step))
                for (counts, _), (_, width) in zip(parts.values(), modules.values(), strict=True)
            ):
                return [forces for _, forces in parts.values()]


def _parse(key, module):
    counts = np.reshape([int(each, 16) for each in module["data"].split(",")], (-1, 3))
    assert module["data"] == ",".join(f"{each:04X}" for each in counts.ravel())
    assert module["integer"] == counts.ravel().tolist()
    assert all(type(each) is int for each in module["integer"])
    taxels = len(counts)
    assert (module["sensor"], module["taxels"], module["temp"]) == (key, taxels, [0.0] * taxels)
    assert [type(module[each]) for each in ("time", "model")] == [float, str]
    assert module["ups"] == [module["ups"][0]] * taxels
    assert module["special"] == [[*each, *[0.0, 0, 0, 0] * 2, 0.0] for each in counts.tolist()]
    if "calibrated" not in module:
        return counts, None
    assert all(type(each) is float for each in module["calibrated"])
    return counts, np.reshape(module["calibrated"], (taxels, 3))


def forces_of(rig, url, step=5):
    """The forces that a client reads with the frame of a step."""
    with Client(url) as client:
        rig.send_whole(step)
        return client.until(step, rig.modules)[0]


@pytest.mark.parametrize("path", ["/xela", "/", ""])
def test_counts_and_forces_of_every_frame_in_order(rig, url, path):
    with Client(url, path) as client:
        for step in (4, 5, 6):
            rig.send_whole(step)
            (forces,) = client.until(step)
            np.testing.assert_allclose(forces, newtons(step), atol=1e-5)
        assert client.models == ["uSPa46"]


@pytest.mark.parametrize(
    ("calibration", "tared", "codec", "model"),
    [
        (UNSHEARED, True, "", "uSPa46"),
        (SCALED, False, 'profile = "current"', "uSPa46"),
        (SCALED + ", dead = [7]", True, 'model = "XR1946"', "XR1946"),
        (RAW, False, 'model = "x-1"', "x-1"),
    ],
)
def test_the_model_is_the_configured_one_and_forces_need_all_known(request, calibration, tared, codec, model):
    with started(request, ONE, calibration, f", {codec}" if codec else "") as modules:
        if tared:
            modules.tare()
        with running(modules.service) as url, Client(url) as client:
            modules.send_whole(5)
            assert client.until(5) == [None]
            assert client.models == [model]


def test_two_modules_are_in_every_message(request):
    pads = {"left": (1, 4), "right": (2, 4)}
    with started(request, pads) as modules, running(modules.service) as url, Client(url) as client:
        modules.send_whole(5)
        assert client.until(5, pads) == [None, None]


def test_a_frame_with_taxels_missing_and_a_silent_module_are_not_sent(request):
    with started(request) as modules, running(modules.service) as url:
        modules.stale_after(0.4)
        with Client(url) as client:
            modules.send(2, drop=(7,))
            until(lambda: (newest := modules.sensor.newest) and newest.flags.any())
            modules.send(3)
            assert np.array_equal(client.read()["1"][0], axes(6, 3))
        until(lambda: modules.sensor.status().state == "stale")
        with Client(url) as client:
            client.app.settimeout(1)
            with pytest.raises(websocket.WebSocketTimeoutException):
                client.read()


def test_a_message_is_made_once_for_all_clients_and_those_of_clients_are_ignored(rig, url, monkeypatch):
    pipeline, made = rig.sensor.pipeline, []
    monkeypatch.setattr(pipeline, "forces", lambda frame: made.append(frame) or np.ones((24, 3)))
    with ExitStack() as stack:
        clients = [stack.enter_context(Client(url)) for _ in range(5)]
        for message in ({"command": "calibrate"}, {}, ["reset"], "stop", None):
            clients[0].app.send(json.dumps(message))
        for step in (31, 32):
            rig.send(step)
            for client in clients:
                client.until(step)
            assert sum(frame is rig.sensor.newest for frame in made) == 1
        rig.rest()
    assert pipeline.tares.done == 1
    assert not pipeline.tares.under_way


GUARDED = Server(port=0, xela=0, **TOKENS)


@contextmanager
def xela_clients(rig, config=GUARDED):
    with XelaClients().running(Host(rig.service, config, [])) as words:
        yield words and words.removeprefix("XELA's clients at ")


def test_the_extra_port_needs_no_token_and_has_nothing_else(rig):
    with running(rig.service, GUARDED) as url, xela_clients(rig) as address:
        np.testing.assert_allclose(forces_of(rig, address), newtons(5), atol=1e-5)
        for path, origin, code in ((websocket_url(url, "/"), None, 4401), (address, "http://x", 4403)):
            with connect(path, origin=origin) as client:
                assert closed(client)[0] == code
        base = address.replace("ws", "http", 1)
        for path in ("/", "/xela", "/api/v1/health", "/api/v1/openapi.json", "/metrics", "/static/app.js"):
            assert problem(ask("GET", base + path), 404) == f"GET {path}: not found"
        problem(ask("PUT", base + "/api/v1/sensors/skin/method", json={"method": "raw"}), 404)
        for path in ("/api/v1/stream", "/api/v1/sensors/skin/stream"):
            with connect(address + path) as client:
                assert closed(client) == (4404, f"{path}: no stream: see /xela")
    with xela_clients(rig, Server()) as none:
        assert none is None


def test_the_extra_port_may_be_open_to_other_machines(rig):
    with xela_clients(rig, GUARDED.model_copy(update={"xela_host": "0.0.0.0"})) as address:
        for host in {"127.0.0.1", socket.gethostbyname(socket.gethostname())}:
            assert forces_of(rig, f"ws://{host}:{urlsplit(address).port}") is not None


def test_the_service_prints_the_extra_port_and_ends_with_it(rig, capsys, monkeypatch):
    servers, make = [], server._server
    monkeypatch.setattr(server, "_server", lambda *each: servers.append(make(*each)) or servers[-1])
    thread = threading.Thread(target=serve, args=(create(rig.service, GUARDED, BRIDGES), GUARDED), daemon=True)
    thread.start()
    until(lambda: len(servers) == 2 and all(each.started for each in servers))
    pattern = r", for XELA's clients at (ws://127\.0\.0\.1:[0-9]+) \(stop: Ctrl-C\)"
    (address,) = re.findall(pattern, capsys.readouterr().out)
    assert forces_of(rig, address) is not None
    servers[0].should_exit = True
    thread.join(BUSY_S)
    assert not thread.is_alive()
    with pytest.raises(ConnectionRefusedError):
        Client(address)


def test_clients_are_closed_where_a_reload_changes_the_modules(request, tmp_path):
    with started(request, {"skin": (1, 6), "tip": (2, 4)}) as modules, running(modules.service) as url:
        modules.service.path = tmp_path / "skins.toml"
        text = BUS.format(channel=modules.config.bus["can0"].channel)
        one = MODULE.format(
            name="skin", controller=1, width=6, columns=[5, 4, 3, 2, 1, 0], calibration=RAW, codec=""
        )
        with connect(websocket_url(url, "/xela")) as client:
            assert "Welcome" in client.recv(timeout=BUSY_S)  # it is known to the service
            modules.service.path.write_text(text + one)
            assert modules.service.reload().sensors.removed == ("tip",)
            assert closed(client) == (1012, "the configuration has other modules now")
