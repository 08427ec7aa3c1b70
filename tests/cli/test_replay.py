import gzip
import json
import re
import subprocess
import sys
import urllib.request
from threading import Event

import can
import numpy as np
import pytest
from typer.testing import CliRunner

from tactiled.build import make_codec
from tactiled.bus import recording
from tactiled.bus.recorder import Recorder
from tactiled.bus.replay import Recording, Replay, frames
from tactiled.bus.router import Router
from tactiled.cli import app as door
from tactiled.cli.replay import replaying
from tactiled.config import Server, parse
from tactiled.config.example import GRASP
from tactiled.errors import ConfigError
from tactiled.frames import Message
from tactiled.web.server import running
from tests.conftest import BUSY_S, Clock, ask

CONFIG = """
[bus.can0]
interface = "socketcan"
channel = "gone0"
fd = true

[sensor.palm]
bus = "can0"
method = "auto"
codec = { name = "packed", bits = 12, fd = true }
array = { rows = 8, columns = 8, pitch_mm = 1.0 }
cover = { thickness_mm = 0.8, young_mpa = 0.6, poisson = 0.48 }
kernel = { model = "layered" }
calibration = { kpa_per_count = 0.5, no_load = 100, saturation = 4000 }
"""
FRAMES = 60


def pressed(sequence, rng):
    counts = np.full((8, 8), 100.0) + rng.normal(0, 2, (8, 8))
    if sequence > 35:  # the noise is measured before
        at = 1 + sequence % 4
        counts[at : at + 2, 3:5] += 700
    return counts.clip(0, 4095).astype(np.uint16).ravel()


def traffic(codec, lose=(), first=1.6e9):
    """Moving presses at 100 Hz, foreign messages between; `lose` are (sequence, segment) that never came."""
    rng = np.random.default_rng(1)
    for sequence in range(FRAMES):
        when = first + sequence * 0.01
        for segment, each in enumerate(codec.encode(pressed(sequence, rng), sequence, when)):
            if (sequence, segment) not in lose:
                yield each._replace(time=when + segment * 0.001)
        yield Message(when + 0.005, 0x77, b"\x01")


def write(path, messages):
    recorder = Recorder(path)
    for each in messages:
        recorder.put(
            can.Message(
                each.time,
                each.id,
                is_extended_id=each.extended,
                is_fd=each.fd,
                bitrate_switch=each.fd,
                data=each.data,
            )
        )
    recorder.close()
    return path


@pytest.fixture(scope="module")
def codec():
    return make_codec(parse(CONFIG).sensor["palm"])


@pytest.fixture
def lossy(tmp_path, codec):
    return write(tmp_path / "a.log", traffic(codec, lose={(7, 0), (20, 1), (40, 1)}))


def images(path, text=CONFIG, speed=0.0):
    """Every image of a replay through the whole service, and how it ended."""
    ended = Event()
    service = replaying(parse(text), path, speed)
    (sensor,) = service.sensors.values()
    got = []
    sensor.hub.subscribe(got.append)
    listener = service._listeners[0]
    told, listener._ended = listener._ended, lambda line: (told(line), ended.set())
    service.start()
    assert ended.wait(60)
    service.stop()
    return got, sensor


def same(one, other):
    assert (one.sequence, one.time, one.method, one.why, one.iterations) == (
        (other.sequence, other.time, other.method, other.why, other.iterations)
    )
    assert (one.noise_kpa, one.noise_gain, one.loss, one.warnings) == (
        (other.noise_kpa, other.noise_gain, other.loss, other.warnings)
    )
    for name in ("raw", "restored", "flags"):
        assert getattr(one, name).tobytes() == getattr(other, name).tobytes(), (one.sequence, name)


