"""Curves and hysteresis of iCub's skin in a pressure chamber: one recording fitted, the others predicted."""

from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import Annotated

import numpy as np
import typer
from scipy.io import loadmat
from scipy.signal import lfilter

from tactiled.calibrate.counts.calibration import Calibration, Calibrator
from tactiled.calibrate.counts.gain import fit_pressure
from tactiled.calibrate.counts.means import Rails
from tactiled.calibrate.counts.reference import Reference
from tactiled.cli.bench import print_table
from tactiled.frames import FrameSeries

KPA_PER_BAR = 100.0
MAX_STEP_KPA = 5.0  # of the chamber's sensor from frame to frame: more is a spike
SMOOTHING = 0.1  # of the counts, as the recordings' authors smooth them
START_FRAMES = 100  # without a load
MAX_DROP, DROP_FRAMES = 8, 5  # smoothed counts within that time: more is a fault
PLAUSIBLE = 100, 250  # smoothed counts
TIMED_FRAMES, TIMED_TAXELS = 2000, 160
ZEROS = ("kept", "tare", "best")  # of the calibration, of the recording's start, of each taxel by its mean error
HEADINGS = ("recording", "counts", "zero", "curve alone", "with hysteresis")


def smooth(counts):
    return lfilter([SMOOTHING], [1, SMOOTHING - 1], counts, axis=0, zi=(1 - SMOOTHING) * counts[:1])[0]


def recording(path):
    """Times (T,) s, counts (T, 280) and the chamber's pressure (T,) kPa, without the spikes of its sensor."""
    content = loadmat(path, squeeze_me=True, struct_as_record=False)["experiment"]
    frames, pressure = np.asarray(content.C, float), KPA_PER_BAR * np.asarray(content.P, float)
    length = min(len(frames), len(pressure))
    near = np.abs(np.diff(pressure[:length])) < MAX_STEP_KPA
    used = np.concatenate([[False], near]) | np.concatenate([near, [False]])
    return frames[:length][used, 1], frames[:length][used, 2:], pressure[:length][used]


def working(counts):
    """Whether each taxel (280,) works all along a recording of smoothed counts.

    The authors leave out those whose count stays the same, too; at rest a sound taxel's does.
    """
    low, high = PLAUSIBLE
    drops = (counts[:-DROP_FRAMES] - counts[DROP_FRAMES:] > MAX_DROP).any(axis=0)
    return (counts.min(axis=0) >= low) & (counts.max(axis=0) <= high) & ~drops


def errors(calibration, counts, pressure, zero):
    """Rms error (N,) in kPa over a recording; for `best` the mean error is taken off, which nobody knows."""
    calibrator = Calibrator(calibration, counts.shape[1])
    if zero == "tare":
        calibrator.tare(counts[:START_FRAMES].mean(axis=0))
    got, _ = calibrator.series(counts.astype(np.float32), np.zeros(counts.shape, np.uint8))
    missed = got - pressure[:, None]
    return np.sqrt(np.mean((missed - (missed.mean(axis=0) if zero == "best" else 0)) ** 2, axis=0))


def microseconds(calibration):
    """Time a frame of TIMED_TAXELS taxels takes in the hysteresis, the median."""
    curves = calibration.curves
    keys = "parameters", "reach_counts", "deviation", "hysteresis", "individual", "error_kpa"
    part = replace(curves, **{key: getattr(curves, key)[:TIMED_TAXELS] for key in keys})
    calibrator = Calibrator(Calibration(curves=part), TIMED_TAXELS)
    frames = np.random.default_rng(0).integers(150, 250, (TIMED_FRAMES, TIMED_TAXELS)).astype(np.float32)
    flags, times = np.zeros(TIMED_TAXELS, np.uint8), []
    for frame in frames:
        began = perf_counter()
        calibrator.follow(frame, flags)
        times.append(perf_counter() - began)
    return 1e6 * float(np.median(times))


def insole(
    folder: Annotated[Path, typer.Argument(help="Folder with calibration.mat and other recordings.")],
) -> None:
    """Fit calibration.mat of iCub's insoles, and print the median taxel's rms error (kPa) in all recordings."""
    times, counts, pressure = recording(folder / "calibration.mat")
    log = Reference(folder / "calibration.mat", "pressure_kpa", times, pressure - pressure[:START_FRAMES].mean())
    fit = fit_pressure(FrameSeries(times, counts.astype(np.float32)), log, Rails(0, 255, -1))
    curves = fit.curves
    with_loop = Calibration(curves=curves, no_loads=fit.no_load)
    alone = fit_pressure(FrameSeries(times, counts.astype(np.float32)), log, Rails(0, 255, -1), loops=False)
    without = Calibration(curves=alone.curves, no_loads=alone.no_load)
    others = {path.stem: recording(path) for path in sorted(folder.glob("*.mat"))}
    validations = [each for name, each in others.items() if name.startswith("validation")]
    good = np.logical_and.reduce([working(smooth(each)) for _, each, _ in validations])
    good[list(fit.dead)] = False
    rows = []
    for name, (_, raw, applied) in others.items():
        for what, readings in (("smoothed", smooth(raw)), ("as sent", raw)):
            for zero in ZEROS:
                load = applied - (applied if zero == "tare" else pressure)[:START_FRAMES].mean()
                medians = [np.median(errors(each, readings, load, zero)[good]) for each in (without, with_loop)]
                rows.append((name, what, zero, *(f"{each:.2f}" for each in medians)))
        shift = np.std((raw[:START_FRAMES].mean(axis=0) - fit.no_load)[good])
        typer.echo(f"{name}: zeros other than those of the calibration by {shift:.1f} counts (standard deviation)")
    print_table(f"{np.count_nonzero(good)} taxels that work in all validations", HEADINGS, rows)
    deviation, elsewhere = (np.nanmedian(each[good]) for each in (alone.curves.deviation, alone.curves.error_kpa))
    typer.echo(f"{alone.curves.form}: standard error {100 * deviation:.1f} %, error elsewhere {elsewhere:.1f} kPa")
    if curves.loop is not None:
        typer.echo(f"{curves.loop}: {microseconds(with_loop):.0f} us for a frame of {TIMED_TAXELS} taxels")
