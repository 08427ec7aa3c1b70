import numpy as np

from tactiled.bench.picard import analyse
from tactiled.bench.skin import rubber
from tactiled.config.example import GRASP
from tests.cli.commands import succeed


def test_less_noise_and_a_thinner_cover_show_more_modes():
    coarse, thin = (analyse(rubber(0.5, 16), noise, 1) for noise in (0.2, 0.01))
    thick = analyse(rubber(3.0, 16), 0.01, 1)
    assert coarse.clear < thin.clear
    assert thick.clear < thin.clear
    assert thick.resolution_mm > thin.resolution_mm
    assert (np.diff(thin.singular) <= 0).all()
    assert thick.singular[-1] < thin.singular[-1]


def test_command_draws_a_configured_skin(tmp_path):
    (tmp_path / "it.toml").write_text(GRASP)
    output = succeed("bench", "picard", "--config", tmp_path / "it.toml", "--out", tmp_path / "new")
    assert "of 60 modes" in output
    assert (tmp_path / "new/picard.svg").exists()
