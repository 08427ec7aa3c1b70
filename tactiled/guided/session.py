"""A guided calibration of one sensor: frames are collected, a fit is made of them, it is applied or discarded."""

import threading
import time
from collections.abc import Callable
from typing import Literal

from tactiled.errors import CalibrationStateError, TactileError
from tactiled.frames import FrameSeries, RawFrame
from tactiled.guided.cover_procedure import CoverOutcome, CoverProcedure
from tactiled.guided.frame_collector import FrameCollector
from tactiled.guided.gain_procedure import GainOutcome, GainProcedure
from tactiled.guided.quality import Quality
from tactiled.live.sensor import Sensor
from tactiled.processes import Cancelled, FitProcess

Way = Literal["uniform", "weight", "tip", "edge", "blind"]
SessionState = Literal["collecting", "fitting", "fitted", "ended"]
Action = Literal["mark", "fit", "fit_done", "fit_failed", "cancel", "apply", "discard"]
NEXT_STATE: dict[tuple[SessionState, Action], SessionState] = {
    ("collecting", "mark"): "collecting",
    ("collecting", "fit"): "fitting",
    ("collecting", "discard"): "ended",
    ("fitting", "fit_done"): "fitted",
    ("fitting", "fit_failed"): "collecting",
    ("fitting", "cancel"): "collecting",
    ("fitting", "discard"): "ended",
    ("fitted", "mark"): "collecting",
    ("fitted", "fit"): "fitting",
    ("fitted", "apply"): "ended",
    ("fitted", "discard"): "ended",
}
IDLE_S = 300.0  # without a request until a session ends; long enough for a person to pause
QUALITY_PERIOD_S = 1.0  # between two looks for presses
MARK_S = 2.0  # of frames at most, whose mean is taken as a known load

Procedure = GainProcedure | CoverProcedure
Outcome = GainOutcome | CoverOutcome


class CalibrationSession:
    """One session; any thread may call it."""

    def __init__(self, sensor: Sensor, procedure: Procedure, clock: Callable[[], float] = time.monotonic) -> None:
        self.sensor, self.procedure = sensor, procedure
        self.collector = FrameCollector(sensor.array.size)
        self.state: SessionState = "collecting"
        self.outcome: Outcome | None = None
        self.error = ""  # why the last fit failed
        self._clock, self._lock = clock, threading.RLock()
        self._quality: tuple[float, int, Quality] | None = None  # when it was made, of how many frames
        self._marked_frames = 0  # by the last mark
        self._process = FitProcess()  # of the newest fit; results of older fits are dropped
        self._touched_at = clock()
        self._stop_collecting = sensor.frames.subscribe(self._take)

    def touch(self) -> None:
        """A client is here."""
        self._touched_at = self._clock()

    @property
    def idle(self) -> bool:
        """Whether its client has gone away."""
        return self._clock() - self._touched_at > IDLE_S

    def lapsed(self) -> bool:
        """Whether it ended because its client has gone away; takes no lock while the client is here."""
        if not self.idle:
            return False
        self.discard()
        return True

    def quality(self) -> Quality:
        """Quality of the frames so far; updated once a second at most, and not during a fit."""
        with self._lock:
            now, last = self._clock(), self._quality
            is_due = last and now - last[0] >= QUALITY_PERIOD_S and last[1] != len(self.collector)
            if last is None or (is_due and self.state == "collecting"):
                last = self._quality = now, len(self.collector), self.procedure.quality(self.collector)
            return last[2]

    def mark(self, value: float) -> None:
        """Note that the newest frames, MARK_S of them at most, are under a known load."""
        with self._lock:
            self._need("mark")
            frames = len(self.collector)
            self.procedure.mark(self.collector.series(self._marked_frames, MARK_S), value)
            self._go("mark")
            self._marked_frames = frames
            self._quality = None

    def fit(self) -> None:
        """Start to fit what was collected, in a process that a thread waits for."""
        with self._lock:
            self._go("fit")
            self._process = FitProcess()
            self.error, self.outcome = "", None
            arguments = self._process, self.collector.series()
            threading.Thread(target=self._fit, args=arguments, name=f"fit {self.sensor.name}", daemon=True).start()

    def cancel(self) -> None:
        """Go on collecting instead of fitting."""
        with self._lock:
            self._go("cancel")
            self._process.cancel()

    def apply(self, apply: Callable[[Outcome], None]) -> None:
        """End by applying the outcome; where that fails, nothing has changed."""
        with self._lock:
            self._need("apply")
            assert self.outcome is not None
            apply(self.outcome)
            self._end("apply")

    def discard(self) -> bool:
        """End without a change, unless it has ended; returns whether this ended it."""
        with self._lock:
            is_open = self.state != "ended"
            if is_open:
                self._end("discard")
            return is_open

    def _end(self, action: Action) -> None:
        self._go(action)
        self._process.cancel()
        self._stop_collecting()
        self.collector, self.outcome = FrameCollector(self.sensor.array.size), None  # the memory

    def _need(self, action: Action) -> SessionState:
        """State after an action; CalibrationStateError where the present one does not allow it."""
        try:
            return NEXT_STATE[self.state, action]
        except KeyError:
            allowed = ", ".join(sorted({verb for state, verb in NEXT_STATE if state == self.state}))
            text = f"{action}: not possible, as the calibration is {self.state}; possible: {allowed or 'nothing'}"
            raise CalibrationStateError(f"sensor {self.sensor.name!r}: {text}") from None

    def _go(self, action: Action) -> None:
        self.state = self._need(action)

    def _take(self, frame: RawFrame) -> None:
        """Collect a frame, on the thread of the bus."""
        if self.idle:
            self.discard()
        else:
            self.collector.add(frame)

    def _fit(self, process: FitProcess, series: FrameSeries) -> None:
        """Fit on this thread, and keep the result unless the fit was cancelled."""
        outcome, error = None, ""
        try:
            outcome = self.procedure.fit(series, process)
        except Cancelled:
            return
        except TactileError as failure:
            error = str(failure)
        except Exception as failure:  # a fault of ours: it ends the fit, not the service
            error = f"{type(failure).__name__}: {failure}"
        with self._lock:
            if process is self._process and self.state == "fitting":
                self.outcome, self.error = outcome, error
                self._go("fit_failed" if error else "fit_done")
