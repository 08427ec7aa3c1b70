import numpy as np
import pytest
from typer.testing import CliRunner

from tactiled.cli.app import app
from tactiled.config.example import GRASP
from tactiled.study.discriminate import METHODS, Told, bound, dip, measure
from tactiled.study.picard import measure as look
from tactiled.study.skin import rubber


@pytest.mark.parametrize("thickness", [0.5, 2.0])
def test_less_noise_shows_more_modes(thickness):
    found = [look(rubber(thickness, 16), noise, 1) for noise in (0.05, 0.01, 0.001)]
    assert found[0].clear <= found[1].clear <= found[2].clear
    assert found[0].clear < found[2].clear or found[0].clear == 256


def test_a_thicker_cover_shows_fewer_modes_and_its_singular_values_fall_sooner():
    thin, thick = (look(rubber(t, 16), 0.01, 1) for t in (0.5, 3.0))
    assert thick.clear < thin.clear
    assert thick.resolution_mm > thin.resolution_mm
    assert (np.diff(thin.singular) <= 0).all()
    assert thick.singular[-1] < thin.singular[-1]


def test_command_draws_a_configured_skin(tmp_path):
    (tmp_path / "it.toml").write_text(GRASP)
    told = CliRunner().invoke(
        app, ["bench", "picard", "--config", str(tmp_path / "it.toml"), "--out", str(tmp_path)]
    )
    assert told.exit_code == 0, told.output
    assert "of 60 modes" in told.output
    assert (tmp_path / "picard.svg").exists()


def test_dip_is_the_share_that_the_middle_sinks():
    image = np.zeros((9, 9))
    image[4, 2] = image[4, 6] = 2.0
    image[4, 4] = 0.5
    middle, half = np.zeros(2), np.array([2.0, 0.0])
    assert dip(np.ones((9, 9)), middle, half) == 0
    assert dip(image, middle, half) == pytest.approx(1.0 - 0.25 / 2)


def test_least_gap_needs_every_wider_one_told_apart_too():
    shares = {"raw": (0, 1, 0, 0, 0, 1, 0.9, 1, 1, 1, 1, 1, 1), "auto": (0.0,) * 13}
    told = Told("it", 1.0, 0.01, shares, 0.3)
    assert told.least("raw") == 2.75
    assert told.least("auto") == np.inf


def test_wide_gaps_are_told_apart_and_the_bound_falls_with_the_noise():
    skin = rubber(1.0, 12)
    told = measure(skin, 0.01, 4, 1)
    assert all(told.shares[name][-1] == 1 for name in METHODS)
    assert bound(skin, 0.1) < bound(skin, 1.0) < bound(skin, 10.0)
