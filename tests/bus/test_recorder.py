import errno
import os
import re
import resource
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path
from threading import Event

import can
import pytest

from tactiled.bus import recording
from tactiled.bus.recorder import WRITERS, ChunkFile, Recorder, open_tap, record
from tactiled.errors import BusError, ConfigError, TactileError
from tests.conftest import until

MESSAGES = [
    can.Message(1.6e9, 0x500, is_extended_id=False, data=b"\x01\x02\x03"),
    can.Message(1.6e9 + 0.25, 0x1ABCDEF0, data=b""),
    can.Message(1.6e9 + 0.5, 0x7FF, is_extended_id=False, is_fd=True, bitrate_switch=True, data=bytes(range(64))),
    can.Message(1.6e9 + 0.75, 0x100, is_extended_id=False, is_remote_frame=True),
    can.Message(1.6e9 + 1.0, is_error_frame=True),
    can.Message(1.6e9 + 1.25, 0x123, is_extended_id=False, is_fd=True, data=bytes(12)),
]


def told(messages):
    """What every format must give back of a message."""
    first = messages[0].timestamp  # an .asc file counts from its first message
    return [
        (round(each.timestamp - first, 3), each.is_error_frame)
        if each.is_error_frame
        else (
            round(each.timestamp - first, 3),
            each.arbitration_id,
            each.is_extended_id,
            each.is_fd,
            each.is_remote_frame,
            bytes(each.data),
        )
        for each in messages
    ]


def read(path):
    with can.LogReader(path) as log:
        return list(log)


def plain(number):
    return can.Message(1.6e9 + number / 1000, 0x500, is_extended_id=False, data=number.to_bytes(8, "big"))


def numbers(path):
    return [int.from_bytes(each.data, "big") for each in recording.read(path)]


def endless(path):
    """The numbers of a compressed file that lacks its end mark."""
    got, messages = [], recording.read(path)
    with pytest.raises(ConfigError, match="end-of-stream"):
        got.extend(int.from_bytes(each.data, "big") for each in messages)
    return got


def flood(recorder, sent):
    for number in range(3000):
        recorder.put(plain(number))
        sent.append(number)
        time.sleep(0.001)


@pytest.mark.parametrize("ending", WRITERS)
@pytest.mark.parametrize("channel", [None, "can1", 2, "my own bus 300", "/dev/ttyUSB0", ""])
def test_every_format_gives_back_what_was_on_the_bus(tmp_path, ending, channel):
    path = tmp_path / f"a{ending}"
    recorder = Recorder(path)
    for each in MESSAGES:
        each.channel = channel
        recorder.put(each)
    recorder.close()
    assert recorder.written == len(MESSAGES)
    assert told(read(path)) == told(MESSAGES)
    assert read(path)[0].timestamp == (0.0 if ".asc" in ending else 1.6e9)


@pytest.mark.parametrize("ending", WRITERS)
def test_a_recording_of_nothing_can_be_read(tmp_path, ending):
    path = tmp_path / f"a{ending}"
    Recorder(path).close()
    assert read(path) == []


def test_another_ending_or_a_file_that_is_there_is_refused_and_left_alone(tmp_path):
    for name in ("a.mf4", "a.csv", "a.blf.gz", "a", "log"):
        with pytest.raises(ConfigError, match=r"unsupported format; use one of \.log, \.asc, \.blf"):
            Recorder(tmp_path / name)
    assert list(tmp_path.iterdir()) == []
    there = tmp_path / "a.log"
    there.write_text("mine")
    with pytest.raises(ConfigError, match="is there already"):
        Recorder(there)
    assert there.read_text() == "mine"
    with pytest.raises(ConfigError, match="No such file or directory"):
        Recorder(tmp_path / "gone" / "a.log")


def test_a_name_that_python_can_would_not_read_again_is_refused(tmp_path):
    with pytest.raises(ConfigError, match=r"leave out dots before \.log\.gz"):
        Recorder(tmp_path / "at.7.30.log.gz")
    Recorder(tmp_path / "at.7.30.log").close()
    assert read(tmp_path / "at.7.30.log") == []


def test_an_upper_case_ending_is_known(tmp_path):
    recorder = Recorder(tmp_path / "A.LOG")
    recorder.put(plain(7))
    recorder.close()
    assert numbers(tmp_path / "A.LOG") == [7]


@pytest.mark.parametrize("ending", WRITERS)
def test_what_has_come_is_on_the_disk_within_a_second(tmp_path, ending):
    path = tmp_path / f"a{ending}"
    recorder = Recorder(path)
    for number in range(5):
        recorder.put(plain(number))
    time.sleep(1.0)
    assert recorder.written == 5
    seen = path.read_bytes()
    copy = tmp_path / f"copy{ending}"
    copy.write_bytes(seen)
    if ending.endswith(".gz"):
        assert endless(copy) == list(range(5))
    else:
        assert numbers(copy) == list(range(5))
    recorder.close()


