"""One array as it runs: its worker thread, its newest image, and its health."""

import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from tactiled.build import SensorPlan
from tactiled.contacts.detection import Contact
from tactiled.errors import LoadedError, NoShearError, NotLiveError
from tactiled.frames import Image, Loss, RawFrame
from tactiled.restore.methods import METHODS
from tactiled.runtime.contact_tracking import Touch
from tactiled.runtime.history import History
from tactiled.runtime.hub import Hub
from tactiled.runtime.pipeline import Pipeline
from tactiled.runtime.watch import Heard

State = Literal["live", "stale", "silent", "down"]
PERIODS = 100  # from frame to frame, of which the jitter is told


@dataclass(frozen=True, slots=True)
class Status:
    """How a sensor is doing now."""

    state: State
    age_s: float | None  # s since the last frame came in; None before the first
    rate_hz: float  # frames a second, over the last second or so; 0 unless live
    detail: str  # one line for people
    loss: Loss
    jitter_s: float | None = None  # standard deviation of the last periods from frame to frame; None unless live
    skew_s: float | None = None  # from the newest frame's first message to its last; None before the first
    errors: Mapping[str, int] = field(default_factory=dict)  # what the bus's error frames told, by kind


class Sensor:
    """One array: a worker thread that restores its newest frame, the newest image, and its health."""

    def __init__(
        self,
        plan: SensorPlan,
        clock: Callable[[], float] = time.monotonic,
        history: tuple[float, int] = (0.0, 0),  # s and bytes of images that are kept
    ) -> None:
        self.name, self.bus_name, self.codec_name, self.codec = plan.name, plan.bus, plan.codec_name, plan.codec
        self.array, self.kernel, self.cells = plan.array, plan.kernel, plan.cells
        self.calibration = plan.calibration
        self.methods = tuple(METHODS)
        self.hub, self.heard = Hub(), Heard()
        self.shears = plan.shears
        self.history = History(*history, plan.array.frame_shape, plan.blur.surface_shape, self.shears)
        self.clock: str | None = None  # that gives the frames' times; None before the bus was first open
        self.down: str | None = None  # why the bus is not there; the bus's thread sets and clears it
        self.counts: Callable[[], Loss] | None = None  # what its bus has counted by now
        self.errors: Callable[[], Mapping[str, int]] = dict  # what its bus's error frames have told by now
        self.plan, self._clock = plan, clock
        self._pipeline = Pipeline(plan.name, plan.array, plan.blur, plan.calibration, plan.method, plan.warnings)
        self._touch = Touch(plan.name, self.hub, plan.array, plan.cells)
        self._wake = threading.Condition()
        self._waiting: RawFrame | None = None
        self._stopping = False
        self._skipped = 0
        self._last: float | None = None
        self._period = 0.0
        self._loss = Loss()
        self._newest: RawFrame | None = None
        self._periods: deque[float] = deque(maxlen=PERIODS)
        self._jitter: float | None = None
        self._failed: str | None = None
        self._thread = threading.Thread(target=self._work, name=f"restore {self.name}", daemon=True)

    @property
    def method(self) -> str:
        """Name of the method asked for."""
        return self._pipeline.method

    @property
    def newest(self) -> RawFrame | None:
        """The newest frame in counts, None before the first; its image may not be made yet."""
        return self._newest

    def need_shear(self) -> None:
        """NoShearError where its skin feels none."""
        if not self.shears:
            raise NoShearError(f"sensor {self.name!r}: its codec {self.codec_name} carries no shear")

    def set_method(self, name: str) -> None:
        """Restore by `name` from the next frame on; ConfigError if there is no such method."""
        self._pipeline.set_method(name)

    def deviation(self, image: Image) -> NDArray[np.float32]:
        """Standard deviation (kPa) of every cell of `image.restored`, given its frame and the noise."""
        return self._pipeline.deviation(image)

    def contacts(self) -> tuple[Image | None, tuple[Contact, ...]]:
        """The newest image and the contacts in it, tracked while anybody asks; any thread."""
        return self._touch.contacts()

    def forces(self, frame: RawFrame) -> NDArray[np.float64] | None:
        """Force (N, 3) in N on each taxel, along x and y and into the skin; None unless all are known."""
        return self._pipeline.forces(frame)

    def tare(self, force: bool = False) -> None:
        """Take the mean of the next frames as the unloaded array; NotLiveError where none come.

        LoadedError where the newest frames show a load, unless it is by `force`.
        """
        status = self.status()
        if status.state != "live":
            raise NotLiveError(f"sensor {self.name!r}: {status.state}, {status.detail}: a tare needs frames")
        if not force and (seen := self._pipeline.load_seen()):
            raise LoadedError(
                f"sensor {self.name!r}: {seen}: unload the array, or tare anyway with force=true", seen
            )
        self._pipeline.tare()

    def lapse(self) -> None:
        """Give up a tare under way if frames no longer come: what lies there later is no zero."""
        if self.status().state != "live":
            self._pipeline.lapse()

    @property
    def no_load(self) -> NDArray[np.float32]:
        """Counts of each taxel (N,) without a load, as configured or last tared."""
        return self._pipeline.no_load

    @property
    def noise_kpa(self) -> float:
        """Standard deviation of a taxel, configured or measured."""
        return self._pipeline.noise_kpa

    @property
    def tared(self) -> int:
        """How often it was tared."""
        return self._pipeline.tared

    @property
    def lapsed(self) -> int:
        """How often a tare was given up."""
        return self._pipeline.lapsed

    def start(self) -> None:
        """Start restoring."""
        self._thread.start()
        self._touch.start()

    def stop(self) -> None:
        """Stop restoring; returns when its threads have ended."""
        with self._wake:
            self._stopping = True
            self._wake.notify()
        if self._thread.ident is not None:
            self._thread.join()
        self._touch.stop()

    def offer(self, frame: RawFrame) -> None:
        """Take a new frame; one that still waits for its turn is skipped and counted."""
        self._note_time(frame)
        with self._wake:
            self._skipped += self._waiting is not None
            self._waiting = replace(frame, loss=replace(frame.loss, skipped=self._skipped))
            self._loss = self._waiting.loss
            self._wake.notify()

    def show(self, frame: RawFrame) -> None:
        """Restore a frame at once, on the caller's thread, so that none is skipped: for recordings."""
        self._note_time(frame)
        self._loss = frame.loss
        self._restore(frame)

    def _note_time(self, frame: RawFrame) -> None:
        """A frame comes now."""
        last, self._newest = self._newest, frame
        with self._wake:
            if last is None or not 0 <= frame.time - last.time < self.plan.stale_after_s:
                self._periods.clear()
            elif frame.sequence == last.sequence + 1:
                self._periods.append(frame.time - last.time)
            self._jitter = float(np.std(self._periods, ddof=1)) if len(self._periods) > 1 else None
        now = self._clock()
        if self._last is not None:
            gap = now - self._last
            if gap > self.plan.stale_after_s:
                self._pipeline.lapse()
            self._period += (gap - self._period) * min(1.0, max(gap, 0.02)) if self._period else gap
        self._last = now

    def _work(self) -> None:
        while True:
            with self._wake:
                self._wake.wait_for(lambda: self._stopping or self._waiting is not None)
                if self._stopping:
                    return
                frame, self._waiting = self._waiting, None
            if frame is not None:
                self._restore(frame)

    def _restore(self, frame: RawFrame) -> None:
        """Publish one image; a frame that cannot be restored ends neither the thread nor the service."""
        try:
            image = self._pipeline.process(frame)
            self.hub.publish(image)
            self.history.add(image)
            self.heard.add(image)
            self._failed = None
        except Exception as error:
            self._failed = f"restoration failed: {type(error).__name__}: {error}"

    def status(self, now: float | None = None) -> Status:
        """Health at `now` (s on this sensor's clock; default: this moment)."""
        age = self._age(self._clock() if now is None else now)
        state, detail = self._judge(age)
        rate = 1 / self._period if state == "live" and self._period else 0.0
        loss = replace(self.counts(), skipped=self._skipped) if self.counts else self._loss
        skew = self._newest.skew if self._newest else None
        jitter = self._jitter if state == "live" else None
        return Status(state, age, rate, detail, loss, jitter, skew, self.errors())

    @property
    def state(self) -> State:
        """State of `status`, at less cost."""
        return self._judge(self._age(self._clock()))[0]

    def _age(self, now: float) -> float | None:
        return None if self._last is None else max(0.0, now - self._last)

    def _judge(self, age: float | None) -> tuple[State, str]:
        if self.down is not None:
            return "down", self.down
        if age is None:
            return "silent", f"no frame yet on {self.bus_name}"
        if age > self.plan.stale_after_s:
            return "stale", f"no frame for {age:.1f} s"
        return ("stale", self._failed) if self._failed else ("live", "")
