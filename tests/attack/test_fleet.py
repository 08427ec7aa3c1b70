"""The fuzzer of a fleet's keys: valid and invalid pieces in any order, beside a robot that goes on undisturbed."""

import json
import random
import time
from copy import copy
from dataclasses import asdict

import numpy as np

from tactiled.config import Server
from tactiled.frames import SensorImage
from tactiled.interop.zenoh.app import create
from tactiled.interop.zenoh.intake import MAX_ROBOTS, STRANGERS
from tactiled.interop.zenoh.messages import MAX_CELLS
from tactiled.interop.zenoh.robots import EVENTS, EVENTS_HZ, MAX_NAMES, MAX_SESSIONS, QUIET_S
from tactiled.interop.zenoh.session import Head
from tactiled.live.events import Event
from tactiled.web.server import on_thread
from tactiled.wire import pack
from tests.conftest import ask, until
from tests.interop.zenoh_kit import fleet_at
from tests.process import free_port

MESSAGES, ROUNDS = 100_000, 200  # in all; after each round of them the good robot sends a frame
DESCRIPTIONS = 0.003  # of the messages that a description of a publisher comes before
GOOD, BAD = "good/palm", ("bad/palm", "bad/tip", "worse/palm")
SESSIONS = {name: f"{at:016x}" for at, name in enumerate((GOOD, *BAD), 1)}
SIDE = 4
STATE = {
    "state": "live", "detail": "", "rate_hz": 50.0, "jitter_s": None, "skew_s": 0.001, "tared_at": None,
    "loss": {"lost": 1}, "bus": "can0", "codec": "packed", "shear": False, "unit": "kPa", "method": "auto",
    "clock": "kernel", "references": None, "error_kinds": {"other": 0}, "stale_after_s": 3600.0, "closing": False,
    "release": "1",
}  # fmt: skip
CELLS = {"rows": SIDE, "columns": SIDE, "cell_mm": 1.0}
GEOMETRY = {
    "shape": [SIDE, SIDE], "positions_mm": [[float(x), float(y)] for y in range(SIDE) for x in range(SIDE)],
    "pitch_mm": 1.0, "aperture": "square", "aperture_mm": 0.8, "raw": CELLS, "restored": CELLS, "areas_mm2": None,
}  # fmt: skip
WARNING = {"code": "saturated", "text": "1 taxel", "taxels": 1, "thickness_mm": None}
DETAIL = {"why": "by hand", "method": "raw", "calibration": "configured", "warnings": [WARNING]}
EVENT = asdict(Event(1, 2.0, "warning_raised", "palm", None, "a word")) | {"warning": WARNING}
NASTY = (
    None, True, 0, -1, 1.5, 2**63, 2**64, 10**400, float("nan"), float("inf"), -1e308, "", "x", "\ud800",
    "\x00\n\x1b[0m", "‮", "é" * 300, "x" * 20_000, "<script>1</script>", "../..", [], {}, [None] * 2000,
    {"rows": 6000, "columns": 6000, "cell_mm": 1.0}, {"rows": 0, "columns": -1, "cell_mm": 0}, "sensor_down",
)  # fmt: skip
BROKEN = (b"", b"\x00", b"null", b"[]", b"[" * 5000, b'{"a":' * 3000, b"\xff\xfe", b'"', b"NaN", b"1" * 5000)
CHUNKS = (
    "bad",
    "worse",
    "palm",
    "",
    "..",
    "*",
    "é",
    "a b",
    "x" * 200,
    "alive",
    "events",
    "state",
    "0" * 16,
    "r/s",
)


def image(values, sequence=0, **changes):
    """A frame of a sensor."""
    settings = {
        "sensor": "",
        "time": 1.0,
        "method": "raw",
        "why": "",
        "iterations": 1,
        "microseconds": 1.0,
    } | changes
    flags = np.zeros((SIDE, SIDE), np.uint8)
    noise = {"noise": 0.1, "noise_gain": 1.0, "resolution_mm": 1.0}
    return SensorImage(raw=values, restored=values, flags=flags, sequence=sequence, **(noise | settings))


