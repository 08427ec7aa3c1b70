"""Recordings of the package, how fast they are played, and files that are faulty or would fill the memory."""

import gzip
import struct
import tracemalloc
import zlib
from contextlib import nullcontext
from dataclasses import replace
from itertools import repeat
from threading import Event

import can
import numpy as np
import pytest
from can.io import blf

from tactiled.build import sensor_plan
from tactiled.bus import recording
from tactiled.bus.assembler import assemble
from tactiled.bus.canbus import can_message
from tactiled.bus.codecs.packed import Packed
from tactiled.bus.logfile import MAX_BLOCK_BYTES, MAX_LINE_CHARACTERS
from tactiled.bus.recorder import Recorder
from tactiled.bus.recording import FD_LOST, MAX_BACK_S, MAX_PAUSE_S, Pace, Recording
from tactiled.bus.textlog import CSV_HEAD
from tactiled.config import parse
from tactiled.config.example import GRASP
from tactiled.errors import ConfigError, TactileError
from tactiled.live.pipeline import Pipeline
from tests.conftest import Clock

# The data set's first slice, as its file has it: rows thumb, index, middle, ring, little.
BEAR_1_FIRST = """
242 242 241 243 243 243 242 243 243 242 243 243
243 243 244 243 242 242 242 240 243 243 242 242
244 244 246 251 252 244 248 248 248 245 247 244
241 243 244 244 244 244 243 243 244 244 244 243
244 244 247 248 248 247 248 247 246 247 248 245
"""
THUMB_LAST = [1, 2, 3, 4, 0]  # triangles are index, middle, ring, little, thumb
LINE = b"(1.000000) can0 500#0102 R\n"
BOMB = 1 << 28  # bytes


@pytest.fixture(scope="module")
def plan():
    return sensor_plan("hand", parse(GRASP).sensor["hand"])


def test_the_recordings_of_the_package_have_their_licence_beside_them():
    assert recording.names() == ("blue_bear_1", "blue_bear_2", "book_1", "book_2")
    for name in recording.names():
        beside = recording.path(name).parent
        assert "Copyright 2012 Harold Soh" in (beside / "DATASET.txt").read_text("utf-8")
    with pytest.raises(ConfigError, match="recording 'cup': no such recording: choose one of blue_bear_1, "):
        recording.path("cup")


def test_real_bytes_of_a_grasp_are_restored(plan):
    frames, loss = assemble(plan.codec, recording.read(recording.path("blue_bear_1")))
    assert (len(frames), loss.lost, any(frame.flags.any() for frame in frames)) == (12, 0, False)
    counts = np.array(BEAR_1_FIRST.split(), np.uint16).reshape(5, 12)[THUMB_LAST].ravel()
    np.testing.assert_array_equal(frames[0].counts, counts)
    pipeline = Pipeline(replace(plan, method="wiener"))
    image = pipeline.process(frames[0])
    np.testing.assert_array_equal(image.raw, 245.0 - counts)  # pressure counts = no load - value
    again = np.linalg.norm(pipeline._chain._restorer.predicted() - image.raw)
    assert again < np.linalg.norm(
        plan.blur.forward(image.raw[plan.blur.taxel]) - image.raw
    )  # than the raw one blurred twice
    assert again < np.sqrt(image.raw.size / 12)  # which rounding to counts leaves


@pytest.mark.parametrize(("loop", "count"), [(False, 150), (True, 325)])
def test_a_recording_is_played_at_its_own_pace_once_or_in_a_loop(plan, monkeypatch, loop, count):
    clock, played = Clock(), []
    monkeypatch.setattr(recording, "time", clock)

    def send(message):
        played.append(message)
        if len(played) == 325:
            clock.wait = lambda _: True

    assert recording.play(recording.path("book_1"), send, clock, loop) == len(played) == count
    times = [each.time for each in played]  # of sending
    original = [each.time for each in recording.read(recording.path("book_1"))]
    np.testing.assert_allclose(np.array(times[:150]) - times[0], np.array(original) - original[0], atol=1e-6)
    frames, _ = assemble(plan.codec, played)
    assert len(frames) == (32 if loop else 15)
    assert not any(frame.flags.any() for frame in frames)
    if loop:
        assert times[150] - times[149] > 0.017  # a lap follows after the longest pause


