from itertools import islice
from operator import call

import numpy as np
import pytest

from tactiled.calibrate.counts.calibration import Calibration, Calibrator
from tactiled.calibrate.upkeep.blocks import BLOCK_FRAMES
from tactiled.calibrate.upkeep.health import Fault
from tactiled.calibrate.upkeep.monitor import SkinMonitor
from tactiled.calibrate.upkeep.neighbourhood import SHARE, Neighbourhood
from tactiled.frames import Loss, RawFrame
from tactiled.geometry import layout
from tactiled.simulate.array import Surface
from tests.bench.health import (
    FAULTY,
    FULL_SCALE,
    NO_LOAD,
    SHAPE,
    SLOW_HZ,
    Run,
    discs,
    false_alarms,
    grasps,
    noisy,
    play,
    scenarios,
)
from tests.plans import plan


@pytest.mark.parametrize(
    ("fault", "thickness", "within_s"),
    [
        (Fault.STUCK, 1.0, 8), (Fault.NOISY, 1.0, 15), (Fault.SATURATED, 1.0, 45),
        (Fault.DEAD, 1.0, 20), (Fault.WEAK, 2.0, 35),
    ],
)  # fmt: skip
def test_a_fault_is_found_named_and_undone_when_the_taxel_heals(fault, thickness, within_s):
    random = np.random.default_rng(fault)
    run = Run(plan(SHAPE, thickness), np.ones(100), SLOW_HZ)
    assert play(run, random, 30) == []
    ((frame, change),) = play(run, random, 60, fault)
    assert (change.taxel, change.before, change.after) == (FAULTY, Fault.HEALTHY, fault)
    assert frame < within_s * SLOW_HZ
    assert np.flatnonzero(run.calibrator.faulty).tolist() == [FAULTY]
    state = run.monitor.state
    assert state.faults[FAULTY] == fault
    assert state.since_s[FAULTY] == change.time_s
    changes = play(run, random, 60)
    assert [(each.taxel, each.after) for _, each in changes] == [(FAULTY, Fault.HEALTHY)]
    assert not run.calibrator.faulty.any()


def test_healthy_arrays_have_no_false_alarm():
    """The demo's tour under three covers and without noise, empty, drifting and heavily loaded pads.

    Of six frames one is looked at.
    """
    for number, each in enumerate(scenarios(tours=1, seconds=30.0)):
        looked_at = each._replace(frames=islice(each.frames, 0, None, 6), rate_hz=each.rate_hz / 6)
        name, frames, changes = false_alarms(looked_at, [77, number], True)
        assert (name, changes) == (name, 0)
        assert frames > 4e5


@pytest.mark.parametrize(("thickness", "calibrated"), [(0.5, True), (1.0, False)])
def test_the_same_object_with_gaps_at_the_same_place_again_is_no_fault(thickness, calibrated):
    for scenario in grasps((thickness,), seconds=40.0, side=16):
        name, _, changes = false_alarms(scenario, 7, calibrated, side=16)
        assert (name, changes) == (name, 0)


@pytest.mark.parametrize("no_load", [1e6, -500])
@pytest.mark.parametrize("gain", [0.05, -0.05])
def test_a_skin_without_a_known_ceiling_is_not_saturated(no_load, gain):
    skin, random = plan((4, 4), 1.0), np.random.default_rng(0)
    calibration = Calibration(gain, no_load)
    calibrator = Calibrator(calibration, 16)
    monitor = SkinMonitor(skin.array, skin.kernel, calibration, (-np.inf, np.inf), 0xFFFF)
    for n in range(960):
        counts = np.round(random.normal(no_load, 5, 16)).astype(np.float32)
        monitor.observe(RawFrame(n, n / SLOW_HZ, 0.0, counts, np.zeros(16, np.uint8), Loss()), calibrator)
    assert not monitor.state.faults.any()


def test_a_weak_taxel_is_no_fault_where_gains_were_not_measured():
    random = np.random.default_rng(3)
    run = Run(plan(SHAPE, 1.0), rate_hz=SLOW_HZ)
    assert play(run, random, 90, Fault.WEAK) == []


