"""The cover's thickness from everyday frames, whatever was pressed.

Pressure never pulls. Under too thick a model, no pressure explains a sharp edge: the misfit of non-negative least
squares rises. Under too thin a model, every frame can be explained, but by pressure that is spread over more cells
than need be. For each scene and each factor of a family of covers, the objective is

    chi^2 + w n,   n = (sum sqrt x)^2 / sum x the cells that are pressed, in effect,

which is a likelihood with a sparse prior. Its sum over the scenes with sharp edges has its minimum near the true
factor; how far off is learned from a simulated recording of flat things with the outlines that were found (a
parametric bootstrap). The interval is that of resampled scenes, with the errors of w and of this correction.
"""

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.special import stdtrit

from tactiled.arrays import Floats, Ints, Reals
from tactiled.calibrate.cover.contact_frames import (
    MAX_FRAMES,
    Shared,
    find_scenes,
    over_zeros,
    shared_noise,
    spread,
    still_means,
)
from tactiled.calibrate.cover.deblur import Convolution, Images, Precision, deblurred
from tactiled.calibrate.cover.fit import CoverFit
from tactiled.cover.family import CoverFamily
from tactiled.cover.stack import Stack
from tactiled.geometry import Array
from tactiled.restore.noise import NORMAL_95

Skin = tuple[CoverFamily, Array]
# Frames over noise, place of the one that counts, variance of their zero.
ContactFrames = tuple[Images, int, float]

MIN_OWN_NOISE = 0.25  # least share of a taxel's noise that is its own
GAIN_ERROR = 0.01  # relative standard deviation of a taxel's gain, at least: cells explain no frame better
LOG_FACTORS = np.linspace(-0.7, 0.7, 15)
FINE_FACTORS = np.linspace(-0.7, 0.7, 561)
# For each pitch of thickness, and half as many more: pressure under a thick cover converges slowly. More of them
# let pressure rise at the rims of contacts, so that too thick a cover explains them.
ITERATIONS = 40
MIN_SCENES = 3
MAX_NOISE = 0.005  # of the peak: at 0.8 % the thickness from most recordings of the tour was wrong by 25 to 60 %
RESAMPLES = 400
MAX_INTERVAL = 1.4  # upper over lower end: a wider interval is refused
# Flat tips of half a pitch's radius (20 x 20 taxels, t/pitch 0.6 to 2.4, noise 0.2 % of the peak) gave covers 6
# to 25 % too thin in intervals of a few per cent. They and those of one pitch have 9 to 15 such cells; those of
# one and a half have 26 and more, and errors of 2 %.
MIN_AREA, NARROW_SHARE = 20, 0.2  # cells below which a contact is narrow; largest share of such contacts
MISFIT = 1.2  # of all scenes under the best thickness, over noise and gain errors
MAX_GAIN_ERROR = 0.03  # of a taxel: uncalibrated gains, 20 % apart, bias the thickness
GAIN_NOTE = "gains that are not calibrated may make thickness and interval wrong: calibrate the gain first"
# Steepest rise of pressure that makes a scene sharp, as `_outlines` has it. In 64 recordings of 12 presses
# (20 x 20 taxels, t/pitch 0.5 to 3) flat things had 0.31 to 0.5, fingers 0.16 to 0.33, balls of 2 pitches' radius
# and more 0.24 to 0.34. Fingers are over 0.32 under three pitches of rubber alone, at most a quarter of them.
SHARP, MIN_SHARP = 0.32, 0.3  # and the least share of the scenes that are sharp
OUTLINE_SLOPE = 6.0  # of the edges of simulated things, over those of smoothed pressure: no wider than a cell
WEIGHT_SNR = 125.0  # w = peak / noise / WEIGHT_SNR; errors are the same with half and twice as much noise
WEIGHT_ERROR = 0.35  # standard deviation of w's binary logarithm
BIAS_ERROR = 0.35  # standard deviation of the correction, over it
MODEL_ERROR = 0.015  # standard deviation of the thickness's logarithm that scenes do not show


class Frames(NamedTuple):
    """Frames of contacts, and what is known of their errors."""

    over_noise: Images  # (T, *shape) over a taxel's own noise, NaN where unknown
    scene: Ints  # (T,)
    gain_error: float  # relative standard deviation
    shared: Shared = (0.0, 0.0, 0.0)  # variance of noise that rows, columns and all taxels share, over the own

    def of(self, scenes: Ints) -> "Frames":
        """Those of some scenes, numbered anew."""
        keep = np.isin(self.scene, scenes)
        return self._replace(over_noise=self.over_noise[keep], scene=np.searchsorted(scenes, self.scene[keep]))


