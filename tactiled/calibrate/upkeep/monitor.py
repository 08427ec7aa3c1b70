"""What a skin finds out about its own taxels while it runs: noise, drift, faults, creep."""

from collections import deque
from dataclasses import dataclass
from operator import call

import numpy as np

from tactiled.arrays import Flags, Floats, Floats32
from tactiled.calibrate.counts.calibration import Calibration, Calibrator
from tactiled.calibrate.upkeep.blocks import Blocks, TaxelNoise
from tactiled.calibrate.upkeep.creep import Creep, CreepMeter
from tactiled.calibrate.upkeep.drift import DriftTracker, reach_mm
from tactiled.calibrate.upkeep.health import LOADED, LOADED_SIGMAS, UNRELATED, Change, Fault, TaxelHealth
from tactiled.calibrate.upkeep.map_monitor import MapMonitor
from tactiled.calibrate.upkeep.neighbourhood import Neighbourhood, Start
from tactiled.cover.kernel import Kernel
from tactiled.frames import BAD, FAULTY, MISSING, RawFrame
from tactiled.geometry import Array


@dataclass(frozen=True, slots=True, eq=False)
class SkinState:
    """What is known of N taxels now; none of it changes any more."""

    faults: Flags  # (N,) of Fault
    since_s: Floats  # (N,) time of the frame from which a taxel has been in its state; NaN: the start
    noise_counts: Floats  # (N,) standard deviation, NaN: unknown
    drift_counts: Floats32 | None  # (N,) by which the zeros have moved since they were measured
    drift_states: Flags | None  # (N,) of DriftState; None, both: drift is not tracked
    creep: Creep | None


class SkinMonitor:
    """Follows drifting zeros and failing taxels of one array, and corrects its calibrator."""

    def __init__(
        self,
        array: Array,
        kernel: Kernel,
        calibration: Calibration,
        ends: tuple[float, float],
        full_scale: int,
        start: Start = call,
    ) -> None:
        """`ends` and `full_scale` are the codec's; `start` runs what takes longer than a frame."""
        gain = calibration.kpa_per_count
        empty, top = ends if gain > 0 else ends[::-1]
        ceiling = top if calibration.saturation is None else calibration.saturation
        span = abs(ceiling - calibration.no_load) if np.isfinite(ceiling) else full_scale
        scale = abs(ceiling - empty) if np.isfinite((ceiling, empty)).all() else span
        self._per_count = abs(gain)
        self._blocks, self._noise, self._creep = Blocks(array.size), TaxelNoise(array.size), CreepMeter()
        self._configured_noise = np.nan if calibration.noise_counts is None else calibration.noise_counts
        neighbourhood, calibrated = Neighbourhood(kernel, array, start), calibration.curves is not None
        self._health = TaxelHealth(array, neighbourhood, (empty, ceiling), scale, calibrated)
        self.map = MapMonitor(array)
        self._drift: DriftTracker | None = None
        if calibration.track_drift:
            self._drift = DriftTracker(array, reach_mm(kernel), span, float(np.sign(gain)), neighbourhood)
        self._tares = 0  # times that the calibrator's zeros had been set when they were taken over
        self._tracks = False  # whether they were measured
        self._changes: deque[Change] = deque(maxlen=array.size)

    def observe(self, frame: RawFrame, calibrator: Calibrator) -> bool:
        """Take a frame; now and then correct the calibrator, and say so."""
        if self._tares != calibrator.tares:
            self._restart(calibrator)
        if self.map.due(frame.time):
            load = calibrator.pressure(frame.counts) / np.float32(self._per_count)
            unknown = frame.flags & (MISSING | BAD) > 0
            unread = unknown | calibrator.dead | UNRELATED[self._health.faults]
            self.map.observe(frame.time, np.where(unread, np.float32(0), load), self._noise.sigma)
        block = self._blocks.collect(frame.time, frame.counts, frame.flags)
        if block is None:
            return False
        load = calibrator.pressure(block.mean) / np.float32(self._per_count)
        self._noise.update(block, load)
        sigma = self._noise.sigma
        configured = ~calibrator.dead
        swapped, measured = self.map.swapped, calibrator.measured
        self._changes.extend(self._health.update(block, self._noise, load, configured, swapped, measured))
        healthy = configured & (self._health.faults == Fault.HEALTHY)
        calibrator.faulty = np.where(self._health.faults > 0, FAULTY, 0).astype(np.uint8)
        loaded = healthy & (load > np.maximum(LOADED_SIGMAS * sigma, LOADED * self._health.full_scale))
        self._creep.update(block.time_s, load, loaded)
        if self._drift is not None and self._tracks:
            self._drift.update(block, sigma, healthy, frame.references)
            calibrator.drift(self._drift.correction)
        return True

    def take_over(self, other: "SkinMonitor", calibrator: Calibrator) -> None:
        """Go on from what `other`, of the same array and another calibration, knows of the taxels.

        The drift of zeros that the calibrator still has goes on, too.
        """
        self._noise, self._changes, self.map = other._noise, other._changes, other.map
        self._health.take_over(other._health)
        self._restart(calibrator)
        if self._drift is not None and other._drift is not None and other._tracks and self._tracks:
            self._drift.take_over(other._drift, calibrator.no_load)
            calibrator.drift(self._drift.correction)

    def _restart(self, calibrator: Calibrator) -> None:
        """Take the zeros just set."""
        self._blocks.restart()
        self._tares, self._tracks = calibrator.tares, calibrator.measured
        if self._drift is not None:
            self._drift.reset(calibrator.no_load)

    @property
    def noise_counts(self) -> Floats:
        """(N,) each taxel's standard deviation as measured, else as calibrated; NaN: unknown."""
        return np.where(self._noise.reliable, self._noise.sigma, self._configured_noise)

    @property
    def creep(self) -> Creep | None:
        """Of the load that lies now, once it is measured."""
        return self._creep.creep

    def drain_changes(self) -> list[Change]:
        """Changes of taxels' states since the last call; any thread."""
        return [self._changes.popleft() for _ in range(len(self._changes))]

    @property
    def state(self) -> SkinState:
        """What is known now."""
        drift = self._drift if self._tracks else None
        return SkinState(
            faults=self._health.faults.copy(),
            since_s=self._health.since_s.copy(),
            noise_counts=self.noise_counts,
            drift_counts=None if drift is None else drift.correction,
            drift_states=None if drift is None else drift.state.copy(),
            creep=self.creep,
        )
