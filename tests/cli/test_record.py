import os
import re
import signal
import subprocess
import sys
import threading
import time
from types import SimpleNamespace

import can
import pytest
from can.interfaces import virtual
from typer.testing import CliRunner

from tactiled.bus import recorder, recording
from tactiled.bus.reader import open_bus
from tactiled.cli import app as door
from tactiled.config.example import EXAMPLE
from tactiled.errors import BusError, ConfigError, TactileError
from tactiled.frames import Message
from tests.conftest import BUSY_S, until


def run(*arguments):
    return CliRunner().invoke(door.app, ["record", *map(str, arguments)])


def sending(channel, count=200):
    """A sender on a thread, which waits for the recorder to open its end."""

    def go():
        end = time.monotonic() + 30
        while not virtual.channels.get(channel) and time.monotonic() < end:
            time.sleep(0.005)
        bus = open_bus("virtual", channel=channel)
        for number in range(count):
            bus.send(Message(0.0, 0x500, number.to_bytes(8, "big")))
        bus.close()

    thread = threading.Thread(target=go)
    thread.start()
    return thread


def numbers(path):
    return [int.from_bytes(each.data, "big") for each in recording.read(path)]


@pytest.mark.parametrize("ending", [".log", ".asc", ".blf", ".log.gz"])
def test_a_virtual_bus_into_every_kind_of_file(tmp_path, request, ending):
    out = tmp_path / f"a{ending}"
    thread = sending(request.node.name)
    done = run("--interface", "virtual", "--channel", request.node.name, "--seconds", 2, out)
    thread.join()
    assert done.exit_code == 0, done.output
    assert f"{out}: 200 messages" in done.output
    assert numbers(out) == list(range(200))


def test_the_bus_of_a_configuration(tmp_path, request):
    path, out = tmp_path / "a.toml", tmp_path / "a.log"
    bus = f'[bus.can0]\ninterface = "virtual"\nchannel = "{request.node.name}"'
    path.write_text(EXAMPLE.replace('[bus.can0]\ninterface = "socketcan"\nchannel = "can0"', bus))
    thread = sending(request.node.name)
    done = run("--config", path, "--seconds", 2, out)
    thread.join()
    assert done.exit_code == 0, done.output
    assert len(numbers(out)) == 200
    told = run("--config", path, "--bus", "can7", tmp_path / "b.log").exception
    assert str(told) == "--bus can7: no such bus: choose one of can0"
    path.write_text(path.read_text() + bus.replace("can0", "can1"))
    assert str(run("--config", path, out).exception) == "--bus is missing: choose one of can0, can1"


@pytest.mark.parametrize(
    ("configured", "given", "leaves"), [(None, None, 1000), (None, 601, 601), (700, None, 700), (500, 650, 650)]
)
def test_too_little_room_is_named_before_anything_is_written(
    tmp_path, request, monkeypatch, configured, given, leaves
):
    monkeypatch.setattr(recorder, "disk_usage", lambda _: SimpleNamespace(free=600e6))
    path, out = tmp_path / "a.toml", tmp_path / "a.log"
    text = EXAMPLE.replace('"socketcan"\nchannel = "can0"', f'"virtual"\nchannel = "{request.node.name}"')
    path.write_text(text.replace("recordings_leave_mb = 1000", f"recordings_leave_mb = {configured}"))
    of = ["--config", path] if configured else ["--interface", "virtual", "--channel", request.node.name]
    bound = [] if given is None else ["--recordings-leave-mb", given]
    told = run(*of, *bound, "--seconds", 1, out).exception
    assert type(told) is TactileError
    assert str(told) == f"{out}: less than {leaves} MB of its disk are free (recordings_leave_mb)"
    assert not out.exists()


@pytest.mark.parametrize(
    ("leaves", "says"),
    [
        (0, "200 messages"),
        (599, "less than 599 MB of its disk are free (recordings_leave_mb): the recording ends early, after 200"),
    ],
)
def test_it_ends_before_the_disk_is_full(tmp_path, request, monkeypatch, leaves, says):
    out = tmp_path / "a.log"

    def usage(_):
        return SimpleNamespace(free=598e6 if out.exists() and len(numbers(out)) == 200 else 600e6)

    monkeypatch.setattr(recorder, "disk_usage", usage)
    thread = sending(request.node.name)
    arguments = ["--interface", "virtual", "--channel", request.node.name, "--recordings-leave-mb", leaves]
    done = run(*arguments, "--seconds", 2, out)
    thread.join()
    assert f"{out}: {says}" in done.output + str(done.exception)
    assert numbers(out) == list(range(200))