@pytest.mark.parametrize(
    ("times", "now", "steps"),
    [
        ([1e9, 1e9 + 0.5, 1e9 + 0.5, 1e9 + MAX_PAUSE_S], MAX_PAUSE_S, {}),
        ([0.0, 5.0, 4.2, 5.1, 4.3, 6.0], 6.0, {}),  # several buses, out of order
        ([4e3, 4001.0, 7601.0, 7602.0], MAX_PAUSE_S + 2, {2: "pauses for 3600 s before message 3"}),
        ([4e3, 4001.0, 401.0, 402.0], MAX_BACK_S + 2, {2: "steps back in time by 3600 s at message 3"}),
        ([0.0, 1.0, 4e9 + 1, 4e9 + 2], MAX_PAUSE_S + 2, {2: "pauses for 4e+09 s before message 3"}),
    ],
)
def test_a_pace_goes_as_the_messages_do_never_back_and_over_steps_of_the_clock(times, now, steps):
    pace, passed = Pace(), []
    for n, each in enumerate(times):
        assert pace.go(each) == steps.get(n)
        passed.append(pace.now)
    assert passed == sorted(passed)
    assert (pace.now, pace.steps) == (pytest.approx(now), len(steps))


def refused(path, reason):
    """A recording is refused in one line with this reason, not as torn, and takes little memory."""
    messages = Recording(path)
    with pytest.raises(ConfigError, match=reason):
        list(messages)
    tracemalloc.start()
    try:
        with pytest.raises(ConfigError, match=reason) as caught:
            list(recording.read(path))
        assert tracemalloc.get_traced_memory()[1] < 8 * MAX_BLOCK_BYTES
    finally:
        tracemalloc.stop()
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 600
    assert str(path) in str(caught.value)
    assert not messages.torn
    return messages.count


@pytest.mark.parametrize(
    ("name", "content", "reason"),
    [
        ("gone.log", None, "No such file"),
        ("a.xyz", b"", "give a recording in a format"),
        ("a.log", b"(0.0) can0 123\n", "give a recording in a format"),
        ("a.log", LINE + b"nonsense\n" + LINE + LINE[:-5], "message 2: .*give a rec"),  # its end is cut, too
        ("a.log", LINE + b"(1." + b"0" * 9000 + b".0) can0 500#00\n", "message 2: "),  # which its reader quotes
        *(
            (f"a.log{packed}", LINE * 2 + LINE.replace(b"1.000000", number.encode()) + LINE,
             rf"message 3: time {float(number):g} s is outside 1970 to 2106".replace("+", r"\+"))
            for number in ("inf", "nan", "1e300", "-1", "1e10") for packed in ("", ".gz")
        ),
    ],
)  # fmt: skip
def test_a_faulty_file_is_refused(tmp_path, name, content, reason):
    if content is not None:
        (tmp_path / name).write_bytes(gzip.compress(content) if name.endswith(".gz") else content)
    refused(tmp_path / name, reason)
    with pytest.raises(ConfigError):
        recording.play(tmp_path / name, lambda _: pytest.fail("sent"), Event())


@pytest.mark.parametrize("ending", [".log", ".asc", ".csv", ".trc", ".log.gz", ".asc.gz"])
def test_an_endless_line_is_refused(tmp_path, ending):
    path = tmp_path / f"a{ending}"
    with gzip.open(path, "wb", 1) if ending.endswith(".gz") else path.open("wb") as file:
        file.write({".log": LINE, ".csv": CSV_HEAD.encode() + b"\n"}.get(ending[:4], b""))
        for _ in range(BOMB >> 20):
            file.write(b"0" * (1 << 20))
    refused(path, f"a line is longer than {MAX_LINE_CHARACTERS} characters")


def container(objects, method=blf.ZLIB_DEFLATE):
    """A .blf file's container of so many bytes."""
    data = objects if method != blf.ZLIB_DEFLATE else zlib.compress(objects)
    size = blf.OBJ_HEADER_BASE_STRUCT.size + blf.LOG_CONTAINER_STRUCT.size + len(data)
    header = blf.OBJ_HEADER_BASE_STRUCT.pack(b"LOBJ", 16, 1, size, blf.LOG_CONTAINER)
    return header + blf.LOG_CONTAINER_STRUCT.pack(method, len(objects)) + data + bytes(size % 4)


def begun(size, kind):
    """The header of a .blf file's object of so many bytes."""
    return struct.pack("<4sHHII", b"LOBJ", 16, 1, size, kind)


ENDLESS = struct.pack("<4sHHII", b"LOBJ", 32, 1, 0xF0000000, 1) + bytes(MAX_BLOCK_BYTES - 100)