class Full:
    """A disk that takes so many bytes and no more."""

    def __init__(self, room):
        self.room, self.real = room, os.pwrite

    def __call__(self, fd, data, at):
        fits = bytes(data)[: max(0, self.room - at)]
        if not fits:
            raise OSError(errno.ENOSPC, "No space left on device")
        return self.real(fd, fits, at)


def fill(recorder, most=20_000):
    """Put messages, a chunk at a time, until the recorder refuses one."""
    for number in range(most):
        recorder.put(plain(number))
        if number % 50 == 49:
            time.sleep(0.03)


@pytest.mark.parametrize("ending", WRITERS)
def test_a_full_disk_ends_it_loudly_and_leaves_a_file_that_can_be_read(tmp_path, monkeypatch, ending):
    path = tmp_path / f"a{ending}"
    monkeypatch.setattr(os, "pwrite", Full(8_000 if ending.endswith(".gz") else 60_000))
    recorder = Recorder(path)
    with pytest.raises(TactileError, match="No space left on device: the recording ends early"):
        fill(recorder)
    with pytest.raises(TactileError, match=f"early, after {recorder.written} messages"):
        recorder.close()
    got = endless(path) if ending.endswith(".gz") else numbers(path)
    assert got == list(range(recorder.written))
    assert recorder.written > 50


def test_a_disk_full_from_the_start_leaves_an_empty_file(tmp_path, monkeypatch):
    monkeypatch.setattr(os, "pwrite", Full(0))
    recorder = Recorder(tmp_path / "a.log")
    recorder.put(plain(1))
    with pytest.raises(TactileError, match="after 0 messages"):
        recorder.close()
    assert (tmp_path / "a.log").read_bytes() == b""


@pytest.mark.parametrize("another", [False, True])
def test_a_file_that_is_removed_meanwhile_ends_it_loudly(tmp_path, another):
    recorder = Recorder(tmp_path / "a.log")
    (tmp_path / "a.log").unlink()
    if another:
        (tmp_path / "a.log").touch()
    with pytest.raises(TactileError, match=r"a\.log: was removed: the recording ends early"):
        fill(recorder)
    with pytest.raises(TactileError, match="was removed"):
        recorder.close()


def truncate(path):
    os.truncate(path, 10)


def empty(path):
    path.write_bytes(b"")


def lengthen(path):
    with path.open("ab") as file:
        file.write(b"mine")


def overwrite(path):
    path.write_text("another's text, which is no recording")


def replace(path):
    path.rename(path.with_name("old"))
    path.write_text("another's text, which is no recording")


@pytest.mark.parametrize("ending", WRITERS)
@pytest.mark.parametrize("act", [truncate, empty, lengthen, overwrite, replace])
def test_a_file_that_another_program_changes_ends_it_loudly(tmp_path, ending, act):
    path = tmp_path / f"a{ending}"
    recorder = Recorder(path)
    recorder.put(plain(1))
    until(lambda: recorder.written == 1)
    act(path)
    with pytest.raises(TactileError) as told:
        fill(recorder)
    says = (
        r"was replaced by another file" if act is replace else r"was changed by another program: it has \d+ bytes"
    )
    assert re.search(rf"a{ending}: {says}.*: the recording ends early", str(told.value))
    left = path.read_bytes()
    with pytest.raises(TactileError, match=rf"{says}.*: the recording ends early, after 1 messages"):
        recorder.close()
    assert path.read_bytes() == left  # nothing more is written into it


@pytest.mark.parametrize("ending", WRITERS)
@pytest.mark.parametrize("act", [truncate, empty, lengthen, overwrite, replace])
def test_so_does_one_that_is_changed_at_the_very_end(tmp_path, monkeypatch, ending, act):
    path, real = tmp_path / f"a{ending}", ChunkFile.check
    recorder = Recorder(path)
    recorder.put(plain(1))

    def check(self):
        if self.closed and not hasattr(self, "acted"):
            self.acted = act(path)
        real(self)

    monkeypatch.setattr(ChunkFile, "check", check)
    with pytest.raises(TactileError, match=r"was replaced|was changed by another program"):
        recorder.close()


def test_a_recording_that_is_renamed_goes_on(tmp_path):
    recorder = Recorder(tmp_path / "a.log")
    recorder.put(plain(1))
    until(lambda: recorder.written == 1)
    (tmp_path / "a.log").rename(tmp_path / "b.log")
    recorder.put(plain(2))
    recorder.close()
    assert numbers(tmp_path / "b.log") == [1, 2]


def test_a_disk_that_cannot_keep_up_ends_it_loudly_with_all_that_it_took(tmp_path, monkeypatch):
    monkeypatch.setattr(os, "fsync", lambda _: time.sleep(1.0))
    recorder, sent = Recorder(tmp_path / "a.log", waiting=100), []
    with pytest.raises(TactileError, match=r"the disk is too slow: 100 messages wait for it: "):
        flood(recorder, sent)
    with pytest.raises(TactileError, match=f"early, after {len(sent)} messages"):
        recorder.close()
    assert numbers(tmp_path / "a.log") == sent


