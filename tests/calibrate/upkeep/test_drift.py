from dataclasses import dataclass
from operator import call
from typing import Any

import numpy as np
import pytest

from tactiled.calibrate.upkeep.blocks import Blocks, TaxelNoise
from tactiled.calibrate.upkeep.drift import MAX_RATE, DriftState, DriftTracker, Surroundings, reach_mm
from tactiled.calibrate.upkeep.neighbourhood import Neighbourhood
from tactiled.diagnostics.checks import FrameChecks
from tactiled.restore.methods import make
from tests.plans import plan

SIDE, FULL_SCALE, NO_LOAD = 24, 3900.0, 100.0  # taxels, counts, counts
HOUR = 3600.0
RATE_HZ, NOISE = 2.0, 0.003  # of full scale
LOAD = 0.2  # of full scale, on the foot
LEARN_S = 1800.0  # before the foot comes


@dataclass
class Run:
    """A tracker on an array of taxels with a spread of gain and of drift, fed with rounded, noisy counts."""

    skin: Any = None
    rate_hz: float = RATE_HZ
    noise: float = NOISE
    seed: int = 5
    sign: int = 1
    spread: float = 0.2

    def __post_init__(self):
        self.skin = self.skin or plan((SIDE, SIDE), 1.0)
        n = self.skin.array.size
        self.random = np.random.default_rng(self.seed)
        self.gain = self.random.normal(1, self.spread, n).clip(0.5, 1.5)
        self.sensitivity = self.random.normal(1, self.spread, n).clip(0.4, 1.6)
        self.no_load = 2000 + self.random.normal(0, 10, n)
        neighbourhood = Neighbourhood(self.skin.kernel, self.skin.array, call)
        reach = reach_mm(self.skin.kernel)
        self.tracker = DriftTracker(self.skin.array, reach, FULL_SCALE, self.sign, neighbourhood)
        self.tracker.reset(self.no_load)
        self.blocks, self.level, self.time_s = Blocks(n), TaxelNoise(n), 0.0
        self.sound = np.ones(n, bool)

    def play(self, seconds, drift=0.0, load=0.0, references=None):
        """Go on for so long; drift(t) and load(t) in parts of full scale, t from the start of this play."""
        began = self.time_s
        for n in range(int(seconds * self.rate_hz)):
            t = n / self.rate_hz
            self.time_s = began + t
            self.drifted = FULL_SCALE * (drift(t) if callable(drift) else drift) * self.sensitivity
            pressed = FULL_SCALE * self.gain * (load(t) if callable(load) else load)
            noise = self.random.standard_normal(self.gain.size, np.float32) * self.noise * FULL_SCALE
            counts = np.round(self.no_load + self.sign * (pressed + self.drifted) + noise).astype(np.float32)
            if block := self.blocks.collect(self.time_s, counts, np.zeros(counts.size, np.uint8)):
                self.level.update(block, block.mean)
                of_pads = None if references is None else np.round(references(t)).astype(np.float32)
                self.tracker.update(block, self.level.sigma, self.sound, of_pads)
        self.time_s += 1 / self.rate_hz

    @property
    def error(self):
        """Error of the zeros (N,), part of full scale: what an unloaded taxel reads."""
        return (self.drifted - self.sign * self.tracker.correction) / FULL_SCALE


@pytest.fixture(scope="module")
def foot():
    """What a square foot presses on the taxels (N,), over its pressure; and its taxels, and their surroundings."""
    skin = plan((SIDE, SIDE), 1.0)
    pressed = np.zeros((SIDE, SIDE))
    pressed[3:8, 2:7] = 1.0
    felt = skin.blur.forward(pressed).ravel()
    return felt, felt > 0.5, (felt > 0.002) & (felt < 0.5)


@pytest.mark.parametrize(("rate_hz", "noise", "sign"), [(1.0, 1e-4, 1), (5.0, 0.003, -1), (100.0, 0.01, 1)])
def test_a_drift_of_5_percent_an_hour_stays_within_half_a_percent(rate_hz, noise, sign):
    run = Run(plan((8, 8), 1.0) if rate_hz > 10 else None, rate_hz, noise, sign=sign)
    worst = 0.0
    for minute in range(60 if rate_hz < 10 else 8):
        run.play(60, lambda t, began=60 * minute: 0.05 * (began + t) / HOUR)
        worst = max(worst, float(np.abs(run.error).max()))
    assert (run.drifted / FULL_SCALE).max() > (0.05 if rate_hz < 10 else 0.008)
    assert worst < 0.005


