"""Restores series of frames of one sensor piece by piece, from a file to an .npy file, with bounded memory."""

import csv
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactiled.arrays import Flags, Floats32
from tactiled.bounds import MAX_READING
from tactiled.build import SensorPlan, make_codec
from tactiled.bus.router import Router
from tactiled.chain import Chain
from tactiled.config import Config
from tactiled.errors import ConfigError
from tactiled.frames import BAD, DEAD, MISSING, SATURATED, FrameSeries
from tactiled.restore.noise import IMPLAUSIBLE_KPA, are_multiples, estimate

PIECE_FRAMES = 256  # in memory at once
NOISE_RUNS, NOISE_RUN_FRAMES = 8, 32  # runs of frames, all over the series, from which the noise is measured
MIN_NOISE_KPA = 1e-3  # assumed where all frames are 0

Frames = NDArray[Any]


class FrameInfo(NamedTuple):
    """How one frame was restored."""

    method: str
    why: str
    iterations: int
    microseconds: float


def open_frames(path: Path, plan: SensorPlan) -> Frames:
    """Map the frames (T, *taxels) of an .npy file, or read a .csv; ConfigError names file and fault."""
    if path.suffix.lower() == ".csv":
        return _read_csv(path, plan)
    try:
        frames = np.load(path, mmap_mode="r", allow_pickle=False)
    except OSError as error:
        raise ConfigError(
            f"{path}: {error.strerror or 'no .npy file'}: give frames in {plan.unit} as .npy"
        ) from error
    except Exception as error:  # numpy evaluates the header as Python text: any error is possible
        raise ConfigError(
            f"{path}: no complete .npy file of numbers: give frames in {plan.unit} as .npy"
        ) from error
    if not isinstance(frames, np.ndarray):
        frames.close()
        raise ConfigError(f"{path}: several arrays in one file: give one array of frames as .npy")
    shape = plan.array.frame_shape
    if frames.ndim != len(shape) + 1 or frames.shape[1:] != shape:
        needed = ", ".join(map(str, shape))
        raise ConfigError(f"{path}: shape {frames.shape} for sensor {plan.name}: give (T, {needed})")
    if frames.dtype.kind not in "fiu":
        raise ConfigError(f"{path}: dtype {frames.dtype}: give real numbers, in {plan.unit}")
    return frames


def _read_csv(path: Path, plan: SensorPlan) -> Frames:
    """Frames (T, *taxels), a line each; an empty field is unknown, a first line of names is left out."""
    frames: list[Floats32] = []
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            for number, fields in enumerate(csv.reader(file), 1):
                if len(fields) != plan.array.size and fields:
                    needed = f"{plan.array.size}, one for each taxel of sensor {plan.name}"
                    raise ConfigError(f"{path}: line {number}: {len(fields)} fields: give {needed}")
                try:
                    values = [float(each) if each.strip() else np.nan for each in fields]
                except ValueError as error:
                    if number > 1:
                        raise ConfigError(f"{path}: line {number}: {error}: give numbers") from error
                    continue
                if values:
                    frames.append(np.array(values, np.float32))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise ConfigError(f"{path}: {getattr(error, 'strerror', None) or error}: give frames as .csv") from error
    return np.array(frames, np.float32).reshape(-1, *plan.array.frame_shape)


def measured_noise(frames: Frames, steps_kpa: tuple[float, ...]) -> float:
    """Standard deviation (kPa) of a taxel, at least that of rounding to one of the steps."""
    starts = np.unique(np.linspace(0, max(len(frames) - NOISE_RUN_FRAMES, 0), NOISE_RUNS).astype(int))
    runs = [_copy(frames, start, NOISE_RUN_FRAMES) for start in starts if len(frames)]
    noises = [estimate(run) for run in runs if np.isfinite(run).any()]
    noise = float(np.median(noises)) if noises else 0.0
    return max(noise or MIN_NOISE_KPA, _rounding_noise(runs, steps_kpa))


def _rounding_noise(runs: list[Frames], steps_kpa: tuple[float, ...]) -> float:
    """Noise (kPa) of rounding to the largest of the steps that all values differ by multiples of; else 0."""
    values = np.concatenate([np.empty(0), *(np.ravel(run).astype(float) for run in runs)])
    values = values[np.abs(values) < IMPLAUSIBLE_KPA]
    differences = values - values[:1]
    for step in sorted(steps_kpa, reverse=True):
        if (np.abs(differences) > step / 2).any() and are_multiples(differences, step):
            return step / 12**0.5
    return 0.0


def _copy(frames: Frames, start: int, count: int) -> Frames:
    """Copy some frames, those of a file through a map of their own: a map keeps in memory all it has read."""
    if isinstance(frames, np.memmap) and frames.filename is not None:
        order: Any = "C" if frames.flags.c_contiguous else "F"
        frames = np.memmap(frames.filename, frames.dtype, "r", frames.offset, frames.shape, order)
    return np.array(frames[start : start + count])


