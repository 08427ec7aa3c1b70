"""`tactiled record` on SocketCAN, beside candump, cangen and canplayer."""

import subprocess
import time

import can
import numpy as np
import pytest

from tactiled.bus.codecs.packed import Packed
from tactiled.bus.router import Router
from tests.cli.commands import TACTILED

CODEC = Packed(16, 12, array_id=2)
FRAMES = 50
ERROR_FRAME = "20000080#0000000000000000"  # as every candump log of python-can's has it, whatever its kind


def counts_of(sequence):
    return (np.arange(CODEC.size) * 37 + sequence).astype(np.uint16) % 4096


def send(bus):
    for sequence in range(FRAMES):
        for message in CODEC.encode(counts_of(sequence), sequence, 0.0):
            bus.send(message)
        time.sleep(0.002)


def logged(path):
    """The times of a log's frames, and all else of each."""
    with can.LogReader(path) as log:
        messages = list(log)
    kinds = [(each.is_extended_id, each.is_remote_frame, each.is_error_frame) for each in messages]
    data = [each.dlc if each.is_remote_frame else bytes(each.data) for each in messages]
    ids = [each.arbitration_id for each in messages]
    return [each.timestamp for each in messages], list(zip(ids, kinds, data, strict=True))


def test_a_recording_is_what_candump_logs_and_what_canplayer_plays(bus, run, until, tmp_path):
    recorded, log, played = tmp_path / "grasp.log", tmp_path / "candump.log", bus()
    recorder = run(*TACTILED, "record", recorded, "--interface", "socketcan", "--channel", "vcan0")
    assert "recording to" in recorder.stdout.readline()
    with log.open("w") as out:
        dump = run("candump", "-L", "vcan0,0:0,#FFFFFFFF", stdout=out)
        time.sleep(1.0)
        noise = run("cangen", "vcan0", "-e", "-I", "18FF0000", "-g", "2", "-n", "100")
        send(bus())
        assert noise.wait(60) == 0
        for frame in ("123#R", ERROR_FRAME):
            subprocess.run(["cansend", "vcan0", frame], check=True)
        count = FRAMES * CODEC.segments + 102
        until(lambda: recorded.read_text().count("\n") == count)
        dump.terminate()
        dump.wait(10)
    recorder.terminate()
    assert f"{count} messages" in recorder.communicate(timeout=60)[0]
    times, ours = logged(recorded)
    their_times, theirs = logged(log)
    assert len(ours) == count
    assert ours == theirs
    assert times == pytest.approx(their_times, abs=2e-6)  # the kernel's, in microseconds

    while played.receive(0.5) is not None:  # what was just sent
        pass
    assert run("canplayer", "-I", recorded).wait(60) == 0
    router, frames = Router({"palm": CODEC}), []
    while (message := played.receive(1.0)) is not None:
        frames += [frame for _, frame in router.push(message)]
    assert [frame.sequence for frame in frames] == list(range(FRAMES))
    for frame in frames:
        assert not frame.flags.any()
        np.testing.assert_array_equal(frame.counts, counts_of(frame.sequence))
