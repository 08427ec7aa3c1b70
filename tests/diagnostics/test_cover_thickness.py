import numpy as np
import pytest

from tactiled.cover.family import CoverFamily
from tactiled.diagnostics.cover_thickness import fitting_thickness
from tests.bench.presses import presses
from tests.diagnostics.test_checks import NOISE, SIDE, sense, stuck_taxel
from tests.plans import plan

CONFIGURED_MM = 1.5


@pytest.fixture(scope="module")
def fitted():
    skin = plan((SIDE, SIDE), CONFIGURED_MM, substrate=True)
    family = CoverFamily(skin.kernel.stack)
    return lambda frame, noise=NOISE: fitting_thickness(frame, noise, family, skin.array)


@pytest.mark.parametrize(("radius", "thickness"), [(2.4, 0.75), (4, 0.6), (4, 0.75), (8, 0.75)])
def test_a_thinner_cover_is_named_with_a_thickness_that_explains_the_frame(fitted, radius, thickness):
    """The disc of 2.4 mm looks like faulty taxels to the residual alone."""
    named = fitted(sense(radius=radius, thickness=thickness))
    assert thickness < named
    assert named < 1.6 * thickness


def spoilt(share):
    return lambda frame: np.where(np.random.default_rng(0).random(frame.shape) < share, 0, frame)


@pytest.mark.parametrize(
    "change",
    [
        lambda frame: frame,
        stuck_taxel,
        spoilt(0.05),
        lambda frame: frame + 5,
        lambda frame: frame - 3,
        lambda frame: np.minimum(frame, 55),
    ],
    ids=["sound", "stuck", "dead", "offset", "negative", "plateau"],
)
def test_what_is_no_matter_of_the_cover_names_none(fitted, change):
    assert fitted(change(sense())) is None


def test_sound_presses_name_none():
    skin = plan((SIDE, SIDE), 2.5, substrate=True)
    family = CoverFamily(skin.kernel.stack)
    for press in presses(SIDE, (2.5,), (0.002,), seed=11):
        assert fitting_thickness(press.frame, press.sigma, family, skin.array) is None
