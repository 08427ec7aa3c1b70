import numpy as np
import pytest

from tactiled.diagnostics.warning_codes import warning
from tactiled.live.thickness_search import ThicknessSearch
from tests.diagnostics.test_checks import NOISE, SIDE, SOUND, sense, stuck_taxel
from tests.plans import plan


@pytest.fixture(scope="module")
def skin():
    return plan((SIDE, SIDE), 1.5, substrate=True)


def named(skin, frame, *codes):
    """Warnings once a search that `codes` start has ended, and those before."""
    warnings, started = tuple(warning(code) for code in codes), []
    search = ThicknessSearch(skin, started.append)
    early = search(warnings, frame, SOUND, NOISE)
    started.pop()()
    return search(warnings, frame, SOUND, NOISE), early


@pytest.mark.parametrize("code", ["outliers", "cover_mismatch"])
def test_a_suspicion_that_a_thinner_cover_explains_names_it_when_the_search_has_ended(skin, code):
    (edge, mismatch), early = named(skin, sense(thickness=0.75), "edge", code)
    assert [each.code for each in early] == ["edge"]
    assert (edge.code, mismatch.code) == ("edge", "cover_mismatch")
    assert 0.75 < mismatch.thickness_mm < 1.2
    assert f"{mismatch.thickness_mm:.2g} mm or less fits better than the configured 1.5 mm" in mismatch.text


def test_what_no_cover_explains_stays_as_it_was(skin):
    (outliers,), _ = named(skin, stuck_taxel(sense()), "outliers")
    assert outliers == warning("outliers")


def test_without_a_suspicion_or_a_grid_nothing_is_searched(skin):
    frame, other = sense(thickness=0.75), (warning("negative"),)
    started = []
    search, layout = (ThicknessSearch(each, started.append) for each in (skin, plan((4, 4), layout=True)))
    assert search(other, frame, SOUND, NOISE) == other
    suspicion = (warning("cover_mismatch"),)
    assert layout(suspicion, np.zeros(16, np.float32), np.zeros(16, np.uint8), NOISE) == suspicion
    assert started == []


def test_a_mismatch_that_comes_back_soon_starts_no_second_search(skin):
    started, frame, mismatch = [], sense(thickness=0.75), (warning("cover_mismatch"),)
    search = ThicknessSearch(skin, started.append)
    for warnings in (mismatch, (), mismatch):  # while it runs
        assert search(warnings, frame, SOUND, NOISE) == ()
    (only,) = started
    only()
    for warnings in ((), mismatch):
        named = search(warnings, frame, SOUND, NOISE)
    assert named[0].thickness_mm
    assert started == [only]
