"""Blind fits of a cover to recordings as people make them, and what goes wrong with such recordings."""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from rich.progress import track

from tactiled.bench.results import machine
from tactiled.bench.skin import rms
from tactiled.calibrate.counts.calibration import Calibration
from tactiled.calibrate.counts.curves import Curves
from tactiled.calibrate.cover.fit import CoverFit
from tactiled.calibrate.cover.recorded_touch import RecordedTouch, fit_touch
from tactiled.cli.bench import print_table
from tactiled.cover.kernel import solve
from tactiled.cover.stack import Layer, Stack
from tactiled.errors import ConfigError
from tactiled.frames import FrameSeries
from tactiled.geometry import grid
from tactiled.simulate.array import Surface
from tests.bench.held_out_scenes import ALL as HELD_OUT
from tests.bench.held_out_scenes import FINER, hertz, inside, laid

SIDE = 20  # taxels along each side of 1 mm
RATE_HZ, FREE_S, RAMP_S, HOLD_S = 50.0, 1.0, 0.2, 1.8  # of one press
PRESSES = 12
PEAKS_KPA, NOISE_KPA = (50.0, 100.0), 0.2
KPA_PER_COUNT, GAIN_SPREAD, GAIN_ERROR = 0.03, 0.1, 0.005  # of 12 bits; how well the gain of a taxel is known
DRIFT_KPA, DRIFT_SPREAD = 0.2, 0.25  # in a recording, of 37 s, and the spread between taxels
CREEP, DELAYS_S = 0.05, 10 ** np.arange(-1, 2.01, 0.25)  # of the load, a decade of time
ROW_NOISE_KPA = 0.15  # standard deviation that the taxels of a row share, beside NOISE_KPA of each
THICKNESS, BELIEVED = (0.5, 3.0), (0.75, 1.35)  # pitches; true over configured


def _coin(u, v, random):
    return random.uniform(2, 4.5) - np.hypot(u, v)


def _ring(u, v, random):
    return random.uniform(0.5, 1.2) - np.abs(np.hypot(u, v) - random.uniform(2.5, 5.5))


def _ruler(u, v, random):
    return np.minimum(random.uniform(0.6, 1.5) - np.abs(u), random.uniform(5, 9) - np.abs(v))


def _block(u, v, random):
    return np.minimum(random.uniform(1.5, 4) - np.abs(u), random.uniform(1.5, 4) - np.abs(v))


def _key(u, v, random):
    del random
    bow = np.minimum(3.2 - np.hypot(u + 3, v), np.hypot(u + 4, v) - 1)
    teeth = 0.4 * np.sign(np.sin(3 * u)) * (v > 0)
    return np.maximum(bow, np.minimum(np.minimum(u, 7 - u), 1.2 + teeth - np.abs(v)))


def _nut(u, v, random):
    radius = random.uniform(2.5, 4.5)
    sides = [np.abs(u * np.cos(each) + v * np.sin(each)) for each in (0, np.pi / 3, 2 * np.pi / 3)]
    return np.minimum(radius - np.max(sides, axis=0), np.hypot(u, v) - 0.55 * radius)


def _ball(u, v, random):
    return hertz(np.hypot(u, v), random.uniform(2, 4.5))


def _finger(u, v, random):
    return hertz(np.hypot(u, v / random.uniform(1.1, 1.5)), random.uniform(3, 5)) ** random.uniform(1, 2)


OUTLINES = _coin, _ring, _ruler, _block, _key, _nut  # distances (mm) within, of what is flat and sharp
SOFT = _ball, _finger  # pressure over its peak


def pressed_by(draw, surface, random):
    """Pressure over its peak of one thing, at any place and angle."""
    half = surface.size / 2
    if draw in HELD_OUT:
        return draw(surface.x, surface.y, half, random)
    value = draw(*laid(surface.x, surface.y, random, 0.45 * half), random)
    return value if draw in SOFT else inside(value)


def crept(load):
    """Loads (T, presses) with what rubber that gives way adds, and what of it remains after a lift."""
    total = load.copy()
    for delay_s in DELAYS_S:
        late, keep = np.zeros(load.shape[1]), np.exp(-1 / RATE_HZ / delay_s)
        for n, each in enumerate(load):
            late = keep * late + (1 - keep) * each
            total[n] += CREEP * 0.25 * late
    return total


class Trial(NamedTuple):
    """A recording of presses on a skin whose cover is known."""

    recorded: RecordedTouch
    factor: float  # the true one


