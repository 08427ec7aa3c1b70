"""The cover's thickness from everyday frames, whatever was pressed.

Pressure never pulls. Under too thick a model, no pressure explains a sharp edge: the misfit of non-negative least
squares rises. Under too thin a model, every frame can be explained, but by pressure that is spread over more cells
than need be. For each scene and each factor of a family of covers, the objective is

    chi^2 + w n,   n = (sum sqrt x)^2 / sum x the cells that are pressed, in effect,

which is a likelihood with a sparse prior. Its sum over scenes has its minimum near the true factor: the misfit of
a sharp scene rises steeply, so that the sharpest scenes decide. Scenes without an edge disagree with them and with
each other by far more than noise explains, so the interval is that of resampled scenes, with the error of w.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.special import stdtrit

from tactiled.calibrate.cover_fit import CoverFit
from tactiled.calibrate.deblur import Convolution, Images, deblurred
from tactiled.cover.family import CoverFamily
from tactiled.cover.stack import Stack
from tactiled.geometry import Array
from tactiled.restore.noise import detection_threshold

Floats = NDArray[np.float64]
Ints = NDArray[np.intp]

GAIN_ERROR = 0.01  # relative standard deviation of a taxel's gain, at least: cells explain no frame better
LOG_FACTORS = np.linspace(-0.7, 0.7, 15)
FINE_FACTORS = np.linspace(-0.7, 0.7, 561)
ITERATIONS = 150  # a factor, from the pressure under the cover one step thinner; twice as many at first
MAX_FRAMES = 16  # that are deblurred
SCENE_CHANGE = 0.3  # of a frame's square: a step that changes more begins another scene
CLEAR = 20.0  # times the noise: a frame with a lower peak says nothing about a cover
MIN_SCENES = 3
STILL_PITCHES = 0.1  # that a contact may move in frames that are averaged: 0.2 % of a cover of half a pitch
MAX_NEAR_FRAMES = 8  # on either side that are averaged
MAX_NOISE = 0.005  # of the peak: at 0.8 % the thickness from most recordings of the tour was wrong by 25 to 60 %
RESAMPLES = 400
MAX_INTERVAL = 1.4  # of its upper over its lower end: more does not tell the thickness
# Flat tips of 0.5 to 2 pitches (16 x 16 and 20 x 20 taxels, t/pitch 0.5 to 3, noise 0.1 to 0.4 % of the peak) gave
# covers up to 20 % too thin in intervals of a few per cent. All of these had fewer cells or more misfit than here;
# three pitches have 37 cells and more. None of 33 minutes of the tour (`tactiled bench calibration`) is refused.
MIN_CELLS, NARROW_SHARE = 33.0, 0.2  # cells in effect of a narrow contact, and the share of these that misleads
MISFIT = 1.2  # of all scenes under the best thickness, over noise and gain errors
MAX_GAIN_ERROR = 0.03  # of a taxel: uncalibrated gains, 20 % apart, bias the thickness
GAIN_NOTE = "gains that are not calibrated may make thickness and interval wrong: calibrate the gain first"
NOTE = "assumes sharp edges in the sharpest scenes: with none, the result may be wrong"
# w = max(1, (peak / noise / WEIGHT_SNR)^WEIGHT_POWER), for which the factor has no bias, was chosen on 91
# recordings of five random scenes each of tactiled/study/scenes.py: 24 x 24 taxels, t/pitch 0.5 to 3, noise 0.1
# to 2 % of the peak, gains within 1 % or exact. Errors are 2 to 3 % where noise is under 0.4 %.
WEIGHT_SNR, WEIGHT_POWER = 180.0, 1.3
# Standard deviation of w's binary logarithm. Of 0.2 to 0.5, with this one nearest to 95 % of the intervals hold
# the truth: 117 of 124, in 84 recordings of the tour, 22 of five random scenes each and 18 with 5 times the noise.
# Twice w raises the factor by 5 to 15 % with sharp scenes, by 50 to 130 % with fingertips and balls alone.
WEIGHT_ERROR = 0.35


@dataclass(frozen=True, slots=True, eq=False)
class Profiles:
    """What frames say of each of LOG_FACTORS."""

    chi2: Floats  # (T, factors) weighted squares of the residuals over the noise
    cells: Floats  # (T, factors) cells that are pressed, in effect
    snr: Floats  # (T,) peak over noise
    scene: Ints  # (T,)
    readings: Ints  # (T,) taxels that are known

    def objective(self, prior: float = 1.0) -> Floats:
        """Sum over the frames of each scene (S, FINE_FACTORS); `prior` multiplies w."""
        weight = prior * np.maximum(1.0, (self.snr / WEIGHT_SNR) ** WEIGHT_POWER)
        of_frames = self.chi2 + weight[:, None] * self.cells
        of_scenes = np.zeros((self.scene.max() + 1, len(LOG_FACTORS)))
        np.add.at(of_scenes, self.scene, of_frames)
        return np.asarray(CubicSpline(LOG_FACTORS, of_scenes, axis=1)(FINE_FACTORS))

    def followed_by(self, newer: "Profiles") -> "Profiles":
        """The newest MAX_FRAMES of both, each a scene."""
        chi2, cells, snr, readings = (
            np.concatenate([getattr(self, key), getattr(newer, key)])[-MAX_FRAMES:]
            for key in ("chi2", "cells", "snr", "readings")
        )
        return Profiles(chi2, cells, snr, np.arange(len(snr)), readings)


def fit_blind(
    frames: NDArray[np.floating],
    noise_kpa: float,
    family: CoverFamily,
    array: Array,
    gain_error: float = GAIN_ERROR,
) -> CoverFit:
    """The cover's thickness from successive frames (T, *shape) in kPa, NaN where unknown, of at least 3 scenes.

    Scenes are separated by frames without contact, or by a sudden change.
    """
    if array.shape is None:
        return _undecided(family, "the array is no grid: use presses with a tip or an edge")
    if 1 in array.shape:
        rows, columns = array.shape
        return _undecided(
            family, f"the array has {rows} x {columns} taxels: a blind fit needs several rows and columns"
        )
    scenes = find_scenes(np.asarray(frames, np.float32), noise_kpa)
    if len(scenes) < MIN_SCENES:
        if sum(map(len, scenes)) == len(frames):
            return _undecided(family, "every frame shows a contact: lift between presses, and check no load")
        count = f"{len(scenes)} scene{'' if len(scenes) == 1 else 's'}"
        return _undecided(
            family, f"{count} with a clear contact: press {MIN_SCENES} things or more, lifting between"
        )
    places, scene = _spread(scenes)
    means, noise = still_means(np.asarray(frames, np.float32), scenes, places, noise_kpa)
    over_noise = means / noise[:, None, None]
    share = 1 / float(np.median(np.nanmax(over_noise, axis=(1, 2))))
    if share > MAX_NOISE:
        return _undecided(
            family,
            f"noise is {100 * share:.2g} % of the pressure, and {100 * MAX_NOISE:.2g} % is the most that "
            "a blind fit stands: press harder, or hold still",
        )
    fit = _fit(profile(over_noise, scene, max(gain_error, GAIN_ERROR), (family, array)), family)
    return replace(fit, notes=(GAIN_NOTE, *fit.notes)) if gain_error > MAX_GAIN_ERROR else fit


def add_contacts(
    kept: Profiles | None, contacts: list[tuple[Images, int]], gain_error: float, stack: Stack, array: Array
) -> tuple[Profiles, CoverFit]:
    """Profiles of the newest MAX_FRAMES contacts and their fit; of a new one frames over noise, and its place."""
    family = CoverFamily(stack)
    means = [still_means(frames, [np.arange(len(frames))], np.array([place]), 1.0) for frames, place in contacts]
    over_noise = np.concatenate([mean / noise for mean, noise in means])
    newer = profile(over_noise, np.arange(len(means)), max(gain_error, GAIN_ERROR), (family, array))
    kept = kept.followed_by(newer) if kept else newer
    return kept, _fit(kept, family)


def find_scenes(frames: Images, noise_kpa: float) -> list[Ints]:
    """Frames of each scene with a clear contact, in order of time."""
    flat = np.nan_to_num(frames.reshape(len(frames), -1))
    square = np.einsum("ti,ti->t", flat, flat)
    step = np.diff(flat, axis=0)
    noise = 2 * noise_kpa**2 * flat.shape[1]
    changed = np.einsum("ti,ti->t", step, step) > noise + SCENE_CHANGE * np.maximum(square[1:], square[:-1])
    reach = max(CLEAR * noise_kpa, detection_threshold(noise_kpa, flat.shape[1]))
    clear = flat.max(axis=1) > reach
    begins = np.concatenate([[True], changed | ~clear[:-1]])
    number = np.cumsum(begins & clear)
    return [np.flatnonzero(clear & (number == n)) for n in np.unique(number[clear])]


def _spread(scenes: list[Ints]) -> tuple[Ints, Ints]:
    """At most MAX_FRAMES frames (T,), as many of each scene, far apart in it, and the scene (T,) of each."""
    scenes = [scenes[n] for n in np.linspace(0, len(scenes) - 1, min(len(scenes), MAX_FRAMES)).round().astype(int)]
    each = max(1, MAX_FRAMES // len(scenes))
    places = (np.arange(each) + 0.5) / each
    picked = [np.unique(scene[(places * len(scene)).astype(int)]) for scene in scenes]
    return np.concatenate(picked), np.repeat(np.arange(len(picked)), [len(one) for one in picked])


def still_means(frames: Images, scenes: list[Ints], places: Ints, noise_kpa: float) -> tuple[Images, Floats]:
    """Means (T, *shape) of the frames around each of `places` while what presses moves less than STILL_PITCHES.

    Also the noise (T,) of each mean, kPa. Frames are of the same one of `scenes`.
    """
    means, counts = frames[places].copy(), np.ones(len(places))
    scene_of = {int(each): scene for scene in scenes for each in scene}
    for n, place in enumerate(places):
        frame, scene = frames[place], scene_of[int(place)]
        near = frames[scene[np.abs(scene - place) <= MAX_NEAR_FRAMES]]
        slopes = sum(np.nansum(each**2) for each in np.gradient(np.nan_to_num(frame))) / 2  # along either axis
        moved = np.nansum((near - frame) ** 2, axis=(1, 2)) - 2 * noise_kpa**2 * frame.size
        still = near[moved < STILL_PITCHES**2 * slopes]
        means[n], counts[n] = still.mean(axis=0), len(still)
    return means, noise_kpa / np.sqrt(counts)


def profile(
    over_noise: NDArray[np.floating], scene: Ints, gain_error: float, skin: tuple[CoverFamily, Array]
) -> Profiles:
    """Deblur frames (T, *shape), over their noise, under every factor of a family over an array."""
    working = np.isfinite(over_noise)
    y = np.where(working, over_noise, 0).astype(np.float32)
    weight = np.where(working, 1 / (1 + (gain_error * y) ** 2), 0).astype(np.float32)
    chi2, cells = np.empty((2, len(LOG_FACTORS), len(y)))
    for n, factor in enumerate(np.exp(LOG_FACTORS)):
        blur = Convolution(skin[0], float(factor), skin[1])
        if n == 0:
            x = deblurred(blur, y, weight, np.zeros((len(y), *blur.cells), np.float32), ITERATIONS)
        x = deblurred(blur, y, weight, x, ITERATIONS)
        chi2[n] = (weight * (blur.forward(x) - y) ** 2).sum(axis=(1, 2), dtype=float)
        total = np.maximum(x.sum(axis=(1, 2), dtype=float), 1e-9)
        cells[n] = np.sqrt(x).sum(axis=(1, 2), dtype=float) ** 2 / total
    return Profiles(chi2.T, cells.T, y.max(axis=(1, 2)).astype(float), scene, working.sum(axis=(1, 2)))


def _fit(profiles: Profiles, family: CoverFamily) -> CoverFit:
    """The factor at which the objective is least, and its interval by resampling scenes."""
    objective = profiles.objective()
    count = len(objective)
    at = int(objective.sum(axis=0).argmin())
    weights = np.random.default_rng(0).dirichlet(np.ones(count), RESAMPLES)  # the Bayesian bootstrap (Rubin 1981)
    scatter = FINE_FACTORS[(weights @ objective).argmin(axis=1)].std() * np.sqrt((count + 1) / (count - 1))
    others = [profiles.objective(prior).sum(axis=0).argmin() for prior in (0.5, 2.0)]
    by_weight = WEIGHT_ERROR * np.abs(FINE_FACTORS[others] - FINE_FACTORS[at]).max()
    half = stdtrit(count - 1, 0.975) * np.hypot(scatter, by_weight)  # Student's quantile: scenes are few
    low, factor, high = np.exp(FINE_FACTORS[at] + np.array([-half, 0, half])).tolist()
    depth = family.configured.depth
    return CoverFit(
        method="blind",
        factor=factor,
        interval=(low, high),
        thickness_mm=factor * depth,
        interval_mm=(low * depth, high * depth),
        presses=len(profiles.scene),
        residual=_left_out(profiles, objective),
        reason=_reason(at, low, high) or _narrow(profiles, at),
        notes=(NOTE,),
    )


def _left_out(profiles: Profiles, objective: Floats) -> float:
    """Root mean square of the residuals of each scene under the factor that all others give, over the noise."""
    others = FINE_FACTORS[(objective.sum(axis=0) - objective).argmin(axis=1)][profiles.scene]
    chi2 = CubicSpline(LOG_FACTORS, profiles.chi2, axis=1)
    total = sum(float(chi2(factor)[n]) for n, factor in enumerate(others))
    return float(np.sqrt(max(total, 0.0) / profiles.readings.sum()))


def _reason(at: int, low: float, high: float) -> str:
    """Why the thickness cannot be told; "" where it can."""
    if at in (0, len(FINE_FACTORS) - 1):
        side = "thinner" if at == 0 else "thicker"
        return (
            f"the scenes fit a cover {side} than {np.exp(FINE_FACTORS[at]):.2g} times the configured one as well"
        )
    if high > MAX_INTERVAL * low:
        return f"the scenes allow {low:.2g} to {high:.2g} times the configured thickness: press sharper things"
    return ""


def _narrow(profiles: Profiles, at: int) -> str:
    """Why contacts are too narrow for the cells, which make them look as under a thinner cover; "" if not."""
    cells = profiles.cells[:, np.abs(LOG_FACTORS - FINE_FACTORS[at]).argmin()]
    if (cells < MIN_CELLS).mean() > NARROW_SHARE:
        return "contacts narrower than three taxels look like a thinner cover: press wider things with sharp edges"
    chi2 = CubicSpline(LOG_FACTORS, profiles.chi2.sum(axis=0))(FINE_FACTORS).min()
    misfit = float(np.sqrt(max(chi2, 0.0) / profiles.readings.sum()))
    if misfit > MISFIT:
        return (
            f"no thickness explains the scenes to better than {misfit:.2g} times noise and gain errors: press "
            "things wider than three taxels, and check the gain"
        )
    return ""


def _undecided(family: CoverFamily, reason: str) -> CoverFit:
    """A fit that tells nothing."""
    depth, ends = family.configured.depth, (float(np.exp(LOG_FACTORS[0])), float(np.exp(LOG_FACTORS[-1])))
    return CoverFit("blind", 1.0, ends, depth, (ends[0] * depth, ends[1] * depth), 0, reason=reason)