def test_a_chunk_is_in_the_file_whole_or_not_at_all(tmp_path, monkeypatch):
    file = ChunkFile(tmp_path / "a")
    file.write(b"first")
    file.flush()
    monkeypatch.setattr(os, "pwrite", Full(8))
    file.write(b"second")
    with pytest.raises(OSError, match="No space"):
        file.flush()
    file.write(b"third")
    file.close()
    assert (tmp_path / "a").read_bytes() == b"first"


def test_a_bus_is_recorded_with_all_that_is_on_it(tmp_path, request):
    tap = open_tap("virtual", channel=request.node.name)
    with can.Bus(interface="virtual", channel=request.node.name) as sender:
        for each in MESSAGES:
            sender.send(each)
        assert record(tap, Recorder(tmp_path / "a.log"), Event(), 0.3) == len(MESSAGES)
    tap.close()
    assert [each[1:] for each in told(read(tmp_path / "a.log"))] == [each[1:] for each in told(MESSAGES)]


def test_a_bus_that_goes_away_is_told_with_what_was_recorded(tmp_path):
    class Gone:
        left = MESSAGES[:3]

        def check(self):
            return None

        def receive(self, _):
            if not self.left:
                raise BusError("bus can0: the interface is down")
            return self.left.pop(0)

    with pytest.raises(BusError, match="the interface is down: the recording ends early, after 3 messages"):
        record(Gone(), Recorder(tmp_path / "a.log"), Event())
    assert len(read(tmp_path / "a.log")) == 3


def test_what_the_kernel_drops_ends_it_loudly(tmp_path, multicast):
    tap = open_tap("udp_multicast", channel=multicast)
    if tap._reader.dropped != 0 or tap._reader._socket is None:
        pytest.fail("a socket's drops cannot be seen here")
    tap._reader._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    with can.Bus(interface="udp_multicast", channel=multicast) as sender:
        for number in range(500):
            sender.send(plain(number))
    recorder = Recorder(tmp_path / "a.log")
    with pytest.raises(
        BusError, match=r"the kernel dropped \d+ messages: .* the recording ends early, after"
    ) as told:
        record(tap, recorder, Event(), 1.0)
    tap.close()
    got = numbers(tmp_path / "a.log")
    assert got == list(range(len(got)))
    assert f"after {len(got)} messages" in str(told.value)


def test_a_late_reader_loses_nothing_that_its_buffer_holds(tmp_path, multicast):
    tap = open_tap("udp_multicast", channel=multicast)
    with can.Bus(interface="udp_multicast", channel=multicast) as sender:
        for number in range(2000):
            sender.send(plain(number))
    assert record(tap, Recorder(tmp_path / "a.log"), Event(), 1.0) == 2000
    tap.close()


FEED = """
import sys, time
from pathlib import Path
from tactiled.bus.recorder import Recorder
import can
recorder = Recorder(Path(sys.argv[1]))
began, number = time.monotonic(), 0
while True:
    time.sleep(0.002)
    while number < (time.monotonic() - began) * 8000:
        data = number.to_bytes(8, "big")
        recorder.put(can.Message(1.6e9 + number / 1000, 0x500, is_extended_id=False, data=data))
        number += 1
    print(number, flush=True)
"""


def child(path, **more):
    return subprocess.Popen(
        [sys.executable, "-c", FEED, str(path)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
        **more,
    )


@pytest.mark.parametrize("ending", WRITERS)
def test_kill_9_leaves_a_file_that_lacks_at_most_the_last_second(tmp_path, ending):
    path = tmp_path / f"a{ending}"
    process = child(path)
    put = []
    began = None
    for line in process.stdout:
        put.append((time.monotonic(), int(line)))
        began = began or put[0][0]
        if put[-1][0] - began > 2.3:
            process.kill()
            break
    process.stdout.close()
    process.stderr.close()
    assert process.wait() == -signal.SIGKILL
    killed = put[-1][0]
    got = endless(path) if ending.endswith(".gz") else numbers(path)
    assert got == list(range(len(got)))
    assert len(got) >= max(number for when, number in put if when < killed - 1.0)
    assert len(got) > 5000


def test_the_systems_own_limit_on_a_file_ends_it_loudly(tmp_path):
    def limit():
        resource.setrlimit(resource.RLIMIT_FSIZE, (400_000, 400_000))

    path = tmp_path / "a.log"
    process = child(path, preexec_fn=limit)
    _, says = process.communicate(timeout=60)
    assert process.returncode == 1
    assert "TactileError" in says
    assert "File too large: the recording ends early" in says
    assert Path(path).read_bytes().endswith(b"\n")
    assert numbers(path) == list(range(len(numbers(path))))
    assert 0 < path.stat().st_size <= 400_000
