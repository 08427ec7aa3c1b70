"""How often healthy taxels are found faulty, and after how many frames faulty ones are."""

from collections.abc import Iterator
from functools import cache
from typing import NamedTuple

import numpy as np

from tactiled.calibrate.calibration import Calibration, Calibrator
from tactiled.calibrate.curves import Curves
from tactiled.calibrate.health import Fault
from tactiled.calibrate.monitor import SkinMonitor
from tactiled.cli.bench import print_table
from tactiled.frames import Loss, RawFrame
from tactiled.simulate.playback import SCENE_S, TOUR
from tactiled.simulate.scenes import SCENES
from tactiled.study.results import machine
from tests.plans import plan

RATE_HZ = 100.0
NO_LOAD, FULL_SCALE, KPA_PER_COUNT = 100, 4095, 0.05  # counts, counts, kPa
STRIDE = 5  # frames of the tour that are computed; those between are interpolated
SIDE = 32


class Scenario(NamedTuple):
    """Frames of a healthy array."""

    name: str
    thickness: float  # pitches
    noise: float  # counts
    frames: Iterator[np.ndarray]  # counts without noise, not rounded


class Run:
    """A monitor and its calibrator, fed with frames of counts."""

    def __init__(self, skin, gain=None, rate_hz=RATE_HZ, **calibration):
        curves = None if gain is None else linear(KPA_PER_COUNT / gain)
        self.calibration = Calibration(KPA_PER_COUNT, NO_LOAD, curves=curves, **calibration)
        self.calibrator = Calibrator(self.calibration, skin.array.size)
        self.calibrator.tare(np.full(skin.array.size, float(NO_LOAD)))
        self.monitor = SkinMonitor(skin.array, skin.kernel, self.calibration, FULL_SCALE)
        self.frames, self.rate_hz = 0, rate_hz
        self._flags = np.zeros(skin.array.size, np.uint8)

    def push(self, counts):
        """Give a frame (N,), noise included; returns the changes of states."""
        rounded = np.clip(np.round(counts), 0, FULL_SCALE).astype(np.uint16)
        frame = RawFrame(self.frames, self.frames / self.rate_hz, 0.0, rounded, self._flags, Loss())
        self.frames += 1
        return self.monitor.drain_changes() if self.monitor.push(frame, self.calibrator) else []


def linear(kpa_per_count):
    """Curves of taxels whose gains (N,) were measured."""
    n = len(kpa_per_count)
    reach = np.column_stack([np.zeros(n), np.full(n, FULL_SCALE)])
    return Curves("linear", kpa_per_count[:, None], reach, np.full(n, 0.01), np.full(n, np.nan), np.ones(n, bool))


@cache
def tour(thickness, side=SIDE):
    """The demo's tour at RATE_HZ as counts (T, N) over no load."""
    from tactiled.simulate.array import Surface

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
    yield Scenario("foot, saturated", 0.5, 2.0, foot(plan((SIDE, SIDE), 0.5), 2.0 * FULL_SCALE, seconds))


def false_positives(tours=4, seconds=60.0, seed=1):
    """(scenario, taxel-frames, false positives) of healthy arrays: gains spread by 20 %, unknown or measured."""
    both = ((calibrated, each) for calibrated in (False, True) for each in scenarios(tours, seconds))
    for number, (calibrated, scenario) in enumerate(both):
        random = np.random.default_rng([seed, number])
        gain = np.clip(random.normal(1, 0.2, SIDE**2), 0.5, 1.5).astype(np.float32)
        run, false_positives = Run(plan((SIDE, SIDE), scenario.thickness), gain if calibrated else None), 0
        for pressed in scenario.frames:
            noise = random.standard_normal(SIDE**2, np.float32) * np.float32(scenario.noise)
            false_positives += len(run.push(NO_LOAD + gain * pressed + noise))
        yield scenario.name + ", gains measured" * calibrated, run.frames * SIDE**2, false_positives


def spoil(fault, counts, random):
    """The reading of a taxel that has a fault, from the one (counts) that it would have."""
    match fault:
        case Fault.DEAD:
            return NO_LOAD + random.normal(0, 2)
        case Fault.STUCK:
            return 700
        case Fault.NOISY:
            return counts + random.normal(0, 400)
        case Fault.SATURATED:
            return FULL_SCALE
        case Fault.WEAK:
            return NO_LOAD + 0.3 * (counts - NO_LOAD)


def detection(fault, taxel, thickness=1.0, tours=3, seed=1, after_s=30.0, heals_s=np.inf):
    """Frames until a taxel's fault is found, and from its end until it is healthy, None: never; others' changes.

    During the demo's tour in noise of two counts, from `after_s` to `heals_s`.
    """
    random = np.random.default_rng(seed)
    run = Run(plan((SIDE, SIDE), thickness), np.ones(SIDE**2))
    found_at = healed_at = None
    others = []
    start, end = after_s * RATE_HZ, heals_s * RATE_HZ
    for n, pressed in enumerate(each for _ in range(tours) for each in tour(thickness)):
        counts = NO_LOAD + pressed + random.normal(0, 2, SIDE**2)
        if start <= n < end:
            counts[taxel] = spoil(fault, counts[taxel], random)
        for change in run.push(counts):
            if change.taxel != taxel:
                others.append(change)
            elif change.after == fault and found_at is None:
                found_at = n - start
            elif change.after == Fault.HEALTHY:
                healed_at = n - end
    return found_at, healed_at, others


def health(tours: int = 4, seconds: float = 60.0, seed: int = 1) -> None:
    """Look for faults on healthy 32 x 32 arrays at 100 Hz, and time how long faulty taxels take to be found."""
    rows, total, false_positives = [], 0, 0
    for name, taxel_frames, count in false_positives(tours, seconds, seed):
        rows.append((name, f"{taxel_frames / 1e6:.1f}", str(count)))
        total, false_positives = total + taxel_frames, false_positives + count
    print_table("Healthy arrays", ("scene", "taxel-frames, 10^6", "false alarms"), rows)
    print(f"{false_positives} false alarms in {total / 1e6:.0f} x 10^6 taxel-frames, seed {seed}. {machine()}")
