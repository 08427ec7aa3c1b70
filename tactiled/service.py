"""The running service: it owns the buses, the threads and what is known of their health."""

import statistics
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from tactiled.bus.codecs import talk_of
from tactiled.bus.reader import Reader, only, open_bus
from tactiled.bus.router import Frames, Router
from tactiled.bus.talk import Talker
from tactiled.config import Config
from tactiled.config.build import SensorPlan, sensor_plans
from tactiled.contacts import APART, Contact, Finder, Tracker
from tactiled.errors import BusError, StateError, TactileError, UnknownSensorError
from tactiled.events import Events
from tactiled.frames import Image, Loss, RawFrame
from tactiled.history import History
from tactiled.hub import Hub
from tactiled.pipeline import Pipeline
from tactiled.restore.methods import METHODS, require
from tactiled.state import State as Kept
from tactiled.watch import Heard, Watch

State = Literal["live", "stale", "silent", "down"]
POLL_S = 0.05  # how long a read waits: bounds how late a stop, or the end of a half-received frame, is seen
BACK_OFF_S = (0.2, 5.0)  # first and longest wait before a lost bus is opened again
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
        self.history = History(*history, plan.array.frame_shape, plan.blur.surface_shape)
        self.down: str | None = None  # why the bus is not there; the bus's thread sets and clears it
        self.counts: Callable[[], Loss] | None = None  # what its bus has counted by now
        self.errors: Callable[[], Mapping[str, int]] = dict  # what its bus's error frames have told by now
        self.plan, self._clock = plan, clock
        self._pipeline = Pipeline(plan.name, plan.array, plan.blur, plan.calibration, plan.method, plan.warnings)
        self._finder = Finder(plan.array, plan.cells)
        self._tracker = Tracker(APART * plan.array.pitch)
        self._looking = threading.Lock()
        self._looked_at: Image | None = None
        self._contacts: tuple[Contact, ...] = ()
        self._wake = threading.Condition()
        self._waiting: RawFrame | None = None
        self._stopping = False
        self._skipped = 0
        self._last: float | None = None
        self._period = 0.0
        self._loss = Loss()
        self._newest: RawFrame | None = None
        self._periods: deque[float] = deque(maxlen=PERIODS)
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

    def set_method(self, name: str) -> None:
        """Restore by `name` from the next frame on; ConfigError if there is no such method."""
        self._pipeline.set_method(name)

    def deviation(self, image: Image) -> NDArray[np.float32]:
        """Standard deviation (kPa) of every cell of `image.restored`, given its frame and the noise."""
        return self._pipeline.deviation(image)

    def contacts(self) -> tuple[Image | None, tuple[Contact, ...]]:
        """The newest image and the contacts in it, tracked from call to call; any thread."""
        with self._looking:
            image = self.hub.latest()
            if image is not None and image is not self._looked_at:
                found = self._finder(image.restored, image.noise_kpa * max(image.noise_gain, 1.0))
                self._looked_at, self._contacts = image, tuple(self._tracker(found))
            return image, self._contacts

    def tare(self) -> None:
        """Take the mean of the next frames as the unloaded array."""
        self._pipeline.tare()

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

    def start(self) -> None:
        """Start restoring."""
        self._thread.start()

    def stop(self) -> None:
        """Stop restoring; returns when the thread has ended."""
        with self._wake:
            self._stopping = True
            self._wake.notify()
        self._thread.join()

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
        now = self._clock()
        if self._last is not None:
            gap = now - self._last
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
        last = self._last
        age = None if last is None else max(0.0, (self._clock() if now is None else now) - last)
        state, detail = self._judge(age)
        rate = 1 / self._period if state == "live" and self._period else 0.0
        loss = replace(self.counts(), skipped=self._skipped) if self.counts else self._loss
        skew = self._newest.skew if self._newest else None
        jitter = self._jitter() if state == "live" else None
        return Status(state, age, rate, detail, loss, jitter, skew, self.errors())

    def _jitter(self) -> float | None:
        """Standard deviation (s) of the last periods, by the times that the bus gave; None of fewer than two."""
        with self._wake:
            periods = tuple(self._periods)
        return statistics.stdev(periods) if len(periods) > 1 else None

    def _judge(self, age: float | None) -> tuple[State, str]:
        if self.down is not None:
            return "down", self.down
        if age is None:
            return "silent", f"no frame yet on {self.bus_name}"
        if age > self.plan.stale_after_s:
            return "stale", f"no frame for {age:.1f} s"
        return ("stale", self._failed) if self._failed else ("live", "")


