"""One sensor's way from counts to the restored image: calibrate, restore, check."""

from functools import cached_property
from threading import Lock
from time import perf_counter
from typing import cast

import numpy as np
from numpy.typing import NDArray

from tactiled.build import SensorPlan
from tactiled.calibrate.calibration import Calibration, Calibrator
from tactiled.calibrate.tare import load_description
from tactiled.diagnostics.checks import NOISE_RATIO, FrameChecks
from tactiled.diagnostics.warning_codes import WarningCode, warning
from tactiled.frames import FLAG_BITS, UNKNOWN, FrameWarning, Image, RawFrame
from tactiled.geometry import tiling
from tactiled.restore.methods import Restorer, make, require
from tactiled.restore.noise import estimate
from tactiled.units import N_PER_KPA_MM2, Unit

NOISE_FRAMES = 32  # from which the noise is measured, to 3 % on 64 taxels
NOISE_PAUSE_FRAMES = 992  # until it is measured again: every 10 s at 100 Hz
TARE_FRAMES = 16  # that a tare averages
FLAG_CODES = {cast(WarningCode, name.lower()): flag for name, flag in FLAG_BITS.items()}


class Pipeline:
    """Turns the raw frames of one array into images, one after the other, on one thread.

    `set_method`, `tare` and `lapse_tare` may be called from any thread and take effect with the next frame;
    `load_description`, `deviation` and `forces` may be called from any thread, too.
    """

    def __init__(self, plan: SensorPlan) -> None:
        self._plan = plan
        size = plan.array.size
        self.calibrator = Calibrator(plan.calibration, size)
        self.noise = Noise(plan.calibration, plan.unit)
        self._tare_mean = _TareMean(size)
        self._shear_zero = np.full((2, size), np.nan, np.float32)  # counts; NaN until tared
        self._recent: tuple[NDArray[np.float32], ...] = ()  # raw images since the last tare, or break
        self.tared = self.lapsed = 0  # times that a tare was done, or given up
        self._checks = FrameChecks(plan.blur, plan.calibration.floor_kpa)
        self.method = plan.method
        self._restorer = self._make_restorer()
        self._deviation: tuple[tuple[str, float], Restorer] | None = None  # of a method and a noise
        self._deviation_lock = Lock()

    def set_method(self, name: str) -> None:
        """Restore the next frames by `name`; ConfigError if there is no such method."""
        require(name)
        self.method = name

    def tare(self) -> None:
        """Take the mean of the next frames as the unloaded array."""
        self._tare_mean.start()

    def load_description(self) -> str:
        """What of a load the newest frames show, in words; "" for none."""
        return load_description(self._recent, self.noise.kpa, self._plan.unit)

    def lapse_tare(self) -> None:
        """Give up a tare that does not have all of its frames yet; `lapsed` counts it."""
        self._recent = ()
        if self._tare_mean.stop():
            self.lapsed += 1

    def deviation(self, image: Image) -> NDArray[np.float32]:
        """Standard deviation of every cell of `image.restored`, in its unit, this pipeline's newest."""
        wanted_by = self._made_for[0], image.noise
        with self._deviation_lock:
            if self._deviation is None or self._deviation[0] != wanted_by:
                self._deviation = wanted_by, make(wanted_by[0], self._plan.blur, wanted_by[1])
            restorer = self._deviation[1]
            restorer.reset()
            restorer(image.raw, image.flags)
            return restorer.deviation().astype(np.float32)

    def forces(self, frame: RawFrame) -> NDArray[np.float64] | None:
        """Force (N, 3) in N on each taxel, along x and y and into the skin, as sensed; None unless all are known.

        They are unknown where shear has no scale or has not been tared, or where a taxel does not work; of a
        saturated one it is the least that it can be.
        """
        scale = self._plan.calibration.shear_n_per_count
        if scale is None or frame.shear is None or not self._plan.calibrated:
            return None
        pressure, _ = self.calibrator(frame.counts, frame.flags)
        tangential = (frame.shear - self._shear_zero) * scale
        forces = np.column_stack([*tangential, pressure * self._areas * N_PER_KPA_MM2])
        return forces if np.isfinite(forces).all() else None

    @cached_property
    def _areas(self) -> NDArray[np.float64]:
        """(N,) mm^2 of the surface that each taxel stands for."""
        return tiling(self._plan.array).areas

    def _make_restorer(self) -> Restorer:
        self._made_for = self.method, self.noise.kpa
        restorer = make(self._made_for[0], self._plan.blur, self._made_for[1])
        restorer.prepare()
        return restorer

    def process(self, frame: RawFrame) -> Image:
        """Image of one frame; `restored` is never NaN, and everything known against it is a flag or a warning."""
        began = perf_counter()
        self._apply_tare(frame)
        shape = self._plan.array.frame_shape
        pressure, taxel_flags = self.calibrator(frame.counts, frame.flags)
        raw, flags = pressure.reshape(shape), taxel_flags.reshape(shape)
        self.noise.add(raw)
        self._recent = (*self._recent, raw)[-TARE_FRAMES:]
        if self._made_for != (self.method, self.noise.kpa):
            self._restorer = self._make_restorer()
        done = self._restorer(raw, flags)
        check_warnings = self._checks(raw, flags, done.image, self.noise.kpa, done.method)
        return Image(
            sensor=self._plan.name,
            sequence=frame.sequence,
            time=frame.time,
            raw=raw,
            restored=done.image.copy(),
            flags=flags,
            method=done.method,
            why=done.why,
            iterations=done.iterations,
            microseconds=(perf_counter() - began) * 1e6,
            noise=self.noise.kpa,
            noise_gain=done.noise_gain,
            resolution_mm=done.resolution_mm,
            loss=frame.loss,
            warnings=self._plan.warnings + self.noise.warning + _flag_warnings(flags) + check_warnings,
            shear=self._tared_shear(frame.shear, flags),
            arrived=frame.arrived,
            unit=self._plan.unit,
            calibration=self._plan.calibration_id,
        )

    def _apply_tare(self, frame: RawFrame) -> None:
        """Take a frame into a tare under way, and its zero over once it is complete."""
        mean = self._tare_mean.add(frame)
        if mean is None:
            return
        self.calibrator.tare(mean[0])
        self._shear_zero = np.where(np.isfinite(mean[1:]), mean[1:], self._shear_zero).astype(np.float32)
        self._restorer.reset()
        self._recent = ()
        self.tared += 1

    def _tared_shear(
        self, shear: NDArray[np.float32] | None, flags: NDArray[np.uint8]
    ) -> NDArray[np.float32] | None:
        """Shear in counts (2, ...), less the tare's; NaN where it is unknown, as in the raw image."""
        if shear is None:
            return None
        tared = shear - np.nan_to_num(self._shear_zero)
        tared[:, flags.ravel() & UNKNOWN > 0] = np.nan
        return tared.reshape((2, *flags.shape))


