"""How long the frames of a sensor take, in histograms: a time waits until it is counted with many others."""

from collections import deque
from collections.abc import Sequence
from threading import Lock

import numpy as np

from tactiled.arrays import Floats
from tactiled.frames import SensorImage, StageTimes

BOUNDS_S = (*(round(step * 10.0**power, 6) for power in range(-5, 0) for step in (1, 2, 5)), 1.0)  # 10 µs to 1 s
STAGES = ("assemble", "wait", "calibrate", "restore", "check", "publish")
MAX_WAITING = 256  # times of one kind that are not counted yet


class Histogram:
    """How many times fell below each bound of BOUNDS_S; one thread counts, any thread reads."""

    __slots__ = ("counts", "sum_s")

    def __init__(self) -> None:
        self.counts = [0] * (len(BOUNDS_S) + 1)  # in (bound before, bound]; the last: above all
        self.sum_s = 0.0

    def count(self, seconds: Sequence[float] | Floats) -> None:
        """Count some times."""
        found = np.bincount(np.searchsorted(BOUNDS_S, seconds), minlength=len(self.counts))
        self.counts = (found + self.counts).tolist()
        self.sum_s += float(np.sum(seconds))


class Timings:
    """The histograms of one sensor."""

    def __init__(self) -> None:
        self._stages = {stage: Histogram() for stage in STAGES}
        self._methods: dict[str, Histogram] = {}
        self._ages = {place: Histogram() for place in ("publish", "send")}
        self._published: deque[tuple[str, StageTimes, float]] = deque()  # method, times, and when it was, s
        self._sent: deque[float] = deque()  # ages, s
        self._counting = Lock()

    @property
    def stages(self) -> dict[str, Histogram]:
        """Of each stage of a frame's way."""
        self._count_waiting()
        return self._stages

    @property
    def methods(self) -> dict[str, Histogram]:
        """Of restoring alone, by the method that ran."""
        self._count_waiting()
        return self._methods

    @property
    def ages(self) -> dict[str, Histogram]:
        """Of a frame's age, since its last message came, by where it is."""
        self._count_waiting()
        return self._ages

    def note(self, image: SensorImage, published: float) -> None:
        """Count an image that was published at `published` (s); for the thread that restores."""
        if image.times is None:
            return
        self._published.append((image.method, image.times, published))
        if len(self._published) >= MAX_WAITING:
            self._count_waiting()

    def note_send(self, image: SensorImage, time: float) -> None:
        """Count an image that a client was sent at `time` (s); for the event loop."""
        if image.times is None:
            return
        self._sent.append(time - image.times.last_message)
        if len(self._sent) >= MAX_WAITING:
            self._count_waiting()

    def _count_waiting(self) -> None:
        """Count all that waits; any thread."""
        with self._counting:
            published = [self._published.popleft() for _ in range(len(self._published))]
            self._ages["send"].count([self._sent.popleft() for _ in range(len(self._sent))])
            if published:
                self._count_published(published)

    def _count_published(self, published: list[tuple[str, StageTimes, float]]) -> None:
        times = np.array([(*each[1:], then) for _, each, then in published])
        for histogram, seconds in zip(self._stages.values(), np.diff(times).T, strict=True):
            histogram.count(seconds)
        self._ages["publish"].count(times[:, -1] - times[:, 0])
        for name in {method for method, _, _ in published}:
            restoring = [each.restored - each.calibrated for method, each, _ in published if method == name]
            self._methods.setdefault(name, Histogram()).count(restoring)
