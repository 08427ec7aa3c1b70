"""One sensor's way from counts to the restored image: calibrate, restore, check."""

from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from math import inf
from operator import call
from threading import Lock
from time import monotonic, thread_time
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from tactiled.build import SensorPlan
from tactiled.calibrate.calibration import Calibrator
from tactiled.calibrate.monitor import SkinMonitor
from tactiled.calibrate.tare import Zero, below_zero, blocks, load_description, own_noise, robust_mean
from tactiled.contacts.felt import shares, unknown_cells
from tactiled.diagnostics.checks import FrameChecks
from tactiled.diagnostics.warning_codes import WarningCode, warning
from tactiled.frames import BELOW_ZERO, FLAG_BITS, UNKNOWN, FrameWarning, Image, RawFrame, StageTimes
from tactiled.geometry import tiling
from tactiled.restore.methods import NO_DATA, Restorer, make, require
from tactiled.restore.noise import estimate, noise_ratio
from tactiled.restore.scene import Restored, never
from tactiled.runtime.cover_monitor import CoverMonitor
from tactiled.runtime.noise import Noise
from tactiled.runtime.tare_frames import TARE_FRAMES, TareFrames
from tactiled.runtime.thickness_search import Start, ThicknessSearch
from tactiled.units import N_PER_KPA_MM2

FLAG_CODES = {cast(WarningCode, name.lower()): flag for name, flag in FLAG_BITS.items()}


