import json
import os
import signal
import subprocess
import sys

import numpy as np
import pytest
from typer.testing import CliRunner

from tactiled.build import sensor_plan
from tactiled.cli.app import app
from tactiled.config import load
from tactiled.errors import ConfigError, TactileError
from tactiled.restore.methods import METHODS
from tactiled.runtime.offline import PIECE, Offline, checked

SENSOR = """
[sensor.{name}]
bus = "can0"
refine = {refine}
codec = {{ name = "packed", bits = 12, fd = true }}
array = {{ rows = 8, columns = 6, pitch_mm = 1.0 }}
cover = {{ thickness_mm = 0.8, young_mpa = 0.6, poisson = 0.48 }}
kernel = {{ model = "layered" }}
calibration = {{ kpa_per_count = 0.5, no_load = 100, saturation = 400, dead = [0] }}
"""
BUS = '[bus.can0]\ninterface = "virtual"\nchannel = "x"\n'


@pytest.fixture
def config(tmp_path):
    def write(names=("palm",), refine=1):
        path = tmp_path / "tactiled.toml"
        path.write_text(BUS + "".join(SENSOR.format(name=name, refine=refine) for name in names))
        return path

    return write


@pytest.fixture
def film(tmp_path):
    """A file of frames: a press that comes and goes, with noise of 0.5 kPa."""

    def write(frames=40, dtype=np.float32, name="frames.npy", shape=(8, 6)):
        random = np.random.default_rng(0)
        clean = np.zeros((frames, *shape))
        clean[:, 3:5, 2:4] = 60 * np.abs(np.sin(np.arange(frames) / 20))[:, None, None]
        path = tmp_path / name
        np.save(path, (clean + random.normal(0, 0.5, clean.shape)).astype(dtype))
        return path

    return write


def run(*arguments):
    return CliRunner().invoke(app, ["restore", *map(str, arguments)], catch_exceptions=True)


def refused(*arguments):
    error = run(*arguments).exception
    assert isinstance(error, TactileError), error
    assert "\n" not in str(error)
    return str(error)


@pytest.mark.parametrize("method", METHODS)
def test_a_film_is_restored_and_told(config, film, tmp_path, method):
    out, stats = tmp_path / "out.npy", tmp_path / "stats.json"
    options = ("--config", config(), "--method", method, "--noise", "0.5", "--stats", stats)
    result = run(film(PIECE + 9), "-o", out, *options)
    assert result.exit_code == 0, result.output
    images, told = np.load(out), json.loads(stats.read_text())
    assert images.shape == (PIECE + 9, 8, 6)
    assert images.dtype == np.float32
    assert np.isfinite(images).all()
    assert len(told) == len(images)
    assert all(set(each) == {"method", "why", "iterations", "microseconds"} for each in told)
    assert all(each["microseconds"] > 0 and each["why"] for each in told)
    if method != "auto":
        fallback = {"nnls"} if method == "points" else set()  # where a fit does not stand
        assert method in {each["method"] for each in told} <= {method} | fallback
    assert not list(tmp_path.glob("*.part"))


@pytest.mark.parametrize("dtype", [np.float64, np.float16, np.int16])
def test_any_real_numbers_will_do_and_the_noise_is_measured(config, film, tmp_path, dtype):
    result = run(film(dtype=dtype), "-o", tmp_path / "out.npy", "--config", config(), "--sensor", "palm")
    assert result.exit_code == 0, result.output
    assert np.load(tmp_path / "out.npy").shape == (40, 8, 6)


def test_the_measured_noise_is_the_noise(config, film):
    plan = sensor_plan("palm", load(config()).sensor["palm"])
    assert Offline(plan).begin(np.load(film(200))) == pytest.approx(0.5, rel=0.1)


@pytest.mark.parametrize(("step", "given"), [(0.5, 0.5 / 12**0.5), (1.0, 0.5 / 12**0.5), (1e-4, 0.05)])
def test_rounding_is_noise(config, film, step, given):
    """Most taxels of a quiet film stay at one count: it seemed to have a noise of 1e-4 of its highest pressure."""
    plan = sensor_plan("palm", load(config()).sensor["palm"])
    frames = np.round(0.1 * np.load(film(60)) / step) * step
    frames[0, 0, :2] = np.nan, 1e30
    assert Offline(plan).begin(frames.astype(np.float32)) == pytest.approx(given, rel=0.1)


def test_a_beginning_without_a_touch_is_not_rounding(config, film):
    """All zero, it was taken for values rounded to 1 kPa, and a faint film came out empty."""
    plan = sensor_plan("palm", load(config()).sensor["palm"])
    frames = np.load(film(200))
    noise = Offline(plan).begin(frames)
    frames[:40] = 0
    assert Offline(plan).begin(1e-3 * frames) == pytest.approx(1e-3 * noise, rel=0.2)


