import numpy as np
import pytest

from tactiled.calibrate.counts.calibration import Calibration, Calibrator
from tactiled.calibrate.counts.curves import Curves
from tactiled.calibrate.counts.gain import fit_pressure, fit_steps
from tactiled.calibrate.counts.hysteresis import Loop, LoopFollower
from tactiled.calibrate.counts.means import Rails
from tactiled.errors import ConfigError
from tactiled.frames import MISSING, FrameSeries
from tests.calibrate.counts.skins import FULL_KPA, Skin, steps
from tests.calibrate.counts.test_gain import pressure_log

LOOP = Loop(0.0, 0.1, 0.5)
END = np.array([1000.0, -1000.0])
STEPS = (0, 10, 20, 30, 40, 50, 60, 50, 40, 30, 20, 10, 0)
SLIPS = np.array([0.02, 0.05, 0.1, 0.2, 0.4])  # of full scale
STIFFNESS = np.array([0.3, 0.2, 0.1, 0.05, 0.02])


def slipping(kpa):
    """What a pressure (T,) becomes behind springs that slide, another model of friction than the fitted one."""
    slips, shares = SLIPS * FULL_KPA, np.zeros(SLIPS.size)
    lag, before = np.empty(kpa.size), 0.0
    for n, each in enumerate(kpa):
        shares, before = np.clip(shares + each - before, -slips, slips), each
        lag[n] = STIFFNESS @ shares
    return np.maximum(kpa - 0.5 * lag * np.minimum(1, kpa / 6), 0)


def added(*counts):
    follower = LoopFollower(LOOP, END)
    return np.array([follower.follow(np.array([each, -each], np.float32)).copy() for each in counts])[:, 0]


def test_a_loop_adds_on_the_way_up_takes_off_on_the_way_down_and_closes_at_no_load():
    assert added(0, 50, 100, 500).tolist() == [0, 25, 50, 50]
    assert added(500, 450, 400, 300, 100).tolist() == [50, 25, 0, -50, -50]
    assert added(500, 300, 50, 0, 50).tolist() == [50, -50, -25, 0, 25]
    assert added(500, 480, 500)[-1] == 50  # a minor loop returns to where it began


def test_counts_that_fall_under_pressure_have_the_same_loop_and_unknown_ones_keep_theirs():
    follower = LoopFollower(LOOP, END)
    both = follower.follow(np.array([300, -300], np.float32))
    np.testing.assert_array_equal(both, [50, -50])
    np.testing.assert_array_equal(follower.follow(np.array([np.nan, -100], np.float32)), [50, 50])


@pytest.mark.parametrize(
    ("loop", "message"), [((0.1, 0.1, 0.2), "half-widths 0.1 and 0.1"), ((0, 0.1, 1), "weight is 1")]
)
def test_a_loop_that_is_none_is_refused(loop, message):
    with pytest.raises(ConfigError, match=message):
        Loop(*loop).check()


def calibrator():
    size = np.ones(2)
    curves = Curves(
        "linear", np.full((2, 1), 0.1), np.tile([0.0, 1000.0], (2, 1)), size, size, size.astype(bool), loop=LOOP
    )
    return Calibrator(Calibration(curves=curves, no_loads=np.array([100.0, 100.0])), 2)


def test_frames_one_by_one_and_a_series_are_the_same_and_a_tare_begins_anew():
    counts = (100 + 400 * np.sin(np.linspace(0, 6, 80)[:, None] * [1, 1.3]) ** 2).astype(np.float32)
    flags = np.zeros(counts.shape, np.uint8)
    flags[20:24, 0] = MISSING
    one = calibrator()
    frames = []
    for each in zip(counts, flags, strict=True):
        one.follow(*each)
        frames.append(one(*each)[0])
    together, _ = calibrator().series(counts, flags)
    np.testing.assert_array_equal(np.stack(frames), together)
    np.testing.assert_array_equal(one.series(counts, flags)[0], together)  # it changes nothing
    last = one(counts[-1], flags[-1])[0]
    other = calibrator()
    other.take_over(one)
    np.testing.assert_array_equal(other(counts[-1], flags[-1])[0], last)
    one.tare(np.array([100.0, 100.0]))
    assert one(counts[-1], flags[-1])[0] == pytest.approx(0.1 * (counts[-1] - 100))


@pytest.mark.parametrize(("way", "noise", "seed"), [("steps", 0.003, 61), ("log", 0.01, 62)])
def test_a_model_is_chosen_where_it_predicts_another_recording_better(way, noise, seed):
    skin = Skin(20, "power", seed, falling=seed % 2 == 0, noise=noise, drift=0)
    if way == "steps":
        fit = fit_steps(skin.series(slipping(steps(STEPS))), STEPS, Rails())
    else:
        kpa = steps((0, 60, 0, 40, 0), hold_s=1, ramp_s=6)
        series = skin.series(slipping(kpa))
        fit = fit_pressure(series, pressure_log(series, kpa), Rails())
    curves = fit.curves
    assert curves.loop is not None
    assert "taken off by a model" in fit.notes[0]
    kpa = steps((0, 45, 20, 55, 10, 35, 0), hold_s=1, ramp_s=5)
    series = skin.series(slipping(kpa))
    calibration = Calibration(curves=curves, no_loads=fit.no_load)
    flags = np.zeros(series.counts.shape, np.uint8)
    got, _ = Calibrator(calibration, 20).series(series.counts, flags)
    plain = curves.pressure(series.counts - fit.no_load)
    own = noise * FULL_KPA * 1.3
    errors = [
        np.sqrt(max(np.median(((each - kpa[:, None]) ** 2).mean(axis=0)) - own**2, 0)) for each in (got, plain)
    ]
    assert errors[0] < 0.6 * errors[1]


@pytest.mark.parametrize(
    ("shape", "seed", "drift"), [("linear", 63, 0.0), ("spline", 64, 0.01), ("power", 103, 0.05)]
)
def test_no_model_is_chosen_without_hysteresis(shape, seed, drift):
    levels = (0, 3, 6, 12, 18, 24, 30, 36, 42, 48, 54, 60, 45, 30, 15, 0)
    skin = Skin(64, shape, seed, drift=drift)
    assert fit_steps(skin.series(steps(levels, hold_s=2)), levels, Rails()).curves.loop is None


def test_a_slow_log_is_aligned_in_spite_of_hysteresis():
    """What reads late on the way up, and late on the way down, looks like another clock: it was 4 s off."""
    rise = np.concatenate([np.zeros(100), np.repeat(np.linspace(0, 60, 21), 40)])
    kpa = np.concatenate([rise, rise[::-1]])
    fast = Skin(16, "power", 66, noise=0.005, drift=0).series(3 * slipping(kpa) - 2 * kpa)
    series = FrameSeries(fast.times[0] + 10 * (fast.times - fast.times[0]), fast.counts)
    fit = fit_pressure(series, pressure_log(series, kpa, 2.5, rate_hz=3.0), Rails())
    assert fit.alignment.offset_s == pytest.approx(2.5, abs=0.4)
