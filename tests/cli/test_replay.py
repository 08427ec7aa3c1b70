import gzip
from dataclasses import fields
from threading import Event

import numpy as np
import pytest

from tactiled.bus.recording import Recording
from tactiled.bus.replay import Replay, frames
from tactiled.bus.router import Router
from tactiled.cli.replay import replaying
from tactiled.config import parse
from tactiled.frames import SensorImage
from tactiled.live.contact_search import ImageContacts
from tests.cli.commands import refusal, succeed
from tests.cli.recordings import CODEC, CONFIG, FRAMES, counts, traffic, write
from tests.conftest import BUSY_S, Clock, ask, problem, running, until


def images(path, speed=0.0):
    """Every image of a replay through the whole service, and its sensor at the end."""
    service = replaying(parse(CONFIG), path, speed)
    (sensor,) = service.sensors.values()
    got = []
    sensor.hub.subscribe(got.append)
    with service.running():
        until(lambda: sensor.health.ended or sensor.health.down)
    return got, sensor


@pytest.fixture
def clock(monkeypatch):
    made = Clock()
    monkeypatch.setattr("tactiled.bus.replay.time", made)
    monkeypatch.setattr("tactiled.bus.replay.Event", lambda: made)
    return made


def test_images_are_bit_identical_at_any_speed(lossy):
    (first, sensor), (second, _) = (images(lossy, speed) for speed in (0, 4))
    for one, other in zip(first, second, strict=True):
        for name in {each.name for each in fields(SensorImage)} - {"microseconds", "times"}:
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name), f"{name} of {one.sequence}")
    assert len({each.method for each in first}) > 1
    loss = first[-1].loss
    assert (loss.lost, loss.incomplete, loss.skipped, loss.malformed) == (3, 3, 0, 0)
    assert loss.foreign == FRAMES - 1  # one comes behind the last frame
    assert [each.sequence for each in first] == list(range(FRAMES))
    status = sensor.status()
    assert sensor.clock == "recording"
    assert (status.state, status.detail) == ("ended", f"a.log has ended after {3 * FRAMES - 3} messages")
    assert status.position_s == pytest.approx((FRAMES - 1) * 0.01 + 0.001)


@pytest.mark.parametrize("speed", [1, 3])
def test_the_recorded_pace_and_multiples_of_it(lossy, clock, speed):
    times, done = [], Event()
    play = Replay(lossy, {"palm": CODEC}, lambda *_: times.append(clock.now), speed, lambda *_: done.set())
    play.start()
    assert done.wait(BUSY_S)
    play.stop()
    assert len(times) == FRAMES
    assert times[-1] - times[0] == pytest.approx((FRAMES - 1) * 0.01 / speed)


def test_silence_and_the_end_close_a_half_received_frame():
    frame = np.full(64, 100, np.uint16)
    halves = [CODEC.encode(frame, sequence, when)[0] for sequence, when in ((0, 1.0), (1, 1.02), (2, 1.2))]
    got = list(frames(halves, Router({"palm": CODEC})))
    assert [(each.sequence, each.loss.incomplete) for _, each in got] == [(0, 1), (1, 2), (2, 3)]
    late = [*halves[:1], CODEC.encode(frame, 0, 1.2)[1]]
    ((_, closed),) = frames(late, Router({"palm": CODEC}))
    assert closed.flags.any()  # its second half came after the silence


def test_a_step_of_the_recordings_clock_is_an_event_and_a_short_pause(tmp_path, clock):
    rng, lines = np.random.default_rng(1), []  # which python-can would not write
    for sequence in range(20):
        when = 1.6e9 + sequence * 0.01 - 3600 * (sequence >= 10)
        messages = CODEC.encode(counts(sequence, rng), sequence, when)
        lines += [f"({each.time:f}) can0 {each.id:03X}##1{each.data.hex()} R\n" for each in messages]
    (tmp_path / "a.log").write_text("".join(lines))
    service, began = replaying(parse(CONFIG), tmp_path / "a.log", 1.0), clock.now
    (sensor,) = service.sensors.values()
    with service.running():
        until(lambda: sensor.health.ended)
    event = "a.log steps back in time by 3599.99 s at message 21: it goes on in 1 s"
    assert [each.text for each in service.events.after(0) if each.kind == "replay_stepped"] == [event]
    assert clock.now - began == pytest.approx(0.18 + 1.0)
    assert sensor.hub.latest().loss.late == 0
    assert sensor.status().detail == "a.log has ended after 40 messages, with 1 step of their clock"


