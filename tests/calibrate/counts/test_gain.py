from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tactiled.calibrate.counts.gain import fit_pressure, fit_steps
from tactiled.calibrate.counts.means import Rails
from tactiled.calibrate.counts.reference import Reference
from tactiled.errors import ConfigError
from tactiled.frames import FrameSeries
from tactiled.geometry import grid, tiling
from tests.calibrate.counts.skins import FULL_KPA, RATE_HZ, Skin, steps

STEPS = (0, 5, 15, 30, 40, 50, 60, 50, 40, 30, 15, 5, 0)
FINE_STEPS = (0, 3, 6, 12, 18, 24, 30, 33, 36, 42, 48, 54, 60, 45, 30, 15, 0)
DEAD = (7, 90)


def errors(fit, skin, kpa):
    """Relative errors of each live taxel's pressure at the counts that it has under `kpa`."""
    over = np.sign(fit.curves.gain) * skin.relative(np.full(skin.size, kpa)) * skin.full
    live = np.setdiff1d(np.arange(skin.size), skin.dead)
    return (fit.curves.pressure(over) / kpa - 1)[live], fit.curves.deviation[live]


def pressure_log(series, kpa, offset_s=0.0, rate_hz=30.0, seed=0):
    times = np.arange(series.times[0], series.times[-1], 1 / rate_hz)
    noise = np.random.default_rng(seed).normal(0, 0.002 * FULL_KPA, times.size)
    return Reference(
        Path("bag.csv"), "pressure_kpa", times + offset_s, np.interp(times, series.times, kpa) + noise
    )


@pytest.mark.parametrize(
    ("shape", "falling", "seed"),
    [("linear", False, 11), ("power", True, 12), ("cubic", False, 11), ("spline", True, 12)],
)
def test_steps_give_each_taxels_curve_its_interval_and_the_dead_ones(shape, falling, seed):
    skin = Skin(256, shape, seed, falling, dead=DEAD)
    levels = FINE_STEPS if shape == "spline" else STEPS
    fit = fit_steps(skin.series(steps(levels)), levels, Rails(0, 65535))
    assert fit.curves.form == shape
    assert fit.dead == DEAD
    np.testing.assert_array_equal(np.flatnonzero(~fit.curves.individual), DEAD)
    for kpa in (30, 45, 60):
        assert np.abs(errors(fit, skin, kpa)[0]).max() < 0.01
    error, deviation = errors(fit, skin, 60)
    inside = (np.abs(error) < 1.96 * deviation).mean()
    assert 0.9 <= inside <= 0.99
    assert 100 * np.median(deviation) < 1
    start = 12000 - skin.offset if falling else skin.offset
    assert np.abs(fit.no_load - start).max() < 0.005 * 3000
    assert np.nanmax(fit.curves.hysteresis) < 1
    top = fit.curves.counts(np.full(skin.size, 61.0))
    assert fit.curves.out_of_range(top)[fit.curves.individual].all()


def test_intervals_cover_the_truth_in_95_of_100_taxels():
    inside = []
    for seed, shape in enumerate(("linear", "power", "cubic"), 20):
        skin = Skin(512, shape, seed)
        error, deviation = errors(fit_steps(skin.series(steps(STEPS, hold_s=2)), STEPS, Rails()), skin, 60)
        inside.append(np.abs(error) < 1.96 * deviation)
    assert 0.93 <= np.mean(inside) <= 0.975


def test_few_steps_support_few_parameters():
    assert set(fit_steps(Skin(64, seed=13).series(steps((0, 60, 0))), (0, 60, 0), Rails()).scores) == {"linear"}
    levels = (0, 20, 40, 60, 0)
    fit = fit_steps(Skin(64, "power", seed=13).series(steps(levels)), levels, Rails())
    assert (set(fit.scores), fit.curves.form) == ({"linear", "power"}, "power")


def test_hysteresis_is_the_loop_over_full_scale():
    skin = Skin(128, seed=14, hysteresis=0.05, drift=0)
    fit = fit_steps(skin.series(steps(STEPS)), STEPS, Rails())
    assert np.median(fit.curves.hysteresis) == pytest.approx(5, abs=0.5)  # 5 % at half of full scale


