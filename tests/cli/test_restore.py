import json
import os
import signal
import tracemalloc

import numpy as np
import pytest

from tactiled.build import sensor_plan
from tactiled.config import load
from tactiled.recorded.offline import PIECE_FRAMES, Offline, measured_noise, open_frames
from tactiled.restore.methods import METHODS
from tests.cli.commands import refusal, run, succeed

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
def plan(config):
    return sensor_plan("palm", load(config()).sensor["palm"])


def press(count):
    """Frames of a press that comes and goes, with noise of 0.5 kPa."""
    frames = np.random.default_rng(0).normal(0, 0.5, (count, 8, 6))
    frames[:, 3:5, 2:4] += 60 * np.abs(np.sin(np.arange(count) / 20))[:, None, None]
    return frames.astype(np.float32)


@pytest.fixture
def npy(tmp_path):
    """A file of frames."""

    def write(frames, name="frames.npy"):
        np.save(tmp_path / name, frames)
        return tmp_path / name

    return write


def restored(frames, config, *options):
    out = config.with_name("out.npy")
    succeed("restore", frames, "-o", out, "--config", config, *options)
    return np.load(out)


@pytest.mark.parametrize("method", METHODS)
def test_frames_are_restored_by_every_method(config, npy, tmp_path, method):
    stats, frames = tmp_path / "stats.json", npy(press(PIECE_FRAMES + 9))
    options = ("--method", method, "--noise", 0.5, "--stats", stats, "--sensor", "palm")
    images = restored(frames, config(), *options)
    assert (images.shape, images.dtype) == ((PIECE_FRAMES + 9, 8, 6), np.float32)
    assert np.isfinite(images).all()
    stories = json.loads(stats.read_text())
    assert len(stories) == len(images)
    assert all(set(each) == {"method", "why", "iterations", "microseconds"} for each in stories)
    assert all(each["microseconds"] > 0 and each["why"] for each in stories)
    if method != "auto":
        fallback = {"nnls"} if method == "points" else set()  # where a fit is refused
        assert method in {each["method"] for each in stories} <= {method} | fallback
    assert not list(tmp_path.glob(".tactiled-*"))


@pytest.mark.parametrize(
    ("dtype", "refine", "shape"), [(np.float64, 2, (16, 12)), (np.float16, 1, (8, 6)), (np.int16, 1, (8, 6))]
)
def test_any_real_numbers_are_accepted_and_a_finer_surface_makes_larger_images(config, npy, dtype, refine, shape):
    assert restored(npy(press(40).astype(dtype)), config(refine=refine)).shape == (40, *shape)


def test_a_csv_and_the_array_in_options_need_no_configuration(config, npy, tmp_path):
    frames = press(20)
    frames[3, 2, 2] = np.nan
    text = "\n".join(",".join("" if np.isnan(each) else f"{each:.9g}" for each in one.ravel()) for one in frames)
    path = tmp_path / "frames.csv"
    names = ",".join(f"t{n}" for n in range(48))
    path.write_text(f"{names}\n{text}\n", "utf-8-sig")
    plain = ("--grid", "8x6", "--pitch", 1.0, "--layer", "0.8,0.6,0.48", "--noise", 0.5)
    by = {}
    for one in (path, npy(frames)):
        out = tmp_path / f"{one.suffix}.npy"
        succeed("restore", one, "-o", out, *plain)
        by[one.suffix] = np.load(out)
    np.testing.assert_array_equal(by[".csv"], by[".npy"])
    exact = restored(path, config(), "--noise", 0.5)  # whose kernel is the exact one, and which has a dead taxel
    np.testing.assert_allclose(by[".csv"][15, 2:6, 2:4], exact[15, 2:6, 2:4], rtol=0.05)
    path.write_text(f"{names}\n{text},7\n")
    refused = refusal("restore", path, "-o", tmp_path / "no.npy", *plain)
    assert "frames.csv: line 21: 49 fields: give 48, one for each taxel of sensor frames" in refused
    path.write_text(text + "\n" + ",".join(["x"] * 48))
    assert "line 21: could not convert" in refusal("restore", path, "-o", tmp_path / "no.npy", *plain)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ((), "--grid is missing: give --config, or --grid, --pitch and --layer"),
        (("--grid", "8", "--pitch", 1, "--layer", "1,1,.4"), "--grid 8: give ROWSxCOLUMNS"),
        (("--grid", "8x6", "--pitch", 1, "--layer", "1,1"), "--layer 1,1: give T,E,NU"),
        (("--grid", "8x6", "--pitch", 1, "--layer", "1,1,.6"), "options: sensor.frames.cover[0].poisson = 0.6"),
        (("--config", "x.toml", "--pitch", 1), "--pitch: --config says it"),
    ],
)
def test_an_array_that_options_do_not_describe_is_refused(npy, tmp_path, options, words):
    assert words in refusal("restore", npy(press(2)), "-o", tmp_path / "o.npy", *options)


