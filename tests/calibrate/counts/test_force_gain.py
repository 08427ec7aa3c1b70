import re
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest

from tactiled import surface
from tactiled.bench.presses import KPA_PER_COUNT, Disc, simulated_skin
from tactiled.calibrate.counts.force_gain import fit_force, fit_weight, reach_of
from tactiled.calibrate.counts.means import Rails
from tactiled.calibrate.counts.reference import Reference
from tactiled.cover.stack import Layer, Stack
from tactiled.errors import ConfigError
from tactiled.frames import FrameSeries
from tactiled.geometry import grid, layout
from tactiled.guided.gain_procedure import _gain_line, _outcome
from tests.calibrate.counts.skins import FULL_KPA, RATE_HZ, Skin, contact

ARRAY = grid(16, 16, 2.0)
WIDTH_MM = 1.5  # of the contact: its force is the sum of what the taxels bear, to 1e-4
PEAK_N = 0.95e-3 * FULL_KPA * 2 * np.pi * WIDTH_MM**2
SPAN_MM = 30.0
LOAD_N = 0.1 * np.pi  # 100 kPa on a disc of 1 mm radius
HOLD = np.repeat([0.0, 1.0, 0.0], (50, 300, 200))[:, None]
FINE, COARSE = np.mgrid[0:13, 0:13] * 1.5, np.mgrid[7:14, -1:8] * 3.0
UNEVEN = layout(np.concatenate([FINE.reshape(2, -1).T, COARSE.reshape(2, -1).T]))


def log(series, force, offset_s=0.412):
    times = np.arange(series.times[0], series.times[-1], 0.02)
    noise = np.random.default_rng(9).normal(0, 0.002 * force.max(), times.size)
    return Reference(Path("force.csv"), "force_n", times + offset_s, np.interp(times, series.times, force) + noise)


def presses(places, seconds=3.0):
    """Places (T, 2) and forces (T,) of presses at `places`, each with a pause before and after."""
    frames = int(seconds * RATE_HZ)
    load = np.interp(np.linspace(0, 1, frames), [0, 0.2, 0.4, 0.6, 0.8, 1], [0, 0, 1, 1, 0, 0])
    strength = np.random.default_rng(8).uniform(0.6, 1, len(places))
    return np.repeat(places, frames, axis=0), PEAK_N * (strength[:, None] * load).ravel()


def laid_on(skin, places, array=ARRAY, width=WIDTH_MM):
    """Frames of PEAK_N that lies at one place after another for 10 s each."""
    places, force = presses(np.array(places), seconds=10)
    return skin.series(contact(places, np.where(force > 0, PEAK_N, 0), array, width))


def middle(count, seed):
    return np.random.default_rng(seed).uniform(6, SPAN_MM - 6, (count, 2))


@pytest.mark.parametrize(("seed", "falling"), [(31, False), (32, True)])
def test_presses_of_known_force_give_the_common_gain_and_the_spread_of_the_taxels(seed, falling):
    skin = Skin(256, seed=seed, falling=falling)
    places, force = presses(middle(40, seed), seconds=1.5)
    series = skin.series(contact(places, force, ARRAY, WIDTH_MM))
    fit = fit_force(series, log(series, force), ARRAY, Rails())
    assert fit.curves.form == "linear"
    assert abs(fit.alignment.offset_s - 0.412) < 0.002
    assert fit.spread == pytest.approx(0.2, rel=0.35)  # some 80 taxels were pressed
    assert not fit.curves.individual.any()
    gains = FULL_KPA / skin.full
    assert 0.9 < (np.abs(np.abs(fit.curves.gain) / gains - 1) < 1.96 * fit.curves.deviation).mean() <= 1


