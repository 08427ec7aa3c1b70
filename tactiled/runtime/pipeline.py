"""One sensor's way from counts to the restored image: calibrate, choose, restore."""

from collections.abc import Callable
from functools import cached_property
from threading import Lock
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from tactiled.calibrate.calibration import Calibration, Calibrator
from tactiled.calibrate.tare import load_seen
from tactiled.diagnostics.checks import FrameChecks
from tactiled.diagnostics.warning_codes import WarningCode, warning
from tactiled.frames import BAD, DEAD, MISSING, SATURATED, FrameWarning, Image, RawFrame
from tactiled.geometry import Array, tiling
from tactiled.restore.blur import Blur
from tactiled.restore.methods import Restorer, make, require
from tactiled.restore.noise import estimate

NOISE_FRAMES = 32  # frames from which an unknown noise is measured
PAUSE_FRAMES = 992  # until it is measured again, to see whether it is still as told
LOUD = 2.0  # times the noise told that are worth a warning
TARE_FRAMES = 16  # frames that a tare averages
FLAG_CODES: dict[WarningCode, int] = {"missing": MISSING, "bad": BAD, "dead": DEAD, "saturated": SATURATED}


class Pipeline:
    """Turns the raw frames of one array into images, one after the other, on one thread.

    `set_method`, `tare` and `lapse` may be called from any thread; they take effect with the next frame. So may
    `forces`.
    """

    def __init__(
        self,
        name: str,
        array: Array,
        blur: Blur,
        calibration: Calibration,
        method: str = "auto",
        warnings: tuple[FrameWarning, ...] = (),  # that hold for every image, such as a missing calibration
        clock: Callable[[], float] = perf_counter,
    ) -> None:
        self.name, self.array, self.blur = name, array, blur
        self._warnings, self._clock = warnings, clock
        self._calibrator = Calibrator(calibration, array.size)
        self._noise = _Noise(calibration)
        self._tare = _Tare(array.size)
        self._no_shear = np.full((2, array.size), np.nan, np.float32)  # NaN until tared
        self._recent: tuple[NDArray[np.float32], ...] = ()  # raw images since the last tare, or break
        self.tared = self.lapsed = 0  # times
        self._checks = FrameChecks(blur, calibration.floor_kpa)
        self._method = ""
        self.set_method(method)
        self._restorer = self._make()
        self._again: tuple[tuple[str, float], Restorer] | None = None  # kept for deviations
        self._one_by_one = Lock()

    @property
    def method(self) -> str:
        """Name of the method asked for."""
        return self._method

    @property
    def no_load(self) -> NDArray[np.float32]:
        """Counts of each taxel (N,) without a load, as configured or last tared."""
        return self._calibrator.no_load

    @property
    def noise_kpa(self) -> float:
        """Standard deviation of a taxel, configured or measured."""
        return self._noise.kpa

    def set_method(self, name: str) -> None:
        """Restore the next frames by `name`; ConfigError if there is no such method."""
        require(name)
        self._method = name

    def tare(self) -> None:
        """Take the mean of the next frames as the unloaded array."""
        self._tare.ask()

    def load_seen(self) -> str:
        """What of a load the newest frames show, in words; "" for none; any thread."""
        return load_seen(self._recent, self._noise.kpa)

    def lapse(self) -> None:
        """Give up a tare that has not all of its frames yet; `lapsed` counts it."""
        self._recent = ()
        if self._tare.lapse():
            self.lapsed += 1

    def deviation(self, image: Image) -> NDArray[np.float32]:
        """Standard deviation (kPa) of every cell of `image.restored`, this pipeline's newest; any thread."""
        asked = self._made[0], image.noise_kpa
        with self._one_by_one:
            if self._again is None or self._again[0] != asked:
                self._again = asked, make(asked[0], self.blur, asked[1])
            again = self._again[1]
            again.reset()
            again(image.raw, image.flags)
            return again.deviation().astype(np.float32)

    def forces(self, frame: RawFrame) -> NDArray[np.float64] | None:
        """Force (N, 3) in N on each taxel, along x and y and into the skin, as sensed; None unless all are known.

        They are not where shear has no scale or has not been tared, or where a taxel does not work; of a saturated
        one it is the least that it can be.
        """
        scale = self._calibrator.calibration.shear_n_per_count
        if scale is None or frame.shear is None:
            return None
        pressure, _ = self._calibrator(frame.counts, frame.flags)
        along = (frame.shear - self._no_shear) * scale
        forces = np.column_stack([*along, pressure * self._areas * 1e-3])  # kPa mm^2 are mN
        return forces if np.isfinite(forces).all() else None

    @cached_property
    def _areas(self) -> NDArray[np.float64]:
        """(N,) mm^2 of the surface that each taxel stands for."""
        return tiling(self.array).areas

    def _make(self) -> Restorer:
        self._made = (self._method, self._noise.kpa)
        restorer = make(self._made[0], self.blur, self._noise.kpa)
        restorer.prepare()
        return restorer

    def process(self, frame: RawFrame) -> Image:
        """Image of one frame; never NaN in `restored`, and nothing known against it is left out."""
        began = self._clock()
        known = frame.flags & (MISSING | BAD) == 0
        if (mean := self._tare.add(frame, known)) is not None:
            self._calibrator.tare(mean[0])
            self._no_shear = np.where(np.isfinite(mean[1:]), mean[1:], self._no_shear).astype(np.float32)
            self._restorer.reset()
            self._recent = ()
            self.tared += 1
        pressure, flags = self._calibrator(frame.counts, frame.flags)
        raw, flags = pressure.reshape(self.array.frame_shape), flags.reshape(self.array.frame_shape)
        self._noise.add(raw)
        self._recent = (*self._recent, raw)[-TARE_FRAMES:]
        if self._made != (self._method, self._noise.kpa):
            self._restorer = self._make()
        done = self._restorer(raw, flags)
        shown = self._checks(raw, flags, done.image, self._noise.kpa, done.method)
        return Image(
            sensor=self.name,
            sequence=frame.sequence,
            time=frame.time,
            raw=raw,
            restored=done.image.copy(),
            flags=flags,
            method=done.method,
            why=done.why,
            iterations=done.iterations,
            microseconds=(self._clock() - began) * 1e6,
            noise_kpa=self._noise.kpa,
            noise_gain=done.noise_gain,
            resolution_mm=done.resolution_mm,
            loss=frame.loss,
            warnings=self._warnings + self._noise.warning + _flag_warnings(flags) + shown,
            shear=self._sheared(frame.shear, flags),
            arrived=frame.arrived,
        )

    def _sheared(self, shear: NDArray[np.float32] | None, flags: NDArray[np.uint8]) -> NDArray[np.float32] | None:
        """Shear in counts (2, ...), less the tare's; NaN where nothing is known, as in the raw image."""
        if shear is None:
            return None
        unknown = flags.ravel() & (MISSING | BAD | DEAD) > 0
        tared = shear - np.nan_to_num(self._no_shear)
        tared[:, unknown] = np.nan
        return tared.reshape((2, *self.array.frame_shape))


