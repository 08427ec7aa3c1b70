"""The cover of one sensor from presses with a tip or an edge, or from anything that touches it."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from tactiled.calibrate.calibration_file import CalibrationFile
from tactiled.calibrate.cover_fit import CoverFit
from tactiled.calibrate.film import Film
from tactiled.calibrate.quality import Need, advice, enough, zone_counts
from tactiled.calibrate.sections import CoverSection
from tactiled.cover.stack import Stack
from tactiled.errors import CalibrationStateError
from tactiled.runtime.calibration_session import Quality, Report
from tactiled.runtime.frame_collector import FrameCollector
from tactiled.runtime.live_presses import LiveContact, LivePresses, presses_of, pressures
from tactiled.runtime.live_sections import origin, with_sections
from tactiled.runtime.sensor import Sensor

NEEDS = {"tip": Need("press", 20, per_zone=1), "edge": Need("edge", 5), "blind": Need("second", 60)}
GAIN_ERROR = 0.05  # relative standard deviation of taxels' gains that nobody measured


@dataclass(frozen=True, slots=True, eq=False)
class CoverOutcome:
    """A fitted cover; without a file where the frames cannot tell it."""

    file: CalibrationFile | None
    fit: CoverFit
    before_mm: float


class CoverProcedure:
    """Something touches the array while frames come."""

    mark_key = None

    def __init__(
        self, sensor: Sensor, stack: Stack, way: Literal["tip", "edge", "blind"], tip_mm: float | None
    ) -> None:
        self.way, self.tip_mm = way, tip_mm
        self._sensor, self._stack = sensor, stack  # as configured
        self._presses = LivePresses(sensor, border=way == "edge")
        self._contact = LiveContact(sensor)

    def mark(self, film: Film, value: float) -> None:
        """No load is entered."""
        del film, value
        raise CalibrationStateError(f"way = {self.way!r}: it needs no mark")

    def quality(self, collector: FrameCollector) -> Quality:
        """The presses so far, or the seconds of contact."""
        need = NEEDS[self.way]
        if self.way == "blind":
            self._contact.look(collector)
            seconds = int(self._contact.seconds)
            nowhere = np.zeros((1, 1), int)
            return Quality(advice(seconds, nowhere, need), enough(seconds, nowhere, need), seconds, need.count)
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

    def fit(self, film: Film, report: Report) -> CoverOutcome:
        """The thickness that explains the frames."""
        return self._outcome(self._fit_blind(film) if self.way == "blind" else self._fit_presses(film, report))

    def _fit_blind(self, film: Film) -> CoverFit:
        from tactiled.calibrate.blind import fit_blind  # imported where needed: it starts the service faster
        from tactiled.cover.family import CoverFamily

        sensor = self._sensor
        pressure, _ = pressures(sensor, film)
        frames = pressure.reshape(-1, *sensor.array.frame_shape)
        gain_error = float(np.median(self._gain_error()))
        return fit_blind(frames, sensor.pipeline.noise.kpa, CoverFamily(self._stack), sensor.array, gain_error)

    def _fit_presses(self, film: Film, report: Report) -> CoverFit:
        from tactiled.calibrate.cover_result import result  # imported where needed: it starts the service faster
        from tactiled.calibrate.cover_search import search
        from tactiled.calibrate.tip import Tip, tip_touch

        sensor = self._sensor
        presses = presses_of(sensor, film, border=self.way == "edge")
        report(0.1)
        touch = tip_touch(presses, sensor.array, self._stack, Tip(self.tip_mm), self._gain_error())
        fitted = search(touch)
        report(0.8)
        return result(fitted, "tip")

    def _gain_error(self) -> NDArray[np.float64] | float:
        curves = self._sensor.plan.calibration.curves
        return GAIN_ERROR if curves is None else curves.deviation

    def _outcome(self, fit: CoverFit) -> CoverOutcome:
        """What is applied of a fit, and what was before."""
        plan = self._sensor.plan
        factor = plan.file.cover.factor if plan.file and plan.file.cover else 1.0
        file = None
        if not fit.reason:
            file = with_sections(plan, cover=CoverSection.of(fit, self._stack, origin(fit.method)))
        return CoverOutcome(file, fit, before_mm=self._stack.depth * factor)
