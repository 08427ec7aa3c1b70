"""How true a calibration is: simulated recordings of known skins are calibrated, and held against the truth.

Seeds, covers and scenes shaped no constant of `calibrate`. What presses is integrated without cells, and restored
with finite elements of the cover that was fitted, never with the exact solution that blurred it.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from math import isfinite
from pathlib import Path
from time import perf_counter
from typing import NamedTuple

import numpy as np
from rich.progress import track

from tactiled import surface
from tactiled.arrays import Flags, Floats, Floats32, Reals
from tactiled.bench.presses import (
    KPA_PER_COUNT,
    Disc,
    HalfPlane,
    Shape,
    SimulatedSkin,
    press_series,
    simulated_skin,
    tour_series,
    uniform_series,
)
from tactiled.bench.results import write_csv
from tactiled.bench.scenes import TEST_SCENES
from tactiled.bench.skin import draw, make_skin, nrmse, rms, sense, touches
from tactiled.calibrate.counts.gain import GainFit, fit_steps
from tactiled.calibrate.counts.means import Rails
from tactiled.calibrate.cover.blind import fit_blind
from tactiled.calibrate.cover.edge import edge_touch
from tactiled.calibrate.cover.fit import CoverFit
from tactiled.calibrate.cover.presses import Press, find_presses
from tactiled.calibrate.cover.result import fit_cover
from tactiled.calibrate.cover.tip import Tip, tip_touch
from tactiled.calibrate.cover.unknowns import CALIPER_ERROR_MM
from tactiled.charts.style import BLACK, BLUE, RED, figure
from tactiled.cover.family import CoverFamily
from tactiled.cover.kernel import cached
from tactiled.cover.stack import Layer, Stack
from tactiled.frames import DEAD, FrameSeries
from tactiled.geometry import Array, grid
from tactiled.restore.blur import Blur
from tactiled.restore.methods import make

PITCH_MM, APERTURE = 1.0, 0.8
SUBSTRATE = Layer(1.0, 980.0, 0.3)
THICKNESS = 0.5, 3.0  # pitches, of true covers, even in the logarithm
MISTAKE = 0.7, 1.4  # of the configured thickness over the true one, likewise
YOUNG_MPA, POISSON = (0.2, 3.0), (0.45, 0.499)  # of rubber; the configuration knows them
PEAK_KPA = 100.0  # of taxels' readings
NOISE_KPA = 1.0  # standard deviation of a taxel, but for the tour
SPREAD = 0.2  # of gains
DEAD_TAXELS = 2
STEPS_KPA = (0.0, 20.0, 40.0, 60.0, 80.0, 100.0, 80.0, 60.0, 40.0, 20.0, 0.0)
TIP_RADII_MM = 0.5, 1.2
PRESSES, EDGES = 20, 5
SIDE, TOUR_SIDE = 16, 20  # taxels along each side, in trials with presses and with the tour
LARGE, LARGE_S, LARGE_RATE_HZ = 32, 60.0, 100.0  # taxels along each side, and a recording of them
RESTORED_SKINS = 4
TOUR_S, TOUR_NOISE_KPA = 60.0, 0.2  # of the demo
GAIN_AIM, NRMSE_AIM = 0.01, 1.1  # relative error; NRMSE over that with the true parameters
MAX_DRAWN = 20.0  # %
AIMS = {"tip": 0.03, "edge": 0.03, "blind": 0.10}  # of a thickness
HEADINGS = ("figure", "measured", "aim")


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """A skin, its true cover, and the cover that its configuration believes in."""

    skin: SimulatedSkin
    true: Stack
    configured: Stack

    @property
    def factor(self) -> float:
        """True thickness over the configured one."""
        return self.true.depth / self.configured.depth


class Trial(NamedTuple):
    """A cover fitted by one way."""

    way: str
    seed: int
    thickness: float  # pitches, the true one
    error: float  # of the thickness; NaN where the presses cannot tell
    low: float  # ends of the interval over the true thickness
    high: float
    seconds: float

    @property
    def covered(self) -> bool:
        """Whether the interval holds the truth."""
        return self.low <= 1 <= self.high


def draw_truth(side: int, noise_kpa: float, random: np.random.Generator) -> Truth:
    """Draw a skin of side x side taxels and what is believed of its cover."""
    thickness = _even_log(random, THICKNESS) * PITCH_MM
    rubber = Layer(thickness, _even_log(random, YOUNG_MPA), float(random.uniform(*POISSON)))
    believed = replace(rubber, thickness=thickness * _even_log(random, MISTAKE))
    array = grid(side, side, PITCH_MM, APERTURE * PITCH_MM)
    true, configured = (Stack((each, SUBSTRATE), 1) for each in (rubber, believed))
    skin = simulated_skin(true, array, random, noise_kpa, SPREAD, DEAD_TAXELS)
    return Truth(skin, true, configured)


def _even_log(random: np.random.Generator, ends: tuple[float, float]) -> float:
    return float(np.exp(random.uniform(*np.log(ends))))


def tips(truth: Truth, radius_mm: float, random: np.random.Generator) -> FrameSeries:
    """Presses with a flat tip, off the grid, away from the border."""
    half = np.ptp(truth.skin.array.positions[:, 0]) / 2 - 2.5 * PITCH_MM
    return _series(truth, [Disc(x, y, radius_mm) for x, y in random.uniform(-half, half, (PRESSES, 2))], random)


def edges(truth: Truth, random: np.random.Generator) -> FrameSeries:
    """Presses with a straight edge at a slant of 5 to 40 degrees to rows or columns."""
    slants = np.radians(random.uniform(5, 40, EDGES)) * random.choice([-1, 1], EDGES)
    angles = slants + np.pi / 2 * random.integers(0, 4, EDGES)
    return _series(truth, [HalfPlane(random.uniform(-2, 2) * PITCH_MM, float(each)) for each in angles], random)


def _series(truth: Truth, shapes: Sequence[Shape], random: np.random.Generator) -> FrameSeries:
    return press_series(truth.skin, shapes, PEAK_KPA * random.uniform(0.6, 1, len(shapes)), random)


class Calibrated(NamedTuple):
    """A skin whose gains are known, and what is left to know."""

    truth: Truth
    gain: GainFit

    def in_kpa(self, series: FrameSeries) -> Floats32:
        """Frames in kPa (T, N), NaN where a taxel is dead."""
        kpa = self.gain.curves.pressure(series.counts - self.gain.no_load.astype(np.float32))
        kpa[:, list(self.gain.dead)] = np.nan
        return np.asarray(kpa, np.float32)

    @property
    def for_touch(self) -> tuple[Array, Stack, Floats]:
        """Array, configured cover and relative error of each taxel's gain."""
        deviation = np.nan_to_num(self.gain.curves.deviation)  # NaN of dead taxels, whose readings are NaN, too
        return self.truth.skin.array, self.truth.configured, deviation

    @property
    def gain_errors(self) -> Floats:
        """Relative errors of the live taxels' gains, at half of the largest pressure."""
        skin = self.truth.skin
        counts = PEAK_KPA / 2 / skin.kpa_per_count
        errors = self.gain.curves.pressure(counts.astype(np.float32)) / (PEAK_KPA / 2) - 1
        return np.asarray(np.delete(errors, skin.dead), float)


