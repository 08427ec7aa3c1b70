"""Counts to kPa: offset, gain or curve, tare, and faulty taxels."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tactiled.calibrate.counts.curves import Curves
from tactiled.calibrate.counts.hysteresis import LoopFollower
from tactiled.core import readings
from tactiled.errors import ConfigError
from tactiled.frames import DEAD, OUT_OF_RANGE, SATURATED, UNKNOWN, Counts


@dataclass(frozen=True, slots=True)
class Calibration:
    """pressure = (counts - no_load) * kpa_per_count, or by curves; a negative gain: counts fall under pressure."""

    kpa_per_count: float = 1.0  # kPa; with curves the median of their gains
    no_load: float = 0.0  # counts
    saturation: float | None = None  # counts from which (falling gain: down to which) a taxel is at its ceiling
    noise_kpa: float | None = None  # standard deviation of one taxel; None: to be estimated from the frames
    dead: tuple[int, ...] = ()  # taxel indices that do not work
    track_drift: bool = True  # of zeros that were measured
    shear_n_per_count: float | None = None  # N along the skin for one count of shear; None: not known
    curves: Curves | None = field(default=None, compare=False)  # of each taxel
    noise_counts: NDArray[np.float64] | None = field(default=None, compare=False)  # (N,), until measured
    no_loads: NDArray[np.float64] | None = field(default=None, compare=False)  # (N,) counts; None: `no_load`

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
        """Noise that no taxel goes under: rounding to whole counts, one step / sqrt(12); of curves the median."""
        step = self.kpa_per_count
        if self.curves is not None:
            step = float(np.median(self.curves.slope(np.zeros(self.curves.size))))
        return abs(step) / 12**0.5

    def counts(self, pressure: NDArray[np.float64]) -> NDArray[np.float64]:
        """Counts (..., N) under `pressure` (..., N) in kPa, not rounded."""
        over = pressure / self.kpa_per_count if self.curves is None else self.curves.counts(pressure)
        return over + (self.no_load if self.no_loads is None else self.no_loads)


class Calibrator:
    """Turns the counts of one array into kPa; its state: tare, drift of the zeros, faulty taxels, hysteresis.

    Of a skin with a hysteresis model `follow` takes each frame in turn, before its pressure is asked for.
    """

    def __init__(self, calibration: Calibration, size: int) -> None:
        self.calibration = calibration
        curves = calibration.curves
        if curves is not None and curves.size != size:
            raise ConfigError(f"gain has {curves.size} taxels: the array has {size}")
        self._no_load = self._zero = np.full(size, calibration.no_load, np.float32)
        self.tares = 0  # times that the zeros were set anew
        self.measured = False  # whether they were measured, not only configured
        if calibration.no_loads is not None:
            self.tare(calibration.no_loads)
        gain = calibration.kpa_per_count if curves is None else curves.gain
        self._gain = np.broadcast_to(np.asarray(gain, np.float32), (size,)).copy()
        self._curves = None if curves is None or curves.form == "linear" else curves
        self._loop = self._follower()
        self._dead, self._nothing = np.zeros(size, np.uint8), np.zeros(size, np.float32)
        beyond = [taxel for taxel in calibration.dead if not 0 <= taxel < size]
        if beyond:
            raise ConfigError(f"dead names taxel {beyond[0]}: the array has 0 to {size - 1}")
        self._dead[list(calibration.dead)] = DEAD
        self.faulty = np.zeros(size, np.uint8)  # FAULTY where the service has found that a taxel does not work

    @property
    def dead(self) -> NDArray[np.bool_]:
        """(N,) taxels that do not work by configuration."""
        return self._dead > 0

    def noise_kpa(self, counts: NDArray[np.floating]) -> NDArray[np.float64]:
        """Noise (N,) in kPa, by the gains, of noise (N,) in counts."""
        return np.asarray(np.abs(self._gain) * counts, float)

    @property
    def no_load(self) -> NDArray[np.float32]:
        """Counts of each taxel (N,) without a load; a copy."""
        return self._no_load.copy()

    def tare(self, counts: NDArray[np.float64], measured: bool = True) -> None:
        """Take `counts` (N,), a mean over frames of the unloaded array, as no load; NaN keeps the taxel's own.

        They are not `measured` where they are only configured.
        """
        self._no_load = self._zero = np.where(np.isfinite(counts), counts, self._no_load).astype(np.float32)
        self.tares, self.measured = self.tares + 1, measured
        self._loop = self._follower()

    def drift(self, counts: NDArray[np.float32]) -> None:
        """Add `counts` (N,) to the zeros of the last tare."""
        self._zero = self._no_load + counts

    def _follower(self) -> LoopFollower | None:
        """The hysteresis from no load on; None where there is no model of it."""
        curves = self.calibration.curves
        return None if curves is None or curves.loop is None else LoopFollower(curves.loop, curves.end)

    def follow(self, counts: Counts, flags: NDArray[np.uint8]) -> None:
        """Take a frame's counts (N,) into the hysteresis; unknown taxels keep theirs."""
        if self._loop is not None:
            over = counts.astype(np.float32) - self._zero
            over[flags & UNKNOWN > 0] = np.nan
            self._loop.follow(over)

    @property
    def past(self) -> NDArray[np.float32] | None:
        """What the hysteresis knows of the frames before; None where there is no model of it."""
        return None if self._loop is None else self._loop.state

    def resume(self, past: NDArray[np.float32] | None) -> None:
        """Go on from a `past` of the same array."""
        if self._loop is not None and past is not None:
            self._loop.resume(past)

    def take_over(self, other: "Calibrator") -> None:
        """Go on from what `other`, of the same array and another calibration, knows of the taxels."""
        self.faulty = other.faulty
        self.resume(other.past)

    def series(self, counts: Counts, flags: NDArray[np.uint8]) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
        """Pressure and flags (T, N) of frames in their order, the first one after no load; changes no state."""
        follower = self._follower()
        if follower is None:
            return self._calibrated(counts, flags, self._nothing)
        over = counts.astype(np.float32) - self._zero
        over[flags & UNKNOWN > 0] = np.nan
        added = (follower.follow(each) for each in over)
        each = (self._calibrated(*one) for one in zip(counts[:, None], flags[:, None], added, strict=True))
        pressure, out = zip(*each, strict=True)
        return np.concatenate(pressure), np.concatenate(out)

    def pressure(self, counts: NDArray[np.number]) -> NDArray[np.float32]:
        """Pressure (..., N) in kPa of counts (..., N), whatever the taxel's state."""
        return self._kpa(counts.astype(np.float32) - self._zero + self._added)

    @property
    def _added(self) -> NDArray[np.float32]:
        """Counts (N,) that the hysteresis adds to those of the newest frame."""
        return self._nothing if self._loop is None else self._loop.added

    def _kpa(self, over: NDArray[np.float32]) -> NDArray[np.float32]:
        return over * self._gain if self._curves is None else self._curves.pressure(over).astype(np.float32)

    def __call__(self, counts: Counts, flags: NDArray[np.uint8]) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
        """Pressure (N,) in kPa, NaN for an unknown taxel; the flags with DEAD, SATURATED, OUT_OF_RANGE added."""
        pressure, out = self._calibrated(counts[None], flags[None], self._added)
        return pressure[0], out[0]

    def _calibrated(
        self, counts: Counts, flags: NDArray[np.uint8], added: NDArray[np.float32]
    ) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
        """Pressure and flags (T, N) of frames, to whose counts over the zeros the same is `added` (N,)."""
        read, saturation = np.ascontiguousarray(counts, np.float32), self.calibration.saturation
        pressure, out = np.empty_like(read), np.empty(read.shape, np.uint8)
        of_taxels = self._dead | self.faulty, self._zero, self._gain, np.asarray(added, np.float32)
        ceiling = np.nan if saturation is None else saturation
        known = np.ascontiguousarray(flags, np.uint8)
        readings.calibrate(read, known, *of_taxels, ceiling, UNKNOWN, SATURATED, pressure, out)
        if self.calibration.curves is not None:
            over, unknown = read - self._zero, out & UNKNOWN > 0
            beyond = self.calibration.curves.out_of_range(over)
            out |= np.where(beyond & ~unknown, OUT_OF_RANGE, 0).astype(np.uint8)
            if self._curves is not None:
                pressure = self._kpa(over + added)
                pressure[unknown] = np.nan
        return pressure, out