def _flag_warnings(flags: NDArray[np.uint8]) -> tuple[FrameWarning, ...]:
    """A warning for each flag that some taxels have."""
    if not flags.any():
        return ()
    counts = ((code, int(np.count_nonzero(flags & flag))) for code, flag in FLAG_CODES.items())
    return tuple(warning(code, count) for code, count in counts if count)


class Noise:
    """Standard deviation of a taxel, in `unit`: as configured, else of the first frames; measured now and then."""

    def __init__(self, calibration: Calibration, unit: Unit) -> None:
        self._unit = unit
        self._floor, self._configured = calibration.floor_kpa, calibration.noise_kpa
        self.kpa = self._configured or self._floor
        self.warning: tuple[FrameWarning, ...] = ()
        self._measured = False
        self._frames: list[NDArray[np.float32]] = []
        self._pause = 0  # frames until frames are taken again

    def add(self, raw: NDArray[np.float32]) -> None:
        """Take one more frame."""
        if self._pause:
            self._pause -= 1
            return
        self._frames.append(raw)
        if len(self._frames) == NOISE_FRAMES:
            self._compare(max(self._floor, estimate(np.stack(self._frames))))
            self._frames, self._pause = [], NOISE_PAUSE_FRAMES

    def _compare(self, measured: float) -> None:
        if self._configured is None and not self._measured:
            self.kpa, self._measured = measured, True
        self.warning = ()
        if measured > NOISE_RATIO * self.kpa:
            source = "configured" if self._configured else "measured at the start"
            raised = warning("noise_high", measured=measured, noise=self.kpa, unit=self._unit, source=source)
            self.warning = (raised,)


class _TareMean:
    """Mean of counts, and of shear where it is felt, over TARE_FRAMES frames; any thread may start and stop it."""

    def __init__(self, taxels: int) -> None:
        self._lock = Lock()
        self._sums = np.zeros((3, taxels))  # of the counts, and of shear along x and y
        self._counts = np.zeros(taxels)  # frames in which a taxel is known
        self._remaining = 0  # frames; 0: no tare is under way

    def start(self) -> None:
        with self._lock:
            self._sums[:], self._counts[:] = 0, 0
            self._remaining = TARE_FRAMES

    def stop(self) -> bool:
        """Stop; returns whether it was under way."""
        with self._lock:
            under_way, self._remaining = self._remaining > 0, 0
        return under_way

    def add(self, frame: RawFrame) -> NDArray[np.float64] | None:
        """Mean (3, N), NaN where a taxel was never known, once enough frames are in; else None."""
        with self._lock:
            if not self._remaining:
                return None
            known_taxels = frame.flags & UNKNOWN == 0
            values = (frame.counts, *(() if frame.shear is None else frame.shear))
            for total, each in zip(self._sums, values, strict=False):
                total[known_taxels] += each[known_taxels]
            self._counts += known_taxels
            self._remaining -= 1
            if self._remaining:
                return None
            return np.where(self._counts > 0, self._sums / np.maximum(self._counts, 1), np.nan)
