"""`tactiled record` and `tactiled sniff` on SocketCAN, beside candump, cangen and canplayer."""

import re
import subprocess
import sys
import time
from threading import Event, Thread

import can
import numpy as np
import pytest

from tactiled.bus.codecs.packed import Packed
from tactiled.bus.router import Router

CODEC = Packed(16, 12, array_id=2)
ERROR_FRAME = "20000080#0000000000000000"  # as every candump log of python-can's has it, whatever its kind
TACTILED = (sys.executable, "-m", "tactiled")


def counts_of(sequence):
    return (np.arange(CODEC.size) * 37 + sequence).astype(np.uint16) % 4096


def send(bus, sequences, stop=None, pause_s=0.002):
    for sequence in sequences:
        for message in CODEC.encode(counts_of(sequence), sequence, 0.0):
            bus.send(message)
        time.sleep(pause_s)
        if stop is not None and stop.is_set():
            return


def logged(path):
    """Every frame of a log and its time."""
    with can.LogReader(path) as log:
        rows = [
            (
                each.timestamp,
                (each.arbitration_id, each.is_extended_id, each.is_remote_frame, each.is_error_frame),
                each.dlc if each.is_remote_frame else bytes(each.data),
            )
            for each in log
        ]
    return [row[0] for row in rows], [row[1:] for row in rows]


@pytest.fixture
def record(run):
    """Starts `tactiled record` on vcan0; it listens."""

    def started(path, *more):
        process = run(*TACTILED, "record", path, "--interface", "socketcan", "--channel", "vcan0", *more)
        line = process.stdout.readline()
        assert "recording to" in line, line + process.communicate()[0]
        return process

    return started


def test_what_is_recorded_is_what_candump_logs(bus, run, record, until, tmp_path):
    recorded, log = tmp_path / "grasp.log", tmp_path / "candump.log"
    recorder = record(recorded)
    with log.open("w") as out:
        dump = subprocess.Popen(["candump", "-L", "vcan0,0:0,#FFFFFFFF"], stdout=out)
        time.sleep(1.0)
        noise = run("cangen", "vcan0", "-e", "-I", "18FF0000", "-g", "2", "-n", "100")
        send(bus(), range(50))
        assert noise.wait(60) == 0
        subprocess.run(["cansend", "vcan0", "123#R"], check=True)
        subprocess.run(["cansend", "vcan0", ERROR_FRAME], check=True)
        until(lambda: recorded.read_text().count("\n") == 50 * CODEC.segments + 102)
        dump.terminate()
        dump.wait(10)
    recorder.terminate()
    assert "302 messages" in recorder.communicate(timeout=60)[0]
    times, ours = logged(recorded)
    their_times, theirs = logged(log)
    assert len(ours) == 50 * CODEC.segments + 102
    assert ours == theirs
    assert times == pytest.approx(their_times, abs=2e-6)  # the kernel's, in microseconds


def test_what_canplayer_plays_of_a_recording_are_the_frames_that_were_sent(bus, run, record, until, tmp_path):
    path = tmp_path / "grasp.log"
    recorder = record(path)
    send(bus(), range(20))
    until(lambda: path.read_text().count("\n") == 20 * CODEC.segments)
    recorder.terminate()
    recorder.communicate(timeout=60)
    reader = bus()
    assert run("canplayer", "-I", path).wait(60) == 0
    router, frames = Router({"it": CODEC}), []
    while (message := reader.receive(1.0)) is not None:
        frames += router.push(message)
    assert [frame.sequence for _, frame in frames] == list(range(20))
    for _, frame in frames:
        assert not frame.flags.any()
        np.testing.assert_array_equal(frame.counts, counts_of(frame.sequence))


def test_sniff_knows_a_skin_in_the_noise(bus, run, tmp_path):
    made = tmp_path / "skin.toml"
    run("cangen", "vcan0", "-I", "6A1", "-g", "5")
    stop = Event()
    sender = Thread(target=send, args=(bus(), [n % 256 for n in range(100_000)], stop, 0.02))
    sender.start()
    try:
        sniffing = run(*TACTILED, "sniff", "--channel", "vcan0", "--seconds", "5", "--write", made)
        said = sniffing.communicate(timeout=120)[0]
    finally:
        stop.set()
        sender.join()
    assert sniffing.returncode == 0, said
    assert re.search(r"packed layout, classic, array 2 at 0x500.* 4 messages a frame on id 0x502", said), said
    assert "lost" not in said
    assert re.search(r"unknown id 6a1: \d+ messages", said), said
    assert "array_id = 2" in made.read_text()