def test_quiet_rounded_taxels_are_not_stuck_however_noisy_the_others_are():
    random = np.random.default_rng(4)
    run = Run(plan(SHAPE, 1.0), rate_hz=SLOW_HZ)
    noise = np.full(100, 3.0)
    noise[[12, 57]] = 0.1, 0.0
    for _ in range(960):
        assert run.push(NO_LOAD + random.normal(0, noise)) == []


@pytest.mark.parametrize("value", [0.0, float(FULL_SCALE)])
def test_readings_at_the_end_of_their_range_that_neighbours_share_are_not_stuck(value):
    """Below zero a converter reads 0 all the time; a heavy load is at the ceiling."""
    random = np.random.default_rng(5)
    run = Run(plan(SHAPE, 0.5), rate_hz=SLOW_HZ)
    for n in range(960):
        counts = NO_LOAD + random.normal(0, 3, 100)
        if n > 480:
            counts[[0, 1, 10, 11]] = value - np.sign(NO_LOAD - value) * 50
        assert run.push(counts) == []


SKIN = plan((12, 12), 0.35)  # 8 bits, noise under a count, counts that fall under pressure, as iCub's


def on_quiet_skin(spoil, seconds=80, presses=False, noise=0.4, rate_hz=20.0, faulty=66):
    """Faults by taxel after so long on a skin of 8 bits, of which one's counts go through `spoil(t, counts)`."""
    random, calibration = np.random.default_rng(8), Calibration(-0.5, 240)
    calibrator = Calibrator(calibration, 144)
    rest = np.round(random.uniform(225, 250, 144))
    calibrator.tare(rest)
    monitor, (x, y) = SkinMonitor(SKIN.array, SKIN.kernel, calibration, (0, 255), 255), SKIN.array.positions.T
    pressed = SKIN.blur.forward(120.0 * (np.hypot(x - 6.3, y - 5.2) < 2.6).reshape(12, 12)).ravel()
    for n in range(int(seconds * rate_hz)):
        t = n / rate_hz
        counts = rest - pressed * (presses and t % 5 < 3) + random.normal(0, noise, 144)
        counts = np.clip(np.round(counts), 0, 255).astype(np.float32)
        if t > 25:
            counts[faulty] = spoil(t, counts[faulty])
        monitor.observe(RawFrame(n, t, 0.0, counts, np.zeros(144, np.uint8), Loss()), calibrator)
    assert {each.taxel for each in monitor.drain_changes()} <= {faulty}
    return {int(each): Fault(monitor.state.faults[each]) for each in np.flatnonzero(monitor.state.faults)}


@pytest.mark.parametrize("presses", [False, True])
@pytest.mark.parametrize(
    ("spoil", "fault"),
    [
        (lambda *_: 60, Fault.STUCK),  # as under a load
        (lambda *_: 255, Fault.STUCK),  # less than no load
        (lambda *_: 0, Fault.SATURATED),
        (lambda t, _: 255 * (t % 0.2 < 0.1), Fault.NOISY),
        (lambda _, counts: counts, None),
    ],
)
def test_a_taxel_of_a_quiet_skin_that_freezes_or_blinks_is_found(spoil, fault, presses):
    assert on_quiet_skin(spoil, presses=presses) == ({} if fault is None else {66: fault})


def test_a_taxel_of_a_quiet_skin_that_freezes_at_rest_is_dead_once_its_neighbours_are_pressed():
    assert on_quiet_skin(lambda *_: 238, presses=True) == {66: Fault.DEAD}


@pytest.mark.parametrize(
    ("thickness", "times", "spikes", "measured", "within_s"),
    [
        (0.5, 8, 1.0, True, 80), (0.5, 30, 1.0, False, 200), (0.5, 100, 0.05, True, 100),
        (1.0, 15, 1.0, False, 15), (1.0, 30, 0.05, True, 25),
    ],
)  # fmt: skip
def test_a_taxel_whose_noise_no_load_explains_is_noisy(thickness, times, spikes, measured, within_s):
    assert noisy(thickness, times, spikes, measured, seconds=within_s, seed=4) < within_s


