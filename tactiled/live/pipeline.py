"""One sensor's way from counts to the restored image: calibrate, restore, check."""

from collections import deque
from dataclasses import replace
from functools import cached_property
from math import inf
from operator import call
from time import monotonic

import numpy as np

from tactiled.arrays import Flags, Floats, Floats32
from tactiled.build import SensorPlan
from tactiled.calibrate.counts.tare import Zero, blocks, load_description, own_noise, reads_below, robust_mean
from tactiled.calibrate.upkeep.monitor import SkinMonitor
from tactiled.chain import Chain, flag_warnings
from tactiled.core import readings
from tactiled.diagnostics.warning_codes import warning
from tactiled.frames import FrameWarning, RawFrame, SensorImage, StageTimes
from tactiled.geometry import tiling
from tactiled.live.budget import Deadline
from tactiled.live.cover_monitor import CoverMonitor
from tactiled.live.noise import Noise
from tactiled.live.tare import TARE_FRAMES, Tare
from tactiled.live.thickness_search import Start, ThicknessSearch
from tactiled.restore.methods import named
from tactiled.restore.noise import estimate
from tactiled.restore.scene import Restored, never
from tactiled.units import N_PER_KPA_MM2


class Pipeline:
    """Turns the raw frames of one array into images, one after the other, on one thread.

    `set_method`, `tare` and `lapse_tare` may be called from any thread and take effect with the next frame;
    `load_description`, `load_during`, `deviation`, `surface` and `forces` may be called from any thread, too; the
    rest between two frames.
    """

    def __init__(self, plan: SensorPlan, before: "Pipeline | None" = None, start: Start = call) -> None:
        """`before` is the present pipeline of the same array: its method and noise are kept at first.

        `start` runs what takes longer than a frame: on a thread, or at once, for the same warnings in every run.
        """
        self._plan = plan
        self.noise: Noise = Noise(plan.calibration, plan.unit, before.noise if before else None, plan.codec.rounds)
        self._chain = Chain(plan, self.noise.kpa)
        self.calibrator = self._chain.calibrator
        self.deviation, self.surface = self._chain.deviation, self._chain.surface
        codec = plan.codec
        self.monitor = SkinMonitor(plan.array, plan.kernel, plan.calibration, codec.ends, codec.full_scale, start)
        self.tares = Tare()
        self.zero = Zero(self.calibrator.no_load, self._chain.shear_zero)  # of the unloaded array
        self._zero_before: Zero | None = None  # the last tare
        self._highest = 0.0  # reading since this zero
        self._recent = deque[Floats32](maxlen=TARE_FRAMES)  # raw images since the last tare, or break
        self._thickness = ThicknessSearch(plan, start)
        self.cover = CoverMonitor(plan)
        self.method: str = before.method if before else plan.method
        self._chain.prepare(self.method)

    def set_method(self, name: str) -> None:
        """Restore the next frames by `name`; ConfigError if there is no such method."""
        self.method = named(name)

    def tare(self, time: float, force: bool = False) -> None:
        """Take the mean of the next frames as the unloaded array, at `time` (s, Unix).

        A load that comes meanwhile, or readings that move, end it, unless it is by `force`.
        """
        self.tares.request(time, force)

    def settle(self, noise: float | None, shear_rest: Floats | None) -> None:
        """Take a recording's noise (None: as configured), and its shear (2, N) without a load, if it is known."""
        if noise is not None:
            self.noise.settle(noise)
        self._chain.shear_rest = shear_rest

    def load_description(self) -> str:
        """Description of the load in the newest frames; "" for none."""
        return load_description(tuple(self._recent), self.noise.kpa, self._plan.unit)

    def lapse_tare(self) -> None:
        """Give up a tare that does not have all of its frames yet."""
        self._recent.clear()
        self.tares.stop("break")

    @property
    def can_undo(self) -> bool:
        """Whether a tare is under way, or there is a zero from before the last one."""
        return self.tares.under_way or self._zero_before is not None

    def set_zero(self, zero: Zero) -> None:
        """Take another zero; `undo_tare` takes the present one again."""
        self._zero_before, self.zero = self.zero, zero
        self._use_zero()

    def undo_tare(self) -> None:
        """Give up a tare under way, else take the zero from before the last one again, if there is one."""
        if not self.tares.stop("undo") and self._zero_before is not None:
            self.zero, self._zero_before = self._zero_before, None
            self._use_zero()

    def _use_zero(self) -> None:
        self._chain.tare(self.zero, self.zero.time is not None or self._plan.calibration.no_loads is not None)
        self._recent.clear()
        self._highest = 0.0
        self.cover.reset()

    def take_over(self, other: "Pipeline") -> None:
        """Go on from where `other`, of the same array and another calibration, is: method, zero, tare under way.

        Its tare is kept unless the calibration's no load is newer, and with it the zero from before.
        """
        self.method, self.tares = other.method, other.tares
        zero, before = self._unless_older(other.zero), other._zero_before
        if zero is other.zero and before is not None:
            self._zero_before = self._unless_older(before)
        self.zero = zero
        self._use_zero()
        self.calibrator.take_over(other.calibrator)
        self.monitor.take_over(other.monitor, self.calibrator)
        self._chain.weigh(self.monitor.noise_counts)

    def _unless_older(self, zero: Zero) -> Zero:
        """A zero of another calibration; with the counts of this one where it was not tared since that."""
        tared = zero.time is not None and zero.time >= self._plan.no_load_time
        return zero if tared else replace(self.zero, shear=zero.shear)

    def forces(self, frame: RawFrame) -> Floats | None:
        """Force (N, 3) in N on each taxel, along x and y and into the skin, as sensed; None unless all are known.

        They are unknown where shear has no scale or has not been tared, or where a taxel does not work; of a
        saturated one it is the least that it can be.
        """
        scale = self._plan.calibration.shear_n_per_count
        if scale is None or frame.shear is None or not self._plan.calibrated:
            return None
        pressure, _ = self.calibrator(frame.counts, frame.flags)
        tangential = (frame.shear - self.zero.shear) * scale
        forces = np.column_stack([*tangential, pressure * self._areas * N_PER_KPA_MM2])
        return forces if np.isfinite(forces).all() else None

    @cached_property
    def _areas(self) -> Floats:
        """(N,) mm^2 of the surface that each taxel stands for."""
        return tiling(self._plan.array).areas

    def process(
        self, frame: RawFrame, budget_s: float = inf, came: tuple[float, float] | None = None
    ) -> SensorImage:
        """SensorImage of one frame; every doubt about it is NaN, a flag or a warning.

        Restoring it ends after `budget_s` of processor time with the best image until then, where its method can.
        `came` is when it arrived and was assembled (s, monotonic); None: now.
        """
        began = monotonic()
        last_message, assembled = came or (began, began)
        self._apply_tare(frame)
        chain = self._chain
        chain.follow(frame.counts, frame.flags)
        if self.monitor.observe(frame, self.calibrator):
            chain.weigh(self.monitor.noise_counts)
        raw, flags = chain.pressure(frame)
        self.noise.learn(raw)
        chain.noise = self.noise.kpa
        if self.noise.settled:
            lowest, highest, _ = readings.look(raw.reshape(-1))
            self._highest = max(self._highest, highest)
            if reads_below(lowest, chain.noise):
                flags = chain.with_below_zero(raw, flags, self._highest)
        self._recent.append(raw)
        chain.prepare(self.method)
        calibrated = monotonic()
        done = chain.restore(raw, flags, self.method, Deadline(budget_s) if budget_s < inf else never, frame)
        restored = monotonic()
        warnings = self._check(raw, flags, done, budget_s)
        checked = monotonic()
        times = StageTimes(
            last_message - frame.skew, last_message, assembled, began, calibrated, restored, checked
        )
        microseconds = (checked - began) * 1e6
        return chain.image(frame, raw, flags, done, microseconds=microseconds, warnings=warnings, times=times)

    def _check(self, raw: Floats32, flags: Flags, done: Restored, budget_s: float) -> tuple[FrameWarning, ...]:
        """Warnings of an image."""
        raw, doubtful = self._chain.sheared_off(raw), self._chain.doubtful(flags)
        checked = self._chain.warnings(raw, doubtful, done)
        if done.cut_short:
            checked = (*checked, warning("cut_short", budget_ms=1e3 * budget_s))
        checked = self._thickness(checked, raw, doubtful, self.noise.kpa)
        self.cover.observe(raw, doubtful, self.noise.kpa if self.noise.settled else np.inf)
        wrong = self.monitor.map.wrong
        of_map = (warning("wrong_map", wrong=", ".join(wrong)),) if wrong else ()
        of_skin = self._plan.warnings + self.noise.warning + flag_warnings(flags)
        return of_skin + of_map + checked + self.cover.warning

    def _apply_tare(self, frame: RawFrame) -> None:
        """Add a frame to a tare under way; apply its zero once it is complete, unless there was a load."""
        frames = self.tares.collect(frame)
        if frames is None:
            return
        if load := "" if self.tares.force else self.load_during(frames[:, 0]):
            self.tares.finish(load)
            return
        mean, zero = robust_mean(frames).astype(np.float32), self.zero
        counts = np.where(np.isfinite(mean[0]), mean[0], zero.counts)
        shear = np.where(np.isfinite(mean[1:]), mean[1:], zero.shear) if len(mean) > 1 else zero.shear
        self.set_zero(Zero(counts, shear, self.tares.time))
        self.tares.finish("")

    def load_during(self, counts: Floats32) -> str:
        """A load in some frames' counts (T, N), in words, or readings that move; "" for neither."""
        pressure, noise = self.calibrator.pressure(counts), self.noise.kpa
        if not self.noise.settled:
            noise = max(noise, estimate(pressure))
        means = [self.calibrator.pressure(each) for each in blocks(counts)]
        return load_description(means, noise, self._plan.unit, own_noise(pressure, noise))