@pytest.mark.parametrize(
    ("arguments", "error", "says"),
    [
        ("a.log", ConfigError, "--interface is missing"),
        ("a.log --interface nope", BusError, "python-can has no interface of that name"),
        ("a.mf4 --interface virtual", ConfigError, "a.mf4: unsupported format; use"),
        ("gone/a.log --interface virtual", ConfigError, "gone/a.log: No such file or directory"),
        ("a.log --interface virtual --recordings-leave-mb inf", ConfigError, "recordings_leave_mb = inf: give 0"),
        ("a.log --interface virtual --bus can0", ConfigError, "--bus can0: names a bus of a --config"),
        ("a.log --interface virtual --config c.toml", ConfigError, "c.toml: No such file"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(tmp_path, monkeypatch, arguments, error, says):
    monkeypatch.chdir(tmp_path)
    done = run(*arguments.split())
    told = done.exception
    assert isinstance(told, error)
    assert says in str(told)
    assert "recording to" not in done.output
    assert "\n" not in str(told)
    assert list(tmp_path.iterdir()) == []


def started(out, channel, **more):
    """`tactiled record` of a bus between processes, once it records."""
    command = [sys.executable, "-m", "tactiled", "record", "--interface", "udp_multicast", "--channel", channel]
    process = subprocess.Popen(
        [*command, str(out)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"OPENBLAS_NUM_THREADS": "1", "PYTHONUNBUFFERED": "1"},
        **more,
    )
    assert "recording to" in process.stdout.readline()
    return process


@pytest.fixture
def send(multicast):
    with can.Bus(interface="udp_multicast", channel=multicast) as bus:
        yield lambda number: bus.send(
            can.Message(arbitration_id=0x500, is_extended_id=False, data=number.to_bytes(8, "big"))
        )


def test_a_file_that_another_program_empties_meanwhile_is_no_success(tmp_path, multicast, send):
    out = tmp_path / "a.log"
    process = started(out, multicast)
    for number in range(50):
        send(number)
    until(lambda: out.stat().st_size > 1000)
    out.write_bytes(b"")
    _, says = process.communicate(timeout=BUSY_S)
    assert process.returncode == 2
    assert re.search(r"a\.log: was changed by another program: it has 0 bytes, \d+ were written", says)


def test_kill_9_leaves_all_but_the_last_second(tmp_path, multicast, send):
    out = tmp_path / "a.log"
    process = started(out, multicast)
    sent, began = [], time.monotonic()
    while time.monotonic() - began < 2.0 or sum(each < time.monotonic() - 1.0 for each in sent) <= 300:
        send(len(sent))
        sent.append(time.monotonic())
        time.sleep(0.001)
    process.kill()
    process.communicate()
    killed = time.monotonic()
    got = numbers(out)
    assert got == list(range(len(got)))
    assert len(got) >= sum(each < killed - 1.0 for each in sent) > 300


@pytest.mark.parametrize("kind", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_ends_it_with_everything_written(tmp_path, multicast, send, kind):
    out = tmp_path / "a.blf"
    process = started(out, multicast)
    for number in range(300):
        send(number)
    until(lambda: len(numbers(out)) == 300)
    process.send_signal(kind)
    said, _ = process.communicate(timeout=BUSY_S)
    assert process.returncode == 0
    assert re.search(r"a\.blf: 300 messages", said)
    assert numbers(out) == list(range(300))


def test_a_full_disk_is_one_line_and_exit_code_2(tmp_path, multicast, send):
    out = tmp_path / "a.log"

    def limit():
        import resource

        resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))

    process = started(out, multicast, preexec_fn=limit)
    number = 0
    while process.poll() is None and number < 100_000:
        send(number)
        number += 1
        time.sleep(0.002)
    _, says = process.communicate(timeout=BUSY_S)
    assert process.returncode == 2
    assert len(says.strip().splitlines()) == 1
    assert "File too large: the recording ends early, after" in says
    got = numbers(out)
    assert got == list(range(len(got)))
    assert f"after {len(got)} messages" in says
    assert len(got) > 100
