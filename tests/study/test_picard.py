import numpy as np
import pytest
from typer.testing import CliRunner

from tactiled.cli.app import app
from tactiled.config.example import GRASP
from tactiled.study.picard import analyse
from tactiled.study.skin import rubber


@pytest.mark.parametrize("thickness", [0.5, 2.0])
def test_less_noise_shows_more_modes(thickness):
    clear = [analyse(rubber(thickness, 16), noise, 1).clear for noise in (0.05, 0.01, 0.001)]
    assert clear == sorted(clear)
    assert clear[0] < clear[2] or clear[0] == 256


def test_a_thicker_cover_shows_fewer_modes_and_its_singular_values_fall_sooner():
    thin, thick = (analyse(rubber(t, 16), 0.01, 1) for t in (0.5, 3.0))
    assert thick.clear < thin.clear
    assert thick.resolution_mm > thin.resolution_mm
    assert (np.diff(thin.singular) <= 0).all()
    assert thick.singular[-1] < thin.singular[-1]


def test_command_draws_a_configured_skin(tmp_path):
    (tmp_path / "it.toml").write_text(GRASP)
    arguments = ["bench", "picard", "--config", str(tmp_path / "it.toml"), "--out", str(tmp_path / "new")]
    done = CliRunner().invoke(app, arguments)
    assert done.exit_code == 0, done.output
    assert "of 60 modes" in done.output
    assert (tmp_path / "new/picard.svg").exists()
