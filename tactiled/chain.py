"""The way of a frame from counts to its image: live, in playback, in exports and from files of frames."""

from collections.abc import Callable
from functools import cached_property, lru_cache
from threading import Lock
from typing import Any, cast

import numpy as np

from tactiled.arrays import Flags, Floats, Floats32, Reals
from tactiled.build import SensorPlan
from tactiled.calibrate.counts.calibration import Calibrator
from tactiled.calibrate.counts.tare import Zero, below_zero
from tactiled.contacts.felt import shares, unknown_cells
from tactiled.diagnostics.checks import FrameChecks
from tactiled.diagnostics.warning_codes import WarningCode, warning
from tactiled.frames import BELOW_ZERO, FLAG_BITS, SATURATED, UNKNOWN, FrameWarning, RawFrame, SensorImage
from tactiled.restore.methods import NO_DATA, Restorer, make
from tactiled.restore.noise import noise_ratio
from tactiled.restore.scene import Restored, never
from tactiled.restore.traction import Load, Traction

FLAG_CODES = {cast(WarningCode, name.lower()): flag for name, flag in FLAG_BITS.items()}


class Chain:
    """Calibrates, restores and checks the frames of one array, one after the other, on one thread.

    A frame goes through `follow` (hysteresis), `pressure` (counts to kPa), `with_below_zero` (of a wrong zero),
    `restore` (without blur), `warnings` or `check` (of image against frame), and `image`. In between the live
    pipeline measures zeros and noise, and playback goes back; frames in kPa need `restore` and `known` alone.
    """

    def __init__(self, plan: SensorPlan, noise: float) -> None:
        """`noise` is a taxel's standard deviation, in the plan's unit; it may be set anew between two frames."""
        self.plan, self.noise = plan, noise
        self.calibrator = Calibrator(plan.calibration, plan.array.size)
        self.follow = self.calibrator.follow
        self.shear_zero = np.full((2, plan.array.size), np.nan, np.float32)  # counts; NaN: not tared
        self.shear_rest: Floats | None = None  # the same of a recording that has no tare; None: not measured
        self.noise_ratio: Floats | None = None  # (N,) of each taxel to `noise`; None: none is noisy
        self._checks = FrameChecks(plan.blur, plan.calibration.floor_kpa)
        self._restorers: dict[tuple[str, float], Restorer] = {}  # of a method and a noise
        self._restorer: Restorer  # of the newest frame
        self._method = plan.method  # of the newest frame
        self._traction = Traction(plan.coupled) if plan.coupled else None
        self._load: Load | None = None  # tangential, under the newest frame's image
        self._deviation: tuple[tuple[str, float], Restorer] | None = None
        self._deviation_lock = Lock()
        if plan.calibration.noise_counts is not None:
            self.weigh(plan.calibration.noise_counts)

    def tare(self, zero: Zero, measured: bool = True) -> None:
        """Take what the unloaded array reads; it is not `measured` where it is only configured."""
        self.calibrator.tare(zero.counts.astype(float), measured)
        self.shear_zero = zero.shear

    def weigh(self, noise_counts: Floats) -> None:
        """Weight noisy taxels by their noise (N,) in counts; NaN: unknown."""
        ratio = noise_ratio(self.calibrator.noise_kpa(noise_counts), self.noise, self.noise_ratio)
        if ratio is not self.noise_ratio:
            self.noise_ratio = ratio
            for each in self._restorers.values():
                each.weigh(ratio)

    def prepare(self, method: str) -> None:
        """Make now what frames by this method need, so that none waits for it, and forget the other methods."""
        if (method, self.noise) not in self._restorers:
            self._restorers = {}
            self.restorer(method).prepare()

    def restorer(self, method: str) -> Restorer:
        """The restorer by a method, made where it is new; ConfigError for a method or noise that is none."""
        made_for = method, self.noise
        if made_for not in self._restorers:
            self._restorers[made_for] = make(method, self.plan.blur, self.noise, self.noise_ratio)
        self._restorer, self._method = self._restorers[made_for], method
        return self._restorer

    def pressure(self, frame: RawFrame) -> tuple[Floats32, Flags]:
        """Pressure of a frame in `unit`, NaN where it is unknown, and flags, both of the array's shape."""
        pressure, flags = self.calibrator(frame.counts, frame.flags)
        shape = self.plan.array.frame_shape
        return pressure.reshape(shape), flags.reshape(shape)

    def with_below_zero(self, raw: Floats32, flags: Flags, highest: float) -> Flags:
        """Flags, and BELOW_ZERO where the zero was taken under a load; `highest` was read since then."""
        below = below_zero(raw, self.noise, highest)
        return flags | np.where(below, BELOW_ZERO, np.uint8(0)) if np.count_nonzero(below) else flags

    def restore(
        self,
        raw: Floats32,
        flags: Flags,
        method: str,
        expired: Callable[[], bool] = never,
        frame: RawFrame | None = None,
    ) -> Restored:
        """Restore pressures; what is far below zero counts as none. The image has no NaN, until the next frame.

        Of a `frame` with shear whose scale is known, the tangential load is restored under that image, and then
        the pressures less what it adds to them, where that matters; not on skins that are not wide enough, nor by
        the raw image.
        """
        restorer, flagged = self.restorer(method), bool(np.count_nonzero(flags))
        if flagged and (flags & BELOW_ZERO).any():
            raw, flags = np.where(flags & BELOW_ZERO > 0, np.float32(0), raw), flags & ~np.uint8(BELOW_ZERO)
        done, self._load = restorer(raw, flags if flagged else None, expired), None
        sheared = None if frame is None else self._sheared(frame, raw, flags)
        if self._traction and sheared is not None:
            noise = self.noise * np.array([1, self._shear_noise, self._shear_noise])
            load = self._traction(restorer.surface, sheared, noise)
            added = np.zeros_like(load.pressure)
            if load.matters and self._traction.coupled.wide and method != "raw":
                added = load.pressure
                done = restorer(_less(raw, added), flags, expired)
                load = self._traction(restorer.surface, sheared, noise)
            load.pressure = added  # that the image is without
            self._load = load
        return done

    def _sheared(self, frame: RawFrame, raw: Floats32, flags: Flags) -> Floats | None:
        """Pressure and shear of a frame (3, N) in kPa, NaN where unknown; None where shear is not restored."""
        if self._traction is None or frame.shear is None:
            return None
        zero = self.shear_rest if np.isnan(self.shear_zero).all() else self.shear_zero
        if zero is None:
            return None
        shear = (frame.shear - zero) * self.plan.kpa_per_shear_count
        readings = np.concatenate([raw.reshape(1, -1), shear]).astype(float)
        readings[:, flags.ravel() & UNKNOWN > 0] = np.nan
        readings[0, flags.ravel() & SATURATED > 0] = np.nan
        return readings

    @cached_property
    def _shear_noise(self) -> float:
        """Noise of shear over that of pressure in kPa, where both have as much in counts."""
        per_count = self.calibrator.noise_kpa(np.ones(self.plan.array.size))
        return float(np.median(np.abs(self.plan.kpa_per_shear_count)) / np.median(per_count))

    def known(self, restored: Floats32, flags: Flags) -> tuple[Floats32, Floats32 | None]:
        """A copy of a restored image, NaN where no taxel feels it or lost ones leave it unknown; and `shares`."""
        image, share = restored.copy(), shares(flags, self.plan.blur)
        if self.plan.array.shape is None:
            image[self.plan.cells.taxel < 0] = np.nan
        if share is not None:
            image[unknown_cells(flags, self.plan.blur, share)] = np.nan
        return image, share

    def doubtful(self, flags: Flags) -> Flags:
        """Flags, not 0 for noisy taxels either."""
        return flags if self.noise_ratio is None else flags | (self.noise_ratio > 1).reshape(flags.shape)

    def sheared_off(self, raw: Floats32) -> Floats32:
        """Pressures less what the image restored last is without: what a tangential load adds to them."""
        return _less(raw, None if self._load is None else self._load.pressure)

    def warnings(self, raw: Floats32, doubtful: Flags, done: Restored) -> tuple[FrameWarning, ...]:
        """Compare the image restored last with its frame, now and then: what several frames in turn have shown.

        `raw` is without what a tangential load adds.
        """
        return self._checks(raw, doubtful, done.image, self.noise, done.method, self._restorer.predicted)

    def check(self, image: SensorImage) -> tuple[WarningCode, ...]:
        """Compare the image restored last, which has no unknown cell, with its frame: what this one shows."""
        doubtful, predict = self.doubtful(image.flags), self._restorer.predicted
        raw = _less(image.raw, image.tilt)
        return self._checks.check(raw, doubtful, image.restored, self.noise, image.method, predict)

    def image(self, frame: RawFrame, raw: Floats32, flags: Flags, done: Restored, **others: Any) -> SensorImage:
        """The image of a frame as it was restored; `others` are the fields that nothing here has."""
        (restored, share), load = self.known(done.image, flags), self._load
        loads: dict[str, Any] = {}
        if load is not None:
            unknown = np.isnan(restored)
            drawn = (np.where(unknown, np.float32(np.nan), each) for each in (load.traction, load.deviation))
            tilt = load.pressure.reshape(raw.shape).astype(np.float32)
            loads = dict(zip(("traction", "traction_deviation", "tilt"), (*drawn, tilt), strict=True))
        return SensorImage(
            sensor=self.plan.name,
            sequence=frame.sequence,
            time=frame.time,
            raw=raw,
            restored=restored,
            flags=flags,
            method=done.method,
            why=done.why,
            iterations=done.iterations,
            noise=self.noise,
            noise_gain=done.noise_gain,
            resolution_mm=done.resolution_mm,
            loss=frame.loss,
            shear=self._shear(frame, flags),
            arrived=frame.arrived,
            unit=self.plan.unit,
            calibration=self.plan.calibration_id,
            shares=share,
            **loads,
            **others,
        )

    def _shear(self, frame: RawFrame, flags: Flags) -> Floats32 | None:
        """Shear in counts (2, ...), less the zero's; NaN where it is unknown, as in the raw image."""
        if frame.shear is None:
            return None
        tared = frame.shear - np.nan_to_num(self.shear_zero)
        tared[:, flags.ravel() & UNKNOWN > 0] = np.nan
        return tared.reshape((2, *flags.shape))

    def deviation(self, image: SensorImage) -> Floats32:
        """Standard deviation of every cell of `image.restored`, this chain's newest, in its unit; any thread.

        The deviation is of what the whole method gives: an image that was cut short is off by the difference, too.
        """
        whole, spread = self._own(self.surface(image))
        return np.asarray(np.hypot(spread, whole - image.restored))

    def surface(self, image: SensorImage) -> Floats32:
        """Restored pressure and its deviation (2, R, C), with what lies beyond the array; as of `deviation`."""
        wanted_by = self._method, image.noise
        with self._deviation_lock:
            if self._deviation is None or self._deviation[0] != wanted_by:
                self._deviation = wanted_by, make(wanted_by[0], self.plan.blur, wanted_by[1])
            restorer = self._deviation[1]
            restorer.weigh(self.noise_ratio)
            restorer(_less(image.raw, image.tilt), image.flags)
            both = np.asarray(restorer.whole(), np.float32)
        self._own(both)[:, np.isnan(image.restored)] = np.nan
        return both

    def _own(self, surface: Floats32) -> Floats32:
        """The array's part of images (n, R, C) of the surface."""
        wide = self.plan.blur.wide
        return surface if wide is None else surface[:, wide.own[0], wide.own[1]]


def _less(raw: Floats32, added: Reals | None) -> Floats32:
    """Pressures less what a tangential load adds to them; None: there is none."""
    return raw if added is None else np.asarray(raw - added.reshape(raw.shape), np.float32)


def flag_warnings(flags: Flags) -> tuple[FrameWarning, ...]:
    """A warning for each flag that some taxels have."""
    return _flagged(flags.tobytes()) if np.count_nonzero(flags) else ()


@lru_cache(maxsize=256)  # flags stay for many frames
def _flagged(values: bytes) -> tuple[FrameWarning, ...]:
    flags = np.frombuffer(values, np.uint8)
    instead = {} if (flags & UNKNOWN == 0).any() else {"instead": NO_DATA}
    counts = ((code, int(np.count_nonzero(flags & flag))) for code, flag in FLAG_CODES.items())
    return tuple(warning(code, count, **instead) for code, count in counts if count)