class Pipeline:
    """Turns the raw frames of one array into images, one after the other, on one thread.

    `set_method`, `tare` and `lapse_tare` may be called from any thread and take effect with the next frame;
    `load_description`, `deviation` and `forces` may be called from any thread, too; the rest between two frames.
    """

    def __init__(self, plan: SensorPlan, before: "Pipeline | None" = None, start: Start = call) -> None:
        """`before` is the present pipeline of the same array: its method and noise are kept at first.

        `start` runs what takes longer than a frame: on a thread, or at once, for the same warnings in every run.
        """
        self._plan = plan
        size = plan.array.size
        self.calibrator = Calibrator(plan.calibration, size)
        codec = plan.codec
        self.monitor = SkinMonitor(plan.array, plan.kernel, plan.calibration, codec.ends, codec.full_scale, start)
        self.noise: Noise = Noise(plan.calibration, plan.unit, before.noise if before else None)
        self._tare_frames = TareFrames()
        self.zero = Zero(self.calibrator.no_load, np.full((2, size), np.nan, np.float32))  # of the unloaded array
        self._zero_before: Zero | None = None  # the last tare
        self._highest = 0.0  # reading since this zero
        self._recent: tuple[NDArray[np.float32], ...] = ()  # raw images since the last tare, or break
        self.tared = self.lapsed = self.refused = 0  # times that a tare was done, given up, or met a load
        self.load_in_tare = ""  # in words: what the last refused tare met
        self._checks = FrameChecks(plan.blur, plan.calibration.floor_kpa)
        self._thickness = ThicknessSearch(plan, start)
        self.cover = CoverMonitor(plan)
        self.method: str = before.method if before else plan.method
        self._noise_ratio: NDArray[np.float64] | None = None  # (N,) of each taxel to `noise`; None: none is noisy
        self._restorer = self._make_restorer()
        self._weigh_taxels()
        self._deviation: tuple[tuple[str, float], Restorer] | None = None  # of a method and a noise
        self._deviation_lock = Lock()

    def set_method(self, name: str) -> None:
        """Restore the next frames by `name`; ConfigError if there is no such method."""
        require(name)
        self.method = name

    def tare(self, time: float, force: bool = False) -> None:
        """Take the mean of the next frames as the unloaded array, at `time` (s, Unix).

        A load that comes meanwhile, or readings that move, end it, unless it is by `force`.
        """
        self._tare_frames.start(time, force)

    def load_description(self) -> str:
        """Description of the load in the newest frames; "" for none."""
        return load_description(self._recent, self.noise.kpa, self._plan.unit)

    def lapse_tare(self) -> None:
        """Give up a tare that does not have all of its frames yet; `lapsed` counts it."""
        self._recent = ()
        if self._tare_frames.stop():
            self.lapsed += 1

    @property
    def can_undo(self) -> bool:
        """Whether a tare is under way, or there is a zero from before the last one."""
        return self._tare_frames.under_way or self._zero_before is not None

    def set_zero(self, zero: Zero) -> None:
        """Take another zero; `undo_tare` takes the present one again."""
        self._zero_before, self.zero = self.zero, zero
        self._use_zero()

    def undo_tare(self) -> None:
        """Give up a tare under way, else take the zero from before the last one again, if there is one."""
        if not self._tare_frames.stop() and self._zero_before is not None:
            self.zero, self._zero_before = self._zero_before, None
            self._use_zero()

    def _use_zero(self) -> None:
        measured = self.zero.time is not None or self._plan.calibration.no_loads is not None
        self.calibrator.tare(self.zero.counts.astype(float), measured)
        self._recent, self._highest = (), 0.0
        self.cover.reset()

    def take_over(self, other: "Pipeline") -> None:
        """Go on from where `other`, of the same array and another calibration, is: method, zero, tare under way.

        Its tare is kept unless the calibration's no load is newer, and with it the zero from before.
        """
        self.method, self._tare_frames = other.method, other._tare_frames
        self.tared, self.lapsed, self.refused = other.tared, other.lapsed, other.refused
        self.load_in_tare, zero, before = other.load_in_tare, self._unless_older(other.zero), other._zero_before
        if zero is other.zero and before is not None:
            self._zero_before = self._unless_older(before)
        self.zero = zero
        self._use_zero()
        self.calibrator.take_over(other.calibrator)
        self.monitor.take_over(other.monitor, self.calibrator)
        self._weigh_taxels()

    def _unless_older(self, zero: Zero) -> Zero:
        """A zero of another calibration; with the counts of this one where it was not tared since that."""
        tared = zero.time is not None and zero.time >= self._plan.no_load_time
        return zero if tared else replace(self.zero, shear=zero.shear)

    def deviation(self, image: Image) -> NDArray[np.float32]:
        """Standard deviation of every cell of `image.restored`, in its unit, this pipeline's newest."""
        wanted_by = self._made_for[0], image.noise
        with self._deviation_lock:
            if self._deviation is None or self._deviation[0] != wanted_by:
                self._deviation = wanted_by, make(wanted_by[0], self._plan.blur, wanted_by[1])
            restorer = self._deviation[1]
            restorer.weigh(self._noise_ratio)
            restorer(image.raw, image.flags)
            return np.where(np.isnan(image.restored), np.nan, restorer.deviation()).astype(np.float32)

    def forces(self, frame: RawFrame) -> NDArray[np.float64] | None:
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
    def _areas(self) -> NDArray[np.float64]:
        """(N,) mm^2 of the surface that each taxel stands for."""
        return tiling(self._plan.array).areas

    def _make_restorer(self) -> Restorer:
        self._made_for = self.method, self.noise.kpa
        restorer = make(self._made_for[0], self._plan.blur, self._made_for[1], self._noise_ratio)
        restorer.prepare()
        return restorer

    def _weigh_taxels(self) -> None:
        """Weight noisy taxels by their noise, where it is known."""
        noise_kpa = self.calibrator.noise_kpa(self.monitor.noise_counts)
        ratio = noise_ratio(noise_kpa, self.noise.kpa, self._noise_ratio)
        if ratio is not self._noise_ratio:
            self._noise_ratio = ratio
            self._restorer.weigh(ratio)

    def process(self, frame: RawFrame, budget_s: float = inf, came: tuple[float, float] | None = None) -> Image:
        """Image of one frame; every doubt about it is NaN, a flag or a warning.

        Restoring it ends after `budget_s` of processor time with the best image until then, where its method can.
        `came` is when it arrived and was assembled (s, monotonic); None: now.
        """
        began = monotonic()
        last_message, assembled = came or (began, began)
        self._apply_tare(frame)
        self.calibrator.follow(frame.counts, frame.flags)
        if self.monitor.push(frame, self.calibrator):
            self._weigh_taxels()
        shape = self._plan.array.frame_shape
        pressure, taxel_flags = self.calibrator(frame.counts, frame.flags)
        raw, flags = pressure.reshape(shape), taxel_flags.reshape(shape)
        self.noise.add(raw)
        if self.noise.settled:
            self._highest = max(self._highest, float(np.fmax.reduce(pressure)))
            flags = flags | np.where(below_zero(raw, self.noise.kpa, self._highest), BELOW_ZERO, np.uint8(0))
        self._recent = (*self._recent, raw)[-TARE_FRAMES:]
        if self._made_for != (self.method, self.noise.kpa):
            self._restorer = self._make_restorer()
        calibrated = monotonic()
        done = restore_frame(self._restorer, raw, flags, Deadline(budget_s))
        restored = monotonic()
        warnings = self._check(raw, flags, done, budget_s)
        checked = monotonic()
        times = StageTimes(
            last_message - frame.skew, last_message, assembled, began, calibrated, restored, checked
        )
        return make_image(
            self._plan,
            frame,
            done,
            raw=raw,
            flags=flags,
            microseconds=(checked - began) * 1e6,
            noise=self.noise.kpa,
            warnings=warnings,
            shear=without_zero(frame.shear, self.zero.shear, flags),
            times=times,
        )

    def _check(
        self, raw: NDArray[np.float32], flags: NDArray[np.uint8], done: Restored, budget_s: float
    ) -> tuple[FrameWarning, ...]:
        """Warnings of an image."""
        doubtful = flags if self._noise_ratio is None else flags | (self._noise_ratio > 1).reshape(flags.shape)
        checked = self._checks(raw, doubtful, done.image, self.noise.kpa, done.method, self._restorer.predicted)
        if done.cut_short:
            checked = (*checked, warning("cut_short", budget_ms=1e3 * budget_s))
        checked = self._thickness(checked, raw, doubtful, self.noise.kpa)
        self.cover.push(raw, doubtful, self.noise.kpa if self.noise.settled else np.inf)
        of_skin = self._plan.warnings + self.noise.warning + flag_warnings(flags) + self._map_warning()
        return of_skin + checked + self.cover.warning

    def _map_warning(self) -> tuple[FrameWarning, ...]:
        wrong = self.monitor.map.wrong
        return (warning("wrong_map", wrong=", ".join(wrong)),) if wrong else ()

    def _apply_tare(self, frame: RawFrame) -> None:
        """Add a frame to a tare under way; apply its zero once it is complete, unless there was a load."""
        frames = self._tare_frames.add(frame)
        if frames is None:
            return
        if load := "" if self._tare_frames.force else self._load_during(frames[:, 0]):
            self.refused, self.load_in_tare = self.refused + 1, load
            return
        mean, zero = robust_mean(frames).astype(np.float32), self.zero
        counts = np.where(np.isfinite(mean[0]), mean[0], zero.counts)
        shear = np.where(np.isfinite(mean[1:]), mean[1:], zero.shear) if len(mean) > 1 else zero.shear
        self.set_zero(Zero(counts, shear, self._tare_frames.time))
        self.tared += 1

    def _load_during(self, counts: NDArray[np.float32]) -> str:
        """A load in frames (T, N) of a tare, in words, or readings that move; "" for neither."""
        pressure, noise = self.calibrator.pressure(counts), self.noise.kpa
        if not self.noise.settled:
            noise = max(noise, estimate(pressure))
        means = [self.calibrator.pressure(each) for each in blocks(counts)]
        return load_description(means, noise, self._plan.unit, own_noise(pressure, noise))