@pytest.mark.parametrize("hysteresis", [0.0, 0.04])
def test_the_error_elsewhere_holds_where_the_pressure_falls_from_another_peak(hysteresis):
    """A standard error of 0.3 % said nothing of a loop of 4 % of full scale."""
    skin = Skin(128, "power", 14, hysteresis=hysteresis, drift=0)
    fit = fit_steps(skin.series(steps(STEPS)), STEPS, Rails())
    kpa = steps((0, 20, 10, 45, 25, 35, 5, 50, 0))
    series = skin.series(kpa)
    missed = fit.curves.pressure(series.counts - fit.no_load) - kpa[:, None]
    error = np.hypot(np.median(fit.curves.error_kpa), 0.01 * FULL_KPA)  # a frame's own noise is another figure
    assert np.median(np.sqrt((missed**2).mean(axis=0))) < 1.2 * error
    assert np.median(fit.curves.error_kpa) < 0.05 * FULL_KPA


def test_a_rise_alone_leaves_the_error_elsewhere_unknown():
    fit = fit_steps(Skin(64, seed=14).series(steps((0, 20, 40, 60))), (0, 20, 40, 60), Rails())
    assert np.isnan(fit.curves.error_kpa).all()


def creeping(kpa, decade):
    """What a pressure (T,) becomes where each step of it grows by `decade` in a tenfold time, from 0.1 s on."""
    growth = decade * np.log10(1 + 10 * np.arange(kpa.size) / RATE_HZ)
    return kpa + np.convolve(np.diff(kpa, prepend=0.0), growth)[: kpa.size]


def test_creep_is_in_the_standard_error_and_no_curve():
    skin = Skin(64, seed=21, noise=0.003, drift=0.003)
    fit = fit_steps(skin.series(creeping(steps(STEPS, hold_s=3), 0.03)), STEPS, Rails())
    assert fit.curves.form == "linear"
    assert fit.notes == ("creep of 2 % in a tenfold time is in the standard error",)
    after_1_s = skin.relative(np.full(64, 60)) * skin.full * (1 + 0.03 * np.log10(11))
    error = np.abs(fit.curves.pressure(after_1_s) / 60 - 1)
    assert (error < 1.96 * fit.curves.deviation).mean() > 0.95
    assert error.mean() > 0.015
    assert fit_steps(Skin(64, seed=21, drift=0.02).series(steps(STEPS, hold_s=3)), STEPS, Rails()).notes == ()


@pytest.mark.parametrize(("spread", "seed"), [(0.05, 22), (0.2, 23)])
def test_a_bag_that_lifts_at_the_border_is_noted(spread, seed):
    array, kpa = grid(16, 16, 1.0), steps(STEPS, hold_s=2)
    rim = tiling(array).rim
    lift = np.where(rim, np.maximum(kpa, 1)[:, None] ** -0.5 * 0.12 + 0.02, 0.0)  # most at low pressures
    for lifted, noted in ((0.0, False), (lift, True)):
        series = Skin(256, seed=seed, spread=spread).series(kpa[:, None] * (1 - lifted))
        notes = fit_steps(series, STEPS, Rails(), array).notes
        assert any("follow a pattern" in each for each in notes) == noted


def test_the_curvature_is_known_where_pressures_lie_between():
    skin = Skin(64, "cubic", 24, drift=0)
    for levels, low, high in ((STEPS, 0, 0.005), ((0, 20, 40, 60, 0), 0.01, 0.2)):
        curves = fit_steps(skin.series(steps(levels, hold_s=2)), levels, Rails()).curves
        middle = curves.pressure(skin.relative(np.full(64, 30)) * skin.full).mean() / 30 - 1
        assert abs(middle) < 2.5 * curves.curvature + 0.001
        assert low < curves.curvature < high
    assert fit_steps(skin.series(steps((0, 60, 0))), (0, 60, 0), Rails()).curves.curvature is None


@pytest.mark.parametrize(("shape", "offset"), [("linear", 3.21), ("power", -0.537)])
def test_a_pressure_log_gives_the_same_and_the_offset_of_its_clock(shape, offset):
    kpa = steps((0, 60, 5, 40, 10, 60, 0), hold_s=4, ramp_s=3)
    skin = Skin(48, shape, 15, dead=(7, 40))
    series = skin.series(kpa)
    fit = fit_pressure(series, pressure_log(series, kpa, offset), Rails())
    assert fit.dead == skin.dead
    error, deviation = errors(fit, skin, 55)
    assert np.abs(error).max() < 0.01
    assert (np.abs(error) < 1.96 * deviation).mean() > 0.9
    assert abs(fit.alignment.offset_s - offset) < min(3 * fit.alignment.deviation_s, 0.5 / RATE_HZ)


