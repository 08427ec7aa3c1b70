"""Presses in frames that still come: each frame is looked at a few times, not at every look."""

import numpy as np

from tactiled.arrays import Floats32, Mask
from tactiled.calibrate.cover.presses import (
    MAX_UNLOADED_FRAMES,
    SETTLING_FRAMES,
    SMOOTHED_FRAMES,
    Press,
    find_presses,
)
from tactiled.errors import ConfigError
from tactiled.frames import MISSING, SATURATED, FrameSeries
from tactiled.guided.frame_collector import FrameCollector
from tactiled.live.sensor import Sensor
from tactiled.restore.noise import detection_threshold

SATURATED_REASON = "saturated"  # begins the reason of such a press
FREE_FRAMES = 2 * MAX_UNLOADED_FRAMES  # without a load, around a press: its zero is the mean of them
RAMP_FRAMES = SETTLING_FRAMES + SMOOTHED_FRAMES  # after a plateau, in which its press ends


def pressures(sensor: Sensor, series: FrameSeries) -> tuple[Floats32, Mask]:
    """A series' pressure (T, N) in kPa, NaN: unknown, as the sensor is calibrated now, and what is saturated."""
    missing = np.where(np.isnan(series.counts), MISSING, 0).astype(np.uint8)
    pressure, flags = sensor.pipeline.calibrator.series(np.nan_to_num(series.counts), missing)
    return pressure, flags & SATURATED > 0


def presses_of(sensor: Sensor, series: FrameSeries, border: bool) -> list[Press]:
    """All presses of a series; ConfigError where no frame is without a load."""
    pressure, saturated = pressures(sensor, series)
    return find_presses(pressure, sensor.array, sensor.pipeline.noise.kpa, saturated, border)


class LivePresses:
    """The presses that have ended, of a collector that only grows."""

    def __init__(self, sensor: Sensor, border: bool) -> None:
        self._sensor, self._border = sensor, border
        self._first = 0  # frame that the next look begins with
        self._counted = 0  # the next press begins after this frame
        self.ended: list[Press] = []
        self.waiting = ""  # why no press can be told apart now

    def look(self, collector: FrameCollector) -> None:
        """Look at the frames since the last press, and as many before it as its zero needs."""
        series = collector.series(self._first)
        count = len(series.times)
        if count < FREE_FRAMES:
            return
        try:
            presses = presses_of(self._sensor, series, self._border)
        except ConfigError as error:
            self.waiting = str(error)
            return
        self.waiting = ""
        new = [each for each in presses if self._first + each.start >= self._counted]
        ended = [each for each in new if each.end + FREE_FRAMES // 2 < count]
        self.ended += ended
        if ended:
            self._counted = self._first + ended[-1].end + RAMP_FRAMES
            self._first += max(0, ended[-1].start - FREE_FRAMES)
        elif not new:
            self._first += max(0, count - 2 * FREE_FRAMES)

    @property
    def usable(self) -> list[Press]:
        """Those that can be used."""
        return [each for each in self.ended if not each.reason]

    @property
    def saturated(self) -> int:
        """How many are saturated."""
        return sum(each.reason.startswith(SATURATED_REASON) for each in self.ended)


class LiveContact:
    """Seconds of contact in the frames of a collector."""

    def __init__(self, sensor: Sensor) -> None:
        self._sensor, self._first = sensor, 0
        self.seconds = 0.0

    def look(self, collector: FrameCollector) -> None:
        """Look at the frames that have come since."""
        series = collector.series(self._first)
        if len(series.times) < FREE_FRAMES:
            return
        pressure, _ = pressures(self._sensor, series)
        peak = np.nan_to_num(pressure).max(axis=1)
        share = np.mean(peak > detection_threshold(self._sensor.pipeline.noise.kpa, self._sensor.array.size))
        self.seconds += float(share * (series.times[-1] - series.times[0]))
        self._first += len(series.times) - 1
