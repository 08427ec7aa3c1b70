import json

import numpy as np
import pytest
from matplotlib.figure import Figure

from tactiled.calibrate.calibration_file import save
from tactiled.charts.style import figure
from tactiled.config.example import EXAMPLE
from tactiled.cover.layered import gain
from tactiled.cover.stack import Layer, Stack
from tests.calibrate.files import calibration_file, cover_section
from tests.cli.commands import refusal, succeed

Q = [0.25, 0.5, 1, 2, 3, 4]
PAPER = Stack((Layer(0.2, 98, 0.3), Layer(1, 980, 0.3)))  # the command's defaults
LOOSE = Stack(
    (Layer(0.05, 4000, 0.35), Layer(1, 0.5, 0.4999), Layer(1, 980, 0.3)), sensing=2, bonds=(True, False, True)
)


def record(arguments):
    return json.loads(succeed("cover", "--json", *arguments.split()))


@pytest.mark.parametrize(
    ("arguments", "stack", "q"),
    [
        ("", PAPER, Q),
        ("--model layered", PAPER, Q[::-1]),
        ("--layer 0.05,4000,0.35 --layer 1,0.5,0.4999,loose", LOOSE, [0.05, 0.1, 0.2]),
    ],
)
def test_json_has_the_gains_at_the_given_frequencies(arguments, stack, q):
    got = record(f"{arguments} --at {','.join(map(str, q))}")
    assert got["q"] == q
    np.testing.assert_allclose(got["gain"], gain(stack, np.array(q)), atol=got["error_estimate"])
    assert 0 < got["error_estimate"] <= 1e-3
    assert got["seconds"] > 0


def test_a_boss_filters_more():
    boss = record("--at 1,2 --profile 0,0.1 --profile 0.4,0.1 --profile 0.6,0")
    assert (np.array(boss["gain"]) < gain(PAPER, np.array([1, 2])) - 0.1).all()


def test_a_footprint_keeps_its_pressure_in_the_middle():
    pressed = record("--footprint 1 --at 1")["footprint"]
    r, stress = np.array(pressed["r"]), np.array(pressed["stress"])
    assert pressed["radius"] == 1
    assert 0 < pressed["error_estimate"] <= 1e-3
    assert stress[0] == pytest.approx(1, abs=0.1)
    assert np.interp(1, r, stress) == pytest.approx(0.5, abs=0.1)
    assert abs(np.interp(1.6, r, stress)) < 0.02
    assert "Pressed on a disc of 1 mm radius: " in succeed("cover", "--footprint", 1)


def test_the_table_is_followed_by_its_meaning():
    output = succeed("cover", "--pitch", 0.25, "--model", "layered")
    for text in (
        "gain 0.5 / 0.1 at: 1.759 / 3.527 cycles/mm",
        "gain at the taxel Nyquist: 0.4173 at 2.000",
        "smallest resolvable gap: 0.25 mm (the pitch sets it), at a noise of 1 % of the pressure",
    ):
        assert text in output


def test_the_default_frequencies_are_round_ones_over_the_fall_of_the_gain():
    assert record("--model layered")["q"] == [0.3, 0.5, 0.7, 1, 1.5, 2, 3, 5, 7]


def test_infinity_is_null_in_json():
    assert record("--thickness 10 --pitch 0.1 --model layered --at 1")["meaning"]["noise_gain"] is None


def test_cover_and_array_of_a_configuration(tmp_path):
    path = tmp_path / "a.toml"
    path.write_text(EXAMPLE)
    stack = Stack((Layer(1.2, 0.6, 0.48), Layer(1, 980, 0.3)))
    got = record(f"--config {path} --model layered --at 0.1,0.2")
    np.testing.assert_allclose(got["gain"], gain(stack, np.array([0.1, 0.2])), atol=1e-3)
    path.write_text(EXAMPLE.replace("[sensor.palm.calibration]", '[sensor.palm.calibration]\nfile = "palm.json"'))
    save(tmp_path / "palm.json", calibration_file(1024, cover=cover_section(1.3, stack)))
    got = record(f"--config {path} --model layered --at 0.1,0.2")
    np.testing.assert_allclose(got["gain"], gain(stack.thickened(1.3), np.array([0.1, 0.2])), atol=1e-3)


def test_plot_replaces_the_file_before_unless_it_is_interrupted(tmp_path, monkeypatch):
    path = tmp_path / "cover.svg"
    path.write_text("old")

    def interrupted(_, out, **_options):
        out.write_text("half")
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(Figure, "savefig", interrupted)
        with pytest.raises(KeyboardInterrupt), figure(path, 1, 1):
            pass
    assert path.read_text() == "old"
    succeed("cover", "--model", "layered", "--plot", path)
    assert path.read_bytes().startswith(b"<?xml")
    assert [*tmp_path.iterdir()] == [path]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("--poisson 0.5", "Poisson's ratio is 0.5"),
        ("--layer 1,2", "--layer 1,2: give T,E,NU"),
        ("--layer 1,2,x", "--layer 1,2,x: give T,E,NU: thickness in mm"),
        ("--profile 0,1,2", "--profile 0,1,2: give R,RISE"),
        ("--profile 0,1 --profile 1,0 --model layered", "model 'layered' knows flat layers only"),
        ("--at 1,-1", "--at 1,-1: give finite frequencies"),
        ("--at inf", "--at inf: give finite frequencies"),
        ("--at=", "--at : give numbers"),
        ("--noise 0", "noise is 0.0"),
        ("--footprint 1 --model layered", "--footprint needs --model fem"),
        ("--accuracy 1e-5 --budget 0", "accuracy 1e-05 is not met in the given time"),
        ("--plot cover.bmp", "picture cover.bmp: give a name"),
        ("--plot gone/cover.svg", "gone/cover.svg: No such file or directory: nothing is written"),
        ("--config nowhere.toml", "nowhere.toml: No such file"),
        ("--config palm.toml --thickness 3", "--thickness has no effect with --config: leave one of them out"),
        ("--layer 1,2,0.3 --young 3", "--young has no effect with --layer: leave one of them out"),
        ("--sensor palm", "--sensor needs --config"),
    ],
)
def test_wrong_input_is_refused(arguments, message):
    assert message in refusal("cover", *arguments.split())
