"""Creep of the rubber: readings under a lasting load grow with the logarithm of time; measured, not corrected."""

from math import log10
from typing import NamedTuple

import numpy as np

from tactiled.arrays import Floats32, Mask

START_S = 30.0  # after a load came, its growth is measured: the exact start matters little by then
SAMPLES_PER_DECADE = 20  # of time, so that each counts alike
MIN_SAMPLES = 20
MAX_CHANGE = 0.1  # share of the load outside the first pattern: more is another contact
MAX_JUMP = 0.03  # from block to block: more is another load
SIGNIFICANT_ERRORS, SIGNIFICANT_PERCENT = 4.0, 0.5  # standard errors; in a decade of time


class Creep(NamedTuple):
    """Growth of a load that stays, while it has been measured."""

    percent_per_decade: float  # of the load after START_S, for each tenfold time
    standard_error: float
    seconds: float  # since the load came
    taxels: int  # that it lies on

    @property
    def significant(self) -> bool:
        """Whether it is more than its error and more than nothing."""
        size = abs(self.percent_per_decade)
        return size > max(SIGNIFICANT_ERRORS * self.standard_error, SIGNIFICANT_PERCENT)


class CreepMeter:
    """Follows the pattern of a load from when it no longer moves, by its projection on what it was at first."""

    def __init__(self) -> None:
        self._restart(0.0)

    def _restart(self, time_s: float) -> None:
        self._began_s, self._next_s = time_s, START_S
        self._pattern: Floats32 | None = None
        self._before = 1.0
        self._points: list[tuple[float, float]] = []  # decimal logarithm of the time (s), load over the first
        self.creep: Creep | None = None

    def update(self, time_s: float, load: Floats32, loaded: Mask) -> None:
        """Take the loads (N,) of a block and which taxels bear one."""
        pattern = np.where(loaded, load, np.float32(0))
        strength = float(np.vdot(pattern, pattern))
        if not strength or time_s < self._began_s:
            self._restart(time_s)
            return
        if self._pattern is None:
            self._pattern = pattern
        ratio = float(np.vdot(pattern, self._pattern)) / float(np.vdot(self._pattern, self._pattern))
        other = float(np.linalg.norm(pattern - np.float32(ratio) * self._pattern))
        if other > MAX_CHANGE * strength**0.5 or abs(ratio - self._before) > MAX_JUMP * self._before:
            self._restart(time_s)
            self._pattern = pattern
            return
        self._before = ratio
        seconds = time_s - self._began_s
        if seconds >= self._next_s:
            self._next_s = seconds * 10 ** (1 / SAMPLES_PER_DECADE)
            self._points.append((log10(seconds), ratio))
            self._fit(seconds, int(np.count_nonzero(loaded)))

    def _fit(self, seconds: float, taxels: int) -> None:
        """Regress the load on the logarithm of time."""
        if len(self._points) < MIN_SAMPLES:
            return
        x, y = np.array(self._points).T
        x -= log10(START_S)
        spread = float(np.square(x - x.mean()).sum())
        slope = float(((x - x.mean()) * y).sum()) / spread
        start = float(y.mean() - slope * x.mean())
        residual = y - start - slope * x
        error = float(np.sqrt(np.square(residual).sum() / (len(x) - 2) / spread))
        self.creep = Creep(100 * slope / start, 100 * error / start, seconds, taxels)
