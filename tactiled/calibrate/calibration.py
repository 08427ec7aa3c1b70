"""Counts to kPa: offset, gain, tare, and faulty taxels."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tactiled.errors import ConfigError
from tactiled.frames import DEAD, SATURATED, UNKNOWN, Counts


@dataclass(frozen=True, slots=True)
class Calibration:
    """pressure = (counts - no_load) * kpa_per_count; a negative gain: counts fall as pressure rises."""

    kpa_per_count: float = 1.0  # kPa
    no_load: float = 0.0  # counts
    saturation: float | None = None  # counts from which (falling gain: down to which) a taxel is at its ceiling
    noise_kpa: float | None = None  # standard deviation of one taxel; None: to be estimated from the frames
    dead: tuple[int, ...] = ()  # taxel indices that do not work
    shear_n_per_count: float | None = None  # N along the skin for one count of shear; None: not known

    def __post_init__(self) -> None:
        """Refuse a gain or a noise that is impossible."""
        if not np.isfinite(self.kpa_per_count) or self.kpa_per_count == 0:
            raise ConfigError(f"kpa_per_count is {self.kpa_per_count}: give kPa for one count, not 0")
        if not np.isfinite(self.no_load):
            raise ConfigError(f"no_load is {self.no_load}: give the counts of an unloaded taxel")
        if self.noise_kpa is not None and not (np.isfinite(self.noise_kpa) and self.noise_kpa > 0):
            raise ConfigError(f"noise_kpa is {self.noise_kpa}: give a standard deviation above 0 kPa")
        scale = self.shear_n_per_count
        if scale is not None and (not np.isfinite(scale) or scale == 0):
            raise ConfigError(f"shear_n_per_count is {scale}: give N for one count, not 0")

    @property
    def floor_kpa(self) -> float:
        """Noise that no taxel goes under: rounding to whole counts, one step / sqrt(12)."""
        return abs(self.kpa_per_count) / 12**0.5


class Calibrator:
    """Turns the counts of one array into kPa; the tare is its only state."""

    def __init__(self, calibration: Calibration, size: int) -> None:
        self.calibration = calibration
        self._no_load = np.full(size, calibration.no_load, np.float32)
        self._dead = np.zeros(size, np.uint8)
        beyond = [taxel for taxel in calibration.dead if not 0 <= taxel < size]
        if beyond:
            raise ConfigError(f"dead names taxel {beyond[0]}: the array has 0 to {size - 1}")
        self._dead[list(calibration.dead)] = DEAD

    @property
    def no_load(self) -> NDArray[np.float32]:
        """Counts of each taxel (N,) without a load; a copy."""
        return self._no_load.copy()

    def tare(self, counts: NDArray[np.float64]) -> None:
        """Take `counts` (N,), a mean over frames of the unloaded array, as no load; NaN keeps the taxel's own."""
        self._no_load = np.where(np.isfinite(counts), counts, self._no_load).astype(np.float32)

    def __call__(self, counts: Counts, flags: NDArray[np.uint8]) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
        """Pressure (N,) in kPa, NaN for a missing or bad taxel, and the flags with DEAD and SATURATED added."""
        gain = self.calibration.kpa_per_count
        flags = flags | self._dead
        if self.calibration.saturation is not None:
            full = np.sign(gain) * (counts - np.float32(self.calibration.saturation)) >= 0
            flags = flags | np.where(full, SATURATED, 0).astype(np.uint8)
        pressure = (counts.astype(np.float32) - self._no_load) * np.float32(gain)
        pressure[flags & UNKNOWN > 0] = np.nan
        return pressure, flags