def test_loads_at_the_border_and_on_dead_taxels_are_left_out():
    skin = Skin(256, seed=35, spread=0, dead=(120,))
    skin.offset[120] = 0
    places, force = presses(
        np.concatenate([middle(10, 35), [[0.0, 4.0], [30.0, 20.0]], [ARRAY.positions[120]] * 3])
    )
    series = skin.series(contact(places, force, ARRAY, WIDTH_MM))
    fit = fit_force(series, log(series, force), ARRAY, Rails())
    assert fit.dead == (120,)
    live = np.arange(256) != 120
    np.testing.assert_allclose(fit.curves.gain[live], FULL_KPA / 3000, rtol=0.01)
    assert np.isnan(fit.curves.deviation[120])
    places, force = presses(np.tile([[0.5, 4.0]], (8, 1)))
    series = skin.series(contact(places, force, ARRAY, WIDTH_MM))
    with pytest.raises(ConfigError, match="reach the border of the array or a dead taxel"):
        fit_force(series, log(series, force), ARRAY, Rails())


def test_a_weight_gives_the_common_gain_and_says_that_the_spread_is_not_known():
    series = laid_on(Skin(256, seed=36, spread=0), [[10.0, 11.0], [12.0, 9.0]])
    fit = fit_weight(series, PEAK_N, ARRAY, Rails())
    np.testing.assert_allclose(fit.curves.gain, FULL_KPA / 3000, rtol=0.01)
    assert not fit.curves.individual.any()
    assert np.isnan(fit.curves.deviation).all()
    assert "their spread is not known, so each one's own error is unknown" in fit.notes[0]
    assert "laid on 2 times, at 2 places; 95 % interval of the common gain ±" in fit.notes[1]
    assert fit.force_n.tolist() == [PEAK_N, PEAK_N]


def test_taxels_that_always_read_their_ceiling_are_dead_and_refuse_no_weight():
    """Ten of 256 were 71 % of the readings under load: those of a small foot are few."""
    series = laid_on(Skin(256, seed=36, spread=0, falling=True), [[10.0, 11.0], [12.0, 9.0]])
    series.counts[:, [15, 250]] = 0
    fit = fit_weight(series, PEAK_N, ARRAY, Rails(low=0))
    np.testing.assert_allclose(fit.curves.gain, -FULL_KPA / 3000, rtol=0.01)
    assert fit.dead == (15, 250)


def laid(array, places, spread=0.0, thickness=2.5):
    """Frames of a load of 0.3 N at places (mm from the middle) of an array under rubber of `thickness` pitches.

    With them the share of a load over each taxel that is sensed.
    """
    stack = Stack((Layer(thickness, 0.6, 0.48), Layer(1.0, 980.0, 0.3)))
    skin = simulated_skin(stack, array, np.random.default_rng(5), noise_kpa=0.5, spread=spread)
    loads = [100 * Disc(*place, 1.0).readings(array, skin.cover) for place in places]
    kpa = np.concatenate([np.zeros((200, array.size)), *(each * HOLD for each in loads)])
    reach = reach_of(surface.make(skin.cover, array, 1), array)
    return skin.series(kpa, np.arange(len(kpa)) / RATE_HZ, np.random.default_rng(6)), reach


def weighed(array, places, reach=None, spread=0.0, thickness=2.5):
    series, known = laid(array, places, spread, thickness)
    return fit_weight(series, LOAD_N, array, Rails(0, 65535), known if reach else None)


def test_a_force_log_under_a_thick_cover_counts_what_is_beyond_the_array():
    """A gain from what is sensed alone is 4.4 % off."""
    array, places = grid(16, 16, 1.0, 0.8), np.random.default_rng(3).uniform(-2, 2, (6, 2))
    series, reach = laid(array, places)
    force = LOAD_N * np.concatenate([np.zeros(200), np.tile(HOLD[:, 0], len(places))])
    fit = fit_force(series, log(series, force), array, Rails(0, 65535), reach)
    assert fit.curves.gain[0] == pytest.approx(KPA_PER_COUNT, rel=0.015)
    assert any("of a load is beyond the array" in each for each in fit.notes)


def test_what_the_cover_spreads_beyond_the_array_is_taken_into_account():
    """At the documented margin nothing else is left of twelve weights under 2.5 pitches: all were refused."""
    array, places = grid(16, 16, 1.0, 0.8), [(-1.5, 1.0), (1.5, -1.0)]
    fit = weighed(array, places, reach=True)
    assert fit.curves.gain[0] == pytest.approx(KPA_PER_COUNT, rel=0.015)
    assert "of a load is beyond the array" in fit.notes[0]
    with pytest.raises(ConfigError, match="reach the border"):
        weighed(array, places)
    with pytest.raises(ConfigError, match="reach the border"):
        weighed(array, [(-6.0, 1.0), (6.0, -1.0)], reach=True)


