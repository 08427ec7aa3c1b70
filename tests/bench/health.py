"""How often healthy taxels are found faulty, and after how many frames faulty ones are."""

from collections.abc import Iterator
from copy import copy
from functools import cache
from itertools import chain, product
from typing import NamedTuple

import numpy as np

from tactiled.bench.results import machine
from tactiled.calibrate.counts.calibration import Calibration, Calibrator
from tactiled.calibrate.counts.curves import Curves
from tactiled.calibrate.upkeep.health import Fault
from tactiled.calibrate.upkeep.monitor import SkinMonitor
from tactiled.cli.bench import print_table
from tactiled.frames import Loss, RawFrame
from tactiled.simulate.array import Surface
from tactiled.simulate.playback import SCENE_S, TOUR
from tactiled.simulate.scenes import SCENES
from tests.plans import plan

RATE_HZ = 100.0
NO_LOAD, FULL_SCALE, KPA_PER_COUNT = 100, 4095, 0.05  # counts, counts, kPa
SLOW_HZ = 16.0  # a block a second: all that is looked at
STRIDE = 5  # frames of the tour that are computed; those between are interpolated
SIDE = 32
SHAPE = 10, 10  # where discs are pressed
FAULTY = 44
PRESS_S = 3.0  # a disc lies for so long, then for as long none
NOISES = (1.0, 5), (1.0, 8), (1.0, 15), (1.0, 30), (0.05, 30), (0.05, 100)  # part of the readings, times


class Scenario(NamedTuple):
    """Frames of a healthy array."""

    name: str
    thickness: float  # pitches
    noise: float  # counts
    frames: Iterator[np.ndarray]  # counts without noise, not rounded
    rate_hz: float = RATE_HZ


class Run:
    """A monitor and its calibrator, fed with frames of counts."""

    def __init__(self, skin, gain=None, rate_hz=RATE_HZ, **calibration):
        self.skin = skin
        curves = None if gain is None else linear(KPA_PER_COUNT / gain)
        self.calibration = Calibration(KPA_PER_COUNT, NO_LOAD, curves=curves, **calibration)
        self.calibrator = Calibrator(self.calibration, skin.array.size)
        self.calibrator.tare(np.full(skin.array.size, float(NO_LOAD)))
        self.monitor = SkinMonitor(skin.array, skin.kernel, self.calibration, (0, FULL_SCALE), FULL_SCALE)
        self.frames, self.rate_hz = 0, rate_hz
        self._flags = np.zeros(skin.array.size, np.uint8)

    def push(self, counts, time_s=None):
        """Give a frame (N,), noise included, after the last one by a period or at a time; returns the changes."""
        rounded = np.clip(np.round(counts), 0, FULL_SCALE).astype(np.uint16)
        at_s = self.frames / self.rate_hz if time_s is None else time_s
        frame = RawFrame(self.frames, at_s, 0.0, rounded, self._flags, Loss())
        self.frames += 1
        return self.monitor.drain_changes() if self.monitor.observe(frame, self.calibrator) else []


def linear(kpa_per_count):
    """Curves of taxels whose gains (N,) were measured."""
    n = len(kpa_per_count)
    reach = np.column_stack([np.zeros(n), np.full(n, FULL_SCALE)])
    return Curves("linear", kpa_per_count[:, None], reach, np.full(n, 0.01), np.full(n, np.nan), np.ones(n, bool))


@cache
def tour(thickness, side=SIDE):
    """The demo's tour at RATE_HZ as counts (T, N) over no load."""
    skin = plan((side, side), thickness)
    surface = Surface(skin.kernel, skin.array)
    times = np.arange(0, SCENE_S * len(TOUR), STRIDE / RATE_HZ)
    images = [SCENES[TOUR[int(t / SCENE_S)]](surface.x, surface.y, t, surface.size, surface.grain) for t in times]
    felt = np.array([surface.sense(each) for each in images], np.float32) / KPA_PER_COUNT
    parts = np.arange(STRIDE, dtype=np.float32)[:, None] / STRIDE
    between = [a + parts * (b - a) for a, b in zip(felt, np.roll(felt, -1, axis=0), strict=True)]
    return np.concatenate(between)


