import errno
import os
import re
import socket
import time
from contextlib import closing
from threading import Event
from types import SimpleNamespace

import can
import pytest

from tactiled.bus.logfile import WRITERS, duration_s
from tactiled.bus.reader import open_bus
from tactiled.bus.recorder import ChunkFile, Recorder, record
from tactiled.bus.recording import Recording
from tactiled.errors import BusError, ConfigError, TactileError
from tests.conftest import BUSY_S, until

MESSAGES = [
    can.Message(1.6e9, 0x500, is_extended_id=False, data=b"\x01\x02\x03"),
    can.Message(1.6e9 + 0.25, 0x1ABCDEF0, data=b""),
    can.Message(1.6e9 + 0.5, 0x7FF, is_extended_id=False, is_fd=True, bitrate_switch=True, data=bytes(range(64))),
    can.Message(1.6e9 + 0.75, 0x100, is_extended_id=False, is_remote_frame=True),
    can.Message(1.6e9 + 1.0, is_error_frame=True),
    can.Message(1.6e9 + 1.25, 0x123, is_extended_id=False, is_fd=True, data=bytes(12)),
]


def contents(messages):
    """What every format must give back of messages, their times aside."""
    return [
        each.is_error_frame
        or (each.arbitration_id, each.is_extended_id, each.is_fd, each.is_remote_frame, bytes(each.data))
        for each in messages
    ]


every_format = pytest.mark.parametrize("ending", WRITERS)


def read(path):
    with can.LogReader(path) as log:
        return list(log)


def numbered(number):
    return can.Message(1.6e9 + number / 1000, 0x500, is_extended_id=False, data=number.to_bytes(8, "big"))


def numbers(path):
    """The numbers in a recording, of a compressed one up to the end that it lacks."""
    messages = Recording(path)
    counts = [int.from_bytes(each.data, "big") for each in messages]
    assert not messages.torn or path.name.endswith(".gz")
    return counts


@pytest.mark.parametrize("at", [40, 56])  # of the years in which it begins and ends
def test_a_recording_without_a_date_has_no_duration(tmp_path, at):
    path = tmp_path / "a.blf"
    with closing(Recorder(path)) as recorder:
        recorder.put(MESSAGES[0])
        recorder.put(MESSAGES[-1])
    head = bytearray(path.read_bytes())
    head[at + 2] = 13  # the month
    path.write_bytes(head)
    assert duration_s(path) is None


@pytest.mark.parametrize("ending", [*WRITERS, ".LOG", ".BLF"])
@pytest.mark.parametrize("channel", [None, "can1", 2, "my own bus 300", ""])
def test_every_format_gives_back_the_traffic_of_the_bus(tmp_path, ending, channel):
    path, empty = tmp_path / f"a{ending}", tmp_path / f"empty{ending}"
    Recorder(empty).close()
    assert (read(empty), duration_s(empty)) == ([], None)
    recorder = Recorder(path)
    for each in MESSAGES:
        each.channel = channel
        recorder.put(each)
    assert duration_s(path) is None
    recorder.close()
    assert duration_s(path) == (None if path.suffix == ".gz" else pytest.approx(1.25, abs=1e-3))
    assert recorder.written == len(MESSAGES)
    messages = read(path)
    assert contents(messages) == contents(MESSAGES)
    start = 0.0 if ".asc" in ending else 1.6e9  # .asc counts from its first message
    assert [each.timestamp for each in messages] == pytest.approx(
        [start + each.timestamp - 1.6e9 for each in MESSAGES], rel=0, abs=1e-3
    )


@every_format
def test_a_clock_that_is_set_back_behind_the_first_message_destroys_no_times(tmp_path, ending):
    path, times = tmp_path / f"a{ending}", [1.6e9, 1.6e9 + 1, 1.6e9 - 5, 1.6e9 - 4]
    recorder = Recorder(path)
    for each in times:
        recorder.put(can.Message(each, 0x500, is_extended_id=False))
    if ".log" not in ending:
        with pytest.raises(
            TactileError, match=r"set back to 5 s before the first .* ends early, after 2 messages"
        ):
            recorder.close()
        times = times[:2]
    else:
        recorder.close()
    start = 1.6e9 if ".asc" in ending else 0.0
    assert [each.timestamp for each in read(path)] == pytest.approx([each - start for each in times], abs=1e-3)


