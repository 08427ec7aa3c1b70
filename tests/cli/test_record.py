import os
import re
import signal
import subprocess
import threading
import time
from types import SimpleNamespace

import can
import pytest
from can.interfaces import virtual

from tactiled.bus import recorder, recording
from tactiled.bus.reader import open_bus
from tactiled.config.example import EXAMPLE
from tactiled.frames import Message
from tests.cli.commands import TACTILED, refusal, run
from tests.conftest import BUSY_S, until

COUNT = 200


@pytest.fixture
def channel(request):
    return re.sub(r"\W", "-", request.node.name)


@pytest.fixture
def sender(channel):
    """Sends COUNT messages on a thread, once the recorder has opened its end."""

    def go():
        end = time.monotonic() + BUSY_S
        while not virtual.channels.get(channel) and time.monotonic() < end:
            time.sleep(0.005)
        bus = open_bus("virtual", channel=channel)
        for number in range(COUNT):
            bus.send(Message(0.0, 0x500, number.to_bytes(8, "big")))
        bus.close()

    thread = threading.Thread(target=go)
    thread.start()
    yield
    thread.join()


@pytest.fixture
def config(tmp_path, channel):
    path = tmp_path / "a.toml"
    path.write_text(EXAMPLE.replace('"socketcan"\nchannel = "can0"', f'"virtual"\nchannel = "{channel}"'))
    return path


def numbers(path):
    return [int.from_bytes(each.data, "big") for each in recording.read(path)]


@pytest.mark.usefixtures("sender")
def test_the_bus_of_a_configuration(tmp_path, config):
    out = tmp_path / "a.log"
    done = run("record", "--config", config, "--seconds", 2, out)
    assert f"{out}: {COUNT} messages" in done.output
    assert numbers(out) == list(range(COUNT))
    message = refusal("record", "--config", config, "--bus", "can7", tmp_path / "b.log")
    assert message == "--bus can7: no such bus: choose one of can0"
    config.write_text(config.read_text() + '[bus.can1]\ninterface = "virtual"\n')
    assert refusal("record", "--config", config, out) == "--bus is missing: choose one of can0, can1"


@pytest.mark.parametrize(
    ("configured", "option", "bound"),
    [(None, None, 1000), (None, 601, 601), (700, None, 700), (500, 650, 650), (700, 0, None)],
)
def test_the_free_space_to_leave_is_checked_before_anything_is_written(
    tmp_path, channel, config, monkeypatch, configured, option, bound
):
    monkeypatch.setattr(recorder, "disk_usage", lambda _: SimpleNamespace(free=600e6))
    out = tmp_path / "a.log"
    config.write_text(config.read_text().replace("_leave_mb = 1000", f"_leave_mb = {configured}"))
    command = ["record", out, "--seconds", 0.1]
    command += ["--config", config] if configured else ["--interface", "virtual", "--channel", channel]
    command += [] if option is None else ["--recordings-leave-mb", option]
    if bound is None:
        assert run(*command).exit_code == 0
    else:
        message = f"{out}: less than {bound} MB of its disk are free (recordings_leave_mb)"
        assert refusal(*command) == message
        assert not out.exists()


@pytest.mark.usefixtures("sender")
def test_a_recording_ends_before_the_disk_is_full(tmp_path, channel, monkeypatch):
    out = tmp_path / "a.log"

    def usage(_):
        return SimpleNamespace(free=598e6 if out.exists() and len(numbers(out)) == COUNT else 600e6)

    monkeypatch.setattr(recorder, "disk_usage", usage)
    message = refusal("record", "--interface", "virtual", "--channel", channel, "--recordings-leave-mb", 599, out)
    assert (
        f"less than 599 MB of its disk are free (recordings_leave_mb): the recording ends early, after {COUNT}"
        in (message)
    )
    assert numbers(out) == list(range(COUNT))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("a.log", "--interface is missing"),
        ("a.log --interface nope", "python-can has no interface of that name"),
        ("a.mf4 --interface virtual", "a.mf4: unsupported format; use"),
        ("gone/a.log --interface virtual", "gone/a.log: No such file or directory"),
        ("a.log --interface virtual --recordings-leave-mb inf", "recordings_leave_mb = inf: give 0"),
        ("a.log --interface virtual --bus can0", "--bus can0: names a bus of a --config"),
        ("a.log --interface virtual --config a.toml", "--config: says how to open the bus: leave out --interface"),
        ("a.log --fd --config a.toml", "--config: says how to open the bus: leave out --interface"),
        ("a.log --config gone.toml", "gone.toml: No such file"),
    ],
)
def test_wrong_arguments_are_refused_and_nothing_is_written(tmp_path, config, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    assert message in refusal("record", *arguments.split())
    assert list(tmp_path.iterdir()) == [config]


@pytest.mark.parametrize("kind", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_ends_it_with_everything_written(tmp_path, multicast, kind):
    out = tmp_path / "a.blf"
    process = subprocess.Popen(
        [*TACTILED, "record", "--interface", "udp_multicast", "--channel", multicast, str(out)],
        stdout=subprocess.PIPE,
        text=True,
        env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
    )
    assert "recording to" in process.stdout.readline()
    with can.Bus(interface="udp_multicast", channel=multicast) as bus:
        for number in range(COUNT):
            bus.send(can.Message(arbitration_id=0x500, is_extended_id=False, data=number.to_bytes(8, "big")))
        until(lambda: len(numbers(out)) == COUNT)
    process.send_signal(kind)
    output, _ = process.communicate(timeout=BUSY_S)
    assert process.returncode == 0
    assert f"a.blf: {COUNT} messages" in output
    assert numbers(out) == list(range(COUNT))
