import os
import signal
import tty
from threading import Event, Thread

import numpy as np
import pytest

from tactiled.build import make_codec
from tactiled.bus.reader import open_bus
from tactiled.bus.recording import Recording
from tactiled.bus.router import Router
from tactiled.cli.demo import demo_config, running, simulation
from tactiled.config import parse
from tactiled.config.example import EXAMPLE, GRASP
from tactiled.frames import Message
from tactiled.live.service import Service
from tests.cli.commands import refusal, succeed
from tests.conftest import until

LINKER_HAND = """
[bus.can0]
interface = "virtual"
channel = "can0"
[sensor.hand]
bus = "can0"
codec = { name = "linker" }
array = { rows = 12, columns = 6, pitch_mm = 1.0 }
cover = { thickness_mm = 1.0, young_mpa = 0.6, poisson = 0.48 }
"""


@pytest.fixture
def channel(request):
    return request.node.name


@pytest.fixture
def listener(channel):
    bus = open_bus(interface="virtual", channel=channel)
    yield bus
    bus.close()


@pytest.fixture
def config(tmp_path, channel):
    def write(text, name="a.toml"):
        text = text.replace("socketcan", "virtual").replace('channel = "can0"', f'channel = "{channel}"')
        (tmp_path / name).write_text(text)
        return tmp_path / name

    return write


def received(listener, text):
    """Frames and losses of what came from the sensor of a configuration."""
    (sensor,) = parse(text).sensor.values()
    router, frames = Router({"it": make_codec(sensor)}), []
    while (message := listener.receive(0)) is not None:
        frames += [frame for _, frame in router.push(message)]
    return frames, router.assemblers["it"].loss


def test_the_examples_sensor_without_a_file(listener, channel):
    bus = ("--interface", "virtual", "--channel", channel)
    output = succeed("simulate", *bus, "--seconds", 0.1, "--scene", "ring", "--noise-kpa", 0)
    frames, loss = received(listener, EXAMPLE)
    assert f"sent {len(frames)} frames of 25 messages" in output
    assert [frame.sequence for frame in frames] == list(range(len(frames)))
    assert 1 <= len(frames) <= 10
    assert (loss.lost, loss.foreign, loss.malformed) == (0, 0, 0)
    pressed = frames[0].counts.reshape(32, 32)
    assert pressed[16, 16] < pressed[3:29].max() / 2  # the ring is hollow
    assert pressed.max() > 400
    output = succeed("simulate", *bus, "--seconds", 0.02, "--classic")
    frames, loss = received(listener, EXAMPLE.replace("fd = true", "fd = false"))
    assert f"sent {len(frames)} frames of 256 messages" in output
    assert frames
    assert loss.malformed == 0


def test_a_sensor_of_a_file_on_the_files_own_bus_or_another(listener, channel, config):
    succeed("simulate", "--config", config(GRASP), "--seconds", 0.05, "--scene", "uniform")
    frames, _ = received(listener, GRASP)
    assert np.all(frames[0].counts < 245)  # pressure lowers them
    other = config(GRASP.replace("can0", "other"))
    succeed("simulate", "--config", other, "--channel", channel, "--seconds", 0.05)
    assert listener.receive(0) is not None


def test_a_serial_adapter_gets_its_own_commands(config):
    """What an slcan adapter gets, read by hand at the other end of a pseudo-terminal."""
    data = b""
    ours, theirs = os.openpty()
    tty.setraw(theirs)
    bus = ("--interface", "slcan", "--channel", os.ttyname(theirs), "--bitrate", 1_000_000)
    try:
        succeed("simulate", "--config", config(GRASP), *bus, "--seconds", 0.3, "--rate-hz", 10, "--scene", "empty")
        while not data.endswith(b"\rC\r"):  # the adapter is closed
            data += os.read(ours, 65536)
    finally:
        os.close(ours)
        os.close(theirs)
    lines = data.decode().split("\r")
    assert {"S8", "O"} <= {*lines}  # 1 Mbit/s, open
    messages = [line for line in lines if line.startswith("t")]
    assert len(messages) >= 10  # a frame; how many frames is the machine's pace
    assert messages[0] == "t4E0840F5F5F5F5F5F5F5"  # id, length, a head of seven pads without load
    assert messages[1] == "t4E08C0F5F5F5F5F50000"


def test_an_interrupt_ends_it_between_two_frames(listener, channel):
    other = open_bus(interface="virtual", channel=channel)

    def interrupt():
        if other.receive(60.0):  # it sends
            os.kill(os.getpid(), signal.SIGINT)

    thread = Thread(target=interrupt)
    thread.start()
    output = succeed("simulate", "--interface", "virtual", "--channel", channel, "--scene", "empty")
    thread.join()
    other.close()
    frames, loss = received(listener, EXAMPLE)
    assert f"sent {len(frames)} frames" in output
    assert loss.incomplete == 0


def test_a_polled_hand_answers_each_request_once(listener, channel, config):
    path, asker, over = config(LINKER_HAND), open_bus(interface="virtual", channel=channel), Event()

    def ask():
        while not over.wait(0.1):
            asker.send(Message(0.0, 0x27, b"\xb1\xc6"))
            asker.send(Message(0.0, 0x27, b"\xb2\xc6"))  # of another finger

    thread = Thread(target=ask)
    thread.start()
    output = succeed("simulate", "--config", path, "--seconds", 1, "--scene", "ring")
    over.set()
    thread.join()
    asker.close()
    assert "whenever it is asked" in output
    frames, loss = received(listener, LINKER_HAND)
    assert frames
    assert f"answered {len(frames)} requests" in output
    assert loss.lost == 0


def test_wrong_arguments_are_refused(config):
    hand = config(GRASP)
    for arguments, message in (
        ("", "--interface is missing"),
        ("--interface nope", "python-can has no interface of that name"),
        ("--interface virtual --sensor tip", "--sensor tip: no such sensor: choose one of palm"),
        ("--interface virtual --scene rain", "scene = 'rain'"),
        ("--config gone.toml", "gone.toml: No such file"),
        (f"--config {hand} --interface virtual --fd", "--fd: sensor hand speaks icub, which is classic CAN"),
    ):
        assert message in refusal("simulate", *arguments.split())


def test_the_demo_shows_a_skin_with_shear_and_has_a_recording_to_play(tmp_path):
    assert {name: each.refine for name, each in demo_config().sensor.items()} == {"palm": 1, "skin": 2}
    config = demo_config(shear=True)
    service = Service(config)
    (sensor,) = service.sensors.values()
    with running(service, config, simulation(service, None, 100.0, tmp_path)):
        until(lambda: (image := sensor.hub.latest()) and image.sequence > 20)
        shear = sensor.hub.latest().shear
        service.events.add("calibration_started", "tip", "skin")
        until(lambda: sensor.hub.latest().raw.max() < 5)  # unloaded first
        until(lambda: sensor.hub.latest().raw.max() > 5)
        service.events.add("calibration_ended", "discarded", "skin")
        until(lambda: np.abs(sensor.hub.latest().shear).max() > 100)
    assert (sensor.name, shear.shape) == ("skin", (2, 4, 6))
    assert np.abs(shear).max() > 100
    router, frames = Router({"skin": sensor.codec}), []
    for message in Recording(tmp_path / "fingertips.log"):
        frames += [frame.counts for _, frame in router.push(message)]
    raw = np.array(frames)
    assert len(raw) >= 299
    assert np.ptp(raw[:50].mean(axis=1)) < 20  # empty at first, as a measurement of the noise wants it
    assert raw.max() > raw[:50].max() + 500