def calibrated(truth: Truth, random: np.random.Generator) -> Calibrated:
    """Equilibrate a skin by uniform steps."""
    return Calibrated(truth, fit_steps(uniform_series(truth.skin, STEPS_KPA, random), STEPS_KPA, Rails()))


def tip_fit(skin: Calibrated, random: np.random.Generator) -> CoverFit:
    """Fit the cover to presses with a tip at unknown places, its diameter measured with a caliper."""
    radius = float(random.uniform(*TIP_RADII_MM))
    measured_mm = float(random.normal(2 * radius, CALIPER_ERROR_MM))
    presses, (array, configured, gain_error) = _presses(skin, tips(skin.truth, radius, random)), skin.for_touch
    return fit_cover(tip_touch(presses, array, configured, Tip(measured_mm), gain_error), presses, "tip")


def edge_fit(skin: Calibrated, random: np.random.Generator) -> CoverFit:
    """Fit the cover to slanted edges."""
    presses = _presses(skin, edges(skin.truth, random), border=True)
    return fit_cover(edge_touch(presses, *skin.for_touch), presses, "edge")


def _presses(skin: Calibrated, series: FrameSeries, border: bool = False) -> list[Press]:
    return find_presses(skin.in_kpa(series), skin.truth.skin.array, skin.truth.skin.noise_kpa, border=border)


