"""Frames that are already there: restored one after the other, in pieces, however many there are."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from time import perf_counter
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactiled.build import SensorPlan
from tactiled.calibrate.calibration import Calibration
from tactiled.errors import ConfigError
from tactiled.files import atomic_write
from tactiled.frames import DEAD, SATURATED
from tactiled.restore.blur import Blur
from tactiled.restore.methods import Restorer, make
from tactiled.restore.noise import IMPLAUSIBLE_KPA, estimate

PIECE = 256  # frames in memory at once
LOOKS = 8  # places of the film where its noise is measured
RUN = 32  # frames in a row at each
QUIET = 1e-3  # kPa: the noise assumed where all frames are 0
WHOLE = 0.02  # of a step, that float32 may be out of a whole multiple by

Frames = NDArray[Any]


class Told(NamedTuple):
    """What is known of one restored frame besides its image."""

    method: str
    why: str
    iterations: int
    microseconds: float


def checked(frames: Frames, plan: SensorPlan, name: str = "frames") -> Frames:
    """Give frames (T, *taxels) of real numbers, as a sensor's plan has it; ConfigError says what else they are."""
    wanted = plan.array.frame_shape
    if frames.shape[1:] != wanted or frames.ndim != len(wanted) + 1:
        shape = ", ".join(map(str, wanted))
        raise ConfigError(f"{name}: shape {frames.shape} for sensor {plan.name}: give (T, {shape})")
    if frames.dtype.kind not in "fiu":
        raise ConfigError(f"{name}: dtype {frames.dtype}: give real numbers, in kPa")
    return frames


def opened(path: Path, plan: SensorPlan) -> Frames:
    """Map the frames of an .npy file, checked; ConfigError names the file and what is wrong with it."""
    try:
        frames = np.load(path, mmap_mode="r", allow_pickle=False)
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror or 'no .npy file'}: give frames in kPa as .npy") from error
    except Exception as error:  # numpy reads the header as Python's text, which goes wrong in many ways
        raise ConfigError(f"{path}: no .npy file of numbers: give frames in kPa as .npy") from error
    if not isinstance(frames, np.ndarray):
        frames.close()
        raise ConfigError(f"{path}: several arrays in one file: give one array of frames as .npy")
    return checked(frames, plan, str(path))


def noise_of(frames: Frames) -> float:
    """Standard deviation (kPa) of a taxel, from runs of frames all over the film."""
    found = [estimate(piece) for piece in _pieces(frames)]
    return (float(np.median(found)) if found else 0.0) or QUIET


def rounding_of(frames: Frames, steps: tuple[float, ...]) -> float:
    """Noise (kPa) of rounding, where a film's values differ by whole multiples of one of `steps`; else 0."""
    values = np.concatenate([np.empty(0), *(np.ravel(piece).astype(float) for piece in _pieces(frames))])
    values = values[np.abs(values) < IMPLAUSIBLE_KPA]
    for step in steps:
        multiples = (values - values[:1]) / step
        whole = multiples.round()
        if whole.any() and float(np.abs(multiples - whole).max()) < WHOLE:
            return step / 12**0.5
    return 0.0


def _pieces(frames: Frames) -> Iterator[Frames]:
    """Runs of frames all over a film."""
    starts = np.unique(np.linspace(0, max(len(frames) - RUN, 0), LOOKS).astype(int))
    return (_piece(frames, start, RUN) for start in starts if len(frames))


def _piece(frames: Frames, start: int, count: int) -> Frames:
    """Copy a few frames, those of a file through a map of their own: one that stays keeps all it has read."""
    if isinstance(frames, np.memmap) and frames.filename is not None:
        order: Any = "C" if frames.flags.c_contiguous else "F"
        frames = np.memmap(frames.filename, frames.dtype, "r", frames.offset, frames.shape, order)
    return np.array(frames[start : start + count])