class Fuzzer:
    """Messages of the bad robots, by a seeded chance."""

    def __init__(self, fleet, seed):
        self.fleet, self.rng, self.number = fleet, random.Random(seed), 0
        self.messages = 0
        frame = image(np.ones((SIDE, SIDE), np.float32))
        self.images = {kind: pack(frame, kind, 1.0) for kind in ("raw", "restored")}

    def mutated(self, message):
        """JSON with up to three wrong values, at any depth, or none at all."""
        rng = self.rng
        if rng.random() < 0.1:
            return rng.choice(BROKEN)
        value = json.loads(json.dumps(message))
        for _ in range(rng.choice((0, 0, 1, 1, 2, 3))):
            place = value
            while True:
                keys = [*place] if isinstance(place, dict) else range(len(place))
                if not keys:
                    break
                key = rng.choice(keys)
                if isinstance(place[key], dict | list) and place[key] and rng.random() < 0.5:
                    place = place[key]
                elif isinstance(place, dict) and rng.random() < 0.3:
                    del place[key]
                    break
                else:
                    place[key] = copy(rng.choice(NASTY))
                    break
        data = json.dumps(value).encode()
        return data[: rng.randrange(len(data))] if rng.random() < 0.05 else data

    def binary(self, data):
        """Bytes that are cut, longer or changed, or none of these."""
        rng = self.rng
        match rng.randrange(8):
            case 0:
                return data[: rng.randrange(len(data) + 1)]
            case 1:
                return data + bytes(rng.choice((1, 100, 100_000)))
            case 2:
                place, number = (
                    rng.randrange(len(data) - 4),
                    rng.choice((b"\xff" * 4, bytes(4), b"\x00\x00\xc0\x7f")),
                )
                return data[:place] + number + data[place + 4 :]
        return data

    def attachment(self, name, detail=b""):
        """The head of a message, of its publisher or another."""
        rng, self.number = self.rng, self.number + 1
        session = SESSIONS[name] if rng.random() < 0.8 else rng.choice(("f" * 16, "0" * 16))
        number = rng.choice((self.number, self.number, self.number, 1, 0, 2**63))
        head = Head(
            session,
            min(number, self.number + 5) if rng.random() < 0.99 else number,
            rng.choice((2, 2, 2, 0, 3, 255)),
        )
        return self.binary(head.pack(detail))

    def resource(self, name, last):
        """The key of a message, seldom none of a robot's."""
        rng = self.rng
        if rng.random() > 0.05:
            return f"{name}/{last}"
        return "/".join(rng.choices(CHUNKS, k=rng.randrange(6)))

    def image(self, name):
        frame, detail = self.rng.choice((("raw", b""), ("restored", b""), ("restored", self.mutated(DETAIL))))
        attachment = self.attachment(name, detail)
        for kind in (frame, "raw" if frame == "restored" else "restored"):
            self.messages += kind != frame
            self.fleet.take_image(kind, self.resource(name, kind), self.binary(self.images[kind]), attachment)

    def state(self, name):
        self.fleet.take_state(self.resource(name, "state"), self.mutated(STATE), self.attachment(name))

    def event(self, name):
        resource = self.resource(name.partition("/")[0], "events")
        self.fleet.take_event(resource, self.mutated(EVENT), b"")

    def token(self, name):
        rng = self.rng
        session = rng.choice((SESSIONS[name], f"{rng.randrange(2, 9):016x}", "z", "A" * 16))
        name = rng.choice((name, f"bad/s{rng.randrange(200)}", f"r{rng.randrange(400)}/palm", GOOD))
        self.fleet.take_token(self.resource(name, f"alive/{session}"), rng.random() < 0.7)

    def describe(self, name):
        """A publisher answers what it is asked."""
        self.fleet.take_token(f"{name}/alive/{SESSIONS[name]}", True)
        line = self.fleet.lines.get(name)
        state, geometry = (
            each if self.rng.random() < 0.5 else self.mutated(json.loads(each)) for each in DESCRIPTION
        )
        if line:
            self.fleet.describe(line, str(line.session), (state, geometry), None)

    def send(self):
        name = self.rng.choice(BAD)
        if self.rng.random() < DESCRIPTIONS:
            self.describe(name)
        self.messages += 1
        self.rng.choices((self.image, self.state, self.event, self.token), (4, 2, 2, 1))[0](name)


