import os
import signal
import tty
from threading import Event, Thread

import numpy as np
import pytest
from typer.testing import CliRunner

from tactiled.build import make_codec
from tactiled.bus.reader import open_bus
from tactiled.bus.router import Router
from tactiled.cli.app import app
from tactiled.cli.demo import demo_config, running, simulated
from tactiled.cli.simulate import simulate
from tactiled.config import parse
from tactiled.config.example import EXAMPLE, GRASP
from tactiled.errors import BusError, ConfigError
from tactiled.frames import Message
from tactiled.runtime.service import Service
from tactiled.simulate import play
from tests.conftest import until

__all__ = ["simulate"]  # importing it gives the command line its verb


def run(arguments):
    return CliRunner().invoke(app, ["simulate", *arguments.split()], catch_exceptions=True)


@pytest.fixture
def listener(request):
    bus = open_bus(interface="virtual", channel=request.node.name)
    yield bus
    bus.close()


def frames_of(listener, codec):
    router = Router({"it": codec})
    frames = []
    while (message := listener.receive(0)) is not None:
        frames += [frame for _, frame in router.push(message)]
    return frames, router.assemblers["it"].loss


def test_the_examples_sensor_without_a_file(listener, request):
    codec = make_codec(parse(EXAMPLE).sensor["palm"])
    result = run(f"--interface virtual --channel {request.node.name} --seconds 0.1 --scene ring --noise-kpa 0")
    assert result.exit_code == 0, result.output
    frames, loss = frames_of(listener, codec)
    assert f"sent {len(frames)} frames of 25 messages" in result.output
    assert [frame.sequence for frame in frames] == list(range(len(frames)))
    assert 1 <= len(frames) <= 10
    assert (loss.lost, loss.foreign, loss.malformed) == (0, 0, 0)
    pressed = frames[0].counts.reshape(32, 32)
    assert pressed[16, 16] < pressed[3:29].max() / 2  # the ring is hollow
    assert pressed.max() > 400


def test_classic_messages_instead(listener, request):
    codec = make_codec(parse(EXAMPLE.replace("fd = true", "fd = false")).sensor["palm"])
    result = run(f"--interface virtual --channel {request.node.name} --seconds 0.02 --classic")
    frames, loss = frames_of(listener, codec)
    assert frames
    assert f"sent {len(frames)} frames of 256 messages" in result.output
    assert loss.malformed == 0


def test_a_sensor_of_a_file_on_the_files_own_bus(listener, request, tmp_path):
    text = GRASP.replace("socketcan", "virtual").replace('channel = "can0"', f'channel = "{request.node.name}"')
    path = tmp_path / "hand.toml"
    path.write_text(text)
    assert run(f"--config {path} --seconds 0.05 --scene uniform").exit_code == 0
    frames, _ = frames_of(listener, make_codec(parse(text).sensor["hand"]))
    assert frames
    assert np.all(frames[0].counts < 245)  # pressure lowers them


def test_an_option_goes_over_what_the_file_says_of_its_bus(listener, request, tmp_path):
    path = tmp_path / "hand.toml"
    path.write_text(GRASP.replace("socketcan", "virtual"))
    assert run(f"--config {path} --channel {request.node.name} --seconds 0.05").exit_code == 0
    assert listener.receive(0) is not None


def test_a_serial_adapter_gets_its_own_words(tmp_path):
    """What an slcan adapter is told, read by hand at the other end of a pseudo-terminal."""
    ours, theirs = os.openpty()
    tty.setraw(theirs)
    path = tmp_path / "hand.toml"
    path.write_text(GRASP)
    bus = f"--interface slcan --channel {os.ttyname(theirs)} --bitrate 1000000"
    try:
        assert run(f"--config {path} {bus} --seconds 0.3 --rate-hz 10 --scene empty").exit_code == 0
        lines = os.read(ours, 65536).decode().split("\r")
    finally:
        os.close(ours)
        os.close(theirs)
    assert "S8" in lines  # 1 Mbit/s
    assert "O" in lines
    said = [line for line in lines if line.startswith("t")]
    assert len(said) in (10, 20, 30)
    assert said[0] == "t4E0840F5F5F5F5F5F5F5"  # id, length, a head of seven pads without load
    assert said[1] == "t4E08C0F5F5F5F5F50000"