def test_no_taxel_is_noisy_where_most_are_loaded_and_frames_come_unevenly():
    random = np.random.default_rng(14)
    run, loaded = Run(plan(SHAPE, 2.0)), np.arange(100) % 10 > 3  # the noise of these cannot be measured
    for time_s in np.cumsum(random.exponential(1 / 9, 800)):
        load = 40 * (1 + 0.25 * np.sin(time_s)) * loaded
        assert run.push(NO_LOAD + load + random.normal(0, 4, 100), time_s) == []


def test_a_dead_row_is_found_though_its_taxels_are_each_others_neighbours():
    random = np.random.default_rng(6)
    run, changes = Run(plan(SHAPE, 1.0), rate_hz=SLOW_HZ), []
    presses = discs(random, FAULTY)
    for n in range(int(300 * SLOW_HZ)):
        if n % 48 == 0:
            pressed = next(presses) if n % 96 == 0 else np.zeros(100)
        counts = NO_LOAD + pressed
        counts[40:50] = NO_LOAD
        changes += run.push(counts + random.normal(0, 1, 100))
    assert {each.after for each in changes} == {Fault.DEAD}
    assert {42, 43, 44, 45, 46} <= {each.taxel for each in changes} <= set(range(40, 50))


def test_noise_is_measured_for_each_taxel_whatever_presses_on_it():
    random = np.random.default_rng(7)
    run = Run(plan(SHAPE, 1.0), rate_hz=SLOW_HZ)
    noise = np.linspace(1, 8, 100)
    play(run, random, 90, noise=noise)
    np.testing.assert_allclose(run.monitor.state.noise_counts, noise, rtol=0.25)
    assert abs(np.mean(run.monitor.state.noise_counts / noise) - 1) < 0.05


@pytest.mark.parametrize("thickness", [0.5, 2.0])
def test_what_neighbours_say_of_a_load_holds_for_every_spot(thickness):
    skin = plan(SHAPE, thickness)
    surface, taxels = Surface(skin.kernel, skin.array), np.array([0, 5, FAULTY])
    neighbourhood, trusted = Neighbourhood(skin.kernel, skin.array, call), np.ones(100, bool)
    lowest, share = [], []
    for at in np.ndindex(*(np.array(surface.x.shape) // 4)):
        spot = np.zeros(surface.x.shape)
        spot[4 * at[0] : 4 * at[0] + 2, 4 * at[1] + 1 : 4 * at[1] + 3] = 100.0
        felt = surface.sense(spot)
        lowest.append(felt[taxels] - neighbourhood.lowest(taxels, felt, trusted))
        beside, part = neighbourhood.beside(taxels, felt, trusted)
        share.append(beside - SHARE * part * felt[taxels])
    assert np.min(lowest) > -0.02
    assert np.min(share) > -0.02
    even = neighbourhood.lowest(taxels, np.ones(100), trusted)
    assert (even > [0.02, 0.03, 0.05] if thickness < 1 else even > [0.2, 0.3, 0.5]).all()


def test_touching_apertures_of_any_layout_have_a_neighbourhood():
    places = np.array([[x + y % 2 / 2, y * 0.75**0.5] for y in range(5) for x in range(5)]) * 6.4 + 0.333
    array, taxels = layout(places, 6.4 * (1 - 1e-12)), np.array([0, 12])  # in a corner and in the middle
    neighbourhood = Neighbourhood(plan(SHAPE, 1.0, pitch=6.4).kernel, array, call)
    even = neighbourhood.lowest(taxels, np.ones(25), np.ones(25, bool))
    sums, share = neighbourhood.beside(taxels, np.ones(25), np.ones(25, bool))
    assert (*sums, len(neighbourhood.peaks(np.arange(25), np.ones(25)))) == (2, 6, 0)
    assert (share > 0).all()
    assert 0.05 < even[1] < 1


def test_a_frame_is_looked_at_now_and_then():
    run = Run(plan(SHAPE, 1.0))
    looks = [n for n in range(300) if (run.push(np.full(100, 100.0)), run.monitor._blocks._frames)[1] == 0]
    assert looks[0] == BLOCK_FRAMES - 1
