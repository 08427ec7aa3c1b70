"""Recordings that would fill the memory, or that cannot be, are refused by name and not told as cut off."""

import gzip
import struct
import tracemalloc
import zlib

import can
import pytest
from can.io import blf

from tactiled.bus import logfile, recording
from tactiled.bus.logfile import MAX_BLOCK_BYTES, MAX_LINE
from tactiled.bus.recorder import Recorder
from tactiled.bus.replay import Recording
from tactiled.errors import ConfigError, TactileError

LINE = b"(1.000000) can0 500#0102 R\n"
BOMB = 1 << 28  # bytes


def refused(path, says):
    """A recording is refused with these words, not told as torn, and takes no memory to speak of."""
    kept = Recording(path)
    tracemalloc.start()
    try:
        with pytest.raises(ConfigError, match=says) as told:
            list(kept)
        assert tracemalloc.get_traced_memory()[1] < 8 * MAX_BLOCK_BYTES
    finally:
        tracemalloc.stop()
    assert "\n" not in str(told.value)
    assert str(path) in str(told.value)
    assert not kept.torn


def spread(file, byte):
    for _ in range(BOMB >> 20):
        file.write(byte * (1 << 20))


@pytest.mark.parametrize("ending", [".log", ".asc", ".csv", ".trc", ".log.gz", ".asc.gz"])
def test_a_line_that_does_not_end(tmp_path, ending):
    path = tmp_path / f"a{ending}"
    with gzip.open(path, "wb", 1) if ending.endswith(".gz") else path.open("wb") as file:
        file.write({".log": LINE, ".csv": b"timestamp\n"}.get(ending[:4], b""))
        spread(file, b"0")
    refused(path, f"a line is longer than {MAX_LINE} characters")


def container(objects, method=blf.ZLIB_DEFLATE):
    """A .blf file's container of so many bytes."""
    data = objects if method != blf.ZLIB_DEFLATE else zlib.compress(objects)
    size = blf.OBJ_HEADER_BASE_STRUCT.size + blf.LOG_CONTAINER_STRUCT.size + len(data)
    header = blf.OBJ_HEADER_BASE_STRUCT.pack(b"LOBJ", 16, 1, size, blf.LOG_CONTAINER)
    return header + blf.LOG_CONTAINER_STRUCT.pack(method, len(objects)) + data + bytes(size % 4)


@pytest.fixture
def blank(tmp_path):
    """A .blf file's own header."""
    path = tmp_path / "blank.blf"
    Recorder(path).close()
    return path.read_bytes()


def test_a_container_that_unpacks_to_more_than_a_bound(tmp_path, blank):
    path = tmp_path / "a.blf"
    path.write_bytes(blank + container(bytes(BOMB)))
    assert path.stat().st_size < 1 << 19
    refused(path, f"a container unpacks to more than {MAX_BLOCK_BYTES} bytes")


def test_an_object_that_goes_on_over_many_containers(tmp_path, blank):
    path = tmp_path / "a.blf"
    first = struct.pack("<4sHHII", b"LOBJ", 32, 1, 0xF0000000, 1) + bytes(MAX_BLOCK_BYTES - 100)
    path.write_bytes(blank + container(first) + container(bytes(MAX_BLOCK_BYTES - 100)) * 20)
    assert path.stat().st_size < 1 << 20
    refused(path, f"an object is longer than {MAX_BLOCK_BYTES} bytes")


def test_a_block_that_is_longer_than_a_bound(tmp_path, blank):
    path = tmp_path / "a.blf"
    path.write_bytes(blank + struct.pack("<4sHHII", b"LOBJ", 16, 1, 0xF0000000, 10))
    refused(path, rf"a block of \d+ bytes: 0 to {MAX_BLOCK_BYTES} can be read")


@pytest.mark.parametrize(
    ("objects", "says"),
    [
        (struct.pack("<4sHHII", b"LOBJ", 16, 1, 3, 10), r"a block of -13 bytes"),
        (struct.pack("<4sHHII", b"LOBJ", 16, 1, 20, 10) + bytes(100), "a container has 4 bytes"),
        (container(b"", 77) + bytes(100), "a container is packed by the unknown method 77"),
    ],
)
def test_a_blf_file_that_cannot_be(tmp_path, blank, objects, says):
    path = tmp_path / "a.blf"
    path.write_bytes(blank + objects)
    refused(path, says)


@pytest.mark.parametrize("method", [blf.ZLIB_DEFLATE, blf.NO_COMPRESSION])
def test_containers_of_python_cans_own_writer_are_read(tmp_path, method):
    path = tmp_path / "a.blf"
    messages = [can.Message(1.6e9 + n / 1000, 0x500, data=n.to_bytes(8, "big")) for n in range(20_000)]
    with can.BLFWriter(path, compression_level=-1 if method == blf.ZLIB_DEFLATE else 0) as file:
        for each in messages:
            file.on_message_received(each)
    assert path.stat().st_size > 100_000 or method == blf.ZLIB_DEFLATE
    assert [each.data for each in recording.read(path)] == [bytes(each.data) for each in messages]


@pytest.mark.parametrize("ending", [".log", ".blf", ".log.gz"])
def test_full_memory_is_no_end_that_was_cut_off(tmp_path, monkeypatch, ending):
    path = tmp_path / f"a{ending}"
    recorder = Recorder(path)
    for n in range(3):
        recorder.put(can.Message(1.6e9 + n, 0x500, data=b"1"))
    recorder.close()
    real = logfile.open_log

    class Full:
        def __enter__(self):
            self.log = real(path)
            return self

        def __exit__(self, *_):
            self.log.stop()

        def __iter__(self):
            yield next(iter(self.log))
            raise MemoryError

    monkeypatch.setattr(recording, "open_log", lambda _: Full())
    kept = Recording(path)
    with pytest.raises(TactileError, match="this machine's memory is full, after 1 messages"):
        list(kept)
    assert not kept.torn


def test_a_fault_within_a_file_whose_end_is_cut_off_is_still_a_fault(tmp_path):
    path = tmp_path / "a.log"
    path.write_bytes(LINE + b"nonsense\n" + LINE + LINE[:-5])
    kept = Recording(path)
    with pytest.raises(ConfigError, match="give a recording in a format"):
        list(kept)
    assert (kept.count, kept.torn) == (1, False)


@pytest.mark.parametrize("time", ["inf", "nan", "1e300", "-1", "1e10"])
@pytest.mark.parametrize("ending", [".log", ".log.gz"])
def test_a_time_that_cannot_be_is_refused_with_its_message_and_value(tmp_path, time, ending):
    path = tmp_path / f"a{ending}"
    text = LINE * 2 + LINE.replace(b"1.000000", time.encode()) + LINE
    path.write_bytes(gzip.compress(text) if ending.endswith(".gz") else text)
    value = f"{float(time):g}".replace("+", r"\+")
    refused(path, rf"message 3: time {value} s is none from 1970 to 2106")