def test_an_interrupt_ends_it_between_two_frames(listener, request):
    other = open_bus(interface="virtual", channel=request.node.name)

    def interrupt():
        if other.receive(60.0):  # it sends
            os.kill(os.getpid(), signal.SIGINT)

    thread = Thread(target=interrupt)
    thread.start()
    result = run(f"--interface virtual --channel {request.node.name} --scene empty")
    thread.join()
    other.close()
    assert result.exit_code == 0, result.output
    frames, loss = frames_of(listener, make_codec(parse(EXAMPLE).sensor["palm"]))
    assert f"sent {len(frames)} frames" in result.output
    assert loss.incomplete == 0


@pytest.mark.parametrize(
    ("arguments", "error", "says"),
    [
        ("", ConfigError, "--interface is missing"),
        ("--interface nope", BusError, "python-can has no interface of that name"),
        ("--interface virtual --sensor tip", ConfigError, "--sensor tip: no such sensor: choose one of palm"),
        ("--interface virtual --scene rain", ConfigError, "scene = 'rain'"),
        ("--config gone.toml", ConfigError, "gone.toml: No such file"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(arguments, error, says):
    told = run(arguments).exception
    assert isinstance(told, error)
    assert says in str(told)
    assert "\n" not in str(told)


def test_a_skin_of_classic_messages_does_not_take_fd(tmp_path):
    path = tmp_path / "hand.toml"
    path.write_text(GRASP)
    told = run(f"--config {path} --interface virtual --fd").exception
    assert str(told) == "--fd: sensor hand speaks icub, which is classic CAN"


HAND = """
[bus.can0]
interface = "virtual"
channel = "{channel}"
[sensor.hand]
bus = "can0"
codec = {{ name = "linker" }}
array = {{ rows = 12, columns = 6, pitch_mm = 1.0 }}
cover = {{ thickness_mm = 1.0, young_mpa = 0.6, poisson = 0.48 }}
"""


def test_a_hand_that_is_polled_answers_as_often_as_it_is_asked_and_no_more(listener, request, tmp_path):
    (tmp_path / "hand.toml").write_text(HAND.format(channel=request.node.name))
    codec = make_codec(parse(HAND.format(channel="x")).sensor["hand"])
    asker, over = open_bus(interface="virtual", channel=request.node.name), Event()
    (poll,) = codec.polling.polls

    def ask():
        while not over.wait(0.1):
            asker.send(poll.message)
            asker.send(Message(0.0, 0x27, b"\xb2\xc6"))  # of another finger

    thread = Thread(target=ask)
    thread.start()
    result = run(f"--config {tmp_path / 'hand.toml'} --seconds 1 --scene ring")
    over.set()
    thread.join()
    asker.close()
    assert result.exit_code == 0, result.output
    assert "on virtual" in result.output
    assert "whenever it is asked" in result.output
    frames, loss = frames_of(listener, codec)
    assert frames
    assert f"answered {len(frames)} requests" in result.output
    assert loss.lost == 0


def test_the_demo_with_shear_shows_a_skin_that_feels_it():
    config = demo_config(shear=True)
    service = Service(config)
    (sensor,) = service.sensors.values()
    source = simulated(config, sensor, "sphere")
    with running(service, config, lambda sender, stop: play(source.messages, sender.send, 100.0, stop)):
        until(lambda: (image := sensor.hub.latest()) and image.sequence > 20, 20)
    image = sensor.hub.latest()
    assert (sensor.name, sensor.plan.shears, image.shear.shape) == ("skin", True, (2, 4, 6))
    assert np.abs(image.shear).max() > 100