class Offline:
    """Restores a series of frames of one sensor by one method; a taxel's noise (kPa) is measured if not given.

    What `go_on` raises, which is asked before each frame, ends it.
    """

    def __init__(
        self,
        plan: SensorPlan,
        frames: Frames,
        method: str = "auto",
        noise_kpa: float | None = None,
        go_on: Callable[[], None] = lambda: None,
    ) -> None:
        self._frames, self._go_on, self._method = frames, go_on, method
        self.shape = (len(frames), *plan.cells.shape)  # of the images
        gain = abs(plan.calibration.kpa_per_count)
        self.noise_kpa = measured_noise(frames, (gain, 1.0)) if noise_kpa is None else noise_kpa
        self._chain = Chain(plan, self.noise_kpa)
        self._chain.restorer(method)  # refuses another noise or method before the first frame
        calibrator, shape = self._chain.calibrator, plan.array.frame_shape
        self._dead = np.where(calibrator.dead, np.uint8(DEAD), np.uint8(0)).reshape(shape)
        self._ceiling_kpa: float | Floats32 = np.inf
        if plan.calibration.saturation is not None:  # less half a count: pressures were rounded on their way here
            ceiling = calibrator.pressure(np.full(plan.array.size, plan.calibration.saturation))
            self._ceiling_kpa = (ceiling - gain / 2).reshape(shape)

    def __iter__(self) -> Iterator[tuple[Floats32, list[FrameInfo]]]:
        """Restore in pieces: images (up to PIECE_FRAMES, *surface), valid until the next."""
        images = np.empty((min(PIECE_FRAMES, self.shape[0]), *self.shape[1:]), np.float32)
        for start in range(0, len(self._frames), PIECE_FRAMES):
            with np.errstate(over="ignore"):  # beyond float32 is beyond any sensor: it counts as unknown
                pressures = np.array(_copy(self._frames, start, PIECE_FRAMES), np.float32)
            saturated = np.where(pressures >= self._ceiling_kpa, np.uint8(SATURATED), np.uint8(0))
            unknown = np.where(np.isfinite(pressures), np.uint8(0), np.uint8(MISSING))
            unknown |= np.where(np.abs(pressures) > MAX_READING, np.uint8(BAD), np.uint8(0))
            pairs = zip(pressures, saturated | unknown | self._dead, strict=True)
            infos = [self._restore(pressure, flags, images[n]) for n, (pressure, flags) in enumerate(pairs)]
            yield images[: len(infos)], infos

    def write(self, path: Path, take: Callable[[list[FrameInfo]], object] = len) -> Counter[str]:
        """Restore into a .npy array (T, *surface) of float32; returns how many frames by each method.

        `take` gets what is known of each piece's frames.
        """
        methods = Counter[str]()
        header = {"descr": "<f4", "fortran_order": False, "shape": self.shape}
        with path.open("wb") as file:
            np.lib.format.write_array_header_2_0(file, header)
            for images, infos in self:
                take(infos)
                methods.update(each.method for each in infos)
                file.write(np.ascontiguousarray(images, "<f4").data)
        return methods

    def _restore(self, pressure: Floats32, flags: Flags, out: Floats32) -> FrameInfo:
        self._go_on()
        began = perf_counter()
        done = self._chain.restore(pressure, flags, self._method)
        microseconds = 1e6 * (perf_counter() - began)
        out[...] = self._chain.known(done.image, flags)[0]
        return FrameInfo(done.method, done.why, done.iterations, round(microseconds, 1))


def read_frame_series(path: Path, name: str, config: Config) -> FrameSeries:
    """Every frame of sensor `name` (which `config` has), NaN where a taxel is missing or bad.

    Where the recording's clock steps back, all times are instead those since its first message, steps left out.
    ConfigError where the recording cannot be read or holds no frame of the sensor.
    """
    # python-can, which these import, has no place in a fleet's server.
    from tactiled.bus.recording import Recording
    from tactiled.bus.replay import AT_ONCE, frames

    bus = config.sensor[name].bus
    router = Router({key: make_codec(each) for key, each in config.sensor.items() if each.bus == bus})
    recording, times, arrived, counts = Recording(path, router.ids), [], [], []
    for sensor, frame in frames(recording, router, AT_ONCE):
        if sensor == name:
            times.append(frame.time)
            arrived.append(frame.arrived)
            valid = frame.flags & (MISSING | BAD) == 0
            counts.append(np.where(valid, frame.counts, np.nan).astype(np.float32))
    if not times:
        raise ConfigError(f"recording {path}: holds no frame of sensor {name} ({recording.summary()})")
    ascending = bool((np.diff(times) >= 0).all())
    return FrameSeries(np.array(times if ascending else arrived, np.float64), np.stack(counts))