@pytest.mark.parametrize("drift", [0.05, -0.05])
def test_a_foot_that_stands_for_an_hour_does_not_fade_and_its_zero_is_right_when_it_lifts(foot, drift):
    felt, under, skirt = foot
    run = Run()
    run.play(LEARN_S, lambda t: drift * t / HOUR)
    at_start = run.error
    run.play(HOUR, lambda t: drift * (LEARN_S + t) / HOUR, LOAD * felt)
    faded = run.error - at_start
    load = LOAD * felt * run.gain
    assert np.abs(faded[under] / load[under]).max() < 0.01
    assert np.abs(faded[skirt]).max() < 0.01 * LOAD
    assert not (run.tracker.state[under] == DriftState.FREE).any()
    run.play(300, lambda t: drift * (LEARN_S + HOUR + t) / HOUR)
    assert np.abs(run.error).max() < 0.005
    assert (run.tracker.state == DriftState.FREE).mean() > 0.99


def test_zeros_follow_an_array_that_warms_up_while_it_is_touched(foot):
    """8 % of full scale in a quarter of an hour, a third of it in the first two minutes."""
    felt, _, _ = foot
    run, warm = Run(rate_hz=5.0), lambda t: 0.08 * (1 - np.exp(-t / 300))
    run.play(60)
    for began in range(0, 900, 150):
        run.play(100, lambda t, began=began: warm(began + t))
        run.play(50, lambda t, began=began: warm(began + 100 + t), LOAD * felt)
        assert np.abs(run.error).max() < 0.005
    run.play(300, lambda t: warm(900 + t))
    assert np.abs(run.error).max() < 0.002
    assert (run.tracker.state == DriftState.FREE).all()
    assert np.abs(run.tracker.correction).max() > 0.005 * FULL_SCALE
    run.tracker.reset(run.no_load + run.drifted)  # a tare starts over
    assert not run.tracker.correction.any()


def test_an_array_that_warms_up_too_fast_to_be_followed_is_told_to_be_tared_until_it_is():
    """By 8 % of full scale in a minute: one that lies still all over the array looks the same."""
    run = Run(plan((12, 12), 1.0), spread=0.15)  # with 0.2 one draw in sixty has parts too unlike for `offset`
    run.tracker = DriftTracker(run.skin.array, reach_mm(run.skin.kernel), FULL_SCALE)
    run.tracker.reset(run.no_load)
    sigma, sound = NOISE * FULL_SCALE, np.zeros((12, 12), np.uint8)
    restore, checks = make("auto", run.skin.blur, sigma), FrameChecks(run.skin.blur)
    run.play(30)
    for began in (0, 30, 60, 90):
        run.play(30, lambda t, began=began: 0.08 * min((began + t) / 60, 1.0))
        frame = (FULL_SCALE * run.error + run.random.normal(0, sigma, 144)).reshape(12, 12).astype(np.float32)
        image = restore(frame, sound).image
        assert "offset" in checks.check(frame, sound, image, sigma)
    assert np.median(run.error) > 0.07


def test_a_slow_load_on_most_of_the_array_is_no_warming():
    run = Run(spread=0.0)
    run.play(60)
    load = run.skin.blur.forward((np.arange(SIDE) < 0.7 * SIDE) * np.ones((SIDE, 1))).ravel()
    run.play(300, load=lambda t: 0.02 * t / 60 * load)
    assert np.abs(run.error).max() < 0.002


@pytest.mark.parametrize(("gradient", "alone", "an_hour"), [(0.3, 1.0, 0.10), (0.0, 6.0, 0.05)])
def test_taxels_that_drift_faster_than_the_others_freeze_none_of_them(gradient, alone, an_hour):
    run = Run()
    across = np.linspace(-1, 1, SIDE) * np.ones((SIDE, 1))
    run.sensitivity = run.sensitivity * (1 + gradient * across.ravel())
    run.sensitivity[[100, 300]] *= alone
    run.play(800, lambda t: an_hour * t / HOUR)
    assert (run.tracker.state == DriftState.FREE).all()
    assert np.abs(np.delete(run.error, [100, 300])).max() < 0.005


@pytest.mark.parametrize("peak", [0.02, 0.2])
def test_a_load_that_comes_within_10_s_is_not_taken_for_drift(foot, peak):
    felt, under, _ = foot
    run = Run()
    run.play(120)
    before = run.error
    run.play(600, load=lambda t: peak * felt * min(t / 10, 1))
    eaten = (run.error - before)[under]
    assert np.abs(eaten).max() < max(0.01 * peak, 12 * MAX_RATE)  # at most what the bound allows in the ramp


