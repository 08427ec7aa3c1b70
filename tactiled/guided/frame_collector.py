"""Frames of one sensor in counts, collected as they come, with bounded memory."""

import time

import numpy as np

from tactiled.arrays import Floats32
from tactiled.build import SensorPlan
from tactiled.calibrate import calibration_file
from tactiled.calibrate.calibration_file import CalibrationFile
from tactiled.calibrate.sections import Origin, Section, utc
from tactiled.frames import BAD, MISSING, FrameSeries, RawFrame

MAX_S = 120.0  # of frames that are collected: time for 20 presses of 5 s each
MAX_BYTES = 64 << 20  # of them: 120 s of 32 x 32 taxels at 100 Hz are 49 MB
LIVE = "live"  # the recording of frames that came from a bus


class FrameCollector:
    """Takes frames on one thread until it is full; any thread may read what it has."""

    def __init__(self, taxels: int, max_s: float = MAX_S, max_bytes: int = MAX_BYTES) -> None:
        self.max_s, self._taxels = max_s, taxels
        self._period_s = max_s * 4 * taxels / max_bytes  # frames that come closer together do not fit
        self._times: list[float] = []
        self._counts: list[Floats32] = []  # (N,) each

    def __len__(self) -> int:
        """Number of frames."""
        return len(self._counts)

    @property
    def seconds(self) -> float:
        """Time from the first frame to the last, s."""
        times = self._times
        return times[-1] - times[0] if times else 0.0

    @property
    def full(self) -> bool:
        """Whether it takes no more frames."""
        return self.seconds >= self.max_s - self._period_s

    def add(self, frame: RawFrame) -> None:
        """Take a frame, unless it is full or the frame comes too close behind the last one."""
        if self.full or (self._times and frame.arrived - self._times[-1] < self._period_s):
            return
        counts = frame.counts.astype(np.float32)
        counts[frame.flags & (MISSING | BAD) > 0] = np.nan
        self._times.append(frame.arrived)
        self._counts.append(counts)  # appended last: readers take its length

    def series(self, first: int = 0, seconds: float = np.inf) -> FrameSeries:
        """The frames from number `first` on, of the last `seconds` only."""
        last = len(self)
        times = np.array(self._times[first:last])
        if len(times):
            first += int(np.searchsorted(times, times[-1] - seconds))
        counts = self._counts[first:last]
        return FrameSeries(
            times[len(times) - len(counts) :], np.array(counts, np.float32).reshape(-1, self._taxels)
        )


def with_sections(plan: SensorPlan, **sections: Section) -> CalibrationFile:
    """A sensor's calibration file, or a first one, with these sections."""
    return calibration_file.with_sections(plan.file, plan.name, plan.codec_name, plan.array.size, **sections)


def origin(method: str) -> Origin:
    """Of a section made now."""
    return Origin(recording=LIVE, method=method, created=utc(time.time()))