def test_what_is_no_path_is_named(config, film, tmp_path):
    loop = tmp_path / "loop"
    loop.symlink_to(loop)
    path = film()
    for name in ("x" * 300, loop):
        for option, other in (("-o", "--stats"), ("--stats", "-o")):
            told = run(path, option, name, other, tmp_path / "y", "--config", config()).exception
            assert isinstance(told, ConfigError), told
            assert str(name) in str(told)


def test_a_finer_surface_makes_larger_images(config, film, tmp_path):
    assert run(film(), "-o", tmp_path / "out.npy", "--config", config(refine=2)).exit_code == 0
    assert np.load(tmp_path / "out.npy").shape == (40, 16, 12)


def test_dead_saturated_and_unknown_taxels_are_not_believed(config, film, tmp_path):
    path = film()
    frames = np.load(path)
    frames[:, 3:5, 2:4] = 150  # (400 - 100) * 0.5: the ceiling
    expected = frames.copy()
    frames[:, 0, 0], frames[:, 7, 5] = 1e30, np.nan
    np.save(path, frames)
    assert run(path, "-o", tmp_path / "a.npy", "--config", config(), "--noise", 0.5).exit_code == 0
    expected[:, 0, 0] = -50
    expected[:, 7, 5] = np.inf
    np.save(path, expected)
    assert run(path, "-o", tmp_path / "b.npy", "--config", config(), "--noise", 0.5).exit_code == 0
    np.testing.assert_array_equal(np.load(tmp_path / "a.npy"), np.load(tmp_path / "b.npy"))


def test_no_frames_and_empty_frames_are_no_error(config, film, tmp_path):
    assert run(film(0), "-o", tmp_path / "out.npy", "--config", config(), "--stats", tmp_path / "s").exit_code == 0
    assert np.load(tmp_path / "out.npy").shape == (0, 8, 6)
    assert json.loads((tmp_path / "s").read_text()) == []
    np.save(tmp_path / "zeros.npy", np.zeros((5, 8, 6)))
    assert run(tmp_path / "zeros.npy", "-o", tmp_path / "out.npy", "--config", config()).exit_code == 0
    assert not np.load(tmp_path / "out.npy").any()


def test_the_film_may_be_written_over(config, film):
    path = film()
    assert run(path, "-o", path, "--config", config(), "--method", "nnls").exit_code == 0
    assert np.load(path).min() >= 0


def test_what_is_read_is_never_written_over_by_accident(config, film, tmp_path):
    """Told to write what it did over the frames, the command emptied them."""
    path, settings, out = film(), config(), tmp_path / "out.npy"
    link = tmp_path / "link"
    link.symlink_to(path)
    before = path.read_bytes(), settings.read_bytes()
    for stats, other in ((link, "FRAMES"), (settings, "--config"), (out, "--out")):
        said = refused(path, "-o", out, "--config", settings, "--stats", stats)
        assert said == f"--stats {stats}: is {other}, too: give another file"
    assert "is --config, too" in refused(path, "-o", settings, "--config", settings)
    assert (path.read_bytes(), settings.read_bytes()) == before
    assert not out.exists()


def test_only_plain_files_are_written(config, film, tmp_path):
    """A pipe was replaced by a file, and so was /dev/null."""
    pipe, out = tmp_path / "pipe", tmp_path / "out.npy"
    os.mkfifo(pipe)
    assert "pipe: no plain file: give a file" in refused(film(), "-o", pipe, "--config", config())
    assert "pipe: no plain file" in refused(film(), "-o", out, "--config", config(), "--stats", pipe)
    assert pipe.is_fifo()
    assert not out.exists()


def test_a_link_is_written_through(config, film, tmp_path):
    link, out = tmp_path / "link.npy", tmp_path / "out.npy"
    link.symlink_to(out)
    assert run(film(), "-o", link, "--config", config()).exit_code == 0
    assert link.is_symlink()
    assert np.load(out).shape == (40, 8, 6)


@pytest.fixture
def kept(tmp_path):
    """Answers of an earlier run: a command that fails leaves them as they are, and nothing beside them."""
    files = [tmp_path / "out.npy", tmp_path / "stats.json"]
    for file in files:
        file.write_text("earlier")
    yield files
    assert [file.read_text() for file in files] == ["earlier", "earlier"]
    assert not list(tmp_path.glob("*.part"))


