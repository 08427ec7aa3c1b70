"""The drift that taxels share: how strongly each taxel follows it, and what pads without pressure show of it."""

import numpy as np

from tactiled.arrays import Floats, Floats32, Mask

SENSITIVITY_STEP = 0.005  # of the common mode, over which a taxel's own drift is compared with it
SENSITIVITY_PRIOR = 0.0625  # of a taxel's noise squared: its zero's variance over that of sensitivities, 0.2^2
MIN_SENSITIVITY = 0.1
MIN_REFERENCE_SQUARE = 4.0  # counts squared of the references' changes, from which their effect is judged
TIME_S = 200.0  # time constant of the zero and its rate, critically damped: a steady drift leaves no error


class Sensitivity:
    """Drift of each taxel over the common mode: 1 to begin with, learnt over its changes while it is free."""

    def __init__(self, taxels: int, full_scale: float) -> None:
        self._step = SENSITIVITY_STEP * full_scale
        self._prior = np.full(taxels, SENSITIVITY_PRIOR)
        self._product, self._square, self._zero, self._common = np.zeros((4, taxels))
        self._tracked = np.zeros(taxels, bool)  # free since its last comparison

    @property
    def values(self) -> Floats:
        """(N,), of a regression through 0 with a prior of 1, over their median."""
        values = (self._prior + self._product) / (self._prior + self._square)
        return np.asarray(np.maximum(values / np.median(values), MIN_SENSITIVITY))

    def reset(self) -> None:
        """Begin new changes: the zeros have been set."""
        self._tracked[:] = False

    def learn(self, zero: Floats32, common: float, free: Mask, sigma: Floats32) -> None:
        """Compare the zeros' changes with those of the common mode, for readings with noise `sigma` (N,)."""
        self._prior = SENSITIVITY_PRIOR * np.square(sigma, dtype=float)
        change = common - self._common
        due = free & self._tracked & (np.abs(change) >= self._step)
        self._product[due] += (zero[due] - self._zero[due]) * change[due]
        self._square[due] += change[due] ** 2
        start = due | (free & ~self._tracked)
        self._zero[start], self._common[start] = zero[start], common
        self._tracked[:] = free


class References:
    """What pads that feel no pressure say of the common mode, where too few taxels are free to show it."""

    def __init__(self) -> None:
        self._smooth = np.nan  # counts, running mean over the pads
        self._anchor: tuple[float, float] | None = None  # smooth reference and common mode
        self._product = self._square = 0.0

    def learn(self, references: Floats32 | None, common: float, seconds: float) -> None:
        """Compare their change with the common mode's."""
        if self._follow(references, seconds) is None:
            return
        if self._anchor is None:
            self._anchor = self._smooth, common
        change = self._smooth - self._anchor[0]
        if abs(change) >= 1.0:
            self._product += change * (common - self._anchor[1])
            self._square += change**2
            self._anchor = self._smooth, common

    def predict(self, references: Floats32 | None, seconds: float, otherwise: float) -> float:
        """Rate (counts a second) of the common mode since the last block, `otherwise` where it is not known."""
        self._anchor = None
        change = self._follow(references, seconds)
        if change is None or not seconds or self._square < MIN_REFERENCE_SQUARE:
            return otherwise
        return self._product / self._square * change / seconds

    def _follow(self, references: Floats32 | None, seconds: float) -> float | None:
        """By how much (counts) their running mean changes; None where no pad is read."""
        if references is None or not np.isfinite(references).any():
            return None
        mean = float(np.nanmean(references))
        before = mean if np.isnan(self._smooth) else self._smooth
        self._smooth = before + min(1.0, seconds / TIME_S) * (mean - before)
        return self._smooth - before