def test_a_bug_ends_the_replay_with_a_reason(lossy, monkeypatch):
    monkeypatch.setattr(Router, "push", lambda *_: {}["byte 7"])
    _, sensor = images(lossy)
    status = sensor.status()
    assert (status.state, status.position_s) == ("down", 0.0)
    assert status.detail == "a.log: the replay failed at message 2: KeyError: 'byte 7'"


@pytest.mark.parametrize("ending", [".log", ".blf", ".log.gz"])  # others: tests/bus/test_textlog.py
def test_a_file_cut_anywhere_gives_its_first_messages_only(tmp_path, ending):
    path = write(tmp_path / f"a{ending}", list(traffic())[:40])
    complete, data = list(Recording(path)), path.read_bytes()
    first = 144 if ending == ".blf" else 3  # within a .blf file's header python-can leaves the file open
    for at in range(first, len(data), max(1, len(data) // 60)):
        path.write_bytes(data[:at])
        cut = Recording(path)
        got = list(cut)
        assert got == complete[: len(got)]
        if ending == ".log":
            assert len(got) == data[:at].count(b"\n")
            assert cut.torn == (data[at - 1 : at] != b"\n")
            assert cut.summary() == f"{len(got)} messages" + cut.torn * " (its end is cut off)"


def test_a_fault_within_a_recording_ends_the_replay_with_a_reason(lossy):
    lines = lossy.read_text().splitlines(keepends=True)
    lossy.write_text("".join([*lines[:20], "nonsense\n", *lines[20:]]))
    got, sensor = images(lossy)
    assert 0 < len(got) < 10
    assert "give a recording in a format" in sensor.status().detail


def test_wrong_arguments_are_refused(tmp_path, lossy, config):
    config.write_text(CONFIG)
    empty = tmp_path / "empty.log"
    empty.write_text("")
    for arguments, message in (
        ((tmp_path / "gone.log", "--config", config), "gone.log: No such file"),
        ((empty, "--config", config), "empty.log: holds no data frame: nothing to replay"),
        ((lossy, "--config", config, "--speed", "inf"), "speed = inf: give 1 for"),
        ((lossy, "--config", config, "--bus", "x"), "--bus x: no such bus: choose one of can0"),
        ((lossy, "--config", config, "--host", "0.0.0.0"), "--host 0.0.0.0: other machines could reach it: give"),
    ):
        assert message in refusal("replay", *arguments)
    config.write_text(CONFIG + '[bus.b]\ninterface = "virtual"\n')
    message = refusal("replay", lossy, "--config", config, "--bus", "b")
    assert message == "bus b: no sensor of the configuration is on it"


def test_the_command_serves_the_recordings_images_and_records_no_bus(tmp_path, lossy, config, monkeypatch):
    config.write_text(f'[server]\nrecordings = "{tmp_path}"\n{CONFIG}')

    def serve(app, server):
        with running(app.state.service, server) as url:
            api = f"{url}/api/v1"
            until(lambda: "a.log has ended after 177 messages" in ask("GET", f"{api}/sensors").text)
            refused = ask("POST", f"{api}/recordings", json={"bus": "can0"})
            assert problem(refused, 409) == "bus can0: is not open: this service replays a recording"
            recordings = ask("GET", f"{api}/recordings").json()["recordings"]
            assert [each["name"] for each in recordings] == ["a.log"]

    monkeypatch.setattr("tactiled.cli.replay.serve", serve)
    output = succeed("replay", lossy, "--config", config, "--port", 0, "--speed", 0)
    assert "a.log has ended after 177 messages" in output


def test_a_replay_stops_while_nothing_comes_of_its_file(tmp_path, monkeypatch):
    monkeypatch.setattr("tactiled.bus.recording.CPU_S", 600.0)
    path, ended = tmp_path / "a.log.gz", []
    path.write_bytes(gzip.compress(b"(1.000000) can0 123#00\n" + b"\n" * (32 << 20), 1))
    play = Replay(path, {"palm": CODEC}, lambda *_: None, 0.0, lambda *line: ended.append(line))
    play.start()
    play.stop()
    assert not ended


def test_an_empty_pad_whose_noise_nobody_configured_has_no_contact_from_the_first_frame_on(tmp_path):
    log = write(tmp_path / "a.log", list(traffic())[:80])  # before the presses
    got, sensor = images(log)
    find = ImageContacts(sensor.array, sensor.plan.cells)
    assert [find(each, each.time) for each in got] == len(got) * [()]
    assert {each.noise for each in got} == {got[0].noise}
    assert got[0].noise == pytest.approx(1.0, rel=0.1)  # 2 counts
    assert not any(each.warnings for each in got)