@pytest.mark.parametrize(
    ("objects", "reason"),
    [
        (lambda: container(bytes(BOMB)), f"a container unpacks to more than {MAX_BLOCK_BYTES} bytes"),
        (
            lambda: container(ENDLESS) + container(bytes(MAX_BLOCK_BYTES - 100)) * 20,
            f"an object is longer than {MAX_BLOCK_BYTES} bytes",
        ),
        (lambda: begun(0xF0000000, 10), rf"a block of \d+ bytes: 0 to {MAX_BLOCK_BYTES} can be read"),
        (lambda: begun(3, 10), r"a block of -13 bytes"),
        (lambda: begun(20, 10) + bytes(100), "a container has 4 bytes"),
        (lambda: container(b"", 77) + bytes(100), "a container is packed by the unknown method 77"),
        (lambda: container(begun(0, 77) + bytes(32)), "an object has 0 bytes"),  # python-can reads it for ever
        (lambda: bytes(100), "no object where one must begin"),
    ],
)
def test_a_faulty_blf_file_is_refused(tmp_path, objects, reason):
    path = tmp_path / "a.blf"
    Recorder(path).close()
    with path.open("ab") as file:
        file.write(objects())
    assert path.stat().st_size < 1 << 20
    refused(path, reason)


def test_containers_of_python_cans_own_writer_are_read(tmp_path):
    path = tmp_path / "a.blf"
    messages = [can.Message(1.6e9 + n / 1000, 0x500, data=n.to_bytes(8, "big")) for n in range(20_000)]
    with can.BLFWriter(path) as file:
        for each in messages:
            file.on_message_received(each)
    assert [each.data for each in recording.read(path)] == [bytes(each.data) for each in messages]


@pytest.mark.parametrize("ending", [".csv", ".db", ".blf"])
def test_short_messages_of_can_fd_are_known_for_such_where_a_format_does_not_tell(tmp_path, ending):
    codec = Packed(33, 16, fd=True)  # its second message has 6 bytes
    path, counts = tmp_path / f"a{ending}", np.arange(33, dtype=np.uint16)
    with can.Logger(path) as file:
        for n in range(3):
            for each in codec.encode(counts + n, n, 1e9 + n):
                file(can_message(each))
    log = Recording(path, codec.ids)
    frames, loss = assemble(codec, log)
    assert ([each.counts[-1] for each in frames], loss.malformed) == ([32, 33, 34], 0)
    assert log.caveats() == ([] if ending == ".blf" else [FD_LOST])


SAME_ID = "(1.0) can0 500#01\n(1.1) can1 77#01\n(1.2) can0 77#01\n(1.3) can1 500#01\n"


@pytest.mark.parametrize("packed", ["", ".gz"])
def test_an_id_that_comes_from_two_channels_is_refused_where_a_sensor_listens_to_it(tmp_path, packed):
    path = tmp_path / f"all.log{packed}"
    path.write_bytes(gzip.compress(SAME_ID.encode()) if packed else SAME_ID.encode())
    assert len(list(Recording(path, frozenset({(0x501, False), (0x500, True)})))) == 4
    messages = Recording(path, frozenset({(0x500, False)}))
    keep = rf"keep one \({'z' if packed else ''}grep ' can0 ' all.log{packed} > can0.log\)"
    with pytest.raises(ConfigError, match=f"message 4: id 0x500 comes from can0 and from can1, .* {keep}"):
        list(messages)
    assert not messages.torn


def test_full_memory_is_no_fault_of_the_recording(tmp_path, monkeypatch):
    def full():
        yield can.Message(1.6e9)
        raise MemoryError

    monkeypatch.setattr(recording, "open_log", lambda *_: nullcontext(full()))
    (tmp_path / "a.log").touch()
    with pytest.raises(TactileError, match="it needs too much memory, after 1 messages") as caught:
        list(recording.read(tmp_path / "a.log"))
    assert not isinstance(caught.value, ConfigError)


def test_more_messages_than_a_file_can_hold_are_refused(tmp_path, monkeypatch):
    (tmp_path / "a.log").write_bytes(bytes(10))
    monkeypatch.setattr(recording, "open_log", lambda *_: nullcontext(repeat(can.Message(1.6e9))))
    with pytest.raises(ConfigError, match="message 1041: more than 1040 messages cannot be in so small a file"):
        list(recording.read(tmp_path / "a.log"))