@pytest.mark.parametrize("speeds", [(0, 0), (0, 4), (4, 1)])
def test_images_are_bit_identical_from_run_to_run_at_any_speed(lossy, speeds):
    (first, sensor), (second, _) = (images(lossy, speed=speed) for speed in speeds)
    assert len(first) == len(second) == FRAMES
    for one, other in zip(first, second, strict=True):
        same(one, other)
    assert len({each.method for each in first}) > 1
    loss = first[-1].loss
    assert (loss.lost, loss.incomplete, loss.skipped, loss.malformed) == (3, 3, 0, 0)
    assert loss.foreign == FRAMES - 1  # one comes behind the last frame
    assert [each.sequence for each in first] == list(range(FRAMES))
    status = sensor.status()
    assert sensor.clock == "recording"
    assert (status.state, status.detail) == ("down", f"a.log has ended after {3 * FRAMES - 3} messages")


def test_a_real_grasp_too():
    (first, _), (second, _) = (images(recording.path("book_1"), GRASP) for _ in range(2))
    assert len(first) == 15
    for one, other in zip(first, second, strict=True):
        same(one, other)


def test_a_frame_that_cannot_be_restored_is_told_and_the_next_one_comes(lossy, monkeypatch):
    from tactiled.runtime.pipeline import Pipeline

    real = Pipeline.process

    def process(self, frame):
        if frame.sequence == 5:
            raise ValueError("five")
        return real(self, frame)

    monkeypatch.setattr(Pipeline, "process", process)
    got, _ = images(lossy)
    assert [each.sequence for each in got] == [each for each in range(FRAMES) if each != 5]


@pytest.mark.parametrize("speed", [1, 3])
def test_the_recorded_pace_and_multiples_of_it(lossy, codec, monkeypatch, speed):
    clock, took, done = Clock(), [], Event()
    monkeypatch.setattr("tactiled.bus.replay.time", clock)
    play = Replay(lossy, {"palm": codec}, lambda *_: took.append(clock.now), speed, lambda _: done.set())
    play._stop = clock
    play.start()
    assert done.wait(BUSY_S)
    play.stop()
    assert len(took) == FRAMES
    assert took[-1] - took[0] == pytest.approx((FRAMES - 1) * 0.01 / speed)


def test_a_stop_ends_it_in_a_pause(tmp_path, codec):
    path = write(tmp_path / "a.log", [Message(1e9, 1, b"\x01"), Message(1e9 + 3600, 1, b"\x01")])
    play = Replay(path, {"palm": codec}, lambda *_: None)
    play.start()
    play.stop()
    assert not play._thread.is_alive()


def test_silence_closes_a_half_received_frame_and_so_does_the_end(codec):
    counts = np.full(64, 100, np.uint16)
    halves = [codec.encode(counts, sequence, when)[0] for sequence, when in ((0, 1.0), (1, 1.02), (2, 1.2))]
    got = list(frames(halves, Router({"palm": codec})))
    assert [(name, frame.sequence, frame.loss.incomplete) for name, frame in got] == [
        ("palm", 0, 1),
        ("palm", 1, 2),
        ("palm", 2, 3),
    ]
    late = [*halves[:1], codec.encode(counts, 0, 1.2)[1]]
    ((_, frame),) = frames(late, Router({"palm": codec}))
    assert frame.flags.any()  # its second half came after the silence


def stepping(codec, step):
    """Frames at 100 Hz, whose clock steps after the tenth."""
    rng = np.random.default_rng(1)
    for sequence in range(20):
        when = 1.6e9 + sequence * 0.01 + (step if sequence >= 10 else 0.0)
        yield from codec.encode(pressed(sequence, rng), sequence, when)


def lines(path, messages):
    """A recording with its times as they are, which python-can's own writer would not write."""
    frames = (f"({each.time:f}) can0 {each.id:03X}##1{each.data.hex()} R\n" for each in messages)
    path.write_text("".join(frames))
    return path