def blind_fit(skin: Calibrated, random: np.random.Generator) -> CoverFit:
    """Fit the cover to the demo's tour, of which the fit knows nothing."""
    array, configured, gain_error = skin.for_touch
    frames = skin.in_kpa(tour_series(skin.truth.skin, TOUR_S, random)).reshape(-1, *array.frame_shape)
    noise_kpa, error = skin.truth.skin.noise_kpa, float(np.median(gain_error))
    return fit_blind(frames, noise_kpa, CoverFamily(configured), array, error)


WAYS: dict[str, tuple[int, float, Callable[[Calibrated, np.random.Generator], CoverFit]]] = {
    "tip": (SIDE, NOISE_KPA, tip_fit),
    "edge": (SIDE, NOISE_KPA, edge_fit),
    "blind": (TOUR_SIDE, TOUR_NOISE_KPA, blind_fit),
}


class Restored(NamedTuple):
    """Errors (NRMSE) of one scene's restored image."""

    scene: str
    before: float  # one gain for all taxels, the configured cover
    after: float  # fitted gains and cover
    true: float  # true gains and cover


def restored(skin: Calibrated, fit: CoverFit, random: np.random.Generator) -> Iterator[Restored]:
    """Restore every scene before and after a calibration, and with the true parameters."""
    truth, array = skin.truth, skin.truth.skin.array
    scenes = make_skin("true", array, truth.true, truth.true)
    stacks = truth.configured, truth.configured.thickened(fit.factor), truth.true
    blurs = [surface.make(cached(each), array, 1) for each in stacks]
    blurs[1].thickness_error = fit.thickness_error
    blurs[2].thickness_error = 0.0
    flags = np.zeros(array.frame_shape, np.uint8)
    flags.flat[truth.skin.dead] = DEAD
    for scene in TEST_SCENES:
        clean, cells = sense(scenes, draw(scenes, scene, random))
        if touches(cells):
            series = truth.skin.series(clean.reshape(1, -1), np.zeros(1), random)
            over = series.counts - truth.skin.no_load
            frames: tuple[Reals, ...] = (
                over * KPA_PER_COUNT,
                np.nan_to_num(skin.in_kpa(series)),
                over * truth.skin.kpa_per_count,
            )
            errors = [
                nrmse(_restore(blur, frame.reshape(array.frame_shape), taxel_flags), cells)
                for blur, frame, taxel_flags in zip(blurs, frames, (0 * flags, flags, flags), strict=True)
            ]
            yield Restored(scene, *errors)


def _restore(blur: Blur, frame: Reals, flags: Flags) -> Floats32:
    return make("auto", blur, NOISE_KPA)(frame.astype(np.float32), flags).image


@dataclass(frozen=True, slots=True, eq=False)
class Results:
    """All that was measured."""

    gain_errors: Floats  # relative, of all live taxels of all trials
    trials: tuple[Trial, ...]
    restored: tuple[Restored, ...]
    large_gain_s: float = np.nan  # gain of LARGE x LARGE taxels from LARGE_S of recording
    large_tip_s: float = np.nan  # their cover from PRESSES presses


def measure(count: int, seed: int, only: str | None = None) -> Results:
    """Run `count` trials of every way, restore what RESTORED_SKINS of them calibrate; or run `only` one."""
    errors: list[Floats] = []
    rows: list[Trial] = []
    images: list[Restored] = []
    for n in track(range(count), "Calibrating", transient=True):
        for way in [only] if only else WAYS:
            side, noise_kpa, fit = WAYS[way]
            random = np.random.default_rng([seed, n, side])
            skin = calibrated(draw_truth(side, noise_kpa, random), random)
            errors.append(skin.gain_errors)
            began = perf_counter()
            fitted = fit(skin, random)
            seconds, factor = perf_counter() - began, skin.truth.factor
            low, high = (each / factor for each in fitted.interval)
            error = np.nan if fitted.reason else fitted.factor / factor - 1
            rows.append(Trial(way, n, skin.truth.true.depth / PITCH_MM, error, low, high, seconds))
            if way == "tip" and n < RESTORED_SKINS and not only:
                images += restored(skin, fitted, random)
    return Results(np.concatenate(errors), tuple(rows), tuple(images), *(() if only else _large(seed)))


