"""Many inputs at once: the bytes of one at a time, in any process, and no work twice."""

import os
import signal
import subprocess
from pathlib import Path

import numpy as np
import pytest

from tactiled.archive import batch
from tactiled.archive.jobs import RestoreJob
from tactiled.archive.places import place
from tactiled.config import load
from tests.archive.test_places import MEMORY, memory  # noqa: F401  # a fixture
from tests.bus.skins import CONFIG, DBC, GRID
from tests.cli.commands import TACTILED, refusal, run, succeed
from tests.cli.recordings import traffic, write
from tests.conftest import BUSY_S, until


@pytest.fixture
def recordings(tmp_path, monkeypatch):
    """A folder of three short recordings that are not the same."""
    monkeypatch.setattr("tests.cli.recordings.FRAMES", 12)
    for number in range(3):
        (tmp_path / "in" / "day").mkdir(parents=True, exist_ok=True)
        write(tmp_path / "in" / "day" / f"r{number}.log", traffic(missing={(7 + number, 0)}))
    return tmp_path / "in"


def contents(folder):
    """All files of a folder but records, by name."""
    files = (each for each in Path(folder).rglob("*") if each.is_file() and each.suffix != ".tactiled")
    return {str(each.relative_to(folder)): each.read_bytes() for each in files}


def one_by_one(recordings, config, ending):
    """The files of three single exports."""
    folder = recordings.parent / "single"
    (folder / "day").mkdir(parents=True)
    for each in recordings.rglob("*.log"):
        succeed("export", each, "--config", config, "-o", folder / "day" / f"{each.stem}{ending}")
    return contents(folder)


def export(recordings, config, *options, out="out/{}.npz"):
    done = run("export", recordings, "--config", config, "-o", recordings.parent / out, *options)
    return done.exit_code, done.stdout.strip(), done.stderr


@pytest.mark.parametrize("ending", [".mcap", ".zarr", ".h5"])
def test_several_exports_have_the_bytes_of_single_ones(recordings, config, ending):
    code, summary, lines = export(recordings, config, out=f"out/{{}}{ending}")
    assert (code, summary) == (0, "3 written, 0 complete before, 0 failed")
    assert f"2/3 {recordings.parent}/out/day/r1{ending}: 12 frames of palm from 35 messages in " in lines
    assert contents(recordings.parent / "out") == one_by_one(recordings, config, ending)


def test_complete_outputs_are_skipped_and_all_others_written_again(recordings, config, monkeypatch):
    out, log = recordings.parent / "out" / "day", recordings / "day" / "r0.log"
    before = export(recordings, config) and contents(out)

    def written():
        code, summary, lines = export(recordings, config)
        assert code == 0
        assert [line.split("/")[-1] for line in lines.splitlines() if line.endswith(": complete")] == [
            f"r{n}.npz: complete" for n in range(3) if f"r{n}.npz: 12 frames" not in lines
        ]
        return int(summary[0])

    assert written() == 0
    (out / "r1.npz").unlink()
    (out / "r2.npz").write_bytes(before["r2.npz"][:-1])
    assert (written(), contents(out), written()) == (2, before, 0)
    (out / ".r1.npz.tactiled").write_text('{"digest')  # cut off
    assert (written(), contents(out), written()) == (1, before, 0)
    log.write_text(log.read_text() + "(1600000001.0) can0 077#02\n")
    assert (written(), written()) == (1, 0)
    config.write_text(config.read_text().replace("thickness_mm = 0.8", "thickness_mm = 0.7"))
    assert (written(), written()) == (3, 0)
    monkeypatch.setattr(batch, "__version__", "0.0.0")
    assert (written(), written()) == (3, 0)


def test_outputs_are_of_the_content_of_the_codecs_file(tmp_path):
    path = tmp_path / "a.toml"
    path.write_text(
        CONFIG.format(
            codec=f'name = "dbc", file = "skin.dbc", taxels = {list(GRID)}',
            array="rows = 2, columns = 3, pitch_mm = 4.0",
        )
    )
    settings = []
    for content in (DBC.read_bytes(), DBC.read_bytes() + b"\n"):
        (tmp_path / "skin.dbc").write_bytes(content)
        settings.append(RestoreJob.of(path, load(path), "skin").settings())
    assert settings[0] != settings[1]