@dataclass(frozen=True, slots=True, eq=False)
class Profiles:
    """What frames say of each of LOG_FACTORS."""

    chi2: Floats  # (T, factors) weighted squares of the residuals over the noise
    cells: Floats  # (T, factors) cells that are pressed, in effect
    snr: Floats  # (T,) peak over noise
    sharpness: Floats  # (T, factors) steepest rise of the pressure
    area: Floats  # (T, factors) cells of more than half of its height
    scene: Ints  # (T,)
    readings: Ints  # (T,) taxels that are known

    def objective(self, prior: float = 1.0) -> Floats:
        """Sum over the frames of each scene (S, FINE_FACTORS); `prior` multiplies w."""
        weight = prior * self.snr / WEIGHT_SNR
        return np.asarray(
            CubicSpline(LOG_FACTORS, self._scenes(self.chi2 + weight[:, None] * self.cells), axis=1)(FINE_FACTORS)
        )

    def sharp(self, at: int) -> Ints:
        """Scenes whose edges are sharp under FINE_FACTORS[at]."""
        sharpness = CubicSpline(LOG_FACTORS, self._scenes(self.sharpness), axis=1)(FINE_FACTORS[at])
        return np.flatnonzero(sharpness > SHARP * np.bincount(self.scene))

    def of(self, scenes: Ints) -> "Profiles":
        """Those of some scenes, numbered anew."""
        keep = np.isin(self.scene, scenes)
        kept = {each.name: getattr(self, each.name)[keep] for each in fields(self)}
        return Profiles(**kept | {"scene": np.searchsorted(scenes, kept["scene"])})

    def followed_by(self, newer: "Profiles") -> "Profiles":
        """The newest MAX_FRAMES of both, each a scene."""
        both = {
            each.name: np.concatenate([getattr(self, each.name), getattr(newer, each.name)])[-MAX_FRAMES:]
            for each in fields(self)
        }
        return Profiles(**both | {"scene": np.arange(len(both["snr"]))})

    def _scenes(self, of_frames: Floats) -> Floats:
        """Sums (S, ...) of frames over their scenes."""
        of_scenes = np.zeros((self.scene.max() + 1, *of_frames.shape[1:]))
        np.add.at(of_scenes, self.scene, of_frames)
        return of_scenes


def fit_blind(
    frames: Reals, noise_kpa: float, family: CoverFamily, array: Array, gain_error: float = GAIN_ERROR
) -> CoverFit:
    """The cover's thickness from successive frames (T, *shape) in kPa, NaN where unknown, of at least 3 scenes.

    Scenes are separated by frames without contact, which show their zeros, or by a sudden change. ConfigError
    where no frame is without a load.
    """
    if array.shape is None:
        return _undecided(family, "the array is no grid: use presses with a tip or an edge")
    if 1 in array.shape:
        rows, columns = array.shape
        return _undecided(
            family, f"the array has {rows} x {columns} taxels: a blind fit needs several rows and columns"
        )
    over, zero_variance = over_zeros(np.asarray(frames, np.float32), noise_kpa)
    scenes = find_scenes(over, noise_kpa)
    if len(scenes) < MIN_SCENES:
        count = f"{len(scenes)} scene{'' if len(scenes) == 1 else 's'}"
        return _undecided(
            family, f"{count} with a clear contact: press {MIN_SCENES} things or more, lifting between"
        )
    places, scene = spread(scenes)
    shared = shared_noise(over, noise_kpa)
    own = np.sqrt(max(1 - sum(shared) / noise_kpa**2, MIN_OWN_NOISE**2))
    means, noise = still_means(over, scenes, places, noise_kpa)
    over_noise = means / (own * np.hypot(noise, noise_kpa * np.sqrt(zero_variance[places])))[:, None, None]
    share = 1 / float(np.median(np.nanmax(over_noise, axis=(1, 2))))
    if share > MAX_NOISE:
        return _undecided(
            family,
            f"noise is {100 * share:.2g} % of the pressure, and {100 * MAX_NOISE:.2g} % is the most that "
            "a blind fit stands: press harder, or hold still",
        )
    row, column, common = (float(each / (own * noise_kpa) ** 2) for each in shared)
    evidence = Frames(over_noise, scene, max(gain_error, GAIN_ERROR), (row, column, common))
    skin = family, array

    def simulated(factor: float, scenes: Ints) -> Profiles:
        return profile(simulate(evidence.of(scenes), factor, min(gain_error, GAIN_ERROR), skin), skin)

    fit = _fit(profile(evidence, skin), family, simulated)
    return replace(fit, notes=(GAIN_NOTE, *fit.notes)) if gain_error > MAX_GAIN_ERROR else fit


