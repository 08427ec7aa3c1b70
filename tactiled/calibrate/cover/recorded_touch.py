"""A recording of what touched an array, and the ways to fit the cover to it."""

from dataclasses import dataclass, replace

import numpy as np

from tactiled.arrays import Floats
from tactiled.calibrate.counts.calibration import Calibration
from tactiled.calibrate.cover.blind import fit_blind
from tactiled.calibrate.cover.edge import edge_touch
from tactiled.calibrate.cover.fit import CoverFit, Method
from tactiled.calibrate.cover.recorded_presses import (
    bend_error,
    gain_errors,
    noise_of,
    pressures,
    recorded_presses,
    without_dead,
)
from tactiled.calibrate.cover.result import fit_cover
from tactiled.calibrate.cover.search import Touch
from tactiled.calibrate.cover.tip import Tip, tip_touch
from tactiled.calibrate.cover.unknowns import CALIPER_ERROR_MM, USUAL, Unknowns
from tactiled.cover.family import CoverFamily
from tactiled.cover.stack import Stack
from tactiled.frames import FrameSeries
from tactiled.geometry import Array


@dataclass(frozen=True, slots=True, eq=False)
class RecordedTouch:
    """Frames of an array under a stack, as configured."""

    series: FrameSeries
    array: Array
    stack: Stack
    calibration: Calibration
    ends: tuple[float, float]  # of the codec's counts


def fit_touch(
    recorded: RecordedTouch,
    way: Method,
    size_mm: float | None,
    sphere: bool = False,
    places_mm: Floats | None = None,
    unknowns: Unknowns = USUAL,
) -> CoverFit:
    """Fit the cover in one of three ways; `size_mm`: the tip's diameter, or the ridge's width, if it is known.

    A tip may be a `sphere`, and have pressed at known places (K, 2). `unknowns`: how well what is given is known.
    """
    series, array, stack, calibration = recorded.series, recorded.array, recorded.stack, recorded.calibration
    gain_error = gain_errors(calibration, array.size)
    if way == "blind":
        pressure, saturated = pressures(series, calibration, recorded.ends)
        pressure[saturated] = np.nan
        noise_kpa = noise_of(pressure, calibration)
        frames = pressure.reshape(-1, *array.frame_shape)
        return fit_blind(frames, noise_kpa, CoverFamily(stack), array, float(np.median(gain_error)))
    presses, dead = without_dead(
        recorded_presses(series, array, calibration, recorded.ends, border=way == "edge"), array
    )
    if unknowns.curvature is None:
        unknowns = replace(unknowns, curvature=bend_error(calibration, presses))
    touch: Touch
    if way == "edge":
        touch = edge_touch(presses, array, stack, gain_error, size_mm, unknowns)
    else:
        tip = Tip(size_mm, unknowns.size_mm or CALIPER_ERROR_MM, sphere)
        touch = tip_touch(presses, array, stack, tip, gain_error, places_mm, unknowns)
    fit = fit_cover(touch, presses, way)
    notes = [
        f"taxel {each} feels nothing where its neighbours do and is left out: list it as dead" for each in dead
    ]
    return replace(fit, notes=(*notes, *fit.notes))