DESCRIPTION = json.dumps(STATE).encode(), json.dumps(GEOMETRY).encode()


class Bystander:
    """The good robot: what it sends must come through, each time."""

    def __init__(self, fleet, url):
        self.fleet, self.url, self.number = fleet, url, 0
        fleet.take_token(f"{GOOD}/alive/{SESSIONS[GOOD]}", True)
        fleet.describe(fleet.lines[GOOD], SESSIONS[GOOD], DESCRIPTION, None)
        self.texts = []
        fleet.events.subscribe(lambda event: event.bus == "good/can7" and self.texts.append(event.text))

    def step(self):
        self.number += 1
        values = np.full((SIDE, SIDE), self.number, np.float32)
        frame, head = image(values, self.number), Head(SESSIONS[GOOD], self.number, 2)
        for kind, detail in (("raw", b""), ("restored", json.dumps(DETAIL).encode())):
            self.fleet.take_image(kind, f"{GOOD}/{kind}", pack(frame, kind, time.time()), head.pack(detail))
        sensor = self.fleet.sensors[GOOD]
        until(lambda: (newest := sensor.hub.latest()) and newest.sequence == self.number)
        np.testing.assert_array_equal(sensor.hub.latest().restored, values)
        assert (sensor.line.lost, sensor.status().state, sensor.line.refused) == (0, "live", "")

    def event(self):
        event = EVENT | {"sensor": None, "bus": "can7", "text": f"{self.number}"}
        self.fleet.take_event("good/events", json.dumps(event).encode(), b"")
        until(lambda: self.texts[-1:] == [f"{self.number}"])

    def is_live(self):
        """Whether health and metrics say so, after one more image: a busy machine may answer late."""
        self.step()
        health, metrics = (ask("GET", f"{self.url}{path}") for path in ("/api/v1/health", "/metrics"))
        assert health.json()["faults"] == {}
        is_live = f'tactiled_state{{sensor="{GOOD}",state="live"}} 1.0' in metrics.text
        return is_live and health.json()["sensors"][GOOD]["state"] == "live"

    def asks(self):
        until(self.is_live)
        for path in ("sensors", "events", "config", f"sensors/{GOOD}/contacts", f"sensors/{GOOD}/frames/restored"):
            assert ask("GET", f"{self.url}/api/v1/{path}").status_code == 200, path


def test_no_message_of_one_robot_disturbs_another():
    endpoint, kinds = f"tcp/127.0.0.1:{free_port()}", []
    with (
        fleet_at("", mode="peer", connect=[], listen=[endpoint]) as fleet,
        on_thread(create(fleet, Server(port=0)), Server(port=0)) as url,
    ):
        began = time.monotonic()
        bystander, fuzzer = Bystander(fleet, url), Fuzzer(fleet, seed=1)
        fleet.events.subscribe(lambda event: kinds.append(event.kind))
        for at in range(ROUNDS):
            while fuzzer.messages < MESSAGES * (at + 1) / ROUNDS:
                fuzzer.send()
            bystander.step()
            if at % (ROUNDS // 20) == 0:
                bystander.event()
                bystander.asks()
        seconds = time.monotonic() - began
    assert (len(bystander.texts), kinds.count("fault_raised")) == (20, 0)
    assert len(fleet.robots) <= MAX_ROBOTS
    assert all(len(robot.lines) <= MAX_NAMES and robot.pieces <= MAX_CELLS for robot in fleet.robots.values())
    quiet = seconds / QUIET_S + 1
    per_robot = EVENTS + EVENTS_HZ * seconds + MAX_SESSIONS + 2 * quiet
    assert 0 < len(kinds) <= 3 * per_robot + STRANGERS * quiet  # of good, bad, worse, and all others
