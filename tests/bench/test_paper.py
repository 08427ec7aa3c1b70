import re
from xml.etree import ElementTree

import numpy as np
import pytest

from tactiled.bench.paper import models, page
from tactiled.bench.paper.figures import FIGURES
from tactiled.bench.paper.statements import statements
from tactiled.errors import ConfigError
from tests.cli.commands import succeed


@pytest.fixture(scope="module")
def compared():
    return statements()


def find(compared, words):
    (one,) = (each for each in compared if words in each.states)
    return one


def test_verdicts(compared):
    verdicts = "".join({True: "+", False: "-", None: "?"}[each.agrees] for each in compared)
    assert verdicts == "++++--++-++-++++++++??"


def test_numbers_in_the_explanations_are_those_of_the_exact_solution(compared):
    gain = {thickness: models.covered("layered", thickness).gain_at(1.0) for thickness in (0.4, 0.6)}
    assert f"{gain[0.4]:.2f} is the gain under 0.4 mm" in find(compared, "0.4 under 0.6 mm").why
    assert f"0.6 mm, {gain[0.6]:.2f}" in find(compared, "0.2 under 1.0 mm").why
    pictures = {thickness: models.under(models.covered("layered", thickness)) for thickness in (0.2, 0.4)}
    assert f"the peak is {pictures[0.2].max():.2f}" in find(compared, "the peak is lower").why
    holes = {thickness: picture[20, 20] / picture.max() for thickness, picture in pictures.items()}
    assert f"at {holes[0.4]:.2f}, under 0.2 mm at {holes[0.2]:.2f}" in find(compared, "inner hole").why
    thin = models.under(models.covered("layered", 0.1))
    assert thin[20, 20] < 0.1 * thin.max()  # "the hole stays under a tenth of it"


def test_both_models_give_the_same_numbers(compared):
    for each in compared:
        if "rim" not in each.states:
            fem, exact = (np.array(re.findall(r"[+-]?\d+\.\d+", cell), float) for cell in (each.fem, each.exact))
            np.testing.assert_allclose(fem, exact, atol=0.0021, rtol=0.002, err_msg=each.states)


def test_the_ring_has_the_papers_sides_and_its_force_under_a_thin_cover():
    ring = models.ring()
    assert ring.shape == (40, 40)
    assert ring[20].sum() * models.ELEMENT == pytest.approx(1.0 - 0.6)
    assert ring.sum() * models.ELEMENT**2 == pytest.approx(1.0**2 - 0.6**2)
    assert models.under(models.covered("layered", 0.1)).sum() == pytest.approx(ring.sum(), rel=0.01)


def test_the_rod_presses_on_one_cell_in_its_middle_and_on_two_on_their_common_edge():
    def force(sheet, *x):
        return models.cell_force(models.covered("layered", sheet), np.array(x), models.POINT)

    assert force(1.0, 0.0) < force(0.25, 0.0)
    assert force(0.25, 0.0) == pytest.approx(models.LOAD, abs=0.002)
    half = models.CELL / 2
    np.testing.assert_allclose(force(0.5, -half, half), models.LOAD / 2, atol=0.01)


def test_a_spread_load_is_still_the_whole_load_and_filters_more():
    point = models.covered("layered", 0.25)
    spread = models.spread(point, 0.3)
    assert spread.gain_at(1e-6) == pytest.approx(1)
    assert spread.gain_at(1.0) < point.gain_at(1.0) - 0.1


def test_command_writes_a_page_with_every_statement_and_figure(tmp_path, compared, monkeypatch):
    monkeypatch.setattr(page, "statements", lambda: compared)
    folder = tmp_path / "new" / "folder"
    assert succeed("paper", folder).strip() == str(folder / "index.html")
    for name, *_ in FIGURES:
        data = (folder / name).read_bytes()
        assert len(data) > 10_000
        if name.endswith("svg"):
            ElementTree.fromstring(data)
    html = (folder / "index.html").read_text(encoding="utf-8")
    assert html.count("<tr><td>") == len(compared)
    assert [name for name, *_ in FIGURES] == re.findall(r"<img src='([^']*)'", html)
    assert "16 agree, 4 do not, 2 cannot" in html


def test_a_folder_that_cannot_be_made_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigError, match=r"folder .*file/here cannot be made: Not a directory"):
        page.write(tmp_path / "file" / "here")
