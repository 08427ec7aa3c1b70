"""One array as it runs: the restoration of its newest frame, its newest image, and its health."""

import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from math import inf, sqrt
from typing import Literal

import numpy as np

from tactiled.arrays import Floats32
from tactiled.build import SensorPlan
from tactiled.calibrate.calibration_file import CalibrationFile
from tactiled.calibrate.counts.tare import Zero
from tactiled.contacts.detection import Contact
from tactiled.errors import LoadedError, NoShearError, NotLiveError, TareStateError
from tactiled.frames import FrameWarning, Image, Loss, RawFrame
from tactiled.geometry import tiling
from tactiled.live.contact_tracking import ContactTracking
from tactiled.live.history import History
from tactiled.live.hub import Hub, Publisher
from tactiled.live.pipeline import Pipeline
from tactiled.live.region_monitor import RegionMonitor
from tactiled.live.timings import Timings
from tactiled.threads import FRAME_LOCK, join_started, run_on_thread

State = Literal["live", "stale", "silent", "down", "ended"]
JITTER_PERIODS = 100  # from frame to frame, whose standard deviation is the jitter
MAX_BUDGET_S = 1e-3  # for restoring a frame, unless it is configured
BUDGET_SHARE = 0.1  # of the time from frame to frame, the same
MAX_SHARES = 0.4  # of all sensors of a service together
REPLAYED = "recording"  # the clock of a sensor whose bus is a recording
QUICK_S = 5e-3  # of processor time for the frame before, up to which the bus's thread restores the next
MIN_RATE_WEIGHT = 0.02  # of a new period in the running mean, which else covers 1 s: at most 50 frames


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

    def add(self, period_s: float) -> None:
        """Take one more."""
        periods = self._periods
        periods.append(period_s)
        oldest = periods.popleft() if len(periods) > JITTER_PERIODS else 0.0
        self._sum += period_s - oldest
        self._squares += period_s**2 - oldest**2
        if (n := len(periods)) > 1:
            self.seconds = sqrt(max(self._squares - self._sum**2 / n, 0.0) / (n - 1))