class Listener:
    """One bus and the thread that reads it; the bus is opened again, with back-off, when it goes away."""

    def __init__(self, name: str, settings: dict[str, Any], sensors: dict[str, Sensor]) -> None:
        self.name, self._sensors = name, sensors
        self._router = Router({each.name: each.codec for each in sensors.values()})
        self._settings = only(settings, self._router.ids)
        self._past: Counter[str] = Counter()  # what readers before this one counted
        self._errors: Counter[str] = Counter()  # what their error frames told
        self._swap = threading.Lock()
        self._told: str | None = None
        for sensor in sensors.values():
            sensor.counts, sensor.errors = partial(self._loss, sensor.name), self._kinds
        self._talker = Talker(talk_of(each.codec) for each in sensors.values())
        self._stop = threading.Event()
        self._reader: Reader | None = None
        self._thread = threading.Thread(target=self._run, name=f"bus {name}", daemon=True)

    def start(self) -> None:
        """Open the bus (BusError where it cannot be) and start to read it."""
        self._reader = open_bus(**self._settings)
        self._thread.start()

    def stop(self) -> None:
        """Stop reading and close the bus."""
        self._stop.set()
        if self._thread.ident is not None:
            self._thread.join()
        if self._reader is not None:
            self._talker.end(self._reader.send)
            self._reader.close()

    def _run(self) -> None:
        wait = BACK_OFF_S[0]
        while not self._stop.is_set():
            try:
                self._reader = self._reader or open_bus(**self._settings)
                self._tell(None)
                wait = BACK_OFF_S[0]
                self._read(self._reader)
            except BusError as error:
                self._tell(str(error))
                self._drop()
                self._stop.wait(wait)
                wait = min(2 * wait, BACK_OFF_S[1])

    def _read(self, reader: Reader) -> None:
        """Take messages until the stop, or until a BusError."""
        self._talker.begin(time.monotonic())
        while not self._stop.is_set():
            now = time.monotonic()
            reader.unsent += self._talker.say(reader.send, now)
            messages = reader.batch(min(POLL_S, self._talker.wait(now)))
            if not messages:
                self._hand(self._router.flush(time.time() - POLL_S))
            for message in messages:
                self._hand(self._router.push(message))
            if reader.off != self._told:
                self._tell(reader.off)

    def _hand(self, frames: Frames) -> None:
        if frames:
            counted = self._counted()
            for name, frame in frames:
                self._sensors[name].offer(replace(frame, loss=replace(frame.loss, **counted)))

    def _counted(self) -> Counter[str]:
        """What the bus itself counted since the start, however often it was opened again."""
        with self._swap:
            return self._past + Counter(self._reader.counts() if self._reader else {})

    def _kinds(self) -> Mapping[str, int]:
        """What the bus's error frames told since the start, by kind; any thread."""
        with self._swap:
            return self._errors + Counter(self._reader.kinds if self._reader else {})

    def _loss(self, name: str) -> Loss:
        """What went wrong by now on a sensor's way in; any thread."""
        return replace(self._router.assemblers[name].loss, **self._counted())

    def _tell(self, down: str | None) -> None:
        self._told = down
        for sensor in self._sensors.values():
            sensor.down = down

    def _drop(self) -> None:
        if self._reader is not None:
            self._reader.close()
            with self._swap:
                self._past += Counter(self._reader.counts())
                self._errors += Counter(self._reader.kinds)
                self._reader = None


class Listening(Protocol):
    """What hands a bus's frames to its sensors."""

    def start(self) -> None:
        """Start; a TactileError where it cannot."""

    def stop(self) -> None:
        """Stop, whether it was started or not."""


class Service:
    """Every sensor of a configuration, on its bus or on what `listen` puts in a bus's place."""

    def __init__(
        self,
        config: Config,
        listen: Callable[[str, dict[str, Any], dict[str, Sensor]], Listening] = Listener,
        state: Kept | None = None,
    ) -> None:
        self.config, self.state, self.events = config, state, Events()
        self.buses = {name: bus.settings() for name, bus in config.bus.items()}
        history = config.server.history_s, int(config.server.history_mb * 1e6 / max(len(config.sensor), 1))
        self.sensors = {plan.name: Sensor(plan, history=history) for plan in sensor_plans(config)}
        self._watch = Watch(self.sensors.values(), self.events)
        self._recall()
        self._listeners = [
            listen(
                name, bus.settings(), {key: each for key, each in self.sensors.items() if each.bus_name == name}
            )
            for name, bus in config.bus.items()
        ]

    def sensor(self, name: str) -> Sensor:
        """The sensor of that name; UnknownSensorError where there is none."""
        try:
            return self.sensors[name]
        except KeyError as error:
            known = ", ".join(self.sensors)
            raise UnknownSensorError(f"sensor {name!r}: no such sensor: there are {known}") from error

    def set_method(self, name: str, method: str, keep: bool = False) -> None:
        """Restore by another method from the next frame on, and with `keep` after a restart, too.

        ConfigError where there is no such method, StateError where it cannot be kept; then nothing has changed.
        """
        sensor = self.sensor(name)
        require(method)
        if keep:
            if self.state is None:
                raise StateError("keep = true: this service keeps no state: `tactiled run` does")
            self.state.keep(name, None if method == sensor.plan.method else method)
        sensor.set_method(method)
        self.events.add("method_set", f"{method}{', kept' if keep else ''}", name)

    def tare(self, name: str) -> None:
        """Take the mean of a sensor's next frames as the unloaded array."""
        self.sensor(name).tare()
        self.events.add("tare_asked", "the next frames are taken as no load", name)

    def _recall(self) -> None:
        """Take over what was kept; what no longer means anything is told, not applied."""
        for name, method in self.state.methods.items() if self.state else ():
            sensor = self.sensors.get(name)
            if sensor is None or method not in METHODS:
                self.events.add("state_ignored", f"sensor {name}, method {method}: no longer there")
                continue
            sensor.set_method(method)
            self.events.add("method_kept", f"{method}, where the configuration says {sensor.plan.method}", name)

    def start(self) -> None:
        """Start everything; a TactileError, with nothing left running, where a bus cannot be opened."""
        for sensor in self.sensors.values():
            sensor.start()
        try:
            for listener in self._listeners:
                listener.start()
        except TactileError:
            self.stop()
            raise
        self._watch.start()

    def stop(self) -> None:
        """Stop everything that runs."""
        self._watch.stop()
        for listener in self._listeners:
            listener.stop()
        for sensor in self.sensors.values():
            sensor.stop()