@pytest.mark.parametrize("sent", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_command_leaves_nothing_half_written(config, film, kept, monkeypatch, sent):
    once = Offline._one

    def one(self, *arguments):
        signal.raise_signal(sent)
        return once(self, *arguments)

    monkeypatch.setattr(Offline, "_one", one)
    before = signal.getsignal(sent)
    assert run(film(9), "-o", kept[0], "--config", config(), "--stats", kept[1]).exit_code == 130
    assert signal.getsignal(sent) is before


def test_a_failed_command_leaves_no_stats_of_half_a_film(config, film, kept):
    """They were begun before it was known whether images could be written."""
    assert "no/out.npy" in refused(film(), "-o", "/no/out.npy", "--config", config(), "--stats", kept[1])


def test_memory_does_not_grow_with_the_film(config, tmp_path):
    """A film of 23 MB, in a process that may grow by a third of it over what a short film takes."""
    path = tmp_path / "long.npy"
    film = np.lib.format.open_memmap(path, "w+", np.float32, (120_000, 8, 6))
    short = tmp_path / "short.npy"
    np.save(short, np.zeros((4 * PIECE, 8, 6), np.float32))
    size = film.nbytes
    del film
    code = (
        "import resource, sys, tactiled.cli; from tactiled.cli.app import app; "
        "app(sys.argv[1:], standalone_mode=False); "
        "print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024)"
    )
    used = []
    for each in (short, path):
        arguments = ("restore", each, "-o", tmp_path / "out.npy", "--config", config(), "--noise", "1")
        command = [sys.executable, "-c", code, *map(str, arguments)]
        result = subprocess.run(command, capture_output=True, text=True, check=True)
        used.append(int(result.stdout.split()[-1]))
    assert size >= 23e6
    assert used[1] - used[0] < size / 3


def several(path):
    np.savez(path.with_suffix(".npz"), a=np.zeros(3))
    path.with_suffix(".npz").replace(path)


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda path: path.unlink(), "frames.npy: No such file"),
        (lambda path: path.write_text("not numbers"), "frames.npy: no .npy file"),
        (lambda path: path.write_bytes(b""), "frames.npy: no .npy file"),
        (lambda path: np.save(path, np.zeros((8, 6))), r"shape (8, 6) for sensor palm: give (T, 8, 6)"),
        (lambda path: np.save(path, np.zeros((9, 6, 8))), r"shape (9, 6, 8) for sensor palm: give (T, 8, 6)"),
        (lambda path: np.save(path, np.zeros((2, 8, 6), complex)), "dtype complex128: give real numbers"),
        (lambda path: np.save(path, np.zeros((2, 8, 6), bool)), "dtype bool: give real numbers"),
        (lambda path: np.save(path, np.full((2, 8, 6), None)), "no .npy file of numbers"),
        (several, "several arrays in one file"),
    ],
)
def test_frames_that_are_none_are_refused_in_a_line(config, film, tmp_path, spoil, said):
    path = film()
    spoil(path)
    assert said in refused(path, "-o", tmp_path / "out.npy", "--config", config())
    assert not (tmp_path / "out.npy").exists()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--noise", "nan"), "noise = nan kPa: give a taxel's standard deviation"),
        (("--noise", "0"), "noise = 0.0 kPa"),
        (("--noise", "-1"), "noise = -1.0 kPa"),
        (("--noise", "inf"), "noise = inf kPa"),
        (("--method", "sharpen"), "method = 'sharpen': no such method: choose one of auto"),
        (("--sensor", "sole"), "--sensor sole: no such sensor: choose one of palm"),
        (("--stats", "/no/such/folder/s.json"), "s.json: No such file or directory: give a file"),
        (("-o", "/no/such/folder/out.npy"), "out.npy: No such file or directory: give a file"),
        (("--config", "/no/such.toml"), "/no/such.toml: No such file"),
    ],
)
def test_settings_that_are_wrong_are_refused_in_a_line(config, film, tmp_path, options, said):
    path = film()
    given = {"-o": tmp_path / "out.npy", "--config": config()} | dict([options])
    assert said in refused(path, *(word for pair in given.items() for word in pair))


def test_of_several_sensors_one_must_be_named(config, film, tmp_path):
    path = config(("palm", "sole"))
    assert "--sensor is missing: choose one of palm, sole" in refused(
        film(), "-o", tmp_path / "o.npy", "--config", path
    )
    assert run(film(), "-o", tmp_path / "o.npy", "--config", path, "--sensor", "sole").exit_code == 0


def test_frames_from_elsewhere_are_checked_alike(config):
    plan = sensor_plan("palm", load(config()).sensor["palm"])
    with pytest.raises(ConfigError, match=r"body: shape \(3, 3\)"):
        checked(np.zeros((3, 3)), plan, "body")