def changed(series, change):
    return FrameSeries(series.times, change(series.counts.copy()).astype(np.float32))


def test_a_saturated_taxel_keeps_the_pressures_below_its_ceiling():
    skin = Skin(64, seed=16, spread=0.05)
    skin.offset[5] = 2000
    series = changed(skin.series(steps(STEPS)), lambda counts: np.minimum(counts, 4000))
    fit = fit_steps(series, STEPS, Rails(high=4000))
    assert fit.curves.reach_counts[5, 1] < 2000
    assert np.abs(errors(fit, skin, 30)[0]).max() < 0.01


@pytest.mark.parametrize("counts", [np.nan, 4000.0, "wild"])
def test_a_taxel_that_sends_nothing_or_its_ceiling_or_what_no_load_explains_is_dead(counts):
    def stuck(all_counts):
        part = np.linspace(0, 1, len(all_counts))
        wild = np.where((part > 0.65) & (part < 0.95), 1500, 500)
        all_counts[:, 5] = wild if counts == "wild" else counts
        return all_counts

    skin = Skin(64, seed=16, spread=0.05)
    fit = fit_steps(changed(skin.series(steps(STEPS)), stuck), STEPS, Rails(high=4000))
    assert fit.dead == (5,)
    assert np.abs(np.delete(errors(fit, skin, 30)[0], 5)).max() < 0.01


def test_half_of_the_taxels_may_be_missing():
    series = Skin(64, seed=16, falling=True).series(steps(STEPS))
    series.counts[:, :20] = 0
    fit = fit_steps(series.without(range(20, 40)), STEPS, Rails(low=0))
    assert fit.dead == tuple(range(40))


def hand_at_the_start(counts):
    counts[:300, :9] += 600
    return counts


BAD = {
    "other steps": (None, (0, 10, 20, 0), "4 pressures are given, and the recording holds 13, at"),
    "noise": (lambda c: np.random.default_rng(0).normal(500, 30, c.shape), STEPS, "no press above the noise"),
    "loaded start": (hand_at_the_start, STEPS, "the recording starts loaded: "),
    "saturated": (lambda counts: np.minimum(counts, 1500), STEPS, "readings under load are saturated"),
    "order": (None, (0, 5, 15, 30, 40, 60, 50, 60, 40, 30, 15, 5, 0), "from 60 to 50 kPa the readings rise"),
    "no zero": (None, (5, 15, 0), "the first of them 0"),
    "twice": (None, (0, 15, 15, 0), "one follows itself"),
    "pascal": (None, (0, 15000, 30000, 0), "give kPa"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_steps_are_refused_in_one_line_that_names_them(case):
    change, pressures, message = BAD[case]
    series = Skin(64, seed=17).series(steps(STEPS))
    rails = Rails(high=1500 if case == "saturated" else 1e5)
    with pytest.raises(ConfigError, match=rf"^.*{message}.*$"):
        fit_steps(changed(series, change) if change else series, pressures, rails)


def test_a_bad_log_is_refused_in_one_line_that_names_it():
    kpa = steps((0, 60, 20, 60, 0))
    series = Skin(64, seed=18).series(kpa)
    log = pressure_log(series, kpa)
    rng, repeated = np.random.default_rng(5), np.tile(steps((0, 60, 0), 1, 0.5), 48)
    alike = Skin(16, seed=19).series(repeated, start_s=0.0)
    wandering = np.convolve(rng.normal(size=log.values.size), np.ones(30), "same")
    for other, recording, message in (
        (replace(log, times=log.times + 3600), series, "does not overlap the recording: 3571 s"),
        (replace(log, values=wandering), series, "correlates with the recording by 0."),
        (replace(log, values=np.round(1000 * log.values, -4)), series, ": 60000 kPa at most, outside 0.01"),
        (replace(log, values=log.values + 20), series, "kPa where the recording starts: start unloaded"),
        (pressure_log(alike, repeated, 5.0), alike, "press with uneven pauses"),
    ):
        with pytest.raises(ConfigError) as error:
            fit_pressure(recording, other, Rails())
        assert message in str(error.value)
        assert str(error.value).startswith("bag.csv")