@pytest.mark.parametrize(
    ("step", "says", "wait"),
    [
        (3600.0, "a.log pauses for 3600.01 s before message 21: it goes on in 10 s", 10.0),
        (-3600.0, "a.log steps back in time by 3599.99 s at message 21: it goes on in 1 s", 1.0),
    ],
)
def test_a_step_of_the_recordings_clock_is_told_and_not_slept_through(
    tmp_path, codec, monkeypatch, step, says, wait
):
    path, clock, done = lines(tmp_path / "a.log", stepping(codec, step)), Clock(), Event()
    monkeypatch.setattr("tactiled.bus.replay.time", clock)
    service = replaying(parse(CONFIG), path, 1.0)
    (listener,), began = service._listeners, clock.now
    told, listener._ended = listener._ended, lambda line: (told(line), done.set())
    listener._stop = clock
    service.start()
    assert done.wait(BUSY_S)
    service.stop()
    assert [each.text for each in service.events.after(0) if each.kind == "replay_stepped"] == [says]
    assert clock.now - began == pytest.approx(0.18 + wait)
    (sensor,) = service.sensors.values()
    assert sensor.hub.latest().loss.late == 0
    assert sensor.status().detail == "a.log has ended after 40 messages, with 1 step of their clock"


@pytest.mark.parametrize("step", [3600.0, -3600.0])
def test_a_sender_that_began_anew_at_a_step_of_the_clock_is_followed(codec, step):
    counts = np.full(64, 100, np.uint16)
    rows = [*((n, 1e9 + n / 100) for n in (100, 101)), *((n, 1e9 + step + n / 100) for n in (0, 1))]
    router = Router({"palm": codec})
    got = list(frames([each for n, when in rows for each in codec.encode(counts, n, when)], router))
    assert (len(got), router.assemblers["palm"].loss.late) == (4, 0)


@pytest.mark.parametrize("time", ["inf", "1e300", "nan"])
def test_a_time_that_cannot_be_ends_the_replay_with_words(tmp_path, codec, time):
    path = lines(tmp_path / "a.log", stepping(codec, 0.0))
    rows = path.read_text().splitlines(keepends=True)
    path.write_text("".join(rows[:30]) + re.sub(r"\(.*\)", f"({time})", rows[30]) + "".join(rows[31:]))
    got, sensor = images(path, speed=100.0)
    assert len(got) == 15
    status = sensor.status()
    assert status.state == "down"
    assert f"message 31: time {float(time):g} s is none from 1970 to 2106" in status.detail


def test_a_fault_of_our_own_ends_the_replay_with_words(lossy, monkeypatch):
    monkeypatch.setattr(Router, "push", lambda *_: {}["byte 7"])
    _, sensor = images(lossy)
    assert sensor.status().detail == "a.log: the replay failed at message 1: KeyError: 'byte 7'"


@pytest.mark.parametrize("cut", range(1, 60, 7))
def test_a_line_that_was_cut_off_is_left_out_and_told(lossy, cut):
    whole = list(Recording(lossy))
    lossy.write_bytes(lossy.read_bytes()[:-cut])
    kept = Recording(lossy)
    got = list(kept)
    assert got == whole[: len(got)]
    lost = len(whole) - len(got)
    assert lost == 1 + (cut > 30)
    assert kept.torn
    assert kept.told() == f"{len(got)} messages, then an end that was cut off"


def test_a_compressed_file_without_its_end_gives_what_is_there(tmp_path, codec):
    path = write(tmp_path / "a.log.gz", traffic(codec))
    whole = list(Recording(path))
    path.write_bytes(path.read_bytes()[:-400])
    kept = Recording(path)
    got = list(kept)
    assert got == whole[: len(got)]
    assert 0 < len(got) < len(whole)
    assert kept.torn


