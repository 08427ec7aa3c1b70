"""`tactiled calibrate cover` on recordings of a simulated skin of 12 x 12 taxels, 12 bits."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from tactiled.build import make_array, make_codec, make_stack
from tactiled.calibrate import calibration_file
from tactiled.calibrate.cover.unknowns import Unknowns
from tactiled.cli import calibrate_cover
from tactiled.cli.calibrate_cover import _lines
from tactiled.config import parse
from tests.calibrate.files import calibration_file as configured
from tests.calibrate.files import cover_section, gain_section
from tests.cli.commands import refusal, run, succeed
from tests.cli.recordings import write
from tests.touched import World, recorded, rubber

THICKNESS = 1.0
TEXT = """
[bus.can0]
interface = "socketcan"
channel = "gone0"
fd = true
[sensor.palm]
bus = "can0"
codec = { name = "packed", bits = 12, fd = true }
array = { rows = 12, columns = 12, pitch_mm = 1.0 }
cover = { thickness_mm = 1.25, young_mpa = 0.6, poisson = 0.49 }
substrate = { thickness_mm = 1.6, young_mpa = 20000.0, poisson = 0.2 }
calibration = { kpa_per_count = 0.05, no_load = 100 }
"""
PALM = parse(TEXT).sensor["palm"]
ARRAY, CODEC = make_array(PALM), make_codec(PALM)
FILE = configured(144, gain=gain_section(np.full(144, 0.05)), cover=cover_section())


@cache
def world():
    return World(ARRAY, rubber(THICKNESS))


@pytest.fixture
def config(tmp_path):
    path = tmp_path / "palm.toml"
    path.write_text(TEXT)
    return path


def recording(path, pressures, random):
    """Frames at 100 Hz of a skin whose gains nobody calibrated, alike to 1 %."""
    gains = 1 + 0.01 * random.normal(size=ARRAY.size)
    frames = recorded(pressures * gains, random, noise=0.5)
    counts = np.clip(np.round(frames / 0.05 + 100), 0, CODEC.full_scale).astype(np.uint16)
    messages = (each for number, frame in enumerate(counts) for each in CODEC.encode(frame, number, 0.01 * number))
    return write(path, messages)


@pytest.fixture(scope="module")
def tips(tmp_path_factory):
    """Six presses with a tip of 1.6 mm, and the file of their places."""
    random = np.random.default_rng(9)
    places = world().places(6, random)
    folder = tmp_path_factory.mktemp("tips")
    rows = "\n".join(f"{x:.2f},{y:.2f}" for x, y in places)
    (folder / "places.csv").write_text(f"x_mm,y_mm\n{rows}\n", "utf-8-sig")  # as spreadsheets write it
    path = recording(folder / "tips.log", np.array([world().tip(0.8, each) for each in places]), random)
    return path, folder / "places.csv"


def test_presses_with_a_tip_become_a_section_of_the_calibration_file(config, tips, tmp_path):
    log, places = tips
    out, chart = tmp_path / "palm.json", tmp_path / "line.svg"
    arguments = ("calibrate", "cover", log, "--config", config, "--out", out, "--tip-mm", 1.6)
    lines = succeed(*arguments, "--places", places, "--plot", chart).splitlines()
    section = calibration_file.load(out).cover
    assert section.method == "tip"
    assert section.presses == 6
    assert section.thickness_mm == pytest.approx(THICKNESS, rel=0.05)
    assert section.interval_mm[0] < THICKNESS < section.interval_mm[1]
    assert section.origin.method == "cover: tip"
    assert lines[0] == "palm: cover by tip"
    assert lines[1].startswith(f"  thickness  {section.thickness_mm:.4g} mm (95 %: ")
    assert lines[1].endswith("configured 1.25 mm")
    assert "<svg" in chart.read_text()
    assert lines[1].split("  ")[-1].split("; ")[0] in succeed("calibrate", "show", out)


def test_an_edge_is_fitted(config, tmp_path):
    random = np.random.default_rng(10)
    edges = [world().edge(np.radians(90 * n + 20), 0.7 * n - 0.5, beyond=False) for n in range(3)]
    out = tmp_path / "palm.json"
    log = recording(tmp_path / "edges.log", np.array(edges), random)
    printed = succeed("calibrate", "cover", log, "--config", config, "--out", out, "--edge")
    section = calibration_file.load(out).cover
    assert (section.method, section.presses) == ("edge", 3)
    assert section.thickness_mm == pytest.approx(THICKNESS, rel=0.06)
    assert printed.endswith(f"{out}: written; give it as calibration.file of the sensor\n")


def test_a_cover_of_other_layers_is_fitted_again_and_a_gain_beside_it_is_refused(config, tips, tmp_path):
    out = tmp_path / "palm.json"
    calibration_file.save(out, FILE)
    arguments = (tips[0], "--config", config, "--out", out)
    line = refusal("calibrate", "gain", *arguments, "--weight-n", 1)
    assert line.startswith(
        f"{out}: cover was fitted with 0.8 mm 0.6 MPa 0.48 ‖ base, and the configuration has 1.25"
    )
    assert line.endswith(" MPa 0.2: fit it again")
    succeed("calibrate", "cover", *arguments, "--tip-mm", 1.6)
    made = calibration_file.load(out)
    assert made.gain == FILE.gain
    assert made.cover.thickness_mm == pytest.approx(THICKNESS, rel=0.05)


def test_another_file_begins_with_the_configured_one(config, tips, tmp_path, monkeypatch):
    fit = cover_section(0.8, make_stack(PALM)).fit
    monkeypatch.setattr(calibrate_cover, "fit_touch", lambda *_: fit)
    calibration_file.save(tmp_path / "palm.json", FILE)
    config.write_text(TEXT.replace("kpa_per_count = 0.05", 'file = "palm.json"'))
    out = tmp_path / "other.json"
    succeed("calibrate", "cover", tips[0], "--config", config, "--out", out, "--tip-mm", 1.6)
    made = calibration_file.load(out)
    assert (made.gain, made.cover.factor) == (FILE.gain, 0.8)


@pytest.mark.parametrize(("measured", "end"), [(True, ""), (False, ", not kept: give --measured")])
def test_a_kernel_that_is_not_kept_is_called_so(measured, end):
    section = cover_section(kernel=np.array([[0, 1, 2, 3], [1, 0.9, 0.5, 0.1]]))
    assert _lines(section.fit, section.stack, measured)[-1] == f"  kernel     measured at 4 frequencies{end}"


def test_what_the_presses_refuse_is_written_only_if_asked_for(config, tips, tmp_path, monkeypatch):
    section, unknowns = cover_section(0.8, make_stack(PALM)), []

    def fit_touch(*arguments):
        unknowns.append(arguments[-1])
        return replace(section.fit, objection="the edge is not sharp: use a tip", kernel=np.ones((2, 4)))

    monkeypatch.setattr(calibrate_cover, "fit_touch", fit_touch)
    out = tmp_path / "palm.json"
    arguments = ("calibrate", "cover", tips[0], "--config", config, "--out", out, "--edge")
    refused = run(*arguments, "--error", "aperture_mm=0.05", "--error", "poisson=0.01")
    assert refused.exception.args[0] == (
        "cover: the edge is not sharp: use a tip; nothing is written (--doubtful writes it)"
    )
    assert refused.output.startswith("palm: cover by tip")
    assert unknowns[0] == Unknowns(aperture_mm=0.05, poisson=0.01)
    assert not out.exists()
    succeed(*arguments, "--doubtful")
    assert calibration_file.load(out).cover.factor == section.factor


def test_deviations_are_named_and_above_0(config, tips, tmp_path):
    arguments = ("calibrate", "cover", tips[0], "--config", config, "--out", tmp_path / "palm.json", "--tip-mm", 1)
    for bad in ("width=1", "size_mm", "poisson=-1", "size_mm=nan"):
        names = "size_mm, aperture_mm, poisson, curvature, profile"
        line = f"--error {bad}: give NAME=VALUE with a number over 0; names: {names}"
        assert refusal(*arguments, "--error", bad) == line


def test_what_cannot_be_fitted_is_refused_in_one_line_and_nothing_is_written(config, tips, tmp_path):
    log, places = tips
    out = tmp_path / "palm.json"
    base = ("calibrate", "cover", log, "--config", config, "--out", out)
    assert refusal(*base) == "give one of --tip-mm, --edge (or --edge-mm) and --blind"
    assert refusal(*base, "--edge", "--tip-mm", 1) == refusal(*base)
    for option, size, highest in (
        ("--tip-mm", "0.0016", 100),
        ("--tip-mm", "nan", 100),
        ("--edge-mm", "-1", 1000),
    ):
        assert refusal(*base, option, size) == f"{option} {size}: give 0.05 to {highest} mm"
    for text in ("x,y\n1,2\n", "x_mm,y_mm\n1,2\n1\n", "x_mm,y_mm\n1,nan\n", "x_mm,y_mm\n", ""):
        (bad := tmp_path / "bad.csv").write_text(text)
        assert "give a first line x_mm,y_mm" in refusal(*base, "--tip-mm", 1.6, "--places", bad)
    missing = refusal(*base, "--tip-mm", 1.6, "--places", "gone.csv")
    assert missing == "--places gone.csv: No such file or directory"
    assert refusal(*base, "--edge", "--sphere") == "--sphere needs --tip-mm"
    assert refusal(*base, "--blind", "--places", places) == "--places needs --tip-mm"
    for option in (("--measured",), ("--plot", "cover.svg")):
        line = f"{option[0]} has no effect with --blind: leave it out"
        assert refusal(*base, "--blind", *option) == line
    quiet = recording(tmp_path / "quiet.log", np.zeros((3, ARRAY.size)), np.random.default_rng(0))
    assert refusal("calibrate", "cover", quiet, *base[3:], "--tip-mm", 1.6).startswith(
        "no press stands out of the"
    )
    undecided = run(*base, "--blind")
    assert undecided.exception.args[0].startswith("cover: ")
    assert not undecided.output
    random = np.random.default_rng(2)
    hard = np.array([3 * world().tip(0.8, each) for each in world().places(3, random)])
    full = recording(tmp_path / "full.log", hard, random)
    line = refusal("calibrate", "cover", full, *base[3:], "--tip-mm", 1.6)
    assert line.startswith("0 of 3 presses can be used (saturated: ")
    assert not out.exists()