def recording(kind: str, random: np.random.Generator) -> Trial:
    """What a skin of 12 bits sends of PRESSES presses, a third or more of them with sharp things."""
    thickness, factor = (float(np.exp(random.uniform(*np.log(ends)))) for ends in (THICKNESS, BELIEVED))
    true = Stack((Layer(thickness, 0.6, 0.48), Layer(1.0, 980.0, 0.3)), 1)
    believed = replace(true, layers=(replace(true.layers[0], thickness=thickness / factor), true.layers[1]))
    array = grid(SIDE, SIDE, 1.0, 0.8)
    surface, feel = Surface(solve(true, "layered"), array, FINER), []
    for n in range(PRESSES):
        things = OUTLINES if n % 3 == 0 else OUTLINES + SOFT
        things = {"fingers alone": (_finger,), "other things": HELD_OUT}.get(kind, things)
        one = surface.sense(pressed_by(things[random.integers(len(things))], surface, random))
        feel.append(one / max(one.max(), 1e-9) * random.uniform(*PEAKS_KPA))
    free, ramp, hold = (round(each * RATE_HZ) for each in (FREE_S, RAMP_S, HOLD_S))
    rise = np.linspace(0, 1, ramp, endpoint=False)
    press = np.concatenate([np.zeros(free), rise, np.ones(hold), rise[::-1]])
    load = np.concatenate([np.kron(np.eye(PRESSES), press[:, None]), np.zeros((free, PRESSES))])
    pressure = (crept(load) if kind == "creep" else load) @ np.array(feel)
    size, seconds = pressure.shape[1], np.arange(len(pressure)) / RATE_HZ
    pressure += random.normal(0, NOISE_KPA, pressure.shape)
    if kind == "drift":
        end = random.choice([-1, 1]) * DRIFT_KPA * (1 + DRIFT_SPREAD * random.normal(size=size))
        pressure += np.outer(seconds / seconds[-1], end)
    if kind == "row noise":
        pressure += np.repeat(random.normal(0, ROW_NOISE_KPA, (len(pressure), SIDE)), SIDE, axis=1)
    gains = KPA_PER_COUNT * np.exp(random.normal(0, GAIN_SPREAD, size))
    counts = np.clip(np.round(pressure / gains + 200 + 40 * random.uniform(-1, 1, size)), 0, 4095)
    calibrated = gains * (1 + GAIN_ERROR * random.normal(size=size))
    ones = np.ones(size)
    curves = Curves(
        "linear", calibrated[:, None], np.outer(ones, [0, 4e3]), GAIN_ERROR * ones, np.nan * ones, ones > 0
    )
    calibration = Calibration(float(np.median(calibrated)), 200.0, curves=curves)
    series = FrameSeries(seconds, counts.astype(np.float32))
    return Trial(RecordedTouch(series, array, believed, calibration, (0, 4095)), factor)


HEADINGS = "", "refused", "rms / worst error", "half of the interval, median", "intervals that hold"
KINDS = "clean", "other things", "fingers alone", "drift", "row noise", "creep"


class Outcome(NamedTuple):
    """What a fit made of a trial."""

    error: float  # of the thickness; NaN where it is refused
    holds: bool
    half: float  # of the interval, over the true thickness
    reason: str


def outcome(kind: str, seed: list[int], fit: Callable[..., CoverFit] = fit_touch) -> Outcome:
    """Fit one trial."""
    trial = recording(kind, np.random.default_rng([*seed, KINDS.index(kind)]))
    try:
        fitted = fit(trial.recorded, "blind", None)
    except ConfigError as error:
        return Outcome(np.nan, False, np.nan, str(error))
    return judged(fitted, trial.factor)


def judged(fitted: CoverFit, factor: float) -> Outcome:
    """Hold a fit against the true factor."""
    if reason := fitted.reason or fitted.objection:
        return Outcome(np.nan, False, np.nan, reason)
    low, high = (each / factor for each in fitted.interval)
    return Outcome(fitted.factor / factor - 1, low < 1 < high, (high - low) / 2, "")


def line(kind: str, outcomes: list[Outcome]) -> tuple[str, ...]:
    """A row of the table."""
    decided = [each for each in outcomes if not each.reason]
    refused = f"{len(outcomes) - len(decided)} of {len(outcomes)}"
    if not decided:
        return kind, refused, "", "", ""
    sizes = 100 * np.abs([each.error for each in decided])
    half = f"{100 * np.median([each.half for each in decided]):.1f} %"
    holding = f"{sum(each.holds for each in decided)} of {len(decided)}"
    return kind, refused, f"{rms(sizes):.1f} / {sizes.max():.1f} %", half, holding


def blind(trials: int = 20, seed: int = 1, kind: str = "") -> None:
    """Fit covers blind to recordings of everyday things that are clean, or have one fault each."""
    rows, reasons = [], []
    for one in [kind] if kind else KINDS:
        outcomes = [outcome(one, [seed, n]) for n in track(range(trials), one, transient=True)]
        rows.append(line(one, outcomes))
        reasons += sorted({f"{one}: {each.reason}" for each in outcomes if each.reason})
    print_table(f"Blind fits of {trials} covers, t/pitch 0.5 to 3", HEADINGS, rows)
    print(*reasons, f"Seed {seed}. {machine()}", sep="\n")
