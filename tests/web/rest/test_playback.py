"""Frames of recordings: any of them at once, as a replay restores them; and their series."""

import csv
import gzip
import os
from contextlib import suppress
from dataclasses import asdict, replace
from itertools import groupby
from pathlib import Path
from unittest.mock import MagicMock

import httpx
import numpy as np
import pytest

from tactiled.archive.export import ExportJob
from tactiled.cli.replay import replaying
from tactiled.config import Server, parse
from tactiled.contacts import felt
from tactiled.contacts.regions import Region
from tactiled.frames import BAD
from tactiled.live.service import Service
from tactiled.recorded import series as recorded_series
from tactiled.recorded.frames import RecordedFrames
from tactiled.web.rest import playback
from tactiled.web.server import running
from tests.cli.recordings import CONFIG, FRAMES, traffic, write
from tests.conftest import HTTP, ask, problem, until
from tests.web.ws.clients import unpack_all

ROOT = "/api/v1/recordings"
PALM = {"sensor": "palm"}
REGIONS = {
    "heel": Region(shape="rectangle", points_mm=((1.5, -1), (5.5, 3.5))),
    "toe": Region(shape="ellipse", points_mm=((3, 3), (8, 8))),
}


@pytest.fixture(scope="module")
def service():
    service = Service(parse(CONFIG))
    for name, region in REGIONS.items():
        service.sensor("palm").regions.put(name, region)
    return service


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Recordings: one with losses, the same packed, one with a fault, and one of another sensor."""
    folder = tmp_path_factory.mktemp("recordings")
    for name in ("a.log", "a.asc.gz"):
        write(folder / name, list(traffic(missing={(20, 1), (40, 0), (41, 1)})))
    lines = (folder / "a.log").read_text().splitlines(keepends=True)
    (folder / "bad.log").write_text("".join([*lines[:40], "nonsense\n", *lines[40:]]))
    (folder / "other.log").write_text("(1.0) can0 123#00 R\n")
    return folder


@pytest.fixture(scope="module")
def client(service, folder):
    server = Server(port=0, recordings=folder, recordings_leave_mb=0, control_per_minute=0)
    with running(service, server) as url, httpx.Client(**HTTP, base_url=url + ROOT) as client:
        yield client


def opened(client, name):
    """The state of a recording once it was read to its end."""
    states = []
    until(lambda: states.append(client.get(f"/{name}/playback", params=PALM).json()) or not states[-1]["reading"])
    return states[-1]


def images(client, name, **query):
    answer = client.get(f"/{name}/frames", params=PALM | query)
    assert answer.status_code == 200, answer.text
    positions = [float(each) for each in answer.headers["x-tactiled-positions"].split(",")]
    return int(answer.headers["x-tactiled-frame"]), positions, unpack_all(answer.content)


def replayed(path):
    """What a replay makes of a recording."""
    service, got = replaying(parse(CONFIG), path, 0.0), []
    sensor = service.sensor("palm")
    sensor.hub.subscribe(got.append)
    with service.running():
        until(lambda: sensor.health.ended)
    return got


def files_without_names(folder):
    """How many this process has open in a folder."""
    count = 0
    for each in Path("/proc/self/fd").iterdir():
        with suppress(OSError):
            name = str(each.readlink())
            count += name.startswith(f"{folder}/") and name.endswith("(deleted)")
    return count


def test_frames_that_nobody_asks_for_leave_the_disk(monkeypatch, tmp_path):
    timers = []
    monkeypatch.setattr(playback, "Timer", lambda *arguments: timers.append(arguments) or MagicMock())
    write(tmp_path / "a.log", list(traffic()))
    with running(Service(parse(CONFIG)), Server(port=0, recordings=tmp_path, recordings_leave_mb=0)) as url:
        answers = [ask("GET", f"{url}{ROOT}/a.log/playback?sensor=palm").status_code for _ in range(2)]
        ((seconds, close_idle),) = timers
        assert (answers, seconds) == ([200, 200], playback.IDLE_S)
        close_idle()  # too early
        assert files_without_names(tmp_path)
        assert len(timers) == 2
        monkeypatch.setattr(playback, "IDLE_S", 0.0)
        close_idle()
        assert not files_without_names(tmp_path)
        assert len(timers) == 2


def test_frames_in_any_order_are_those_of_a_replay(client, folder):
    path = folder / "a.asc.gz"
    expected = replayed(path)
    state = opened(client, path.name)
    assert [state[key] for key in ("frames", "error", "tared_at")] == [FRAMES, None, None]
    assert state["duration_s"] == pytest.approx(expected[-1].arrived)
    for number in (*range(FRAMES - 1, -1, -1), 40):
        first, (position,), (raw, restored) = images(client, path.name, first=number)
        image = expected[number]
        assert (first, raw.sequence, raw.method) == (number, image.sequence, image.method)
        assert (position, raw.timestamp) == (pytest.approx(image.arrived, abs=1e-6), image.time)
        np.testing.assert_array_equal(raw.values, image.raw)
        np.testing.assert_array_equal(raw.flags, image.flags.ravel())
        np.testing.assert_array_equal(restored.values, image.restored)
        details = client.get(f"/{path.name}/frames/{number}", params=PALM).json()
        assert details["loss"] == asdict(image.loss)
        assert [each["text"] for each in details["warnings"]] == [each.text for each in image.warnings]
        assert details["why"] == image.why
    areas = np.nansum([each.raw for each in expected], axis=(1, 2)) * 1e-3  # N: taxels of 1 mm2
    force = np.array(state["force"], float)
    assert np.nanmax(force) == pytest.approx(areas.max(), rel=1e-5)
    assert state["positions_s"][int(np.nanargmax(force))] == pytest.approx(expected[areas.argmax()].arrived)
    lost = [n for n, image in enumerate(expected) if np.isnan(image.restored).any()]
    assert np.isnan(force).tolist() == [n in lost for n in range(FRAMES)]
    assert lost


def test_a_recording_has_no_force_where_a_cell_is_unknown(client, folder, monkeypatch):
    monkeypatch.setattr(felt, "MIN_SUM_SHARE", 0.0)  # however few taxels are left
    write(folder / "lost.log", list(traffic(missing={(20, 1)})))
    force = opened(client, "lost.log")["force"]
    (folder / "lost.log").unlink()
    assert [n for n, each in enumerate(force) if each is None] == [20]


def test_contacts_of_frames_are_those_of_each_alone(client):
    opened(client, "a.log")
    query = PALM | {"first": 10, "count": 4, "step": 20}
    frames = client.get("/a.log/contacts", params=query).json()["frames"]
    alone = [client.get(f"/a.log/frames/{number}", params=PALM).json() for number in (10, 30, 50)]
    keys = ("number", "sequence", "timestamp", "contacts")
    assert frames == [{key: each[key] for key in keys} for each in alone]
    assert any(each["contacts"] for each in frames)
    assert client.get("/a.log/contacts", params=PALM | {"first": FRAMES}).status_code == 404


def test_frames_by_position_and_in_steps(client):
    opened(client, "a.log")
    assert images(client, "a.log", at=0.2)[0] == 19  # whose last message came at .191
    assert images(client, "a.log", at=0.0)[0] == 0
    assert images(client, "a.log", at=1e9)[0] == FRAMES - 1
    _, positions, messages = images(client, "a.log", first=10, count=4, step=20)
    np.testing.assert_allclose(positions, [0.101, 0.301, 0.501], atol=1e-6)
    assert [each.sequence for each in messages] == [10, 10, 30, 30, 50, 50]
    contacts = client.get("/a.log/frames/50", params=PALM).json()["contacts"]
    assert [each["id"] for each in contacts] == [1]
    assert 0 < contacts[0]["force_deviation"] < 0.5 * contacts[0]["force"]
    (raw, same) = images(client, "a.log", first=50, method="raw")[2]
    np.testing.assert_array_equal(raw.values, same.values)


def test_frames_that_are_not_read_yet_are_refused_by_number_and_position(client, monkeypatch):
    opened(client, "a.log")
    monkeypatch.setattr(RecordedFrames, "reading", True)
    for query, what in ({"first": FRAMES}, f"frame {FRAMES} is"), ({"at": 99.5}, "position 99.5 s is"):
        answer = client.get("/a.log/frames", params=PALM | query)
        assert problem(answer, 409) == f"recording a.log: {what} not read yet"
    assert images(client, "a.log", at=0.2)[0] == 19


def test_no_frame_is_restored_before_the_frames_that_its_noise_is_measured_from_are_read(
    client, folder, monkeypatch
):
    path = write(folder / "slow.log", list(traffic()))
    opened(client, path.name)
    with monkeypatch.context() as slow:
        slow.setattr(RecordedFrames, "reading", True)
        slow.setattr(RecordedFrames, "count", lambda *_: 4)
        early = client.get(f"/{path.name}/frames", params=PALM | {"first": 0})
        assert problem(early, 409) == "recording slow.log: its noise is not measured yet"
        state = client.get(f"/{path.name}/playback", params=PALM).json()
        assert (state["frames"], state["reading"], state["noise"]) == (0, True, None)
    assert images(client, path.name, first=0)[0] == 0
    path.unlink()


def test_an_answer_is_short_where_restoring_takes_long(client, monkeypatch):
    opened(client, "a.log")
    monkeypatch.setattr(playback, "ANSWER_S", 0.0)
    assert len(images(client, "a.log", first=0, count=30)[1]) == 1


def test_the_tare_from_before_a_recording_is_its_zero_and_a_later_one_is_not(client, service):
    assert opened(client, "a.log")["tared_at"] is None
    sensor = service.sensor("palm")
    ((before, _), pipeline) = images(client, "a.log", first=0)[2], sensor.pipeline
    zero = pipeline.zero
    for time, shift in ((1.6e9 - 1, 5.0), (1.6e9 + 1, 0.0)):
        pipeline.set_zero(type(zero)(zero.counts - 10, zero.shear, time))
        assert opened(client, "a.log")["tared_at"] == (time if shift else None)
        np.testing.assert_allclose(images(client, "a.log", first=0)[2][0].values, before.values + shift, atol=1e-4)
    pipeline.set_zero(zero)


def test_an_end_that_is_cut_off_is_reported(client, folder):
    path = folder / "cut.asc.gz"
    path.write_bytes((folder / "a.asc.gz").read_bytes()[:-100])
    state = opened(client, path.name)
    assert (state["error"], 0 < state["frames"] < FRAMES) == ("its end is cut off", True)
    path.unlink()


def test_what_is_left_out_of_a_recording_is_reported(client, folder):
    path = folder / "errors.log"
    path.write_bytes((folder / "a.log").read_bytes() + b"(1600000009.0) can0 20000004#0001000000000000\n")
    state = opened(client, path.name)
    assert (state["error"], state["frames"], state["caveats"]) == (None, FRAMES, ["left out: 1 error frame"])
    path.unlink()


def test_a_file_that_could_not_be_read_is_read_again_if_the_reason_may_pass(client, folder):
    path, content = folder / "b.log.gz", gzip.compress((folder / "a.log").read_bytes())
    for wrong, count in ((b"", FRAMES), (gzip.compress(b"nonsense\n"), 0)):  # no gzip file: an OSError; no message
        path.write_bytes(wrong.ljust(len(content), b"\0"))
        modified = path.stat().st_mtime_ns
        failed = opened(client, path.name)
        assert (failed["frames"], bool(failed["error"])) == (0, True)
        path.write_bytes(content)
        os.utime(path, ns=(modified, modified))  # as if the file was the same
        assert opened(client, path.name)["frames"] == count
    path.unlink()


def test_noise_is_measured_from_frames_with_data(client, folder, monkeypatch):
    frame = RecordedFrames.frame

    def partly_bad(self, sensor, number):
        each = frame(self, sensor, number)
        return replace(each, flags=np.full_like(each.flags, BAD)) if number % 2 else each

    monkeypatch.setattr(RecordedFrames, "frame", partly_bad)
    path = write(folder / "half.log", list(traffic())[:100])  # before the presses
    assert opened(client, path.name)["noise"] == pytest.approx(1.0, rel=0.1)  # 2 counts
    path.unlink()


def test_what_cannot_be_played_is_refused_in_a_line(client, folder):
    opened(client, "a.log")
    get = lambda path, **query: client.get(path, params=PALM | query)  # noqa: E731
    assert problem(get("/b.log/playback"), 404) == "recording b.log: no such recording"
    assert problem(get("/a.log/playback", sensor="plam"), 404).startswith("sensor 'plam'")
    assert problem(get("/a.log/frames", first=60), 404) == (
        "recording a.log: no frame 60: it has 60 frames of sensor palm"
    )
    for kind in ("shear", "traction"):
        assert "no shear" in problem(get("/a.log/frames", **{kind: True}), 404)
    assert problem(get("/a.log/frames", first=0, at=0.2), 422) == "first and at: give one of them"
    broken = opened(client, "bad.log")
    assert broken["frames"] == 14  # the last one half
    assert str(folder) not in broken["error"]
    assert "nonsense" in broken["error"] or "give a recording in a format" in broken["error"]
    assert opened(client, "other.log")["frames"] == 0
    assert "it has 0 frames of sensor palm" in problem(get("/other.log/frames", first=0), 404)


def test_a_file_that_was_written_anew_is_read_anew_and_leaves_nothing_beside_it(client, folder, monkeypatch):
    monkeypatch.setattr(playback, "MAX_OPEN", 1)
    path = write(folder / "b.log", traffic())
    assert opened(client, "b.log")["frames"] == FRAMES
    lines = path.read_text().splitlines(keepends=True)
    path.write_text("".join(lines[: len(lines) // 2]))
    assert opened(client, "b.log")["frames"] == FRAMES // 2
    path.unlink()
    assert {each.name for each in folder.iterdir()} == {"a.log", "a.asc.gz", "bad.log", "other.log"}


def measured(client, **query):
    """The series of the recording, once every frame is measured."""
    get = lambda: client.get("/a.log/series", params=PALM | query)  # noqa: E731
    until(lambda: (answer := get()).status_code == 200 and not answer.json()["running"], 60)
    return get().json()


def test_a_series_has_what_an_export_has_for_every_frame_its_highest_values_and_a_csv(client, folder, tmp_path):
    config, target = tmp_path / "palm.toml", tmp_path / "a.npz"
    config.write_text(CONFIG)
    job = ExportJob.of(config, parse(CONFIG), "palm", regions=REGIONS)
    job.make(folder / "a.log", target)
    with np.load(target) as arrays:
        expected, restored = (arrays["regions"], arrays["restored"].reshape(FRAMES, -1))
    series = measured(client, regions="heel,toe")
    assert [series[key] for key in ("frames", "measured", "error", "unit")] == [FRAMES, FRAMES, None, "kPa"]
    for n, area in enumerate(series["regions"]):
        assert area["name"] == ("heel", "toe")[n]
        for k, key in enumerate(("force", "mean", "peak", "area")):
            np.testing.assert_allclose(np.array(area[key], float), expected[:, n, k], rtol=1e-6)
        for k, key in enumerate(("force", "peak")):
            best = int(np.nanargmax(expected[:, n, 2 * k]))
            highest = area["highest"][key]
            assert highest["number"] == best
            assert highest["value"] == pytest.approx(expected[best, n, 2 * k])
            assert highest["position_s"] == pytest.approx(series["position_s"][best])
    total = 1e-3 * job.plan().cells.side ** 2 * restored.sum(axis=1)
    np.testing.assert_allclose(np.array(series["total"]["force"], float), total, rtol=1e-4)
    lost = [20, 40, 41]
    assert np.flatnonzero(np.isnan(total)).tolist() == lost
    details = client.get("/a.log/frames/50", params=PALM).json()
    assert [each["name"] for each in details["regions"]] == ["heel", "toe"]
    assert details["regions"][1]["peak"] == pytest.approx(series["regions"][1]["peak"][50])
    answer = client.get("/a.log/series", params=PALM | {"regions": "heel,toe", "format": "csv"})
    head, lines = [[*group] for _, group in groupby(answer.text.splitlines(), lambda line: line[0] == "#")]
    assert head[:3] == ["# recording: a.log", "# sensor: palm", "# method: auto"]
    rows = list(csv.DictReader(lines))
    assert answer.headers["content-disposition"] == 'attachment; filename="a-palm.csv"'
    assert list(rows[0])[:3] == ["frame", "position_s", "total_force_N"]
    assert list(rows[0])[6:10] == ["heel_force_N", "heel_mean_kPa", "heel_peak_kPa", "heel_area_mm2"]
    assert list(rows[0])[14:] == ["missing_taxels"]
    assert [int(each["frame"]) for each in rows] == list(range(FRAMES))
    assert [n for n, each in enumerate(rows) if int(each["missing_taxels"])] == lost
    forces = [float(each["heel_force_N"] or "nan") for each in rows]
    np.testing.assert_allclose(forces, np.array(series["regions"][0]["force"], float), rtol=1e-5)


def test_what_cannot_be_measured_is_refused_in_a_line_and_one_series_is_measured_at_a_time(client, monkeypatch):
    get = lambda **query: client.get("/a.log/series", params=PALM | query)  # noqa: E731
    measured(client)
    assert problem(get(regions="heal"), 404) == "sensor 'palm' has no region 'heal'; there are: heel, toe"
    assert "best" in problem(get(method="best"), 422)
    assert problem(get(sensor="plam"), 404).startswith("sensor 'plam'")
    monkeypatch.setattr(recorded_series.RecordedSeries, "running", property(lambda _: True))
    assert problem(get(method="wiener"), 409) == "recording a.log: another series is being measured"
    assert problem(get(format="csv"), 409) == f"recording a.log: {FRAMES} of {FRAMES} frames are measured"