def add_contacts(
    kept: Profiles | None, contacts: list[ContactFrames], gain_error: float, stack: Stack, array: Array
) -> tuple[Profiles, CoverFit]:
    """Profiles of the newest MAX_FRAMES contacts and their fit."""
    family = CoverFamily(stack)
    means = [still_means(frames, [np.arange(len(frames))], np.array([at]), 1.0) for frames, at, _ in contacts]
    zeros = [variance for *_, variance in contacts]
    over_noise = np.concatenate(
        [mean / np.sqrt(noise**2 + zero) for (mean, noise), zero in zip(means, zeros, strict=True)]
    )
    newer = profile(Frames(over_noise, np.arange(len(means)), max(gain_error, GAIN_ERROR)), (family, array))
    kept = kept.followed_by(newer) if kept else newer
    return kept, _fit(kept, family)


def profile(frames: Frames, skin: Skin) -> Profiles:
    """Deblur frames under every factor of a family over an array."""
    y, precision = _weighted(frames)
    chi2, cells, sharpness, area = np.empty((4, len(LOG_FACTORS), len(y)))
    x = None
    for n, factor in enumerate(np.exp(LOG_FACTORS).tolist()):
        blur, x = _pressure(y, precision, factor, skin, x)
        chi2[n] = precision.square(blur.forward(x) - y)
        total = np.maximum(x.sum(axis=(1, 2), dtype=float), 1e-9)
        cells[n] = np.sqrt(x).sum(axis=(1, 2), dtype=float) ** 2 / total
        sharpness[n], area[n] = _outlines(x)
    readings, snr = np.isfinite(frames.over_noise).sum(axis=(1, 2)), y.max(axis=(1, 2)).astype(float)
    return Profiles(chi2.T, cells.T, snr, sharpness.T, area.T, frames.scene, readings)


def simulate(frames: Frames, factor: float, gain_error: float, skin: Skin) -> Frames:
    """Frames of flat things that have the outlines of those in `frames`, as a cover of `factor` shows them."""
    random, (y, precision) = np.random.default_rng(0), _weighted(frames)
    blur, x = _pressure(y, precision, factor, skin)
    smooth, top = _smooth(x)
    clean = blur.forward(np.clip(OUTLINE_SLOPE * (smooth / top - 0.5) + 0.5, 0, 1).astype(np.float32))
    clean *= (y * clean).sum(axis=(1, 2), keepdims=True) / (clean**2).sum(axis=(1, 2), keepdims=True)
    count, rows, columns = y.shape
    sizes = ((count, rows, 1), (count, 1, columns), (count, 1, 1))
    noise = random.normal(size=y.shape) + sum(
        np.sqrt(variance) * random.normal(size=size) for variance, size in zip(frames.shared, sizes, strict=True)
    )
    seen = clean * (1 + gain_error * random.normal(size=(rows, columns))) + noise
    return frames._replace(over_noise=np.where(np.isfinite(frames.over_noise), seen, np.nan).astype(np.float32))


def _weighted(frames: Frames) -> tuple[Images, Precision]:
    """Readings, 0 where unknown, and what they count."""
    finite = np.isfinite(frames.over_noise)
    y = np.where(finite, frames.over_noise, 0).astype(np.float32)
    weight = np.where(finite, 1 / (1 + (frames.gain_error * y) ** 2), 0).astype(np.float32)
    return y, Precision(weight, frames.shared)


def _pressure(
    y: Images, precision: Precision, factor: float, skin: Skin, start: Images | None = None
) -> tuple[Convolution, Images]:
    """The blur of a cover of `factor`, and pressure that explains readings; without a start it takes longer."""
    blur = Convolution(skin[0], factor, skin[1])
    iterations = round(ITERATIONS * (0.5 + factor * skin[0].configured.depth / skin[1].pitch))
    if start is None:
        start = deblurred(blur, y, precision, np.zeros((len(y), *blur.cells), np.float32), iterations)
    return blur, deblurred(blur, y, precision, start, iterations)


def _smooth(x: Images) -> tuple[Floats, Floats]:
    """Means of pressure over 3 x 3 cells, and their typical height (T, 1, 1)."""
    from scipy.ndimage import uniform_filter  # which nothing imports that starts a service

    smooth = np.maximum(uniform_filter(x, (0, 3, 3), mode="constant"), 0).astype(float)
    cubes, squares = ((smooth**n).sum(axis=(1, 2), keepdims=True) for n in (3, 2))
    return smooth, cubes / np.maximum(squares, 1e-9)


