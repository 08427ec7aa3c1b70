"""The gain of one sensor from loads that are set and entered one after the other."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from tactiled import surface
from tactiled.arrays import Floats
from tactiled.build import SensorPlan
from tactiled.calibrate.calibration_file import CalibrationFile
from tactiled.calibrate.counts.curves import Curves
from tactiled.calibrate.counts.means import Rails
from tactiled.calibrate.counts.plateaus import noise
from tactiled.calibrate.sections import gain_sections
from tactiled.errors import CalibrationStateError, ConfigError
from tactiled.frames import FrameSeries
from tactiled.guided.frame_collector import FrameCollector, origin, with_sections
from tactiled.guided.quality import Need, Quality, advice, enough, zone_counts
from tactiled.live.sensor import Sensor
from tactiled.processes import FitProcess
from tactiled.restore.noise import NORMAL_95
from tactiled.units import number_text

if TYPE_CHECKING:
    from tactiled.calibrate.counts.gain import GainFit

GainWay = Literal["uniform", "weight"]
MarkKey = Literal["pressure_kpa", "weight_n"]
MARKS: dict[GainWay, tuple[MarkKey, str]] = {"uniform": ("pressure_kpa", "kPa"), "weight": ("weight_n", "N")}
MIN_STEPS = 3  # pressures, 0 among them
MAX_DRIFT_SHARE = 0.02  # of a load: largest change within the second that is taken
MIN_MARK_FRAMES = 10  # the fit of a gain needs as many for its first guess of no load
STEADY_SIGMAS = 5.0  # of noise: one mark in a million is refused wrongly
CURVE_POINTS = 60  # of a plotted curve


@dataclass(frozen=True, slots=True, eq=False)
class GainOutcome:
    """Fitted gains, as applied and as shown."""

    file: CalibrationFile
    form: str
    kpa_per_count: float  # median over the taxels
    interval_kpa_per_count: tuple[float, float] | None  # 95 %; None: unknown, of a weight at one place
    before_kpa_per_count: float | None  # None: uncalibrated
    spread_percent: float | None
    hysteresis_percent: float | None
    notes: tuple[str, ...]
    line: Floats  # (3, n): counts over no load, measured and fitted kPa; NaN: none there


class GainProcedure:
    """Loads are set and entered one after the other; the last second of each is taken."""

    size_mm = None

    def __init__(self, sensor: Sensor, way: GainWay) -> None:
        self.way, self._sensor = way, sensor
        self.mark_key, self._unit = MARKS[way]
        self._marks: list[tuple[float, FrameSeries]] = []
        self._on_zero = ""  # the load that the newest mark of 0 had by the present calibration, in words

    def mark(self, series: FrameSeries, value: float) -> None:
        """Take frames under a known load, the last one again; CalibrationStateError where they cannot be."""
        begin = f"{self.mark_key} = {value:g}"
        if len(series.times) < MIN_MARK_FRAMES:
            raise CalibrationStateError(
                f"{begin}: {len(series.times)} frames since the last: wait for {MIN_MARK_FRAMES}"
            )
        if not self._marks and value:
            raise CalibrationStateError(f"{begin}: take 0 first, with nothing on the array")
        others = {each for each, _ in self._marks} - {0, value}
        if self.way == "weight" and value and others:
            raise CalibrationStateError(f"{begin}: use one weight only: {max(others):g} N was taken")
        self._require_steady(series, begin)
        if self._marks and self._marks[-1][0] == value:
            self._marks.pop()
        self._marks.append((value, series))
        if not value:
            self._on_zero = self._sensor.pipeline.load_during(np.asarray(series.counts, np.float32))

    def _require_steady(self, series: FrameSeries, begin: str) -> None:
        """CalibrationStateError where the readings move by more than noise and a share of the load."""
        totals = np.asarray(np.nansum(series.counts, axis=1, dtype=np.float64))
        first, second = (each.mean() for each in np.array_split(totals, 2))
        error = float(np.std(np.diff(totals))) * np.sqrt(2 / len(series.times))  # of the two means' difference
        zero = np.nansum((self._marks[0][1] if self._marks else series).counts, axis=1).mean()
        if abs(second - first) > STEADY_SIGMAS * error + MAX_DRIFT_SHARE * abs(float(totals.mean() - zero)):
            raise CalibrationStateError(f"{begin}: the readings still move: wait until they stand still")

    def quality(self, collector: FrameCollector) -> Quality:
        """The loads taken so far."""
        del collector
        loads = ", ".join(f"{value:g}" for value, _ in self._marks)
        need = Need("load", MIN_STEPS if self.way == "uniform" else 2)
        count = len(self._marks)
        zones = zone_counts(np.empty((0, 2)), self._sensor.array)
        text = advice(count, zones, need) if count else f"take 0 {self._unit} first, with nothing on the array"
        line = f"{text} ({loads} {self._unit})" if loads else text
        if self._on_zero:
            instead = "unload the array and take 0 again"
            line = f"0 {self._unit} was taken under a load ({self._on_zero}): if that is so, {instead}. {line}"
        return Quality(line, enough(count, zones, need), count, need.count)

    def fit(self, series: FrameSeries, process: FitProcess) -> GainOutcome:
        """Curves from the loads taken."""
        del series  # the loads taken hold what is needed
        if (count := len(self._marks)) < 2:
            loads = f"{count} load{'' if count == 1 else 's'}"
            raise ConfigError(f"{self.mark_key}: {loads}: take 0 with nothing on the array, and one more")
        frames = self._joined()
        fitted, plan, made = self._fitted(frames, process), self._sensor.plan, origin(f"gain: {self.way}, guided")
        file = with_sections(plan, **gain_sections(fitted, noise(frames.counts), made))
        return _outcome(plan, file, fitted)

    def _joined(self) -> FrameSeries:
        """The frames of all loads, as many of each, one after the other."""
        parts = [series for _, series in self._marks]
        length = min(len(series.times) for series in parts)
        times, counts = ([getattr(series, key)[-length:] for series in parts] for key in ("times", "counts"))
        return FrameSeries(np.concatenate(times), np.concatenate(counts))

    def _fitted(self, frames: FrameSeries, process: FitProcess) -> "GainFit":
        # Imported here, so that the service starts faster.
        from tactiled.calibrate.counts.force_gain import fit_weight, reach_of
        from tactiled.calibrate.counts.gain import fit_steps

        plan, values = self._sensor.plan, [value for value, _ in self._marks]
        limits = Rails.of(plan.calibration.saturation, plan.codec.ends)
        if self.way == "uniform":
            return process.run(fit_steps, frames, values, limits, self._sensor.array)
        array = self._sensor.array
        reach = reach_of(surface.make(plan.kernel, array, 1), array)
        return process.run(fit_weight, frames, max(values), array, limits, reach)


def _outcome(plan: SensorPlan, file: CalibrationFile, fitted: "GainFit") -> GainOutcome:
    from tactiled.calibrate.counts.gain import unlike_gain

    curves, before = fitted.curves, plan.calibration.kpa_per_count if plan.calibrated else None
    live = np.setdiff1d(np.arange(curves.size), fitted.dead)
    gains = curves.gain[live]
    middle = live[np.argsort(gains)[gains.size // 2]]
    gain, half = float(curves.gain[middle]), NORMAL_95 * float(curves.deviation[middle])
    half = fitted.common_error if np.isnan(half) else half  # of a weight the taxels' own are unknown
    ends = sorted(gain * (1 + side * half) for side in (-1, 1))
    hysteresis = curves.hysteresis[live]
    dead = [f"taxels without a response: {', '.join(map(str, fitted.dead))}"] if fitted.dead else []
    return GainOutcome(
        file=file,
        form=curves.form,
        kpa_per_count=gain,
        interval_kpa_per_count=(ends[0], ends[1]) if np.isfinite(half) else None,
        before_kpa_per_count=before,
        spread_percent=100 * fitted.spread if np.isfinite(fitted.spread) else None,
        hysteresis_percent=float(np.nanmedian(hysteresis)) if np.isfinite(hysteresis).any() else None,
        notes=(*unlike_gain(curves, before), *dead, *_elsewhere(curves), *fitted.notes),
        line=_gain_line(fitted, int(middle)),
    )


def _elsewhere(curves: Curves) -> tuple[str, ...]:
    """A note of the error where the pressure rises or falls in another way, if that is known."""
    if curves.error_kpa is None or not np.isfinite(curves.error_kpa).any():
        return ()
    error = number_text(float(np.nanmedian(curves.error_kpa)))
    return (f"error in a rise or fall that was left out: {error} kPa rms (median taxel); hysteresis is in it",)


def _gain_line(fitted: "GainFit", taxel: int) -> Floats:
    """Counts over no load (n,), measured and fitted kPa of one taxel."""
    low, high = fitted.curves.reach_counts[taxel]
    counts = np.linspace(0, low + high, CURVE_POINTS)
    each = (fitted.points.counts * fitted.points.weight).sum(axis=2)  # a weight lies on all together
    points = np.sign(low + high) * each[:, 0 if each.shape[1] == 1 else taxel]
    x = np.concatenate([counts, points])
    over = np.zeros((len(x), fitted.curves.size))
    over[:, taxel] = x
    curve = fitted.curves.pressure(over)[:, taxel]
    measured = np.concatenate([np.full(CURVE_POINTS, np.nan), fitted.points.pressure])
    return np.stack([x, measured, np.where(np.isnan(measured), curve, np.nan)])