def test_a_load_that_leaves_no_taxel_free_does_not_fade_in_five_minutes():
    run = Run(plan((16, 16), 1.0), rate_hz=2.0, seed=6)
    pressed = np.zeros((16, 16))
    pressed[5:11, 5:11] = LOAD
    felt = run.skin.blur.forward(pressed).ravel()
    run.play(LEARN_S, lambda t: 0.05 * t / HOUR)
    before = run.error
    run.play(300, lambda t: 0.05 * (LEARN_S + t) / HOUR, felt)
    assert not (run.tracker.state == DriftState.FREE).any()
    under = felt > LOAD / 2
    assert np.abs((run.error - before)[under] / (felt * run.gain)[under]).max() < 0.01
    run.play(300, lambda t: 0.05 * (LEARN_S + 300 + t) / HOUR)
    assert np.abs(run.error).max() < 0.005


@pytest.mark.parametrize("noise", [0.001, 0.005])
def test_a_load_of_0_3_percent_and_one_and_a_half_times_the_noise_does_not_fade(noise):
    run = Run(plan((14, 14), 1.0), noise=noise, spread=0.0)
    pressed = np.zeros((14, 14))
    pressed[5:9, 5:9] = 0.003 + 1.5 * noise
    load = run.skin.blur.forward(pressed).ravel()
    run.play(60)
    before = run.error
    run.play(1200, load=load)
    under = load > 0.7 * load.max()
    assert np.mean((before - run.error)[under]) < 0.1 * load[under].mean()


def test_zeros_do_not_move_faster_than_the_bound():
    run = Run(plan((12, 12), 1.0), spread=0.0)
    run.play(60)
    for _ in range(3):  # a light touch too weak for a contact, a step of everything, and back
        before, began = run.tracker.correction.copy(), run.time_s
        run.play(120, load=0.0015)
        run.play(120, load=0.03)
        moved = np.abs(run.tracker.correction - before).max() / FULL_SCALE
        assert moved <= MAX_RATE * (run.time_s - began) * 1.01


def test_a_taxel_that_does_not_work_is_no_contact_and_no_voter():
    run = Run()
    run.play(60)
    run.sound[:5] = False
    load = np.zeros(SIDE**2)
    load[:5] = 0.5
    run.play(300, lambda t: 0.05 * t / HOUR, load)
    assert (run.tracker.state[:5] == DriftState.UNREAD).all()
    assert (run.tracker.state[5:] == DriftState.FREE).all()
    assert np.abs(run.error[5:]).max() < 0.005


def test_reference_pads_move_the_zeros_where_everything_is_loaded():
    run, blind = (Run(plan((8, 8), 1.0), spread=0.05) for _ in range(2))
    for each, pads in ((run, lambda t: 240 + np.array([90.0, 110.0]) * t / HOUR), (blind, None)):
        each.play(HOUR / 2, lambda t: 0.05 * t / HOUR, references=pads)
        began = each.error
        later = None if pads is None else lambda t, pads=pads: pads(HOUR / 2 + t)
        each.play(HOUR / 2, lambda t: 0.05 * (t + HOUR / 2) / HOUR, LOAD, later)
        each.faded = float(np.abs(each.error - began).max())
    assert blind.faded > 0.01  # the last rate of the common mode, held, makes up for half of it
    assert run.faded < 0.006


def test_surroundings_of_a_layout_are_discs_and_of_a_grid_hold_them():
    grid, layout = plan((8, 8), 1.0), plan((8, 8), 1.0, layout=True)
    touched = np.zeros(64, bool)
    touched[[0, 36]] = True
    distance = np.linalg.norm(grid.array.positions[:, None] - grid.array.positions[None, touched], axis=-1)
    near = (distance <= 2.5).any(axis=1)
    np.testing.assert_array_equal(Surroundings(layout.array, 2.5)(touched), near)
    square = Surroundings(grid.array, 2.5)(touched)
    assert (square >= near).all()
    assert not square.all()
    assert not Surroundings(grid.array, 2.5)(np.zeros(64, bool)).any()


def test_the_reach_is_where_a_wide_contact_leaves_a_thousandth():
    skin = plan((64, 64), 1.0)
    half = np.zeros((64, 64))
    half[:, :32] = 1.0
    beyond = skin.blur.forward(half)[32, 32:]  # of columns from half a pitch beyond the edge on
    reach = reach_mm(skin.kernel)
    assert 3e-4 < np.interp(reach, np.arange(32) + 0.5, beyond) < 1.5e-3
