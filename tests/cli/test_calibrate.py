import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from tactiled.calibrate import calibration_file
from tactiled.calibrate.counts.plateaus import response
from tactiled.config import load
from tactiled.geometry import grid
from tactiled.recorded.offline import read_frame_series
from tests.calibrate.counts.skins import Skin, contact, steps
from tests.cli.commands import refusal, succeed
from tests.cli.recordings import CODEC, CONFIG, write

STEPS = (0, 10, 20, 40, 60, 40, 20, 10, 0)
LISTED = ",".join(map(str, STEPS))


def record(path, series):
    frames = np.clip(series.counts, 0, 4095).astype(np.uint16)
    return write(
        path,
        (
            message._replace(time=series.times[n] + 0.001 * part)
            for n, counts in enumerate(frames)
            for part, message in enumerate(CODEC.encode(counts, n, 0.0))
        ),
    )


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    """A folder with a configuration, a recording of steps, and a log of their pressure."""
    folder = tmp_path_factory.mktemp("bag")
    (folder / "palm.toml").write_text(CONFIG.replace("kpa_per_count = 0.5, no_load = 100, ", "dead = [63], "))
    kpa = steps(STEPS, hold_s=1.5, ramp_s=0.3)
    series = Skin(64, seed=51, dead=(9,)).series(kpa)
    record(folder / "bag.log", series)
    rows = [f"{time - 0.25:.4f},{value:.3f}" for time, value in zip(series.times, kpa, strict=True)]
    (folder / "bag.csv").write_text("\n".join(["time_s,pressure_kpa", *rows]))
    return folder


@pytest.fixture(scope="module")
def calibrated(bag):
    """What the steps print with their chart, and the file that they make."""
    out = bag / "palm.json"
    return succeed(*gain(bag, "--steps-kpa", LISTED, "--out", out, "--plot", bag / "gain.png")), out


def gain(folder, *arguments):
    return "calibrate", "gain", folder / "bag.log", "--config", folder / "palm.toml", *arguments


def test_steps_are_written_into_the_file_and_printed(bag, calibrated):
    output, out = calibrated
    file = calibration_file.load(out)
    assert (file.sensor, file.taxels, file.health.dead) == ("palm", 64, (9, 63))
    assert file.gain.origin.recording == "bag.log"
    assert file.gain.origin.method == f"gain: steps kpa {LISTED}"
    assert (bag / "gain.png").read_bytes()[:4] == b"\x89PNG"
    assert f"curve           {file.gain.form}" in output
    assert "dead            2 (9, 63)" in output
    series = read_frame_series(bag / "bag.log", "palm", load(bag / "palm.toml"))
    top = series.counts[np.argmax(response(series))] - file.no_load.values
    assert np.nanmedian(file.gain.curves.pressure(top)) == pytest.approx(60, abs=1.5)  # one frame: 1 % of noise
    listing = succeed("calibrate", "show", out)
    assert f"palm, packed, 64 taxels, id {file.id}" in listing
    assert file.gain.form in listing
    assert "dead: 2 (9, 63)" in listing
    for each in (output, listing):
        assert re.search(r"error elsewhere \d\S* kPa rms \(median\)", each)


def test_a_log_updates_the_file_and_keeps_its_other_sections(bag, calibrated, tmp_path):
    out = Path(shutil.copy(calibrated[1], tmp_path))
    first = calibration_file.load(out)
    output = succeed(*gain(bag, "--reference", bag / "bag.csv", "--out", out))
    second = calibration_file.load(out)
    assert second.gain.origin.method == "gain: reference bag.csv"
    (offset,) = re.findall(r"clocks +log (\S+) s from the recording's", output)
    assert float(offset) == pytest.approx(-0.25, abs=0.002)
    assert calibration_file.load(tmp_path / "palm.json.1").id == first.id
    np.testing.assert_allclose(second.gain.curves.gain[:9], first.gain.curves.gain[:9], rtol=0.01)


def test_a_weight_is_printed_with_the_pressure_at_the_counts_that_it_reached(bag, tmp_path):
    array, load_n = grid(8, 8, 1.0), 0.05 * (steps((0, 1, 0, 1, 0), hold_s=2, ramp_s=0.2) > 0.5)
    kpa = contact(np.full((load_n.size, 2), 3.5), load_n, array, 0.6)
    log = record(tmp_path / "weight.log", Skin(64, seed=52, spread=0).series(kpa))
    chart = tmp_path / "weight.svg"
    arguments = ("--config", bag / "palm.toml", "--out", tmp_path / "palm.json", "--plot", chart)
    output = succeed("calibrate", "gain", log, *arguments, "--weight-n", 0.05)
    (reach, counts, load) = re.search(
        r"calibrated +up to (\S+) kPa, (\d+) counts over no load .*; the largest load is (\S+) N", output
    ).groups()
    assert float(reach) == pytest.approx(kpa.max(), rel=0.02)
    assert float(reach) == pytest.approx(0.02 * float(counts), rel=0.02)
    assert load == "0.0500"
    assert "known force (N)" in chart.read_text()
    assert "check the unit" not in output
    grams = succeed("calibrate", "gain", log, *arguments, "--weight-n", 5.1)
    assert (
        "the gain is 102 times the one before: check the unit of the load (N or kPa; 1 kg weighs 9.81 N)" in grams
    )


def test_bad_input_is_one_line_and_changes_nothing(bag, calibrated, tmp_path):
    out = Path(shutil.copy(calibrated[1], tmp_path))
    before = out.read_bytes()
    wrong = tmp_path / "wrong.csv"
    wrong.write_text("time_s,force_kg\n0,1\n")
    for arguments, message in (
        ((), "give one of --steps-kpa, --reference and --weight-n"),
        (("--steps-kpa", LISTED, "--weight-n", 4.9), "give one of --steps-kpa, --reference and --weight-n"),
        (("--steps-kpa", "0,ten"), "--steps-kpa 0,ten: give numbers"),
        (("--steps-kpa", "0,10,0"), "3 pressures are given, and the recording holds 9"),
        (("--reference", wrong), "wrong.csv: column 'force_kg': unknown unit"),
        (("--weight-n", 4.9), "show no load, or the weight held still"),
        (("--steps-kpa", LISTED, "--plot", "a.gif"), "a.gif: give a name that ends in"),
    ):
        assert message in refusal(*gain(bag, *arguments, "--out", out))
    other = tmp_path / "other.json"
    other.write_text(json.dumps({"format": "x"}))
    assert "other.json: format" in refusal(*gain(bag, "--steps-kpa", LISTED, "--out", other))
    assert "gone.json: no such file" in refusal("calibrate", "show", tmp_path / "gone.json")
    assert out.read_bytes() == before
