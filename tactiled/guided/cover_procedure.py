"""The cover of one sensor from presses with a tip or an edge, or from anything that touches it."""

from dataclasses import dataclass, replace

import numpy as np

from tactiled.calibrate.calibration_file import CalibrationFile
from tactiled.calibrate.cover.fit import CoverFit, Method
from tactiled.calibrate.sections import CoverSection
from tactiled.cover.stack import Stack
from tactiled.errors import CalibrationStateError
from tactiled.frames import FrameSeries
from tactiled.guided.frame_collector import FrameCollector, origin, with_sections
from tactiled.guided.live_presses import LiveContact, LivePresses
from tactiled.guided.quality import Need, Quality, advice, enough, zone_counts
from tactiled.live.sensor import Sensor
from tactiled.processes import FitProcess

NEEDS = {"tip": Need("press", 20, per_zone=1), "edge": Need("edge", 5), "blind": Need("second", 60)}


@dataclass(frozen=True, slots=True, eq=False)
class CoverOutcome:
    """A fitted cover; without a file where the frames cannot tell it."""

    file: CalibrationFile | None
    fit: CoverFit
    before_mm: float


class CoverProcedure:
    """Something touches the array while frames come."""

    mark_key = None

    def __init__(self, sensor: Sensor, stack: Stack, way: Method, size_mm: float | None) -> None:
        self.way: Method = way
        self.size_mm = size_mm
        self._sensor, self._stack = sensor, stack  # as configured
        self._presses = LivePresses(sensor, border=way == "edge")
        self._contact = LiveContact(sensor)

    def mark(self, series: FrameSeries, value: float) -> None:
        """No load is entered."""
        del series, value
        raise CalibrationStateError(f"way = {self.way!r}: it needs no mark")

    def quality(self, collector: FrameCollector) -> Quality:
        """The presses so far, or the seconds of contact."""
        need = NEEDS[self.way]
        if self.way == "blind":
            self._contact.look(collector)
            seconds = int(self._contact.seconds)
            line = f"{seconds} of {need.count} s of contact"
            return Quality(line, seconds >= need.count, seconds, need.count)
        live = self._presses
        live.look(collector)
        zones = zone_counts(np.array([each.place_mm for each in live.usable]), self._sensor.array)
        count = len(live.usable)
        return Quality(
            advice(count, zones, need),
            enough(count, zones, need),
            presses=count,
            presses_needed=need.count,
            presses_saturated=live.saturated,
            last_unused=live.waiting or (live.ended[-1].reason if live.ended else ""),
            zones=tuple(map(tuple, zones.tolist())) if need.per_zone else (),
            zone_presses_needed=need.per_zone,
        )

    def fit(self, series: FrameSeries, process: FitProcess) -> CoverOutcome:
        """The thickness that explains the frames."""
        # Imported here, so that the service starts faster.
        from tactiled.calibrate.cover.recorded_touch import RecordedTouch, fit_touch

        sensor = self._sensor
        now = sensor.pipeline.calibrator
        dead = tuple(np.flatnonzero(now.dead | (now.faulty > 0)).tolist())
        calibration = replace(sensor.plan.calibration, no_loads=now.no_load.astype(float), dead=dead)
        recorded = RecordedTouch(series, sensor.array, self._stack, calibration, sensor.codec.ends)
        return self._outcome(process.run(fit_touch, recorded, self.way, self.size_mm))

    def _outcome(self, fit: CoverFit) -> CoverOutcome:
        """What is applied of a fit, and what was before."""
        plan = self._sensor.plan
        factor = plan.file.cover.factor if plan.file and plan.file.cover else 1.0
        file = None
        if fit.objection:
            fit = replace(fit, reason=fit.objection)
        if not fit.reason:
            file = with_sections(plan, cover=CoverSection.of(fit, self._stack, origin(fit.method)))
        return CoverOutcome(file, fit, before_mm=self._stack.depth * factor)
