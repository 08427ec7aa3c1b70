"""From frames in counts to presses in kPa, and how well their taxels' gains are known."""

from dataclasses import replace

import numpy as np

from tactiled.arrays import Floats, Mask, Reals
from tactiled.calibrate.counts.calibration import Calibration, Calibrator
from tactiled.calibrate.counts.means import unknown_taxels
from tactiled.calibrate.counts.plateaus import noise as taxel_noise
from tactiled.calibrate.cover.presses import MIN_PEAK, Press, find_presses
from tactiled.calibrate.upkeep.health import NOISY_RATIO, opposite_pairs
from tactiled.errors import ConfigError
from tactiled.frames import SATURATED, FrameSeries
from tactiled.geometry import Array
from tactiled.restore.noise import estimate
from tactiled.units import number_text

UNCALIBRATED_SPREAD = 0.2  # relative standard deviation of uncalibrated gains
SILENT = 0.1  # of what two opposite neighbours feel: a taxel with less is dead
CLEARLY_PRESSED = 0.2  # of a press's peak: what lies between two taxels that feel more is pressed, too
NOISE_FRAMES = 2000  # of the middle of a recording, that its noise is measured from


def pressures(series: FrameSeries, calibration: Calibration, ends: tuple[float, float]) -> tuple[Floats, Mask]:
    """Pressures (T, N) in kPa (in counts without a gain), NaN: unknown, and which readings are at their ceiling.

    Where no ceiling is configured, it is one of the codec's `ends`. A taxel of NOISY_RATIO times the array's noise
    is left out.
    """
    size = series.counts.shape[1]
    with np.errstate(invalid="ignore"):
        free = np.zeros(series.counts.shape, np.uint8)
        pressure, flags = Calibrator(calibration, size).series(series.counts, free)
        saturated = flags & SATURATED > 0
        if calibration.saturation is None:
            rising = calibration.kpa_per_count > 0
            ceiling = series.counts >= ends[1] if rising else series.counts <= ends[0]
            saturated = saturated | ceiling
    with unknown_taxels():
        noisy = taxel_noise(_middle(pressure)) > NOISY_RATIO * noise_of(pressure, calibration)
    pressure[:, noisy] = np.nan
    return pressure.astype(np.float64), saturated


def recorded_presses(
    series: FrameSeries, array: Array, calibration: Calibration, ends: tuple[float, float], border: bool = False
) -> list[Press]:
    """Every press in a recording, the unusable ones with their reason; `border` lets them reach over the border.

    A taxel whose counts never change is left out. ConfigError where no frame is without a load, or none has one.
    """
    pressure, saturated = pressures(series, calibration, ends)
    with np.errstate(invalid="ignore"):
        still = ~(np.nan_to_num(series.counts) != np.nan_to_num(series.counts[:1])).any(axis=0)
    pressure[:, still] = np.nan
    noise = noise_of(pressure, calibration)
    presses = find_presses(pressure, array, noise, saturated & ~still, border)
    if not presses:
        raise ConfigError(
            f"no press stands out of the noise of {number_text(noise)} kPa in {len(pressure)} frames"
        )
    return presses


def without_dead(presses: list[Press], array: Array) -> tuple[list[Press], list[int]]:
    """The presses, unknown at taxels that feel none of them while two opposite neighbours do; and these taxels."""
    pressed, silent, pairs = np.zeros(array.size, bool), np.ones(array.size, bool), opposite_pairs(array)
    for press in presses:
        if not press.reason:
            mean = np.append(np.where(np.isfinite(press.mean), press.mean, -np.inf), -np.inf)
            opposite = mean[pairs].min(axis=0).max(axis=0)
            threshold = np.maximum(CLEARLY_PRESSED * mean.max(), MIN_PEAK * press.error)
            clear = np.isfinite(press.mean) & (opposite > threshold)
            pressed |= clear
            silent &= ~clear | (mean[:-1] < SILENT * opposite)
    dead = pressed & silent
    rest = [replace(each, mean=np.where(dead, np.nan, each.mean)) for each in presses]
    return rest, np.flatnonzero(dead).tolist()


def noise_of(pressure: Reals, calibration: Calibration) -> float:
    """Standard deviation (kPa) of a taxel in frames (T, N), not below what rounding to counts makes."""
    return max(estimate(_middle(pressure)), calibration.floor_kpa)


def _middle(frames: Reals) -> Reals:
    """NOISE_FRAMES of frames (T, N), if there are as many."""
    start = max(0, (len(frames) - NOISE_FRAMES) // 2)
    return frames[start : start + NOISE_FRAMES]


def bend_error(calibration: Calibration, presses: list[Press]) -> float | None:
    """Standard deviation of the bend of all taxels' curves at their range's end; None: unknown.

    A bend is twice what it changes of the gain in the middle of the range. Beyond the range nobody measured it.
    """
    curves = calibration.curves
    if curves is None or curves.curvature is None:
        return None
    highest = max(float(np.nanmax(each.mean)) for each in presses)
    return None if highest > np.median(curves.pressure(curves.end)) else 2 * curves.curvature


def gain_errors(calibration: Calibration, size: int) -> Floats:
    """Relative standard deviation (N,) of the taxels' gains, UNCALIBRATED_SPREAD where nobody measured it."""
    curves = calibration.curves
    if curves is None:
        return np.full(size, UNCALIBRATED_SPREAD)
    return np.where(curves.individual & np.isfinite(curves.deviation), curves.deviation, UNCALIBRATED_SPREAD)
