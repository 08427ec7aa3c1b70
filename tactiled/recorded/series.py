"""Force, mean, peak and contact area in every frame of a recording, of the whole array and of regions.

Another process measures the restored images, the same that playback shows.
"""

import os
import time
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from threading import Thread, Timer
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactiled.arrays import Floats, Floats32
from tactiled.build import SensorPlan
from tactiled.calibrate.counts.tare import Zero
from tactiled.contacts.regions import Measures, Region, RegionMeter
from tactiled.frames import MISSING
from tactiled.processes import Cancelled, FitProcess
from tactiled.recorded.frames import FLUSH_S, FrameFiles, RecordedFrames, SharedFile, check_goes_on
from tactiled.recorded.playback import MAX_POINTS, Playback, noise_frames
from tactiled.threads import join_started

ROWS_AT_ONCE = 512
MAX_SERIES = 4  # on the disk; the one used longest ago makes room
IDLE_S = 90.0  # without a request until measuring ends: a page in the background asks once a minute
REPLACED_AFTER_S = 3.0  # without a request until another series is measured instead


@dataclass(frozen=True, eq=False)
class SeriesJob:
    """What is measured: every frame of a sensor, restored by a method."""

    plan: SensorPlan
    zero: Zero
    frames: FrameFiles
    method: str
    regions: Mapping[str, Region]
    folder: Path
    leave_mb: float

    @property
    def row(self) -> np.dtype[Any]:
        """Of a frame: position, s; taxels that did not arrive; measures (K, 4) of the array and its regions."""
        values = 1 + len(self.regions), len(Measures._fields)
        return np.dtype([("position", "<f8"), ("missing", "<i8"), ("values", "<f4", values)])


def write_measures(job: SeriesJob, target: SharedFile) -> None:
    """Write a row for each frame; TactileError where the disk is full or the service has ended."""
    count = job.frames.count(job.plan.name)
    playback = Playback(job.plan, job.zero, job.frames, noise_frames(job.plan, job.frames, count))
    meters = [RegionMeter(each, job.plan.cells) for each in (None, *job.regions.values())]
    row, parent, flushed = np.zeros((), job.row), os.getppid(), time.monotonic()
    for number in range(count):
        image = playback.image(number, job.method)
        row["position"], row["missing"] = image.arrived, np.count_nonzero(image.flags & MISSING)
        row["values"] = [each(image) for each in meters]
        target.write(row.tobytes())
        if time.monotonic() - flushed > FLUSH_S:
            target.flush()
            check_goes_on(parent, job.folder, job.leave_mb)
            flushed = time.monotonic()
    target.flush()


class Summary(NamedTuple):
    """A series in P pieces; K counts the array and its regions, 4 the fields of Measures. NaN: not known."""

    position_s: Floats  # (P,) at which a piece begins
    values: Floats32  # (P, K, 4) the highest of each piece
    highest: Floats32  # (K, 4) of the recording
    number: NDArray[np.int64]  # (K, 4) of the first frame that has it
    highest_s: Floats  # (K, 4) its position