def test_what_fails_or_is_somebody_elses_stops_no_other(recordings, config):
    out = recordings.parent / "out" / "day"
    out.mkdir(parents=True)
    (out / "r0.npz").write_text("precious")
    (recordings / "day" / "r1.log").write_text("no candump\n")
    code, summary, lines = export(recordings, config)
    assert (code, summary) == (2, "1 written, 0 complete before, 2 failed")
    assert f"1/3 failed: {out}/r0.npz is there already: name another file" in lines
    assert "2/3 failed: recording " in lines
    assert ((out / "r0.npz").read_text(), sorted(contents(out))) == ("precious", ["r0.npz", "r2.npz"])
    assert not list(out.glob(".tactiled-*"))


def test_a_folder_needs_more_than_one_output(recordings, config):
    text = refusal("export", recordings, "--config", config, "-o", "a.npz")
    assert text == "--out a.npz: is one file for a folder: put {} where the names of its files go"


def test_from_memory_to_memory(recordings, config, memory):  # noqa: F811
    memory.put(str(recordings), "/in", recursive=True)
    summaries = [
        run("export", "memory://in", "--config", config, "-o", "memory://out/{}.npz").stdout for _ in range(2)
    ]
    assert summaries == ["3 written, 0 complete before, 0 failed\n", "0 written, 3 complete before, 0 failed\n"]
    single = one_by_one(recordings, config, ".npz")
    for name, content in single.items():
        assert MEMORY.cat(f"/out/{name}") == content
        assert MEMORY.exists(f"/out/day/.{Path(name).name}.tactiled")
    assert len(MEMORY.find("/out")) == 6
    succeed("export", "memory://in/day/r1.log", "--config", config, "-o", "memory://one.npz")
    assert MEMORY.cat("/one.npz") == single["day/r1.npz"]


def test_frames_of_several_files_are_restored_by_a_scheduler_that_is_there(tmp_path, config):
    from distributed import LocalCluster  # 1 s, of the process alone that runs this test

    (tmp_path / "in").mkdir()
    for number in range(3):
        frames = np.random.default_rng(number).normal(0, 0.5, (40, 8, 8)) + 60 * (np.arange(64) == 27).reshape(
            8, 8
        )
        np.save(tmp_path / "in" / f"f{number}.npy", frames.astype(np.float32))
        succeed("restore", tmp_path / f"in/f{number}.npy", "--config", config, "-o", tmp_path / f"f{number}.npy")
    command = "restore", tmp_path / "in", "--config", config, "-o", tmp_path / "out" / "{}.npy", "--noise"
    with LocalCluster(1, threads_per_worker=2, processes=False, protocol="tcp", dashboard_address=None) as cluster:
        command = (*command[:-1], "--scheduler", cluster.scheduler_address)
        assert succeed(*command).startswith("1/3 ")
        assert "0 written, 3 complete before, 0 failed" in succeed(*command)
        assert contents(tmp_path / "out") == {f"f{n}.npy": (tmp_path / f"f{n}.npy").read_bytes() for n in range(3)}
        assert "3 written" in succeed(*command, "--noise", 0.5)
        other = batch.process(None, batch.Task(place("a"), place("b")), "", "0.0.0")
    assert other == ("failed", f"a worker has tactiled {batch.__version__}, not 0.0.0: install the same")
    assert f"--scheduler {cluster.scheduler_address}: " in refusal(*command)


def writing(folder, parent):
    """Processes that were started by `parent` and have a file in a folder open."""
    for process in Path("/proc").glob("[0-9]*"):
        try:
            mine = f"PPid:\t{parent}\n" in (process / "status").read_text()
            if mine and any(f"{folder}/" in str(each.readlink()) for each in (process / "fd").iterdir()):
                yield int(process.name)
        except OSError:  # it has ended
            continue


def test_a_worker_killed_in_the_middle_costs_time_alone(recordings, config, monkeypatch):
    monkeypatch.setattr("tests.cli.recordings.FRAMES", 60)
    for number in range(3, 5):
        write(recordings / "day" / f"r{number}.log", traffic(missing={(7 + number, 0)}))
    out = recordings.parent / "out"
    command = [*TACTILED, "export", recordings, "--config", config, "-o", out / "{}.npz", "--workers", "1"]
    with subprocess.Popen(
        [*map(str, command)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:

        def killed():
            assert process.poll() is None, process.communicate()
            for worker in writing(out, process.pid):
                os.kill(worker, signal.SIGSTOP)
                middle = worker in writing(out, process.pid)
                os.kill(worker, signal.SIGKILL if middle else signal.SIGCONT)
                if middle:
                    return True
            return False

        until(killed, 2 * BUSY_S)
        stdout, stderr = process.communicate(timeout=2 * BUSY_S)
    assert (process.returncode, stdout) == (0, "5 written, 0 complete before, 0 failed\n"), stderr
    assert contents(out) == one_by_one(recordings, config, ".npz")
