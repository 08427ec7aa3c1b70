import numpy as np
import pytest

from tactiled.diagnostics.warning_codes import warning
from tactiled.runtime.thickness_search import ThicknessSearch
from tests.diagnostics.test_checks import NOISE, SIDE, SOUND, sense, stuck_taxel
from tests.plans import plan


@pytest.fixture(scope="module")
def skin():
    return plan((SIDE, SIDE), 1.5, substrate=True)


def named(search, frame, *codes):
    """Warnings once a search that `codes` start has ended, and those before."""
    warnings = tuple(warning(code) for code in codes)
    early = search(warnings, frame, SOUND, NOISE)
    if search._thread:
        search._thread.join()
    return search(warnings, frame, SOUND, NOISE), early


@pytest.mark.parametrize("code", ["outliers", "cover_mismatch"])
def test_a_suspicion_that_a_thinner_cover_explains_names_it_when_the_search_has_ended(skin, code):
    (edge, mismatch), early = named(ThicknessSearch(skin), sense(thickness=0.75), "edge", code)
    assert [each.code for each in early] == ["edge"]
    assert (edge.code, mismatch.code) == ("edge", "cover_mismatch")
    assert 0.75 < mismatch.thickness_mm < 1.2
    assert f"{mismatch.thickness_mm:.2g} mm or less fits better than the configured 1.5 mm" in mismatch.text


def test_what_no_cover_explains_stays_as_it_was(skin):
    (outliers,), _ = named(ThicknessSearch(skin), stuck_taxel(sense()), "outliers")
    assert outliers == warning("outliers")


def test_without_a_suspicion_or_a_grid_nothing_is_searched(skin):
    frame, other = sense(thickness=0.75), (warning("negative"),)
    search, layout = ThicknessSearch(skin), ThicknessSearch(plan((4, 4), layout=True))
    assert search(other, frame, SOUND, NOISE) == other
    suspicion = (warning("cover_mismatch"),)
    assert layout(suspicion, np.zeros(16, np.float32), np.zeros(16, np.uint8), NOISE) == suspicion
    assert search._thread is layout._thread is None


def test_a_mismatch_that_comes_back_soon_starts_no_second_search(skin):
    search, frame = ThicknessSearch(skin), sense(thickness=0.75)
    first, _ = named(search, frame, "cover_mismatch")
    thread = search._thread
    assert search((), frame, SOUND, NOISE) == ()
    assert named(search, frame, "cover_mismatch")[0] == first
    assert search._thread is thread