@every_format
def test_messages_are_on_the_disk_before_the_end_also_if_the_file_is_renamed(tmp_path, ending):
    """A copy of the file meanwhile is what a crash would leave."""
    path, renamed, copy = (tmp_path / f"{name}{ending}" for name in ("a", "renamed", "copy"))
    recorder = Recorder(path)
    for number in range(5):
        recorder.put(numbered(number))
    until(lambda: recorder.written == 5)
    copy.write_bytes(path.read_bytes())
    assert numbers(copy) == list(range(5))
    path.rename(renamed)
    recorder.put(numbered(5))
    recorder.close()
    assert numbers(renamed) == list(range(6))


def fill(recorder):
    """Put messages, a chunk at a time, until the recorder refuses one."""
    for number in range(20_000):
        recorder.put(numbered(number))
        if number % 50 == 49:
            time.sleep(0.03)


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        *((name, r"unsupported format; use one of \.log, \.asc") for name in ("a.mf4", "a.blf.gz", "log")),
        ("here.log", "is there already"),
        ("gone/a.log", "No such file or directory"),
        ("at.7.30.log.gz", r"leave out dots before \.log\.gz"),
    ],
)  # fmt: skip
def test_a_name_that_cannot_be_recorded_to_is_refused(tmp_path, name, reason):
    (tmp_path / "here.log").write_text("mine")
    with pytest.raises(ConfigError, match=reason):
        Recorder(tmp_path / name)
    assert [(each.name, each.read_text()) for each in tmp_path.iterdir()] == [("here.log", "mine")]
    ChunkFile.__new__(ChunkFile).close()  # as its finalizer does, whose errors Python 3.13 and later print


class FullDisk:
    """A disk that takes so many bytes and no more."""

    def __init__(self, capacity):
        self.capacity, self.real = capacity, os.pwrite

    def __call__(self, fd, data, at):
        fits = bytes(data)[: max(0, self.capacity - at)]
        if not fits:
            raise OSError(errno.ENOSPC, "No space left on device")
        return self.real(fd, fits, at)


@every_format
def test_a_full_disk_ends_the_recording_with_an_error_and_leaves_a_readable_file(tmp_path, monkeypatch, ending):
    path = tmp_path / f"a{ending}"
    monkeypatch.setattr(os, "pwrite", FullDisk(8_000 if ending.endswith(".gz") else 60_000))
    recorder = Recorder(path)
    with pytest.raises(TactileError, match="No space left on device: the recording ends early"):
        fill(recorder)
    with pytest.raises(TactileError, match=f"early, after {recorder.written} messages"):
        recorder.close()
    assert numbers(path) == list(range(recorder.written))
    assert recorder.written > 50


def test_a_disk_that_is_full_before_the_header_leaves_no_message(tmp_path, monkeypatch):
    monkeypatch.setattr(os, "pwrite", FullDisk(0))
    with pytest.raises(TactileError, match=r"No space left on device: .* early, after 0 messages"):
        Recorder(tmp_path / "a.asc").close()


def test_a_chunk_is_in_the_file_as_a_whole_or_not_at_all(tmp_path, monkeypatch):
    file = ChunkFile(tmp_path / "a")
    file.write(b"first")
    file.flush()
    monkeypatch.setattr(os, "pwrite", FullDisk(8))
    file.write(b"second")
    with pytest.raises(OSError, match="No space"):
        file.flush()
    file.write(b"third")
    file.close()
    assert (tmp_path / "a").read_bytes() == b"first"


CHANGED = r"was changed by another program: it has \d+ bytes"
CHANGES = {
    "truncated": (lambda path: os.truncate(path, 10), CHANGED),
    "lengthened": (lambda path: path.open("ab").write(b"mine"), CHANGED),
    "replaced": (
        lambda path: (path.rename(path.with_name("old")), path.write_text("no recording")),
        "was replaced by another file",
    ),
    "removed": (lambda path: path.unlink(), "was removed"),
    "removed and made again": (lambda path: (path.unlink(), path.touch()), "was (removed|replaced)"),
}  # fmt: skip


