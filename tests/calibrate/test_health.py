import numpy as np
import pytest

from tactiled.calibrate.blocks import BLOCK_FRAMES
from tactiled.calibrate.calibration import Calibration, Calibrator
from tactiled.calibrate.health import Fault
from tactiled.calibrate.monitor import SkinMonitor, joined
from tactiled.frames import Loss, RawFrame
from tests.plans import plan
from tests.study.health import (
    FAULTY,
    FULL_SCALE,
    NO_LOAD,
    RATE_HZ,
    SHAPE,
    Run,
    discs,
    false_alarms,
    false_positives,
    grasps,
    play,
)  # fmt: skip


@pytest.mark.parametrize(
    ("fault", "thickness", "within_s"),
    [
        (Fault.STUCK, 1.0, 8), (Fault.NOISY, 1.0, 25), (Fault.SATURATED, 1.0, 45), (Fault.DEAD, 0.5, 20),
        (Fault.DEAD, 1.0, 20), (Fault.WEAK, 2.0, 35),
    ],
)  # fmt: skip
def test_a_fault_is_found_named_and_undone_when_the_taxel_heals(fault, thickness, within_s):
    random = np.random.default_rng(fault)
    run = Run(plan(SHAPE, thickness), np.ones(100))
    assert play(run, random, 30) == []
    ((frame, change),) = play(run, random, 60, fault)
    assert (change.taxel, change.before, change.after) == (FAULTY, Fault.HEALTHY, fault)
    assert frame < within_s * RATE_HZ
    assert np.flatnonzero(run.calibrator.faulty).tolist() == [FAULTY]
    state = run.monitor.state
    assert state.faults[FAULTY] == fault
    assert state.since_s[FAULTY] == change.time_s
    changes = play(run, random, 60)
    assert [(each.taxel, each.after) for _, each in changes] == [(FAULTY, Fault.HEALTHY)]
    assert not run.calibrator.faulty.any()


def test_healthy_arrays_have_no_false_alarm_in_forty_million_taxel_frames():
    """The demo's tour under three covers and without noise, empty, drifting and heavily loaded pads."""
    counts = [each[1:] for each in false_positives(tours=1, seconds=30.0, seed=77, gains_measured=(True,))]
    assert sum(frames for frames, _ in counts) > 4e7
    assert sum(changes for _, changes in counts) == 0


@pytest.mark.parametrize("thickness", [0.5, 1.0])
@pytest.mark.parametrize("calibrated", [False, True])
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
    for n in range(6000):
        counts = np.round(random.normal(no_load, 5, 16)).astype(np.float32)
        monitor.push(RawFrame(n, n / RATE_HZ, 0.0, counts, np.zeros(16, np.uint8), Loss()), calibrator)
    assert not monitor.state.faults.any()


def test_a_weak_taxel_is_no_fault_where_gains_were_not_measured():
    random = np.random.default_rng(3)
    run = Run(plan(SHAPE, 1.0))
    assert play(run, random, 90, Fault.WEAK) == []


def test_quiet_rounded_taxels_are_not_stuck_however_noisy_the_others_are():
    random = np.random.default_rng(4)
    run = Run(plan(SHAPE, 1.0))
    noise = np.full(100, 3.0)
    noise[[12, 57]] = 0.1, 0.0
    for _ in range(6000):
        assert run.push(NO_LOAD + random.normal(0, noise)) == []


@pytest.mark.parametrize("value", [0.0, float(FULL_SCALE)])
def test_a_reading_at_the_end_of_its_range_is_not_stuck(value):
    """Below zero a converter reads 0 all the time; a heavy load is at the ceiling."""
    random = np.random.default_rng(5)
    run = Run(plan(SHAPE, 0.5))
    for n in range(6000):
        counts = NO_LOAD + random.normal(0, 3, 100)
        if n > 3000:
            counts[[0, 1, 10, 11, 99]] = value - np.sign(NO_LOAD - value) * 50
        assert run.push(counts) == []


def test_a_dead_row_is_found_though_its_taxels_are_each_others_neighbours():
    random = np.random.default_rng(6)
    run, changes = Run(plan(SHAPE, 1.0)), []
    presses = discs(random, FAULTY)
    for n in range(int(300 * RATE_HZ)):
        if n % 300 == 0:
            pressed = next(presses) if n % 600 == 0 else np.zeros(100)
        counts = NO_LOAD + pressed
        counts[40:50] = NO_LOAD
        changes += run.push(counts + random.normal(0, 1, 100))
    assert {each.after for each in changes} == {Fault.DEAD}
    assert {42, 43, 44, 45, 46} <= {each.taxel for each in changes} <= set(range(40, 50))


def test_noise_is_measured_for_each_taxel_whatever_presses_on_it():
    random = np.random.default_rng(7)
    run = Run(plan(SHAPE, 1.0))
    noise = np.linspace(1, 8, 100)
    play(run, random, 90, noise=noise)
    np.testing.assert_allclose(run.monitor.state.noise_counts, noise, rtol=0.25)
    assert abs(np.mean(run.monitor.state.noise_counts / noise) - 1) < 0.05


def test_a_thin_cover_joins_taxels_less_and_a_frame_is_looked_at_now_and_then():
    near, far = (joined(plan(SHAPE, thickness).kernel, plan(SHAPE, thickness).array) for thickness in (2.0, 0.5))
    assert 0 < far < near < 1
    run = Run(plan(SHAPE, 1.0))
    looks = [n for n in range(300) if (run.push(np.full(100, 100.0)), run.monitor._blocks._frames)[1] == 0]
    assert looks[0] == BLOCK_FRAMES - 1