class RecordedSeries:
    """One series; more of it comes while `running`."""

    def __init__(self, job: SeriesJob) -> None:
        """OSError where its folder takes no files."""
        self.job, self.error, self.used_at = job, "", 0.0
        self.frames = job.frames.count(job.plan.name)
        self._file = SharedFile.temporary(job.folder)
        self._process = FitProcess()
        self._idle = Timer(IDLE_S, self._process.cancel)
        self._thread = Thread(target=self._measure, name=f"measure {job.plan.name}", daemon=True)
        self._thread.start()

    def _measure(self) -> None:
        try:
            self._process.run(write_measures, self.job, self._file)
        except Cancelled:
            pass
        except Exception as error:
            self.error = str(error)
        self._idle.cancel()

    @property
    def running(self) -> bool:
        """Whether frames are still being measured."""
        return self._thread.is_alive()

    @property
    def given_up(self) -> bool:
        """Whether it ended early because no client asked for it."""
        return not (self.running or self.error) and self.measured < self.frames

    @property
    def measured(self) -> int:
        """Frames by now."""
        return self._file.size // self.job.row.itemsize

    def use(self) -> None:
        """Somebody asks for it."""
        self.used_at = time.monotonic()
        self._idle.cancel()
        if self.running:
            self._idle = Timer(IDLE_S, self._process.cancel)
            self._idle.daemon = True
            self._idle.start()

    def close(self) -> None:
        """Measure no more, and give the disk free."""
        self._process.cancel()
        join_started(self._thread)
        self._idle.cancel()
        self._file.close()

    @property
    def rows(self) -> "SeriesRows":
        """Rows of the frames that are measured by now."""
        return SeriesRows(self._file, self.job.row, self.measured)

    @cached_property
    def summary(self) -> Summary:
        """Of all frames, once they are measured."""
        rows, shape = self.rows, (1 + len(self.job.regions), len(Measures._fields))
        first = np.unique(np.linspace(0, rows.frames, MAX_POINTS, endpoint=False).astype(int)).tolist()
        number, highest = np.zeros(shape, np.int64), np.full(shape, -np.inf, np.float32)
        pieces = []
        for start, end in pairwise([*first, rows.frames]):
            piece = np.full(shape, np.nan, np.float32)
            for n in range(start, end, ROWS_AT_ONCE):
                values = rows.read(n, end)["values"]
                piece = np.fmax(piece, np.fmax.reduce(values, axis=0))
                finite = np.nan_to_num(values, nan=-np.inf)
                number = np.where(finite.max(axis=0) > highest, n + finite.argmax(axis=0), number)
                highest = np.maximum(highest, finite.max(axis=0))
            pieces.append(piece)
        highest_s = {n: rows.read(n, n + 1)["position"][0] for n in np.unique(number).tolist()}
        return Summary(
            np.array([rows.read(n, n + 1)["position"][0] for n in first]),
            np.array(pieces),
            np.where(np.isneginf(highest), np.nan, highest),
            number,
            np.vectorize(highest_s.__getitem__, otypes=[float])(number),
        )


class SeriesRows(NamedTuple):
    """The rows of a series (`SeriesJob.row`) in its file, of which a few are in memory at a time."""

    file: SharedFile
    dtype: np.dtype[Any]
    frames: int

    def read(self, first: int, end: int) -> NDArray[Any]:
        """Up to ROWS_AT_ONCE rows, from one number to before another."""
        size = self.dtype.itemsize
        count = min(end, self.frames, first + ROWS_AT_ONCE) - first
        return np.frombuffer(self.file.read(count * size, first * size), self.dtype)

    def of_their_own(self) -> "SeriesRows":
        """The same, which can also be read when the series is closed; to be closed."""
        return self._replace(file=self.file.duplicate())


class SeriesRuns:
    """The series of recordings: one is measured at a time; on one thread, but for `close`."""

    def __init__(self) -> None:
        self._runs: dict[tuple[Any, ...], RecordedSeries] = {}  # by what they depend on, newest use last

    def series(
        self, playback: Playback, recorded: RecordedFrames, method: str, regions: Mapping[str, Region]
    ) -> RecordedSeries | None:
        """The series of a recording that was read; None while another one is measured for somebody else.

        OSError where its folder takes no files.
        """
        plan = playback.plan
        key = recorded, plan, playback.tared_at, method, tuple(regions.items())
        run = self._runs.get(key)
        if run is None or run.given_up:
            if not self._make_room():
                return None
            frames, folder = recorded.of(plan.name), recorded.path.parent
            job = SeriesJob(plan, playback.zero, frames, method, regions, folder, recorded.leave_mb)
            run = RecordedSeries(job)
        self._runs.pop(key, None)
        self._runs[key] = run
        run.use()
        return run

    def drop(self, run: RecordedSeries) -> None:
        """Measure it anew when somebody asks again."""
        self._runs = {key: each for key, each in self._runs.items() if each is not run}
        run.close()

    def _make_room(self) -> bool:
        for each in self._runs.values():
            if each.running and time.monotonic() - each.used_at < REPLACED_AFTER_S:
                return False
        for each in list(self._runs.values()):
            if each.running or each.given_up or len(self._runs) >= MAX_SERIES:
                self.drop(each)
        return True

    def close(self) -> None:
        """Close all."""
        while self._runs:
            self._runs.popitem()[1].close()