def _outlines(x: Images) -> tuple[Floats, Floats]:
    """Steepest rise (T,) of smoothed pressure from cell to cell, over its height; cells over half of that."""
    smooth, top = _smooth(x)
    steep = np.hypot(*np.gradient(smooth, axis=(1, 2)))
    cubes, squares = ((steep**n).sum(axis=(1, 2)) for n in (3, 2))
    return cubes / np.maximum(squares * top[:, 0, 0], 1e-9), (smooth > top / 2).sum(axis=(1, 2)).astype(float)


def _fit(
    profiles: Profiles, family: CoverFamily, simulated: Callable[[float, Ints], Profiles] | None = None
) -> CoverFit:
    """The factor at which the objective of sharp scenes is least, less what it is off in `simulated` ones."""
    scenes = int(profiles.scene.max()) + 1
    sharp = np.arange(scenes)
    for _ in range(2):
        at = int(profiles.of(sharp).objective().sum(axis=0).argmin())
        sharp = profiles.sharp(at)
        if len(sharp) < max(MIN_SCENES, MIN_SHARP * scenes):
            advice = "press more coins or keys, as fingers look the same under a thinner cover"
            return _undecided(family, f"sharp edges in {len(sharp)} of {scenes} scenes: {advice}")
    kept = profiles.of(sharp)
    objective = kept.objective()
    at = int(objective.sum(axis=0).argmin())
    bias = 0.0
    if simulated is not None and 0 < at < len(FINE_FACTORS) - 1:
        again = simulated(float(np.exp(FINE_FACTORS[at])), sharp).objective().sum(axis=0).argmin()
        bias = float(FINE_FACTORS[again] - FINE_FACTORS[at])
    half = _half_interval(kept, at, bias)
    low, factor, high = np.exp(FINE_FACTORS[at] - bias + np.array([-half, 0, half])).tolist()
    depth = family.configured.depth
    unused = scenes - len(sharp)
    return CoverFit(
        method="blind",
        factor=factor,
        interval=(low, high),
        thickness_mm=factor * depth,
        interval_mm=(low * depth, high * depth),
        presses=len(kept.scene),
        residual=_left_out(kept, objective),
        reason=_reason(at, low, high) or _narrow(kept, at),
        notes=(f"{unused} of {scenes} scenes have no sharp edge and are not used",) if unused else (),
    )


def _half_interval(profiles: Profiles, at: int, bias: float) -> float:
    """Half of the 95 % interval of the factor's logarithm."""
    objective = profiles.objective()
    count = len(objective)
    weights = np.random.default_rng(0).dirichlet(np.ones(count), RESAMPLES)  # the Bayesian bootstrap (Rubin 1981)
    scatter = FINE_FACTORS[(weights @ objective).argmin(axis=1)].std() * np.sqrt((count + 1) / (count - 1))
    others = [profiles.objective(prior).sum(axis=0).argmin() for prior in (0.5, 2.0)]
    by_weight = WEIGHT_ERROR * np.abs(FINE_FACTORS[others] - FINE_FACTORS[at]).max()
    model = np.sqrt(by_weight**2 + (BIAS_ERROR * bias) ** 2 + MODEL_ERROR**2)
    return float(np.hypot(stdtrit(count - 1, 0.975) * scatter, NORMAL_95 * model))  # Student's: scenes are few


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
    """Why contacts are too narrow, or no thickness explains them; "" if neither is so."""
    area = profiles.area[:, np.abs(LOG_FACTORS - FINE_FACTORS[at]).argmin()]
    if (area < MIN_AREA).mean() > NARROW_SHARE:
        return "contacts narrower than three taxels look like a thinner cover: press wider things with sharp edges"
    chi2 = CubicSpline(LOG_FACTORS, profiles.chi2.sum(axis=0))(FINE_FACTORS).min()
    misfit = float(np.sqrt(max(chi2, 0.0) / profiles.readings.sum()))
    if misfit > MISFIT:
        return (
            f"no thickness explains the scenes to better than {misfit:.2g} times noise and gain errors: press "
            "things wider than three taxels, wait longer after each lift as rubber creeps, and check the gain"
        )
    return ""


def _undecided(family: CoverFamily, reason: str) -> CoverFit:
    depth, ends = family.configured.depth, (float(np.exp(LOG_FACTORS[0])), float(np.exp(LOG_FACTORS[-1])))
    return CoverFit("blind", 1.0, ends, depth, (ends[0] * depth, ends[1] * depth), 0, reason=reason)
