"""What a person does not know exactly: its place in the model, in the interval, and in words."""

import re
from dataclasses import replace
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest
from scipy.special import j0

from tactiled.calibrate.cover.edge import EdgeTouch, edge_touch
from tactiled.calibrate.cover.notes import edge_objection
from tactiled.calibrate.cover.result import fit_cover
from tactiled.calibrate.cover.tip import Tip, tip_touch
from tactiled.calibrate.cover.touch_response import edge_transform, ridge_transform, tip_transform
from tactiled.calibrate.cover.unknowns import APERTURE, SHARED, Unknowns
from tactiled.geometry import grid
from tests import rigid
from tests.touched import PEAK_KPA, Skin, World, rubber

ARRAY = grid(10, 10, 1.0, 0.8)
TIP_MM = 1.4


def pressed(array, thickness, count=5, bend=0.0, poisson=0.49, sphere=False):
    """Presses with a tip, and their places."""
    random = np.random.default_rng(4)
    world, skin = (
        World(array, rubber(thickness, poisson=poisson)),
        Skin(array.size, random, gain_error=0.01, dead=0),
    )
    places = world.places(count, random)
    clean = [world.tip(TIP_MM / 2, each, sphere) * random.uniform(0.5, 1) for each in places]
    return [skin.press(each * (1 - bend * each / PEAK_KPA), array) for each in clean]


def laid(array, thickness, blur=0.0, count=3):
    """Edges, each a mean of edges at offsets that spread by `blur` (mm)."""
    random = np.random.default_rng(5)
    world, skin = World(array, rubber(thickness)), Skin(array.size, random, gain_error=0.01, dead=0)
    spread = blur * np.array([-1.3, 0, 1.3]) if blur else np.zeros(1)
    edges = [np.mean([world.edge(np.pi / 2 * n + 0.3, s) for s in spread], axis=0) for n in range(count)]
    return [skin.press(each, array) for each in edges]


@pytest.mark.parametrize("kind", ["tip", "edge", "ridge"])
def test_slopes_are_those_of_the_model(kind):
    presses = pressed(ARRAY, 1.0, count=3) if kind == "tip" else laid(ARRAY, 1.0, count=2)
    if kind == "tip":
        touch = tip_touch(presses, ARRAY, rubber(1.1), Tip(TIP_MM), 0.01)
    else:
        touch = edge_touch(presses, ARRAY, rubber(1.1), 0.01, 1.2 if kind == "ridge" else None)
    model, own = touch.likelihood((0.8, 1.2)).model, touch.prior.own + 0.01
    shared = touch.prior.shared + np.array([0.05, 0.02, -0.1, -0.01, 0.03, 0.02])
    step = 1e-3
    for at in touch.free:
        ahead, behind = (model(shared + side * step * np.eye(SHARED)[at], own)[0] for side in (1, -1))
        slope = (ahead - behind) / (2 * step)
        assert np.abs(model(shared, own)[1][:, at] - slope).max() < 0.02 * np.abs(slope).max(), at


@pytest.mark.parametrize(("kind", "scale"), [("tip", 0.75), ("edge", 1.2)])
def test_another_aperture_is_that_of_another_array(kind, scale):
    presses = pressed(ARRAY, 0.6, count=3) if kind == "tip" else laid(ARRAY, 0.6, count=2)

    def touched(array):
        if kind == "tip":
            return tip_touch(presses, array, rubber(0.6), Tip(TIP_MM), 0.01)
        return edge_touch(presses, array, rubber(0.6), 0.01)

    one, other = touched(ARRAY), touched(replace(ARRAY, width=scale * ARRAY.width))
    shared = one.prior.shared + np.array([0, 0, np.log(scale), 0, 0, 0])
    as_scaled = one.likelihood((0.8, 1.2)).model(shared, one.prior.own)[0]
    exact = other.fixed(APERTURE).likelihood((0.8, 1.2)).model(one.prior.shared, one.prior.own)[0]
    nominal = one.likelihood((0.8, 1.2)).model(one.prior.shared, one.prior.own)[0]
    assert np.abs(as_scaled - exact).max() < 0.05 * np.abs(nominal - exact).max()


def test_profiles_are_even_pressure_a_sphere_s_and_a_rigid_punch_s():
    q = np.linspace(0.01, 1, 50)
    x = 2 * np.pi * q * 0.7
    np.testing.assert_allclose(tip_transform(q, 0.7, 0.5), 3 * (np.sin(x) - x * np.cos(x)) / x**3, rtol=1e-9)
    thick = rubber(30.0)
    np.testing.assert_allclose(tip_transform(q, 0.7, -0.5), rigid.tip_transform(thick, 0.7)(q), atol=2e-3)
    np.testing.assert_allclose(ridge_transform(q, 1.4, 0.0), np.sinc(q * 1.4), atol=1e-9)
    np.testing.assert_allclose(ridge_transform(q, 1.4, -0.5), rigid.ridge_transform(thick, 1.4)(q), atol=5e-3)
    assert edge_transform(q, 1e-9) == pytest.approx(edge_transform(q, -1e-9))