def test_the_noise_is_measured(plan):
    frames = press(200)
    noise = Offline(plan, frames).noise_kpa
    assert noise == pytest.approx(0.5, rel=0.1)
    frames[:40] = 0  # a beginning without a touch is not rounding
    assert Offline(plan, 1e-3 * frames).noise_kpa == pytest.approx(1e-3 * noise, rel=0.2)


@pytest.mark.parametrize(("step", "noise"), [(0.5, 0.5 / 12**0.5), (1.0, 1 / 12**0.5), (1e-4, 0.05)])
def test_rounding_is_noise(plan, step, noise):
    """Most taxels of quiet frames stay at one count, which looks like less noise than rounding has."""
    frames = np.round(0.1 * press(60) / step) * step
    frames[0, 0, :2] = np.nan, 1e30
    assert Offline(plan, frames.astype(np.float32)).noise_kpa == pytest.approx(noise, rel=0.1)


def test_dead_saturated_and_unknown_taxels_are_ignored(config, npy):
    frames = press(40)
    frames[:, 3:5, 2:4] = 150  # (400 - 100) * 0.5: the ceiling
    other = frames.copy()
    frames[:, 0, 0], frames[:, 7, 5] = 1e30, np.nan
    other[:, 0, 0], other[:, 7, 5] = -50, np.inf
    frames[:, 2, 1], other[:, 2, 1] = 1e20, 2e9  # past any sensor
    one, two = (restored(npy(each), config(), "--noise", 0.5) for each in (frames, other))
    np.testing.assert_array_equal(one, two)


def test_no_frames_and_empty_frames_are_no_error(config, npy, tmp_path):
    assert restored(npy(press(0)), config(), "--stats", tmp_path / "s").shape == (0, 8, 6)
    assert json.loads((tmp_path / "s").read_text()) == []
    assert not restored(npy(np.zeros((5, 8, 6))), config()).any()


def test_images_may_replace_their_frames_but_no_other_file_is_replaced(config, npy, tmp_path):
    path, settings, out, link = npy(press(40)), config(), tmp_path / "out.npy", tmp_path / "link"
    link.symlink_to(path)
    before = path.read_bytes(), settings.read_bytes()
    for stats, other in ((link, "FRAMES"), (settings, "--config"), (out, "--out")):
        message = refusal("restore", path, "-o", out, "--config", settings, "--stats", stats)
        assert message == f"--stats {stats}: is {other}, too: give another file"
    assert "is --config, too" in refusal("restore", path, "-o", settings, "--config", settings)
    assert (path.read_bytes(), settings.read_bytes()) == before
    assert not out.exists()
    succeed("restore", path, "-o", path, "--config", settings, "--method", "nnls")
    assert np.load(path).min() >= 0


def test_only_plain_files_and_links_to_them_are_written(config, npy, tmp_path):
    frames = npy(press(40))
    pipe, out, link, loop = (tmp_path / name for name in ("pipe", "out.npy", "link", "loop"))
    os.mkfifo(pipe)
    link.symlink_to(out)
    loop.symlink_to(loop)
    for bad, message in ((pipe, "pipe: no plain file: give a file"), ("x" * 300, "x" * 300), (loop, str(loop))):
        for option, other in (("-o", "--stats"), ("--stats", "-o")):
            command = (frames, option, bad, other, out, "--config", config())
            assert message in refusal("restore", *command)
            assert not out.exists()
    assert pipe.is_fifo()
    succeed("restore", frames, "-o", link, "--config", config())
    assert link.is_symlink()
    assert np.load(out).shape == (40, 8, 6)


