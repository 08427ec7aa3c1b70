import os
import subprocess
import time
from types import SimpleNamespace

import can
import pytest

from tactiled.bus import recorder, recording
from tactiled.config.example import EXAMPLE
from tests.cli.commands import TACTILED, refusal, run
from tests.conftest import BUSY_S, until

COUNT = 200


@pytest.fixture
def config(tmp_path):
    def write(interface, channel):
        path, bus = tmp_path / "a.toml", f'"{interface}"\nchannel = "{channel}"'
        path.write_text(EXAMPLE.replace('"socketcan"\nchannel = "can0"', bus))
        return path

    return write


def numbers(path):
    return [int.from_bytes(each.data, "big") for each in recording.read(path)]


def test_messages_that_could_not_be_decoded_are_counted(tmp_path, monkeypatch):
    bus = SimpleNamespace(label="it", unreadable=3, dropped=0, frame=time.sleep, close=lambda: None)
    monkeypatch.setattr("tactiled.cli.record.open_bus", lambda **_: bus)
    out = tmp_path / "a.log"
    done = run("record", "--interface", "virtual", "--seconds", 0.1, out)
    assert f"{out}: 0 messages, and 3 that could not be decoded" in done.output


@pytest.mark.parametrize(
    ("configured", "option", "bound"),
    [(None, None, 1000), (None, 601, 601), (700, None, 700), (500, 650, 650), (700, 0, None)],
)
def test_the_free_space_to_leave_is_checked_before_anything_is_written(
    tmp_path, config, monkeypatch, configured, option, bound
):
    monkeypatch.setattr(recorder, "disk_usage", lambda _: SimpleNamespace(free=600e6))
    out = tmp_path / "a.log"
    path = config("virtual", "x")
    path.write_text(path.read_text().replace("_leave_mb = 1000", f"_leave_mb = {configured}"))
    command = ["record", out, "--seconds", 0.1]
    command += ["--config", path] if configured else ["--interface", "virtual", "--channel", "x"]
    command += [] if option is None else ["--recordings-leave-mb", option]
    if bound is None:
        assert run(*command).exit_code == 0
    else:
        message = f"{out}: less than {bound} MB of its disk are free (recordings_leave_mb)"
        assert refusal(*command) == message
        assert not out.exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("a.log", "--interface is missing"),
        ("a.log --interface nope", "python-can has no interface of that name"),
        ("a.mf4 --interface virtual", "a.mf4: unsupported format; use"),
        ("gone/a.log --interface virtual", "gone/a.log: No such file or directory"),
        ("a.log --interface virtual --recordings-leave-mb inf", "recordings_leave_mb = inf: give 0"),
        ("a.log --interface virtual --bus can0", "--bus can0: give --config"),
        ("a.log --interface virtual --config a.toml", "--config: says how to open the bus: leave out --interface"),
        ("a.log --fd --config a.toml", "--config: says how to open the bus: leave out --interface"),
        ("a.log --config gone.toml", "gone.toml: No such file"),
        ("a.log --config a.toml --bus can7", "--bus can7: no such bus: choose one of can0, can1"),
        ("a.log --config a.toml", "--bus is missing: choose one of can0, can1"),
    ],
)
def test_wrong_arguments_are_refused_and_nothing_is_written(tmp_path, config, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    path = config("virtual", "x")
    path.write_text(path.read_text() + '[bus.can1]\ninterface = "virtual"\n')
    assert message in refusal("record", *arguments.split())
    assert list(tmp_path.iterdir()) == [path]


def test_an_interrupt_ends_it_with_everything_written(tmp_path, config, udp_port):
    out, bus = tmp_path / "a.blf", {"interface": "udp_multicast", "channel": "239.74.163.77"}
    path = config(*bus.values())
    path.write_text(path.read_text().replace('.77"', f'.77"\nport = {udp_port}'))
    command = [*TACTILED, "record", "--config", str(path), str(out)]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
    process = subprocess.Popen(command, env=os.environ | {"OPENBLAS_NUM_THREADS": "1"}, **pipes)

    def recorded():
        assert process.poll() is None, process.stdout.read()
        return len(list(recording.Recording(out)))  # of which the end may just be written

    assert "recording to" in process.stdout.readline()  # it handles signals from before this line on
    with can.Bus(**bus, port=udp_port) as sender:
        for number in range(COUNT):
            sender.send(can.Message(arbitration_id=0x500, is_extended_id=False, data=number.to_bytes(8, "big")))
            if number % 20 == 19:  # few at once: the kernel drops what a busy machine does not take in time
                until(lambda last=number: recorded() > last)
    process.terminate()
    output, _ = process.communicate(timeout=BUSY_S)
    assert process.returncode == 0
    assert f"a.blf: {COUNT} messages" in output
    assert numbers(out) == list(range(COUNT))