@pytest.mark.parametrize("poisson", [0.3, 0.49])
def test_a_rigid_tip_s_pressure_on_a_thin_cover_gives_an_even_displacement(poisson):
    """The contact's own condition, integrated anew; and where the family of profiles stands for it."""
    stack, radius = rubber(0.7, poisson=poisson), 1.0
    transform = rigid.tip_transform(stack, radius)
    k = np.concatenate([np.linspace(1e-3, 80, 8000), np.geomspace(80.01, 2000, 3000)])
    r = np.linspace(0, 0.9, 7)
    weight = transform(k / (2 * np.pi)) * rigid.compliance(stack, k) * k * np.gradient(k)
    depth = j0(np.outer(r, k)) @ weight
    assert np.ptp(depth) < 0.005 * depth.mean()
    q = np.linspace(0.01, 0.5, 30)
    best = min(np.abs(tip_transform(q, radius, each) - transform(q)).max() for each in np.arange(-0.6, 0.6, 0.05))
    assert best < 0.01


def test_a_wrong_aperture_is_held_by_the_interval_named_and_made_up_for():
    true = grid(10, 10, 1.0, 0.55)
    presses, configured = pressed(true, 0.6, count=8), rubber(0.7)
    fit = fit_cover(tip_touch(presses, ARRAY, configured, Tip(TIP_MM), 0.01), presses, "tip")
    factor = 0.6 / 0.7
    assert not fit.effective[0] < factor < fit.effective[1]
    assert fit.interval[0] < factor < fit.interval[1]
    assert fit.thickness_error < (fit.interval[1] - fit.interval[0]) / (2 * 1.96 * fit.factor)
    assert any(each.startswith("the presses look like those on an aperture of 0.") for each in fit.notes)
    assert any("to narrow the interval, measure exactly: the aperture (" in each for each in fit.notes)
    assert fit.objection == ""


def test_what_is_exactly_known_does_not_count_and_the_first_to_measure_narrows_as_the_note_says():
    presses = pressed(ARRAY, 1.0, count=8)
    exact = Unknowns(aperture_mm=0, poisson=0, curvature=0, profile=0)
    fits = [
        fit_cover(tip_touch(presses, ARRAY, rubber(1.2), Tip(TIP_MM, 0.001), 0.01, None, each), presses, "tip")
        for each in (Unknowns(), Unknowns(aperture_mm=0), exact)
    ]
    usual, known, least = (fit.interval[1] - fit.interval[0] for fit in fits)
    assert least < 0.6 * usual
    ((name, percent),) = re.findall(r"measure exactly: ([a-z ]+) \((\d+) % narrower\)", fits[0].notes[0])
    assert name == "the aperture"
    assert 1 - known / usual == pytest.approx(int(percent) / 100, abs=0.05)
    assert "aperture" not in " ".join(fits[1].notes)


def test_a_blurred_edge_is_refused_with_what_to_do():
    presses = laid(ARRAY, 0.6, blur=0.45)
    fit = fit_cover(edge_touch(presses, ARRAY, rubber(0.7), 0.01), presses, "edge")
    assert fit.objection.startswith(("the edge is not sharp", "presses left out of the fit miss by"))
    assert "--edge-mm" in fit.objection or "--tip-mm" in fit.objection
    assert fit.notes[0] == fit.objection
    assert fit.kernel is None


@pytest.mark.parametrize(
    ("square_mm", "depth", "deviations", "refused"),
    [(0.09, 1.0, 4.0, True), (-0.09, 1.0, 4.0, True), (0.09, 1.0, 2.0, False), (0.09, 2.0, 4.0, False)],
    ids=["blurred", "hardest at its rim", "not clear", "thick cover"],
)
def test_a_pad_whose_blur_is_wide_for_its_cover_is_refused_as_its_shape_is_not_known(
    square_mm, depth, deviations, refused
):
    """Pads that fade by 0.1 to 0.3 mm under t/pitch 0.8 to 1.4 were fitted 6 % too thin, and accepted."""
    family = SimpleNamespace(configured=SimpleNamespace(depth=depth))
    touch = Mock(spec=EdgeTouch, width=np.inf, family=family)
    solution = SimpleNamespace(shared=np.array([0, 0, 0, 0, 0, square_mm]))
    joint = Mock(touch=touch, freed=(), misfit=1.0, solution=solution)
    joint.differs.return_value = deviations
    assert edge_objection(joint).startswith("the edge is not sharp") == refused


def test_a_common_bend_of_the_curves_is_named():
    presses = pressed(ARRAY, 1.2, count=10, bend=0.12)
    fit = fit_cover(tip_touch(presses, ARRAY, rubber(1.0), Tip(TIP_MM), 0.01), presses, "tip")
    assert fit.interval_mm[0] < 1.2 < fit.interval_mm[1]
    assert any(each.endswith("calibrate the gain over the pressures of the presses") for each in fit.notes)


def test_an_aperture_that_nobody_gave_is_known_less():
    usual, default = (Unknowns().deviations(grid(3, 3, 1.0, width), 0.01, 0.5)[APERTURE] for width in (0.8, 1.0))
    assert usual < default
    assert Unknowns(aperture_mm=0.08).deviations(ARRAY, 0.01, 0.5)[APERTURE] == pytest.approx(0.1)