def _flag_warnings(flags: NDArray[np.uint8]) -> tuple[FrameWarning, ...]:
    """A warning for each flag that some taxels have."""
    if not flags.any():
        return ()
    counts = ((code, int(np.count_nonzero(flags & flag))) for code, flag in FLAG_CODES.items())
    return tuple(warning(code, count) for code, count in counts if count)


class _Noise:
    """Standard deviation (kPa) of a taxel: as calibrated, else from the first frames; measured now and then."""

    def __init__(self, calibration: Calibration) -> None:
        self._floor, self._told = calibration.floor_kpa, calibration.noise_kpa
        self.kpa = self._told or self._floor
        self.warning: tuple[FrameWarning, ...] = ()
        self._measured = False
        self._frames: list[NDArray[np.float32]] = []
        self._pause = 0

    def add(self, raw: NDArray[np.float32]) -> None:
        """Look at one more frame."""
        if self._pause:
            self._pause -= 1
            return
        self._frames.append(raw)
        if len(self._frames) == NOISE_FRAMES:
            self._judge(max(self._floor, estimate(np.stack(self._frames))))
            self._frames, self._pause = [], PAUSE_FRAMES

    def _judge(self, found: float) -> None:
        if self._told is None and not self._measured:
            self.kpa, self._measured = found, True
        loud = found > LOUD * self.kpa
        source = "configured" if self._told else "measured at the start"
        self.warning = ()
        if loud:
            self.warning = (warning("noise_high", measured_kpa=found, noise_kpa=self.kpa, source=source),)


class _Tare:
    """Averages counts, and shear where it is felt, over a few frames after it is asked to; any thread may ask."""

    def __init__(self, taxels: int) -> None:
        self._lock = Lock()
        self._sum = np.zeros((3, taxels))  # of the counts, and of shear along x and y
        self._seen = np.zeros(taxels)
        self._left = 0

    def ask(self) -> None:
        with self._lock:
            self._sum[:], self._seen[:] = 0, 0
            self._left = TARE_FRAMES

    def lapse(self) -> bool:
        """Be asked no longer; whether it was."""
        with self._lock:
            asked, self._left = self._left > 0, 0
        return asked

    def add(self, frame: RawFrame, known: NDArray[np.bool]) -> NDArray[np.float64] | None:
        """Mean (3, N), NaN where a taxel was never `known` (N,), once enough frames are in; else None."""
        felt = (frame.counts, *(() if frame.shear is None else frame.shear))
        with self._lock:
            if not self._left:
                return None
            for each, counts in zip(self._sum, felt, strict=False):
                each[known] += counts[known]
            self._seen += known
            self._left -= 1
            if self._left:
                return None
            return np.where(self._seen > 0, self._sum / np.maximum(self._seen, 1), np.nan)
