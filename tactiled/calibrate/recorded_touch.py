"""A recording of what touched an array, and the ways to fit the cover to it."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tactiled.calibrate.blind import fit_blind
from tactiled.calibrate.calibration import Calibration
from tactiled.calibrate.cover_fit import CoverFit, Method
from tactiled.calibrate.cover_result import fit_cover
from tactiled.calibrate.edge import edge_touch
from tactiled.calibrate.frame_series import FrameSeries
from tactiled.calibrate.presses import Press
from tactiled.calibrate.recorded_presses import gain_errors, noise_of, pressures, recorded_presses
from tactiled.calibrate.tip import Tip, tip_touch
from tactiled.cover.family import CoverFamily
from tactiled.cover.stack import Stack
from tactiled.geometry import Array

Floats = NDArray[np.float64]


class RecordedTouch:
    """Frames of an array under `stack`, as configured; `full_scale` is the codec's largest count."""

    def __init__(
        self, series: FrameSeries, array: Array, stack: Stack, calibration: Calibration, full_scale: int
    ) -> None:
        self._series, self._array, self._stack = series, array, stack
        self._calibration, self._full_scale = calibration, full_scale
        self._gain_error = gain_errors(calibration, array.size)

    def presses(self, border: bool) -> list[Press]:
        """Every press; `border` lets them reach over the array's border, as edges do."""
        return recorded_presses(self._series, self._array, self._calibration, self._full_scale, border)

    def tip(self, presses: Sequence[Press], tip: Tip, places_mm: Floats | None = None) -> CoverFit:
        """Fit the cover to presses with a tip, at `places_mm` (K, 2) if they are known."""
        touch = tip_touch(presses, self._array, self._stack, tip, self._gain_error, places_mm)
        return fit_cover(touch, presses, "tip")

    def edge(self, presses: Sequence[Press], width_mm: float | None) -> CoverFit:
        """Fit the cover to straight edges, or to ridges of a width."""
        touch = edge_touch(presses, self._array, self._stack, self._gain_error, width_mm)
        return fit_cover(touch, presses, "edge")

    def blind(self) -> CoverFit:
        """Fit the cover to whatever touched the array."""
        pressure, saturated = pressures(self._series, self._calibration, self._full_scale)
        pressure[saturated] = np.nan
        frames, noise_kpa = pressure.reshape(-1, *self._array.frame_shape), noise_of(pressure, self._calibration)
        error = float(np.median(self._gain_error))
        return fit_blind(frames, noise_kpa, CoverFamily(self._stack), self._array, error)


def fit_touch(recorded: RecordedTouch, way: Method, size_mm: float | None) -> CoverFit:
    """Fit the cover in one of three ways; `size_mm`: the tip's diameter, or the ridge's width, if it is known."""
    if way == "blind":
        return recorded.blind()
    presses = recorded.presses(border=way == "edge")
    return recorded.edge(presses, size_mm) if way == "edge" else recorded.tip(presses, Tip(size_mm))