def foot(skin, peak, seconds):
    """A square foot that stands from the first tenth of the time to the last, counts over no load."""
    rows, columns = skin.array.shape
    pressed = np.zeros(skin.array.shape)
    pressed[rows // 4 : rows // 2, columns // 4 : columns // 2] = peak
    felt = skin.blur.forward(pressed).ravel().astype(np.float32)
    frames = int(seconds * RATE_HZ)
    return (felt * (frames / 10 < n < 0.9 * frames) for n in range(frames))


def scenarios(tours, seconds):
    """Healthy arrays: `tours` through the demo's tour, and `seconds` of each of the rest."""
    frames = int(seconds * RATE_HZ)
    still = np.zeros(SIDE**2, np.float32)
    for thickness in (0.5, 1.0, 2.0):
        clip = tour(thickness)
        noise = 0.01 * float(clip.max())
        yield Scenario(f"tour, t/pitch {thickness:g}", thickness, noise, (f for _ in range(tours) for f in clip))
    yield Scenario("tour without noise", 1.0, 0.0, (each for each in tour(1.0)))
    yield Scenario("empty, no count changes", 1.0, 0.0, (still for _ in range(frames)))
    yield Scenario("empty, noise of half a count", 1.0, 0.5, (still for _ in range(frames)))
    yield Scenario("empty, noise of two counts", 1.0, 2.0, (still for _ in range(frames)))
    drifting = (np.float32(0.05 * FULL_SCALE * n / RATE_HZ / 60) + still for n in range(frames))
    yield Scenario("drift of 5 % a minute", 1.0, 1.5, drifting)
    yield Scenario("foot, 70 % of full scale", 1.0, 2.0, foot(plan((SIDE, SIDE), 1.0), 0.7 * FULL_SCALE, seconds))
    for thickness in (0.5, 1.0):
        heavy = foot(plan((SIDE, SIDE), thickness), 2.0 * FULL_SCALE, seconds)
        yield Scenario(f"foot, saturated, t/pitch {thickness:g}", thickness, 2.0, heavy)


def objects(surface):
    """Pressure (kPa) of objects with gaps, by name: all loads that a taxel may well not feel."""
    x, y = (
        surface.x - surface.grain / 2,
        surface.y - surface.grain / 2,
    )  # on a taxel of an even array's middle four
    within = lambda mm: 100 * np.clip(mm / surface.grain + 0.5, 0, 1)  # noqa: E731
    off = lambda along, period: np.abs((along + period / 2) % period - period / 2)  # noqa: E731
    round_pad = 6 - np.hypot(x, y)
    return {
        "pins, 2 pitches apart": within(np.minimum(0.35 - np.hypot(off(x - 0.5, 2), off(y - 0.5, 2)), round_pad)),
        "hole of 1.4 pitches": within(np.minimum(5 - np.hypot(x, y), np.hypot(x - 0.5, y - 0.5) - 0.7)),
        "ring": within(np.minimum(4 - np.hypot(x, y), np.hypot(x, y) - 1.5)),
        "ridges": within(np.minimum(0.4 - off(x - 0.5, 2), round_pad)),
        "texture": within(round_pad) * np.clip(np.cos(2.8 * x) * np.cos(2.6 * y), 0, 1),
    }


def grasps(thicknesses=(0.5, 1.0), seconds=60.0, side=24):
    """The same object at the same place, for 3 s of every 5; sliding ridges move by 0.4 pitch meanwhile."""
    for thickness in thicknesses:
        skin = plan((side, side), thickness)
        surface = Surface(skin.kernel, skin.array)
        felt = {name: [surface.sense(each)] for name, each in objects(surface).items()}
        slid = copy(surface)
        for _ in range(4):
            slid.x = slid.x - 0.1
            felt.setdefault("sliding ridges", []).append(surface.sense(objects(slid)["ridges"]))
        for name, images in felt.items():
            times = np.arange(seconds * SLOW_HZ) / SLOW_HZ % 5
            frames = (
                images[int(t / 3 * len(images)) % len(images)].astype(np.float32) * ((t < 3) / KPA_PER_COUNT)
                for t in times
            )
            noise = 0.01 * images[0].max() / KPA_PER_COUNT
            yield Scenario(f"{name}, t/pitch {thickness:g}", thickness, noise, frames, SLOW_HZ)


def false_positives(tours, seconds, seed):
    """(scenario, taxel-frames, false positives) of healthy arrays: gains spread by 20 %, unknown or measured."""
    both = ((calibrated, each) for calibrated in (False, True) for each in scenarios(tours, seconds))
    for number, (calibrated, scenario) in enumerate(both):
        yield false_alarms(scenario, [seed, number], calibrated)


def false_alarms(scenario, seed, calibrated, side=SIDE):
    """(scenario, taxel-frames, false positives) of one healthy array whose gains spread by 20 %."""
    random, n = np.random.default_rng(seed), side**2
    gain = np.clip(random.normal(1, 0.2, n), 0.5, 1.5).astype(np.float32)
    run = Run(plan((side, side), scenario.thickness), gain if calibrated else None, scenario.rate_hz)
    false_positives = 0
    for pressed in scenario.frames:
        noise = random.standard_normal(n, np.float32) * np.float32(scenario.noise)
        false_positives += len(run.push(NO_LOAD + gain * pressed + noise))
    return scenario.name + ", gains measured" * calibrated, run.frames * n, false_positives


def spoil(fault, counts, random):
    """The reading of a taxel that has a fault, from the one (counts) that it would have."""
    match fault:
        case Fault.DEAD:
            return NO_LOAD + random.normal(0, 2)
        case Fault.STUCK:
            return 700
        case Fault.NOISY:
            return counts + random.normal(0, 30)  # 15 times what `play` has
        case Fault.SATURATED:
            return FULL_SCALE
        case Fault.WEAK:
            return NO_LOAD + 0.3 * (counts - NO_LOAD)


def discs(random, taxel=None, skin=None):
    """Presses of a disc (N,), counts over no load: on a taxel, or anywhere."""
    skin = skin or plan(SHAPE, 1.0)
    x, y = skin.array.positions.T
    while True:
        at = random.uniform(2, 7, 2) if taxel is None else skin.array.positions[taxel] + random.uniform(-1, 1, 2)
        pressed = random.uniform(800, 2000) * (np.hypot(x - at[0], y - at[1]) < random.uniform(2.5, 4))
        yield skin.blur.forward(pressed.reshape(SHAPE).astype(float)).ravel()


def play(run, random, seconds, fault=None, taxel=FAULTY, noise=2.0):
    """Press discs for so long with a fault on a taxel; gives the changes, each with its frame from the start."""
    presses, changes, began = discs(random, taxel, run.skin), [], run.frames
    for n in range(int(seconds * run.rate_hz)):
        if n % int(2 * PRESS_S * run.rate_hz) == 0:
            pressed = next(presses)
        lies = n / run.rate_hz % (2 * PRESS_S) < PRESS_S
        counts = NO_LOAD + pressed * lies + random.normal(0, noise, pressed.size)
        if fault is not None:
            counts[taxel] = spoil(fault, counts[taxel], random)
        changes += [(run.frames - began, each) for each in run.push(counts)]
    return changes


def detection(thicknesses=(0.5, 1.0, 2.0), seeds=range(5)):
    """(fault, t/pitch, s until found in each trial, s until healed) under presses of discs; NaN: not in 60 s."""
    for fault, thickness in product((each for each in Fault if each not in (0, Fault.SWAPPED)), thicknesses):
        seconds = []
        for seed in seeds:
            random, run = np.random.default_rng([seed, fault]), Run(plan(SHAPE, thickness), np.ones(100))
            assert not play(run, random, 30)
            changes = [play(run, random, 60, each) for each in (fault, None)]
            seconds.append([each[0][0] / RATE_HZ if each else np.nan for each in changes])
        yield fault, thickness, *np.transpose(seconds)


def noisy(thickness, times, spikes=1.0, measured=True, noise=4.0, seconds=300, seed=0):
    """When (s) a taxel is found noisy that has so many times the noise in a part of its readings; NaN: never."""
    random, run = np.random.default_rng(seed), Run(plan(SHAPE, thickness), np.ones(100), SLOW_HZ)
    run.calibrator.tare(np.full(100, float(NO_LOAD)), measured)
    presses, period, start = discs(random, FAULTY, run.skin), int(2 * PRESS_S * SLOW_HZ), 30 * SLOW_HZ
    for n in range(int(start + seconds * SLOW_HZ)):
        if n % period == 0:
            pressed = next(presses)
        counts = NO_LOAD + pressed * (n % period < period / 2) + random.normal(0, noise, pressed.size)
        if n > start and spikes == 1:
            counts[FAULTY] += random.normal(0, times * noise)
        elif n > start and random.random() < spikes:
            counts[FAULTY] += times * noise
        for change in run.push(counts):
            assert (n > start, change.taxel, change.after) == (True, FAULTY, Fault.NOISY)
            return (n - start) / SLOW_HZ
    return np.nan


def health(tours: int = 4, seconds: float = 60.0, seed: int = 1) -> None:
    """False alarms on healthy 32 x 32 arrays at 100 Hz, seconds until a fault is found."""
    rows, total, wrong = [], 0, 0
    again = (
        false_alarms(each, seed, measured, 24) for measured in (False, True) for each in grasps(seconds=seconds)
    )
    for name, taxel_frames, count in chain(false_positives(tours, seconds, seed), again):
        rows.append((name, f"{taxel_frames / 1e6:.1f}", str(count)))
        total, wrong = total + taxel_frames, wrong + count
    print_table("Healthy arrays", ("scene", "taxel-frames, 10^6", "false alarms"), rows)
    print(f"{wrong} false alarms in {total / 1e6:.0f} x 10^6 taxel-frames, seed {seed}")
    times = [
        (
            fault.name.lower(),
            f"{thickness:g}",
            *(f"{each.max():.1f}" if np.isfinite(each).all() else "–" for each in both),
        )
        for fault, thickness, *both in detection()
    ]
    headings = ("fault", "t/pitch", "found after at most, s", "healed after at most, s")
    print_table("Presses of 3 s every 6 s", headings, times)
    rows = [
        (f"{thickness:g}", f"{100 * spikes:g} %", f"{factor:g}", "yes" if measured else "no", f"{found_s:.0f}")
        for thickness, (spikes, factor), measured in product((0.5, 1, 2), NOISES, (True, False))
        if np.isfinite(found_s := noisy(thickness, factor, spikes, measured))
    ]
    print_table(
        "Noisy taxels", ("t/pitch", "of the readings", "times the noise", "zero measured", "found after, s"), rows
    )
    print(machine())