class Offline:
    """Restores films of one sensor by one method; a taxel's noise (kPa) is measured if not given."""

    def __init__(self, plan: SensorPlan, method: str = "auto", noise_kpa: float | None = None) -> None:
        self._blur: Blur = plan.blur
        self._method, self._given = method, noise_kpa
        self._steps = abs(plan.calibration.kpa_per_count), 1.0
        self._taxels = _Taxels(plan.calibration, plan.array.frame_shape)
        self._restorer: Restorer = make(method, plan.blur, QUIET if noise_kpa is None else noise_kpa)

    def begin(self, frames: Frames) -> float:
        """Get ready for a film; gives the noise (kPa) that it is restored with."""
        noise = max(noise_of(frames), rounding_of(frames, self._steps)) if self._given is None else self._given
        self._restorer = make(self._method, self._blur, noise)
        return noise

    def __call__(self, frames: Frames) -> Iterator[tuple[NDArray[np.float32], list[Told]]]:
        """Restore a film in pieces: images (up to PIECE, *surface), valid until the next, and their stories."""
        images = np.empty((min(PIECE, len(frames)), *self._blur.surface_shape), np.float32)
        for start in range(0, len(frames), PIECE):
            pressures, flags = self._taxels(_piece(frames, start, PIECE))
            told = [
                self._one(pressure, None if flags is None else flags[n], images[n])
                for n, pressure in enumerate(pressures)
            ]
            yield images[: len(told)], told

    def _one(self, frame: NDArray[np.float32], flags: NDArray[np.uint8] | None, out: NDArray[np.float32]) -> Told:
        began = perf_counter()
        done = self._restorer(frame, flags)
        took = 1e6 * (perf_counter() - began)
        out[...] = done.image
        return Told(done.method, done.why, done.iterations, round(took, 1))


class _Taxels:
    """Finds taxels of pressures (kPa) that cannot be believed, as the sensor's calibration has them."""

    def __init__(self, calibration: Calibration, shape: tuple[int, ...]) -> None:
        self._dead = np.zeros(shape, np.uint8)
        self._dead.flat[list(calibration.dead)] = DEAD
        gain = calibration.kpa_per_count
        # Half a count of room: the pressures were rounded on their way here.
        full = calibration.saturation
        self._ceiling = np.inf if full is None else (full - calibration.no_load) * gain - abs(gain) / 2

    def __call__(self, frames: Frames) -> tuple[NDArray[np.float32], NDArray[np.uint8] | None]:
        """Give frames (T, ...) as float32 and their flags, None if there are none."""
        with np.errstate(over="ignore"):  # beyond float32 is beyond any sensor: it counts as unknown
            pressures = np.array(frames, np.float32)
        full = pressures >= self._ceiling
        if not self._dead.any() and not full.any():
            return pressures, None
        return pressures, np.where(full, np.uint8(SATURATED), np.uint8(0)) | self._dead


@contextmanager
def created(path: Path) -> Iterator[BinaryIO]:
    """Open a file that gets its name only once it is whole; ConfigError where it cannot be written."""
    try:
        target = path.resolve()
        plain = target.is_file() or not target.exists()
    except (OSError, RuntimeError) as error:  # the latter of links in a circle
        raise ConfigError(f"{path}: {error}: give a file that can be written") from error
    if not plain:
        raise ConfigError(f"{path}: no plain file: give a file that can be written")
    try:
        with atomic_write(target, replace=True) as part, part.open("wb") as file:
            yield file
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}: give a file that can be written") from error


def write(
    images: Iterator[NDArray[np.float32]], shape: tuple[int, ...], path: Path, done: Callable[[int], None]
) -> None:
    """Write images as one .npy array (T, ...) of known shape; ConfigError where that cannot be."""
    header = {"descr": "<f4", "fortran_order": False, "shape": shape}
    with created(path) as file:
        np.lib.format.write_array_header_2_0(file, header)
        for piece in images:
            file.write(np.ascontiguousarray(piece, "<f4").data)
            done(len(piece))