class Sensor:
    """One array: its bus's thread or its own restores its newest frame; any may ask for images and health."""

    def __init__(
        self,
        plan: SensorPlan,
        clock: Callable[[], float] = time.monotonic,
        history: tuple[float, int] = (0.0, 0),  # s and bytes of images that are kept
    ) -> None:
        self.plan, self.name, self.codec, self.array = plan, plan.name, plan.codec, plan.array
        self.cells = plan.cells
        self.pipeline, self.hub, self.timings = Pipeline(plan, start=run_on_thread), Hub(), Timings()
        self.frames: Publisher[RawFrame] = Publisher()  # every one in counts, on the bus's thread
        self.sends: Publisher[tuple[Image, float]] = Publisher()  # each to a client, and when (s): event loop
        self.history = History(*history, plan.array.frame_shape, plan.cells.shape, plan.shears)
        self.regions = RegionMonitor(lambda: self.plan.cells)
        self.clock: str | None = None  # that gives the frames' times; None before the bus was first open
        self.down: str | None = None  # why the bus is not there; the bus's thread sets and clears it
        self.ended: str | None = None  # how the recording that was replayed ended
        self.counts: Callable[[], Loss] | None = None  # what its bus has counted by now
        self.errors: Callable[[], Mapping[str, int]] = dict  # error frames of its bus by now, by kind
        self.budget_share = BUDGET_SHARE  # set by the service, from the number of its sensors
        self.newest: RawFrame | None = None  # in counts; its image may not be made yet
        self.former: tuple[CalibrationFile, ...] = ()  # the newest first; those that were not written
        self._clock = clock
        self._tracking = ContactTracking(plan.name, self.hub, plan.array, plan.cells, self.deviation)
        self._between_frames = threading.Lock()  # is held while a frame is processed
        self._wake = threading.Condition()
        self._waiting: tuple[RawFrame, float] | None = None  # and when it was assembled (s)
        self._working = self._stopping = False
        self._turns = 0  # frames that are finished
        self._took_s = inf  # of processor time, the newest of them; before any, as the first builds its tables
        self._skipped = 0
        self._loss = Loss()
        self._warnings: dict[str, FrameWarning] = {}  # by code, since they were last drained
        self._failure: str | None = None  # why the last frame could not be restored
        self._arrived_at: float | None = None  # s, by `clock`: the newest frame
        self._period_s = 0.0  # running mean of the time between two arrivals
        self._jitter = _Jitter()
        self._thread = threading.Thread(target=self._work, name=f"restore {self.name}", daemon=True)

    @property
    def method(self) -> str:
        """Name of the method that is set."""
        return self.pipeline.method

    @property
    def turns(self) -> int | None:
        """Frames that are finished; None while there is none to restore."""
        return self._turns if self._working or self._waiting is not None else None

    @property
    def references(self) -> list[float | None] | None:
        """Counts of the newest frame's pads that feel no pressure, None of a missing one; None: it has none."""
        if self.newest is None or self.newest.references is None:
            return None
        return [None if np.isnan(each) else float(each) for each in self.newest.references]

    @property
    def areas_mm2(self) -> tuple[float, ...] | None:
        """Areas of the taxels, None: of a grid."""
        return None if self.array.shape else tuple(tiling(self.array).areas.tolist())

    def deviation(self, image: Image) -> Floats32:
        """Standard deviation of every cell of the newest restored image, in its unit."""
        return self.pipeline.deviation(image)

    def need_shear(self) -> None:
        """NoShearError where its skin feels none."""
        if not self.plan.shears:
            raise NoShearError(f"sensor {self.name!r}: its codec {self.plan.codec_name} carries no shear")

    def need_traction(self) -> None:
        """NoShearError where its shear is not restored."""
        self.need_shear()
        if not self.plan.restores_shear:
            raise NoShearError(
                f"sensor {self.name!r}: shear is not restored: that needs calibration.shear_n_per_count, "
                "kpa_per_count or a gain, and a cover that does not slide"
            )

    def contacts(self) -> tuple[Image | None, tuple[Contact, ...]]:
        """The newest image and the contacts in it, tracked while anybody asks; any thread."""
        return self._tracking.contacts()

    def tare(self, force: bool = False) -> None:
        """Take the mean of the next frames as the unloaded array; NotLiveError where none come.

        LoadedError where the newest frames show a load, unless it is by `force`.
        """
        status = self.status()
        if status.state != "live":
            raise NotLiveError(f"sensor {self.name!r}: {status.state}, {status.detail}: a tare needs frames")
        if not force and (load := self.pipeline.load_description()):
            raise LoadedError(
                f"sensor {self.name!r}: {load}: unload the array, or tare anyway with force=true", load
            )
        self.pipeline.tare(time.time(), force)

    def undo_tare(self) -> None:
        """Give up a tare under way, else take the zero from before the last; TareStateError without either."""
        with self._between_frames:
            if not self.pipeline.can_undo:
                raise TareStateError(f"sensor {self.name!r}: no tare to undo")
            self.pipeline.undo_tare()

    def set_zero(self, zero: Zero) -> None:
        """Take a zero from the next frame on."""
        with self._between_frames:
            self.pipeline.set_zero(zero)

    def recalibrate(self, plan: SensorPlan, commit: Callable[[], None]) -> None:
        """Go on by another plan of the same array from the next frame on; not where `commit` fails.

        The new pipeline is made first, so that frames wait for the exchange alone.
        """
        pipeline = Pipeline(plan, self.pipeline, run_on_thread)
        commit()
        with self._between_frames:
            pipeline.take_over(self.pipeline)
            self.plan, self.pipeline = plan, pipeline

    def lapse_tare(self) -> None:
        """Give up a tare under way if frames no longer come: what lies there later is no zero."""
        if self.state != "live":
            self.pipeline.lapse_tare()

    def drain_warnings(self) -> dict[str, FrameWarning]:
        """The newest warning of each code in the images since the last call."""
        with self._wake:
            warnings, self._warnings = self._warnings, {}
        return warnings

    def start(self) -> None:
        """Start restoring."""
        self._thread.start()
        self._tracking.start()

    def stop(self) -> None:
        """Stop restoring; returns when its threads have ended."""
        with self._wake:
            self._stopping = True
            self._wake.notify()
        join_started(self._thread)
        self._tracking.stop()

    def offer(self, frame: RawFrame, wake: bool = True) -> None:
        """Take a new frame; one that still waits for its turn is skipped and counted.

        Its own thread restores it. Without `wake` that thread begins only if frames take long; else the caller
        restores it by `take_turn`.
        """
        assembled = self._note_arrival(frame)
        with self._wake:
            self._skipped += self._waiting is not None
            if self._skipped:
                frame = replace(frame, loss=replace(frame.loss, skipped=self._skipped))
            self._waiting, self._loss = (frame, assembled), frame.loss
            if wake or self._took_s > QUICK_S:
                self._wake.notify()

    def take_turn(self) -> None:
        """Restore the frame that waits on the caller's thread, to save a hand-over, unless frames take long."""
        if self._took_s <= QUICK_S:
            self._restore_waiting()

    def restore(self, frame: RawFrame) -> None:
        """Restore a frame at once, on the caller's thread, so that none is skipped: for recordings."""
        now = self._note_arrival(frame)
        self._loss = frame.loss
        self._publish(frame, inf, (now, now))

    def note_send(self, image: Image) -> None:
        """A client is sent an image now; on the event loop."""
        now = time.monotonic()
        self.timings.add_send(image, now)
        self.sends.publish((image, now))

    def _note_arrival(self, frame: RawFrame) -> float:
        """A frame comes now: the time (s)."""
        last, self.newest = self.newest, frame
        if last is None or not 0 <= frame.time - last.time < self.plan.stale_after_s:
            self._jitter = _Jitter()
        elif frame.sequence == last.sequence + 1:
            self._jitter.add(frame.time - last.time)
        now = self._clock()
        if self._arrived_at is not None:
            gap = now - self._arrived_at
            if gap > self.plan.stale_after_s:
                self.pipeline.lapse_tare()
                self._period_s = 0.0  # a break is no period
            else:
                weight = min(1.0, max(gap, MIN_RATE_WEIGHT)) if self._period_s else 1.0
                self._period_s += (gap - self._period_s) * weight
        self._arrived_at = now
        self.frames.publish(frame)
        return now

    def _work(self) -> None:
        while True:
            with self._wake:
                self._wake.wait_for(lambda: self._stopping or (self._waiting is not None and not self._working))
                if self._stopping:
                    return
            self._restore_waiting()

    def _begin_turn(self) -> tuple[RawFrame, float] | None:
        """The frame that waits; None where there is none, or a thread is at the one before."""
        with self._wake:
            if self._waiting is None or self._working:
                return None
            waiting, self._waiting, self._working = self._waiting, None, True
            return waiting

    def _restore_waiting(self) -> None:
        """Restore the frame that waits, if it is its turn."""
        if (waiting := self._begin_turn()) is None:
            return
        frame, assembled = waiting
        began = time.thread_time()
        self._publish(frame, self._budget_s(), (frame.arrived, assembled))
        self._took_s = time.thread_time() - began
        self._turns += 1
        with self._wake:
            self._working = False
            if self._waiting is not None:
                self._wake.notify()

    def _budget_s(self) -> float:
        """Time for restoring a frame."""
        if self.plan.budget_s is not None:
            return self.plan.budget_s
        return min(self.budget_share * self._period_s, MAX_BUDGET_S) if self._period_s else MAX_BUDGET_S

    def _publish(self, frame: RawFrame, budget_s: float, came: tuple[float, float]) -> None:
        """Publish one image; a frame that cannot be restored ends neither the thread nor the service.

        `came` is when it arrived and was assembled (s).
        """
        try:
            with self._between_frames, FRAME_LOCK:
                image = self.pipeline.process(frame, budget_s, came)
            self.regions.add(image)
            self.hub.publish(image)
            self.timings.add(image, time.monotonic())
            self.history.add(image)
            if image.warnings:
                with self._wake:
                    self._warnings.update((each.code, each) for each in image.warnings)
            self._failure = None
        except Exception as error:
            self._failure = f"restoration failed: {type(error).__name__}: {error}"

    def status(self) -> Status:
        """Health at this moment."""
        age = self._age()
        state, detail = self._judge(age)
        live = state == "live"
        return Status(
            state=state,
            age_s=age,
            rate_hz=1 / self._period_s if live and self._period_s else 0.0,
            detail=detail,
            loss=replace(self.counts(), skipped=self._skipped) if self.counts else self._loss,
            jitter_s=self._jitter.seconds if live else None,
            skew_s=self.newest.skew if self.newest else None,
            errors=self.errors(),
            tared_at=self.pipeline.zero.time,
            position_s=self._position(),
        )

    @property
    def state(self) -> State:
        """State of `status`, at less cost."""
        return self._judge(self._age())[0]

    def _position(self) -> float | None:
        if self.clock != REPLAYED:
            return None
        return self.newest.arrived if self.newest else 0.0

    def _age(self) -> float | None:
        return None if self._arrived_at is None else max(0.0, self._clock() - self._arrived_at)

    def _judge(self, age: float | None) -> tuple[State, str]:
        """State and detail: the first condition that holds."""
        if self.down is not None:
            return "down", self.down
        if self.ended is not None:
            return "ended", self.ended
        if age is None:
            return "silent", f"no frame yet on {self.plan.bus}"
        if age > self.plan.stale_after_s:
            return "stale", f"no frame for {age:.1f} s"
        return ("stale", self._failure) if self._failure else ("live", "")
