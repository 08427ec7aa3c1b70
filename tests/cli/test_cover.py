import json

import numpy as np
import pytest
from typer.testing import CliRunner

from tactiled.cli.app import app
from tactiled.cover.layered import gain
from tactiled.cover.stack import Layer, Stack
from tactiled.errors import TactileError

PAPER = "--thickness 0.2 --young 98 --poisson 0.3 --sensor-thickness 1 --sensor-young 980 --sensor-poisson 0.3"
Q = [0.25, 0.5, 1, 2, 3, 4]


def run(arguments):
    return CliRunner().invoke(app, ["cover", *arguments.split()], catch_exceptions=True)


def told(arguments):
    result = run(f"{arguments} --json")
    assert result.exit_code == 0, result.output
    return json.loads(result.output)


def refused(arguments):
    error = run(arguments).exception
    assert isinstance(error, TactileError)
    assert "\n" not in str(error)
    return str(error)


@pytest.mark.parametrize("model", ["fem", "layered"])
def test_json_gives_the_gains_in_the_order_asked(model):
    record = told(f"{PAPER} --at 0.25,0.5,1,2,3,4 --model {model}")
    assert record["q"] == Q
    np.testing.assert_allclose(
        record["gain"],
        gain(Stack((Layer(0.2, 98, 0.3), Layer(1, 980, 0.3))), np.array(Q)),
        atol=record["error_estimate"],
    )
    assert 0 < record["error_estimate"] <= 1e-3
    assert record["seconds"] > 0


def test_layers_take_the_place_of_the_cover():
    record = told("--layer 0.05,4000,0.35 --layer 1,0.5,0.4999,loose --at 0.05,0.1,0.2")
    stack = Stack(
        (Layer(0.05, 4000, 0.35), Layer(1, 0.5, 0.4999), Layer(1, 980, 0.3)), sensing=2, bonds=(True, False, True)
    )
    np.testing.assert_allclose(
        record["gain"], gain(stack, np.array([0.05, 0.1, 0.2])), atol=record["error_estimate"]
    )


def test_a_boss_filters_more():
    flat, boss = (
        told(f"{PAPER} --at 1,2 {extra}")["gain"]
        for extra in ("", "--profile 0,0.1 --profile 0.4,0.1 --profile 0.6,0")
    )
    assert boss[0] < flat[0] - 0.1
    assert boss[1] < flat[1] - 0.1


def test_a_footprint_leaves_most_of_its_pressure_in_the_middle_and_little_outside():
    pressed = told(f"{PAPER} --footprint 1 --at 1")["footprint"]
    r, stress = np.array(pressed["r"]), np.array(pressed["stress"])
    assert pressed["radius"] == 1
    assert 0 < pressed["error_estimate"] <= 1e-3
    assert stress[0] == pytest.approx(1, abs=0.1)
    assert np.interp(1, r, stress) == pytest.approx(0.5, abs=0.1)
    assert abs(np.interp(1.6, r, stress)) < 0.02


def test_the_table_says_what_a_footprint_leaves():
    output = run(f"{PAPER} --footprint 1").output
    assert "Pressed on a disc of 1 mm radius: " in output


def test_the_table_says_what_it_means():
    output = run(f"{PAPER} --pitch 0.25 --model layered").output
    assert "Gain 0.5 at 1.76/mm and 0.1 at 3.53/mm." in output
    assert "gain 0.417" in output
    assert "0.25 mm (the taxels stand no closer)" in output


def test_without_at_the_frequencies_are_round_ones_over_the_fall_of_the_gain():
    record = told(f"{PAPER} --model layered")
    assert record["q"] == [0.3, 0.5, 0.7, 1, 1.5, 2, 3, 5, 7]


def test_infinity_is_null_in_json():
    assert told("--thickness 10 --pitch 0.1 --model layered --at 1")["meaning"]["noise_gain"] is None


@pytest.mark.parametrize("ending", ["svg", "png"])
def test_plot(tmp_path, ending):
    path = tmp_path / f"cover.{ending}"
    assert run(f"{PAPER} --model layered --plot {path}").exit_code == 0
    assert path.read_bytes()[:5] in (b"<?xml", b"\x89PNG\r")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ("--poisson 0.5", "Poisson's ratio is 0.5"),
        ("--thickness 0", "thickness is 0.0 mm"),
        ("--thickness -1", "thickness is -1.0 mm"),
        ("--young nan", "Young's modulus is nan MPa"),
        ("--layer 1,2", "--layer 1,2: give T,E,NU"),
        ("--layer 1,2,x", "--layer 1,2,x: give numbers"),
        ("--profile 0,1,2", "--profile 0,1,2: give R,RISE"),
        ("--profile 0,1 --profile 1,0 --model layered", "model 'layered' knows flat layers only"),
        ("--at 1,-1", "--at 1,-1: give finite frequencies"),
        ("--at x", "--at x: give numbers"),
        ("--at=", "--at : give numbers"),
        ("--noise 0", "noise is 0.0"),
        ("--footprint 0", "footprint radius is 0.0 mm"),
        ("--footprint 1 --model layered", "--footprint needs --model fem"),
        ("--pitch 0", "array pitch is 0.0 mm"),
        ("--accuracy 0", "accuracy is 0.0"),
        ("--accuracy 1e-5 --budget 0", "accuracy 1e-05 is not met in the given time"),
        ("--plot cover.bmp", "picture cover.bmp: give a name"),
        ("--config nowhere.toml", "nowhere.toml: No such file"),
    ],
)
def test_bad_input_is_one_line_that_names_it(arguments, words):
    assert words in refused(arguments)
