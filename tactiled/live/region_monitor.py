"""What the images of one sensor hold in its regions, image by image, with peaks, integrals and thresholds."""

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from threading import Lock
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactiled.arrays import Floats, Floats32
from tactiled.contacts.detection import BEGIN_SIGMAS
from tactiled.contacts.regions import NOT_KNOWN, TOTAL, Measures, Region, RegionMeter
from tactiled.frames import MISSING, SensorImage
from tactiled.geometry import Raster
from tactiled.units import Unit

SERIES_S = 600.0
MAX_RATE_HZ = 100.0  # that a series keeps; of a faster sensor it keeps fewer images,
MIN_GAP_S = 0.9 / MAX_RATE_HZ  # so far apart at least: frames jitter
MAX_REGIONS = 16  # of a sensor: each series has 1.6 MB
MAX_CROSSINGS = 64  # between two looks, ten a second
MAX_GAP_S = 1.0  # between two images that an integral bridges


class Crossing(NamedTuple):
    """A value went over its threshold, or came back under it."""

    region: str
    above: bool
    value: float


@dataclass(frozen=True, slots=True)
class Summary:
    """What a region holds now, and has held since `since`."""

    now: Measures
    highest: Measures  # each on its own
    impulse: float  # integral of force over time, N s, or counts mm2 s
    pressure_time: float  # integral of the peak pressure over time, in the image's unit times s
    since: float  # s, Unix
    exceeded: bool  # the threshold is
    unit: Unit


class Series(NamedTuple):
    """Values of a region in T images."""

    time: Floats  # (T,) s
    values: Floats32  # (T, 4) fields of Measures; NaN: not known
    missing: NDArray[np.int64]  # (T,) taxels of the array that did not arrive
    unit: Unit

    def of(self, images: slice | list[int]) -> "Series":
        """Of some of these images."""
        return Series(self.time[images], self.values[images], self.missing[images], self.unit)


class RegionSeries:
    """One region: its cells, its newest 10 minutes, and what has come together since it was reset."""

    def __init__(self, name: str, region: Region, cells: Raster) -> None:
        self.name, self.region = name, region
        self.measure = RegionMeter(region, cells)
        slots = int(SERIES_S / MIN_GAP_S) + 1
        self._time, self._values = np.zeros(slots), np.zeros((slots, len(Measures._fields)), np.float32)
        self._missing = np.zeros(slots, np.int64)
        self._count = 0
        self._lock = Lock()
        self.exceeded = False
        self._now = NOT_KNOWN
        self._last = self._stored = -np.inf  # s, of the newest image, and of the newest in the series
        self._unit: Unit = "kPa"
        self._forget()

    def take_threshold(self, region: Region) -> bool:
        """Go on as a region that has the same place; False, and nothing changed, where it has another."""
        same = self.region.model_copy(update={"threshold": region.threshold}) == region
        if same and self.region != region:
            self.region, self.exceeded = region, False
        return same

    def reset(self) -> None:
        """Forget peaks and integrals."""
        with self._lock:
            self._forget()

    def _forget(self) -> None:
        self._highest = np.full(len(Measures._fields), -np.inf)
        self._impulse = self._pressure_time = 0.0
        self._since = np.nan

    def watch(self, image: SensorImage) -> float | None:
        """Measure an image; the value that has crossed the threshold, None where none has."""
        gap = image.time - self._last
        now = self.measure(image)
        if not (image.noise_known or now.peak > BEGIN_SIGMAS * image.cell_noise):
            now = NOT_KNOWN  # it may be noise alone
        with self._lock:
            self._now = now
            if image.unit != self._unit:
                self._unit, gap = image.unit, -np.inf  # nothing goes on from another unit
                self._forget()
            if gap < 0:
                self._count, self._stored = 0, -np.inf
            if image.time - self._stored >= MIN_GAP_S:
                slot = self._count % len(self._time)
                self._time[slot], self._values[slot] = image.time, now
                self._missing[slot] = np.count_nonzero(image.flags & MISSING)
                self._count, self._stored = self._count + 1, image.time
            self._since = image.time if np.isnan(self._since) else self._since
            np.fmax(self._highest, now, out=self._highest)
            if 0 < gap <= MAX_GAP_S and now.force == now.force:
                self._impulse += now.force * gap
                self._pressure_time += max(now.peak, 0.0) * gap
            self._last = image.time
        return self._crossed(now)

    def _crossed(self, now: Measures) -> float | None:
        limit = self.region.threshold
        if limit is None:
            return None
        value: float = getattr(now, limit.quantity)
        if not (value < limit.below if self.exceeded else value > limit.above):
            return None
        self.exceeded = not self.exceeded
        return value

    def summary(self) -> Summary | None:
        """What it holds now; None before the first image."""
        with self._lock:
            if not self._count:
                return None
            highest = Measures(*np.where(np.isfinite(self._highest), self._highest, np.nan).tolist())
            integrals = self._impulse, self._pressure_time
            return Summary(self._now, highest, *integrals, self._since, self.exceeded, self._unit)

    def series(self, seconds: float, points: int, until: float | None = None) -> "Series":
        """The last `seconds` before `until` (s), or the newest; of more than `points` images the highest ones."""
        with self._lock:
            length = min(self._count, len(self._time))
            order = np.arange(self._count - length, self._count) % len(self._time)
            series = Series(self._time[order], self._values[order], self._missing[order], self._unit)
        end = length if until is None else int(np.searchsorted(series.time, until, "right"))
        series = series.of(slice(np.searchsorted(series.time, series.time[end - 1] - seconds) if end else 0, end))
        if len(series.time) <= points:
            return series
        bounds = np.linspace(0, len(series.time), points + 1).astype(int)
        peak = np.nan_to_num(series.values[:, Measures._fields.index("peak")], nan=-np.inf)
        return series.of([a + int(peak[a:b].argmax()) for a, b in pairwise(bounds)])


class RegionMonitor:
    """The regions of one sensor."""

    def __init__(self, cells: Callable[[], Raster]) -> None:
        self._cells = cells
        self.series: Mapping[str, RegionSeries] = {}  # by name of the region; replaced, never changed
        self._crossings: deque[Crossing] = deque(maxlen=MAX_CROSSINGS)

    @property
    def regions(self) -> dict[str, Region]:
        """By name."""
        return {name: each.region for name, each in self.series.items()}

    def put(self, name: str, region: Region) -> None:
        """Watch a region; ValueError, and nothing changed, where its name or place is wrong or there are too many.

        One of that name that has the same place goes on with its series, maybe by another threshold.
        """
        if name == TOTAL:
            raise ValueError(f"region = {name!r}: a series has this name for the array: give another")
        region.check()
        if (series := self.series.get(name)) and series.take_threshold(region):
            return
        if series is None and len(self.series) >= MAX_REGIONS:
            raise ValueError(f"{MAX_REGIONS} regions a sensor at most")
        self.series = {**self.series, name: RegionSeries(name, region, self._cells())}

    def remove(self, name: str) -> None:
        """Watch a region no longer; KeyError where there is none."""
        series = dict(self.series)
        del series[name]
        self.series = series

    def watch(self, image: SensorImage) -> None:
        """Measure every region in an image: on the sensor's thread."""
        for name, each in self.series.items():
            value = each.watch(image)
            if value is not None:
                self._crossings.append(Crossing(name, each.exceeded, value))

    def drain_crossings(self) -> list[Crossing]:
        """The crossings of thresholds since the last call, oldest first."""
        return [self._crossings.popleft() for _ in range(len(self._crossings))]