@pytest.mark.parametrize("ending", [".log", ".asc", ".blf", ".log.gz", ".asc.gz"])
def test_a_file_cut_anywhere_gives_its_first_messages_and_none_that_was_not_sent(tmp_path, codec, ending):
    path = write(tmp_path / f"a{ending}", list(traffic(codec))[:40])
    whole, data = list(Recording(path)), path.read_bytes()
    first = 144 if ending == ".blf" else 3  # within a .blf file's header python-can leaves the file open
    for at in range(first, len(data), max(1, len(data) // 60)):
        path.write_bytes(data[:at])
        got = list(Recording(path))
        assert got == whole[: len(got)]


def test_a_fault_within_a_recording_is_refused_not_skipped(lossy):
    lines = lossy.read_text().splitlines(keepends=True)
    lossy.write_text("".join([*lines[:20], "nonsense\n", *lines[20:]]))
    with pytest.raises(ConfigError, match="give a recording in a format"):
        list(Recording(lossy))
    got, sensor = images(lossy)
    assert 0 < len(got) < 10
    assert "give a recording in a format" in sensor.status().detail


def test_every_format_replays_to_the_same_images(tmp_path, codec):
    first, _ = images(write(tmp_path / "a.log", traffic(codec)))
    for ending in (".blf", ".asc", ".log.gz"):
        other, _ = images(write(tmp_path / f"a{ending}", traffic(codec)))
        for one, two in zip(first, other, strict=True):
            assert one.restored.tobytes() == two.restored.tobytes()


def run(*arguments):
    return CliRunner().invoke(door.app, ["replay", *map(str, arguments)])


def test_what_cannot_be_is_refused_in_one_line(tmp_path, lossy):
    path = tmp_path / "a.toml"
    path.write_text(CONFIG)
    empty = tmp_path / "empty.log"
    empty.write_text("")
    for arguments, says in (
        ((tmp_path / "gone.log", "--config", path), "gone.log: No such file"),
        ((empty, "--config", path), "empty.log: holds no data frame: nothing to replay"),
        ((lossy, "--config", tmp_path / "b.toml"), "b.toml: No such file"),
        ((lossy, "--config", path, "--speed", "inf"), "speed = inf: give 1 for"),
        ((lossy, "--config", path, "--bus", "x"), "--bus x: no such bus: choose one of can0"),
        ((lossy, "--config", path, "--host", "0.0.0.0"), "--host 0.0.0.0: other machines could reach it: give"),
    ):
        told = run(*arguments).exception
        assert isinstance(told, ConfigError), (arguments, told)
        assert says in str(told)
        assert "\n" not in str(told)
    path.write_text(CONFIG + '[bus.b]\ninterface = "virtual"\n')
    assert str(run(lossy, "--config", path, "--bus", "b").exception) == (
        "bus b: no sensor of the configuration is on it"
    )


def test_the_command_serves_the_recordings_images(tmp_path, lossy):
    path = tmp_path / "a.toml"
    path.write_text(CONFIG)
    command = [sys.executable, "-m", "tactiled", "replay", str(lossy), "--config", str(path), "--port", "0"]
    process = subprocess.Popen([*command, "--speed", "0"], stdout=subprocess.PIPE, text=True)
    said = ""
    while not (url := re.search(r"http://\S+/", said)) or "has ended" not in said:
        said += process.stdout.readline()
    with urllib.request.urlopen(f"{url[0]}api/v1/sensors") as answer:
        text = json.dumps(json.load(answer))
    process.terminate()
    process.communicate()
    assert "a.log has ended after 177 messages" in said
    assert "a.log has ended after 177 messages" in text


def test_a_replay_lists_recordings_and_records_no_bus(tmp_path, lossy):
    service = replaying(parse(CONFIG.replace("socketcan", "virtual")), lossy, 0.0)
    with running(service, Server(port=0, recordings=tmp_path)) as url:
        refused = ask("POST", f"{url}/api/v1/recordings", json={"bus": "can0"})
        listed = ask("GET", f"{url}/api/v1/recordings").json()
    assert (refused.status_code, refused.headers["content-type"]) == (409, "application/problem+json")
    assert refused.json()["detail"] == "bus can0: is not open: this service replays a recording"
    assert [each["name"] for each in listed["recordings"]] == ["a.log"]


def test_a_compressed_recording_is_one(tmp_path, lossy):
    path = tmp_path / "b.log.gz"
    path.write_bytes(gzip.compress(lossy.read_bytes()))
    assert list(Recording(path)) == list(Recording(lossy))
