"""Presses with a tip: a sample of what `World` makes by another way than the fit."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from tactiled.calibrate.counts.calibration import Calibration
from tactiled.calibrate.counts.curves import Curves
from tactiled.calibrate.cover import recorded_touch
from tactiled.calibrate.cover.recorded_presses import without_dead
from tactiled.calibrate.cover.recorded_touch import RecordedTouch, fit_touch
from tactiled.calibrate.cover.result import ENDS, _reason, fit_cover
from tactiled.calibrate.cover.tip import Tip, tip_touch
from tactiled.calibrate.cover.unknowns import Unknowns
from tactiled.errors import ConfigError
from tactiled.frames import FrameSeries
from tactiled.geometry import grid, layout
from tests.touched import Skin, World, recorded, rubber

CONFIGURED = 1.3  # times the true thickness
ARRAY = grid(12, 12, 1.0)
EXACT = Unknowns(aperture_mm=0, poisson=0, curvature=0, profile=0)
SCATTERED = np.random.default_rng(8).uniform(-0.2, 0.2, (196, 2)) + grid(14, 14, 1.0).positions


@cache
def world_of(array, thickness):
    return World(array, rubber(thickness))


def pressed(array, thickness, seed=0, tip_mm=1.6, count=20, **errors):
    """Presses at random places."""
    random = np.random.default_rng(seed)
    world, skin = world_of(array, thickness), Skin(array.size, random, **errors)
    places = world.places(count, random)
    return [skin.press(world.tip(tip_mm / 2, each) * random.uniform(0.6, 1.4), array) for each in places], places


def fitted(presses, array, thickness, tip, gain_error=0.01, places=None, unknowns=EXACT):
    touch = tip_touch(presses, array, rubber(CONFIGURED * thickness), tip, gain_error, places, unknowns)
    return fit_cover(touch, presses, "tip")


@pytest.mark.parametrize(
    ("array", "thickness", "tip"),
    [
        (grid(16, 16, 1.0, 0.9), 0.5, Tip(1.6, 0.002)),
        (grid(14, 14, 2.0, aperture="round"), 5.0, Tip(1.6)),
        (layout(SCATTERED), 1.2, Tip()),
    ],
    ids=["thin", "thick", "no grid, unknown tip"],
)
def test_thickness_is_within_three_percent_and_its_interval(array, thickness, tip):
    presses, _ = pressed(array, thickness, seed=3)
    fit = fitted(presses, array, thickness, tip)
    assert fit.thickness_mm == pytest.approx(thickness, rel=0.03)
    low, high = fit.interval_mm
    middle, half = (low + high) / 2, (high - low) / 2
    assert abs(thickness - middle) < 1.5 * half < 0.05 * thickness  # 3 deviations
    assert 0.85 < fit.residual < 1.15
    assert fit.reason == ""
    assert fit.kernel is None
    assert fit.presses == 20
    x, measured, model = fit.line
    assert (np.diff(x) >= 0).all()
    assert np.abs(measured - model)[x < 3].mean() < 0.02


def test_intervals_hold_the_truth_as_often_as_they_say():
    scores = []
    for seed in range(10):
        presses, _ = pressed(ARRAY, 0.9, seed=100 + seed, count=8, dead=0.05)
        fit = fitted(presses, ARRAY, 0.9, Tip(1.6, 0.0))
        deviation = np.log(fit.interval_mm[1] / fit.interval_mm[0]) / (2 * 1.96)
        scores.append(np.log(fit.thickness_mm / 0.9) / deviation)
    # chi-squared of 10: 2.56 to 23.2 in 98 of 100 samples
    assert 2.56 < np.square(scores).sum() < 23.2


@pytest.mark.parametrize(
    ("true", "measured", "thickness", "note", "gain_error"),
    [
        (0.5, 1.6, 2.0, "the presses look like those of a tip of 0.", 0.01),
        (1.6, 0.5, 1.0, "the presses look like those of a tip of 1.6 mm, not 0.5 mm, under a cover of 1", 0.01),
        (0.5, 0.5, 1.0, "", 0.2),  # taken for 0.01: no tip explains the presses
    ],
)
def test_a_tip_of_another_diameter_is_noted(true, measured, thickness, note, gain_error):
    presses, _ = pressed(ARRAY, thickness, seed=11, tip_mm=true, count=8, gain_error=gain_error)
    notes = fitted(presses, ARRAY, thickness, Tip(measured)).notes
    assert notes[0].startswith(note)
    assert any("those of a tip of" in each for each in notes) == bool(note)


def test_gains_that_nobody_calibrated_widen_the_interval():
    presses, _ = pressed(ARRAY, 1.1, seed=5, count=8, gain_error=0.2)
    wide = fitted(presses, ARRAY, 1.1, Tip(1.6, 0.0), gain_error=0.2)
    even, _ = pressed(ARRAY, 1.1, seed=5, count=8, gain_error=0.0)
    narrow = fitted(even, ARRAY, 1.1, Tip(1.6, 0.0), gain_error=0.0)
    assert wide.interval[1] - wide.interval[0] > 2 * (narrow.interval[1] - narrow.interval[0])
    assert wide.interval_mm[0] < 1.1 < wide.interval_mm[1]
    wrong = fitted(presses, ARRAY, 1.1, Tip(1.6, 0.0), gain_error=0.01)  # taken for calibrated
    assert wrong.residual > 3
    assert "is the gain of the taxels calibrated?" in wrong.notes[0]


def test_a_press_of_something_else_is_put_aside_and_places_may_be_known():
    array = grid(14, 14, 1.0)
    presses, places = pressed(array, 1.0, seed=6, count=8)
    random, world = np.random.default_rng(1), world_of(array, 1.0)
    two = world.tip(0.8, np.array([4.0, 4.0])) + world.tip(0.8, np.array([6.5, 5.0]))
    presses[3] = replace(Skin(array.size, random).press(two, array), start=77)
    presses[5] = replace(presses[5], start=99, reason="saturated: 3 taxels at their ceiling, press less hard")
    places[3] = 5.0, 4.5
    fit = fitted(presses, array, 1.0, Tip(1.6), places=places)
    assert fit.presses == 6
    assert fit.notes[0].startswith("press 4 of 8 is not used: fits far worse than the others")
    assert fit.notes[1].startswith("press 6 of 8 is not used: saturated: 3 taxels")
    assert fit.thickness_mm == pytest.approx(1.0, rel=0.03)


def test_dead_taxels_that_nobody_listed_are_left_out_and_named():
    random = np.random.default_rng(3)
    world = world_of(ARRAY, 1.0)
    places = world.places(12, random)
    tips = np.array([world.tip(0.8, each) for each in places])
    dead = {int(np.linalg.norm(ARRAY.positions - each, axis=1).argmin()) for each in places[:3]}
    tips[:, list(dead)] = 0
    counts = np.round(recorded(tips, random, noise=0.5) / 0.05 + 100)
    series, calibration = FrameSeries(np.arange(len(counts)) / 100, counts), Calibration(0.05, 100)
    fit = fit_touch(RecordedTouch(series, ARRAY, rubber(CONFIGURED), calibration, (0, 4095)), "tip", 1.6)
    assert fit.reason == ""
    assert fit.thickness_mm == pytest.approx(1.0, rel=0.02)
    advice = "feels nothing where its neighbours do and is left out: list it as dead"
    assert fit.notes[:3] == tuple(f"taxel {each} {advice}" for each in sorted(dead))


@pytest.mark.parametrize(("full_kpa", "expected"), [(120.0, 0.02), (80.0, None)])
def test_the_bend_of_the_curves_is_known_as_their_calibration_says_within_its_range(
    monkeypatch, full_kpa, expected
):
    array, random = grid(8, 8, 1.0), np.random.default_rng(2)
    tips = np.array([world_of(array, 1.0).tip(0.8, each) for each in array.positions[[18, 27, 36]]])
    counts = np.round(recorded(tips, random, noise=0.5) / 0.05 + 100)
    reach, exact, own = np.tile([0.0, full_kpa / 0.05], (64, 1)), np.full(64, 1e-3), np.ones(64, bool)
    curves = Curves("linear", np.full((64, 1), 0.05), reach, exact, exact, own, curvature=0.01)
    one = RecordedTouch(
        FrameSeries(np.arange(len(counts)) / 100, counts), array, rubber(1.0),
        Calibration(0.05, 100, curves=curves), (0, 4095),
    )  # fmt: skip

    def tip_touch(*arguments):
        raise ConfigError(f"bend known to {arguments[-1].curvature}")

    monkeypatch.setattr(recorded_touch, "tip_touch", tip_touch)
    with pytest.raises(ConfigError, match=f"bend known to {expected}"):
        fit_touch(one, "tip", 1.6)


@pytest.mark.parametrize("tip_mm", [0.5, 4.0])
def test_taxels_beside_a_press_are_not_dead(tip_mm):
    presses, _ = pressed(ARRAY, 0.3, tip_mm=tip_mm, gain_error=0.2, dead=0.0)
    assert without_dead(presses, ARRAY)[1] == []


def test_gains_come_first_where_presses_do_not_tell():
    assert _reason(ENDS, 1.0, True).endswith("explains the presses: calibrate the gain first")


def test_notes_say_what_modulus_and_compressibility_do_and_nothing_of_the_right_tip():
    presses, _ = pressed(ARRAY, 1.0, seed=7, count=8)
    notes = fitted(presses, ARRAY, 1.0, Tip(1.6)).notes
    assert any(note.startswith("the cover's Young's modulus does not matter") for note in notes)
    assert not any("those of a tip of" in note for note in notes)


def test_what_cannot_be_fitted_is_refused_or_has_a_reason():
    array = grid(10, 10, 1.0)
    presses, places = pressed(array, 1.0, count=4)
    two_usable = [*presses[:2], *(replace(each, reason="reaches over the array's border") for each in presses[2:])]
    with pytest.raises(
        ConfigError, match=r"2 of 4 presses can be used \(reaches over the array's border\): press"
    ):
        fitted(two_usable, array, 1.0, Tip(1.6))
    with pytest.raises(
        ConfigError, match="the tip is 12 mm wide: give more than 0 and less than the array's 10 mm"
    ):
        fitted(presses, array, 1.0, Tip(12.0))
    with pytest.raises(ConfigError, match="3 places are given, and there are 4 presses"):
        fitted(presses, array, 1.0, Tip(1.6), places=places[:3])
    thick = fit_cover(tip_touch(presses, array, rubber(6.0), Tip(1.6), 0.01), presses, "tip")
    assert thick.reason.startswith("any cover thinner than ")
    assert thick.factor == pytest.approx(0.25)
