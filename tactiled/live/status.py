"""How a sensor is doing: when its frames come in, and what its bus says."""

import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from math import exp, sqrt
from typing import Literal

from tactiled.build import SensorPlan
from tactiled.frames import Loss, RawFrame

State = Literal["live", "stale", "silent", "down", "ended"]
JITTER_PERIODS = 100  # from frame to frame, whose standard deviation is the jitter
REPLAYED = "recording"  # the clock of a sensor whose bus is a recording
RATE_S = 1.0  # after which a period counts for 1/e in the mean


@dataclass(frozen=True, slots=True)
class Status:
    """How a sensor is doing now."""

    state: State
    age_s: float | None  # since the last frame came in; None before the first
    rate_hz: float  # frames a second, over the last second or so; 0 unless live
    detail: str  # one line for people
    loss: Loss
    jitter_s: float | None = None  # standard deviation of the last periods from frame to frame; None unless live
    skew_s: float | None = None  # from the newest frame's first message to its last; None before the first
    errors: Mapping[str, int] = field(default_factory=dict)  # error frames of the bus, by kind
    tared_at: float | None = None  # s, Unix, of the tare that holds; None: not tared
    position_s: float | None = None  # of the newest frame in a replayed recording; None: on a bus


class _Jitter:
    """Standard deviation of the last JITTER_PERIODS periods (s), by their sums: it costs next to nothing."""

    def __init__(self) -> None:
        self._periods: deque[float] = deque()
        self._sum = self._squares = 0.0
        self.seconds: float | None = None  # None before two periods

    def include(self, period_s: float) -> None:
        """Take one more."""
        periods = self._periods
        periods.append(period_s)
        oldest = periods.popleft() if len(periods) > JITTER_PERIODS else 0.0
        self._sum += period_s - oldest
        self._squares += period_s**2 - oldest**2
        if (n := len(periods)) > 1:
            self.seconds = sqrt(max(self._squares - self._sum**2 / n, 0.0) / (n - 1))


class Health:
    """The state of one sensor; what the bus's thread sets, any thread may read."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self.clock: str | None = None  # that gives the frames' times; None before the bus was first open
        self.down: str | None = None  # why the bus is not there
        self.ended: str | None = None  # how the recording that was replayed ended
        self.counts: Callable[[], Loss] | None = None  # what its bus has counted by now
        self.errors: Callable[[], Mapping[str, int]] = dict  # error frames of its bus by now, by kind
        self.failure: str | None = None  # why the last frame could not be restored
        self.newest: RawFrame | None = None  # in counts; its image may not be made yet
        self.period_s = 0.0  # running mean of the time between two arrivals; 0: unknown
        self._periods = self._span_s = 0.0  # how many are in it, and their sum, each by its weight
        self._clock = clock
        self._arrived_at: float | None = None  # s, by `clock`: the newest frame
        self._jitter = _Jitter()

    def note_arrival(self, frame: RawFrame, stale_after_s: float) -> tuple[float, bool]:
        """A frame comes now: the time (s), and whether none had come for `stale_after_s`."""
        last, self.newest = self.newest, frame
        if last is None or not 0 <= frame.time - last.time < stale_after_s:
            self._jitter = _Jitter()
        elif frame.sequence == last.sequence + 1:
            self._jitter.include(frame.time - last.time)
        now, before = self._clock(), self._arrived_at
        self._arrived_at = now
        if before is None:
            return now, False
        gap = now - before
        if gap > stale_after_s:
            self.period_s = self._periods = self._span_s = 0.0  # a break is no period
            return now, True
        kept = exp(-gap / RATE_S)
        self._periods, self._span_s = kept * self._periods + 1, kept * self._span_s + gap
        self.period_s = self._span_s / self._periods
        return now, False

    def status(self, plan: SensorPlan, loss: Loss, skipped: int, tared_at: float | None) -> Status:
        """Health at this moment; `loss` counts where there is no bus."""
        state, detail = self.judge(plan)
        live = state == "live"
        position_s = None if self.clock != REPLAYED else self.newest.arrived if self.newest else 0.0
        return Status(
            state=state,
            age_s=self._age(),
            rate_hz=1 / self.period_s if live and self.period_s else 0.0,
            detail=detail,
            loss=replace(self.counts(), skipped=skipped) if self.counts else loss,
            jitter_s=self._jitter.seconds if live else None,
            skew_s=self.newest.skew if self.newest else None,
            errors=self.errors(),
            tared_at=tared_at,
            position_s=position_s,
        )

    def _age(self) -> float | None:
        return None if self._arrived_at is None else max(0.0, self._clock() - self._arrived_at)

    def judge(self, plan: SensorPlan) -> tuple[State, str]:
        """State and detail: the first condition that holds."""
        if self.down is not None:
            return "down", self.down
        if self.ended is not None:
            return "ended", self.ended
        if (age := self._age()) is None:
            return "silent", f"no frame yet on {plan.bus}"
        if age > plan.stale_after_s:
            return "stale", f"no frame for {age:.1f} s"
        return ("stale", self.failure) if self.failure else ("live", "")