@pytest.fixture
def earlier(tmp_path):
    """Answers of an earlier run: a command that fails leaves them as they are, and nothing beside them."""
    files = [tmp_path / "out.npy", tmp_path / "stats.json"]
    for file in files:
        file.write_text("earlier")
    yield files
    assert [file.read_text() for file in files] == ["earlier", "earlier"]
    assert not list(tmp_path.glob(".tactiled-*"))


@pytest.mark.parametrize("kind", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_command_leaves_nothing_half_written(config, npy, earlier, monkeypatch, kind):
    once = Offline._restore

    def one(self, *arguments):
        signal.raise_signal(kind)
        return once(self, *arguments)

    monkeypatch.setattr(Offline, "_restore", one)
    before = signal.getsignal(kind)
    done = run("restore", npy(press(9)), "-o", earlier[0], "--config", config(), "--stats", earlier[1])
    assert done.exit_code == 130
    assert signal.getsignal(kind) is before


def test_memory_does_not_grow_with_the_frames(plan, tmp_path):
    frames = np.lib.format.open_memmap(tmp_path / "long.npy", "w+", np.float32, (30_000, 8, 6))
    frames.flush()
    offline = Offline(plan, open_frames(tmp_path / "long.npy", plan), "auto", 1.0)
    tracemalloc.start()
    offline.write(tmp_path / "out.npy")
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < frames.nbytes / 3


def several_arrays(path):
    np.savez(path.with_suffix(".npz"), a=np.zeros(3))
    path.with_suffix(".npz").replace(path)


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda path: path.unlink(), "frames.npy: No such file"),
        (lambda path: path.write_text("not numbers"), "frames.npy: no complete .npy file"),
        (lambda path: np.save(path, np.zeros((8, 6))), r"shape (8, 6) for sensor palm: give (T, 8, 6)"),
        (lambda path: np.save(path, np.zeros((9, 6, 8))), r"shape (9, 6, 8) for sensor palm: give (T, 8, 6)"),
        (lambda path: np.save(path, np.zeros((2, 8, 6), bool)), "dtype bool: give real numbers"),
        (lambda path: np.save(path, np.full((2, 8, 6), None)), "no complete .npy file of numbers"),
        (lambda path: path.write_bytes(path.read_bytes()[:-9]), "no complete .npy file of numbers"),
        (several_arrays, "several arrays in one file"),
    ],
)
def test_wrong_frames_are_refused(config, npy, tmp_path, spoil, message):
    path = npy(press(9))
    spoil(path)
    assert message in refusal("restore", path, "-o", tmp_path / "out.npy", "--config", config())
    assert not (tmp_path / "out.npy").exists()


def test_wrong_options_are_refused(config, npy, tmp_path, earlier):
    frames, settings = npy(press(9)), config(("palm", "sole"))
    for option, value, message in (
        ("--noise", "nan", "noise = nan: give a taxel's standard deviation"),
        ("--method", "sharpen", "method = 'sharpen': no such method: choose one of auto"),
        ("--sensor", "toe", "--sensor toe: no such sensor: choose one of palm, sole"),
        ("-o", "/no/out.npy", "/no/out.npy: No such file or directory: nothing is written"),
        ("--stats", "/no/s.json", "s.json: No such file or directory: nothing is written"),
    ):
        options = {"-o": earlier[0], "--config": settings, "--sensor": "palm", "--stats": earlier[1]}
        options[option] = value
        assert message in refusal("restore", frames, *(word for pair in options.items() for word in pair))
    message = refusal("restore", frames, "-o", tmp_path / "o.npy", "--config", settings)
    assert message == "--sensor is missing: choose one of palm, sole"


def test_the_noise_is_that_of_the_frames_that_have_data():
    frames = press(2000)
    frames[:1500] = np.nan
    assert measured_noise(frames, ()) == pytest.approx(0.5, rel=0.1)