def test_the_interval_of_a_weight_is_students_over_its_places():
    array, places = grid(14, 14, 1.0, 0.8), [(-3.0, 1.0), (2.0, -1.0)]
    once = [weighed(array, [place], True, 0.4, 0.5) for place in places]
    first, second = (each.curves.gain[0] for each in once)
    half = 12.706 * abs(first - second) / (first + second)
    outcomes = [_outcome(Mock(calibrated=False), None, once[0])]
    for again in (places, [*places, *places]):
        fit = weighed(array, again, True, 0.4, 0.5)
        assert f"laid on {len(again)} times, at 2 places" in fit.notes[-1]
        (printed,) = re.findall(r"±(\S+) %", fit.notes[-1])
        assert float(printed) / 100 == pytest.approx(half, rel=0.1)
        outcomes.append(_outcome(Mock(calibrated=False), None, fit))
    assert "unknown: lay it on again" in once[0].notes[-1]
    intervals = [each.interval_kpa_per_count for each in outcomes]
    assert intervals[0] is None
    for low, high in intervals[1:]:
        assert (high - low) / (first + second) == pytest.approx(half, rel=0.1)


def test_a_weight_that_was_laid_on_the_border_once_is_left_out():
    series = laid_on(Skin(256, seed=36, spread=0), [[10.0, 11.0], [0.0, 11.0]])
    fit = fit_weight(series, PEAK_N, ARRAY, Rails())
    np.testing.assert_allclose(fit.curves.gain, FULL_KPA / 3000, rtol=0.01)
    assert fit.notes[0] == "load 2 of 2 is not used: it reaches the border of the array or a dead taxel"


@pytest.mark.parametrize(
    ("weight_n", "first", "message"),
    [(PEAK_N, 400, "must start unloaded"), (-1.0, 0, "weight_n = -1: give the force"), (1e4, 0, "check the unit")],
)
def test_a_bad_weight_is_refused(weight_n, first, message):
    series = laid_on(Skin(256, seed=37), [[10.0, 11.0]])
    with pytest.raises(ConfigError, match=message):
        fit_weight(FrameSeries(series.times[first:], series.counts[first:]), weight_n, ARRAY, Rails(sign=1))


@pytest.mark.parametrize("array", [grid(1, 1, 2.0), grid(1, 4, 2.0), layout(np.zeros((1, 2)), 2.0)])
def test_a_force_on_an_array_that_is_all_border_is_refused(array):
    series = laid_on(Skin(array.size, seed=39), np.zeros((2, 2)), array)
    with pytest.raises(ConfigError, match="every taxel is at the border"):
        fit_weight(series, PEAK_N, array, Rails())


@pytest.mark.parametrize("shape", ["linear", "power"])
def test_a_force_gives_the_same_gain_wherever_it_lies_on_an_uneven_layout(shape):
    skin = Skin(UNEVEN.size, shape, 38, spread=0)
    places, force = presses(np.tile([[9.0, 9.0], [30.0, 9.0], [20.0, 9.0]], (4, 1)))
    force *= (2.5 / WIDTH_MM) ** 2
    series = skin.series(contact(places, force, UNEVEN, 2.5))
    fit = fit_force(series, log(series, force), UNEVEN, Rails())
    assert fit.curves.form == shape
    got = fit.curves.pressure(skin.relative(np.full(UNEVEN.size, 40)) * skin.full)
    np.testing.assert_allclose(got, 40, rtol=0.01)


def test_the_chart_of_a_weight_on_an_uneven_layout_has_its_loads_on_the_line():
    series = laid_on(Skin(UNEVEN.size, seed=40, spread=0), [[9.0, 9.0], [30.0, 9.0]], UNEVEN, 2.5)
    fit = fit_weight(series, PEAK_N, UNEVEN, Rails())
    counts, measured, _ = _gain_line(fit, 0)[:, -2:]
    np.testing.assert_allclose(counts * fit.curves.gain[0], measured, rtol=0.01)