def _large(seed: int) -> tuple[float, float]:
    """Seconds for gain and cover of a large array."""
    random = np.random.default_rng([seed, 2**20])
    truth = draw_truth(LARGE, NOISE_KPA, random)
    series = uniform_series(truth.skin, STEPS_KPA, random, LARGE_S / len(STEPS_KPA), LARGE_RATE_HZ)
    began = perf_counter()
    skin = Calibrated(truth, fit_steps(series, STEPS_KPA, Rails()))
    gain_s, began = perf_counter() - began, perf_counter()
    tip_fit(skin, random)
    return gain_s, perf_counter() - began


def lines(results: Results) -> list[tuple[str, str, str]]:
    """A table by HEADINGS."""
    errors = np.abs(results.gain_errors)
    worst = f"{100 * rms(errors):.2f} / {100 * errors.max():.2f} %"
    ways = {each.way: [one for one in results.trials if one.way == each.way] for each in results.trials}
    table = [
        ("gain of a taxel, root mean square / worst error", worst, f"{100 * GAIN_AIM:g} %"),
        *(line for way, trials in ways.items() for line in _way_lines(way, trials)),
    ]
    if not results.restored:
        return table
    before, after = (
        np.array([getattr(each, when) / each.true for each in results.restored]) for when in ("before", "after")
    )
    ratio = "NRMSE {} calibration over that with the truth, median / worst"
    large = f"{LARGE} x {LARGE} taxels: {{}}"
    return [
        *table,
        (ratio.format("before"), f"{np.median(before):.2f} / {before.max():.2f}", ""),
        (ratio.format("after"), f"{np.median(after):.3f} / {after.max():.3f}", f"{NRMSE_AIM:g}"),
        (large.format(f"gain from {LARGE_S:g} s of recording"), f"{results.large_gain_s:.1f} s", "10 s"),
        (large.format(f"cover from {PRESSES} presses"), f"{results.large_tip_s:.1f} s", ""),
    ]


def _way_lines(way: str, trials: list[Trial]) -> Iterator[tuple[str, str, str]]:
    decided = [each for each in trials if isfinite(each.error)]
    sizes = np.abs([each.error for each in decided] or [np.nan])
    within, covered = sum(sizes <= AIMS[way]), sum(each.covered for each in decided)
    name, of = f"thickness by {way}", f"of {len(decided)}"
    yield f"{name}, root mean square / worst error", f"{100 * rms(sizes):.2f} / {100 * sizes.max():.2f} %", ""
    yield f"{name}, within {100 * AIMS[way]:g} %", f"{within} {of}", "all"
    yield f"{name}, 95 % intervals that hold the truth", f"{covered} {of}", "90 to 99 of 100"
    yield f"{name}, cannot tell", f"{len(trials) - len(decided)} of {len(trials)}", ""
    yield f"{name}, median time", f"{np.median([each.seconds for each in trials]):.1f} s", ""


def write(folder: Path, results: Results) -> None:
    """Write every trial into calibration_trials.csv, and draw them into calibration_trials.svg."""
    write_csv(folder / "calibration_trials.csv", Trial._fields, results.trials)
    with figure(folder / "calibration_trials.svg", 10, 3.6) as drawing:
        axes = drawing.subplots(1, len(AIMS), sharey=True)
        for panel, (way, aim) in zip(axes, AIMS.items(), strict=True):
            for covered, colour, label in ((True, BLUE, "holds the truth"), (False, RED, "misses it")):
                some = [each for each in results.trials if each.way == way and each.covered == covered]
                fitted = [100 * (each.low + each.high) / 2 - 100 for each in some]
                half = [50 * (each.high - each.low) for each in some]
                place = [each.thickness for each in some]
                panel.errorbar(place, fitted, half, fmt="o", ms=3, lw=1, color=colour, label=f"interval {label}")
            panel.axhspan(-100 * aim, 100 * aim, color=BLUE, alpha=0.08, lw=0, label=f"aim: {100 * aim:g} %")
            panel.axhline(0, color=BLACK, lw=0.8)
            panel.set(title=f"Cover by {way}", xlabel="true thickness (pitches)", xscale="log")
            panel.set(ylim=(-MAX_DRAWN, MAX_DRAWN), xticks=(0.5, 1, 2, 3), xticklabels=("0.5", "1", "2", "3"))
            panel.minorticks_off()
        axes[0].set_ylabel("error of the thickness (%)")
        axes[-1].legend(loc="upper left", fontsize=8)