class Deadline:
    """Whether a thread's processor time for an image is over.

    It is so before a step that would end too late if it took as long as the one before.
    """

    def __init__(self, budget_s: float) -> None:
        self._last = thread_time()
        self._end = self._last + budget_s

    def __call__(self) -> bool:
        """Whether to stop now; asked before every step."""
        now = thread_time()
        step, self._last = now - self._last, now
        return now + step > self._end


def make_image(plan: SensorPlan, frame: RawFrame, done: Restored, **others: Any) -> Image:
    """The image of a frame as it was restored; `others` are the fields that neither of them has."""
    restored, flags = done.image.copy(), others["flags"]
    share = shares(flags, plan.blur)
    if share is not None:
        restored[unknown_cells(flags, plan.blur, share)] = np.nan
    return Image(
        sensor=plan.name,
        sequence=frame.sequence,
        time=frame.time,
        restored=restored,
        shares=share,
        method=done.method,
        why=done.why,
        iterations=done.iterations,
        noise_gain=done.noise_gain,
        resolution_mm=done.resolution_mm,
        loss=frame.loss,
        arrived=frame.arrived,
        unit=plan.unit,
        calibration=plan.calibration_id,
        **others,
    )


def without_zero(
    shear: NDArray[np.float32] | None, zero: NDArray[np.float32], flags: NDArray[np.uint8]
) -> NDArray[np.float32] | None:
    """Shear in counts (2, ...), less a tare's `zero` (2, N); NaN where it is unknown, as in the raw image."""
    if shear is None:
        return None
    tared = shear - np.nan_to_num(zero)
    tared[:, flags.ravel() & UNKNOWN > 0] = np.nan
    return tared.reshape((2, *flags.shape))


def restore_frame(
    restorer: Restorer, raw: NDArray[np.float32], flags: NDArray[np.uint8], expired: Callable[[], bool] = never
) -> Restored:
    """Restore a frame; what is far below zero counts as no pressure."""
    below = flags & BELOW_ZERO > 0
    if not below.any():
        return restorer(raw, flags, expired)
    return restorer(np.where(below, np.float32(0), raw), flags & ~np.uint8(BELOW_ZERO), expired)


def flag_warnings(flags: NDArray[np.uint8]) -> tuple[FrameWarning, ...]:
    """A warning for each flag that some taxels have."""
    if not flags.any():
        return ()
    instead = {} if (flags & UNKNOWN == 0).any() else {"instead": NO_DATA}
    counts = ((code, int(np.count_nonzero(flags & flag))) for code, flag in FLAG_CODES.items())
    return tuple(warning(code, count, **instead) for code, count in counts if count)