@pytest.mark.filterwarnings("ignore::ResourceWarning")
@pytest.mark.parametrize(
    ("change", "ending"),
    [*((change, ".log") for change in CHANGES), ("truncated", ".blf"), ("removed", ".log.gz")],
)
def test_a_file_that_another_program_changes_ends_the_recording_with_an_error(tmp_path, ending, change):
    path, (act, reason) = tmp_path / f"a{ending}", CHANGES[change]
    recorder = Recorder(path)
    recorder.put(numbered(1))
    until(lambda: recorder.written == 1)
    act(path)
    with pytest.raises(TactileError, match=rf"a{ending}: {reason}.*: the recording ends early"):
        fill(recorder)
    after = path.read_bytes() if path.exists() else None
    with pytest.raises(TactileError, match=rf"{reason}.*: the recording ends early, after 1 messages"):
        recorder.close()
    assert after == (path.read_bytes() if path.exists() else None)  # nothing more is written into it


@pytest.mark.filterwarnings("ignore::ResourceWarning")
@pytest.mark.parametrize("change", ["truncated", "replaced"])
def test_a_change_at_the_very_end_is_an_error_too(tmp_path, monkeypatch, change):
    path, real = tmp_path / "a.log", ChunkFile.check
    recorder = Recorder(path)
    recorder.put(numbered(1))

    def check(self):
        if self.closed and not hasattr(self, "changed"):
            self.changed = CHANGES[change][0](path) or True
        real(self)

    monkeypatch.setattr(ChunkFile, "check", check)
    with pytest.raises(TactileError, match=CHANGES[change][1]):
        recorder.close()


def test_a_disk_that_is_too_slow_ends_the_recording_with_all_that_was_taken(tmp_path, monkeypatch):
    synced = []
    monkeypatch.setattr(os, "fsync", lambda fd: (synced.append(fd), time.sleep(1.0)))
    recorder, put = Recorder(tmp_path / "a.log", max_waiting=100), []

    def flood():
        for number in range(100_000):
            recorder.put(numbered(number))
            put.append(number)

    with pytest.raises(TactileError, match=r"the disk is too slow: 100 messages wait for it: "):
        flood()
    with pytest.raises(TactileError, match=f"early, after {len(put)} messages"):
        recorder.close()
    assert numbers(tmp_path / "a.log") == put
    assert synced


def test_a_bus_is_recorded_with_all_that_is_on_it_until_it_goes_away(tmp_path):
    rest = [None, *MESSAGES]

    def frame(_):
        if not rest:
            raise BusError("bus can0: the interface is down")
        return rest.pop(0)

    why = f"the interface is down: the recording ends early, after {len(MESSAGES)} messages"
    with pytest.raises(BusError, match=why):
        record(SimpleNamespace(frame=frame, dropped=0), Recorder(tmp_path / "a.log"), Event())
    assert contents(read(tmp_path / "a.log")) == contents(MESSAGES)


@pytest.mark.parametrize("buffer_bytes", [None, 4096])
def test_a_late_reader_loses_nothing_or_the_recording_ends_with_an_error(tmp_path, udp_port, buffer_bytes):
    """What the kernel's buffer holds is recorded; what it dropped is never left out in silence."""
    bus, path = {"interface": "udp_multicast", "channel": "239.74.163.77", "port": udp_port}, tmp_path / "a.log"
    reader = open_bus(**bus)
    if buffer_bytes:
        reader._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, buffer_bytes)
    with can.Bus(**bus) as sender:
        for number in range(2000):
            sender.send(numbered(number))
    if buffer_bytes:
        dropped = r"the kernel dropped \d+ messages: .* the recording ends early, after (\d+) messages"
        with pytest.raises(BusError, match=dropped) as caught:
            record(reader, Recorder(path), Event(), BUSY_S)
        count = int(re.search(dropped, str(caught.value))[1])
    else:
        count = record(reader, Recorder(path), Event(), 1.0)
        assert count == 2000
    reader.close()
    assert numbers(path) == list(range(count))
