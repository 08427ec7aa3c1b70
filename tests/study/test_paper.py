import re
from xml.etree import ElementTree

import numpy as np
import pytest

from tactiled.study.paper import cases, page
from tactiled.study.paper.claims import Claim
from tactiled.study.paper.figures import FIGURES


@pytest.fixture(scope="module")
def claims():
    return page.claims()


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return page.write(tmp_path_factory.mktemp("paper")).parent


def find(claims, words):
    (found,) = (claim for claim in claims if words in claim.states)
    return found


@pytest.mark.parametrize(
    ("words", "agrees"),
    [
        ("square of the thickness", True),
        ("the gain is 0.9 under 0.1 mm", True),
        ("the gain is 0.8 under 0.2 mm", True),
        ("the gain is 0.4 under 0.6 mm", False),
        ("the gain is 0.2 under 1.0 mm", False),
        ("nearly zero under 0.4 mm", True),
        ("the gain is 0.4 under 0.2 mm", True),
        ("becomes less than 0.4", False),
        ("softer the cover", True),
        ("higher Poisson's ratio is more favourable", False),
        ("only slight", True),
        ("corners are enhanced", True),
        ("inner hole is dim", True),
        ("greatly at 4903 MPa", True),
        ("Measured forces", None),
    ],
)
def test_verdicts(claims, words, agrees):
    assert find(claims, words).agrees is agrees


def test_the_gains_written_under_the_wrong_thickness_are_shown_with_the_right_ones(claims):
    first, second = find(claims, "0.4 under 0.6 mm"), find(claims, "0.2 under 1.0 mm")
    assert (first.exact, second.exact) == ("0.170", "0.021")
    assert "0.42 is the gain under 0.4 mm" in first.why
    assert "0.6 mm, 0.17" in second.why


def test_both_models_say_the_same(claims):
    for claim in claims:
        if "rim" in claim.states:
            continue
        fem, exact = (np.array(re.findall(r"[+-]?\d+\.\d+", text), float) for text in (claim.fem, claim.exact))
        np.testing.assert_allclose(fem, exact, atol=0.0021, rtol=0.002, err_msg=claim.states)


def test_the_ring_has_the_papers_sides():
    ring = cases.ring()
    assert ring.shape == (40, 40)
    assert ring[20].sum() * cases.ELEMENT == pytest.approx(1.0 - 0.6)
    assert ring.sum() * cases.ELEMENT**2 == pytest.approx(1.0**2 - 0.6**2)


def test_the_ring_keeps_its_force_under_a_thin_cover():
    kept = cases.under(cases.covered(0.1), "exact").sum() / cases.ring().sum()
    assert kept == pytest.approx(1, abs=0.01)


def test_the_rod_in_the_middle_of_a_cell_presses_on_it_alone():
    thin, thick = (
        cases.cell_force(cases.covered(sheet).exact, np.array([0.0]), cases.POINT) for sheet in (0.25, 1.0)
    )
    assert thick < thin
    assert thin == pytest.approx(cases.LOAD, abs=0.002)


def test_two_cells_share_a_rod_on_their_common_edge():
    edge = cases.cell_force(cases.covered(0.5).exact, np.array([-cases.CELL / 2, cases.CELL / 2]), cases.POINT)
    np.testing.assert_allclose(edge, cases.LOAD / 2, atol=0.01)


def test_a_spread_load_is_still_the_whole_load_and_filters_more():
    point = cases.covered(0.25).exact
    spread = cases.spread(point, 0.3)
    assert spread.gain_at(1e-6) == pytest.approx(1)
    assert spread.gain_at(1.0) < point.gain_at(1.0) - 0.1


def test_every_figure_is_drawn(folder):
    for name, *_ in FIGURES:
        data = (folder / name).read_bytes()
        assert len(data) > 10_000
        if name.endswith("svg"):
            ElementTree.fromstring(data)


def test_the_page_shows_every_claim_and_figure(folder, claims):
    text = (folder / "index.html").read_text(encoding="utf-8")
    assert text.count("<tr><td>") == len(claims)
    assert [name for name, *_ in FIGURES] == re.findall(r"<img src='([^']*)'", text)
    agree, disagree = (sum(claim.agrees is verdict for claim in claims) for verdict in (True, False))
    assert f"{agree} agree, {disagree} do not" in text


def test_the_page_escapes_and_writes_numbers_well():
    row = page._row(Claim("I", "a < b", "2e-08 of peak", "-0.058 to +0.026", None, "5e-1 & more"))
    assert "a &lt; b" in row
    assert "2 × 10<sup>−8</sup> of peak" in row
    assert "<td>−0.058 to +0.026</td>" in row
