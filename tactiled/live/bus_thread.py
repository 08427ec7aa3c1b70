"""The thread that reads a bus, hands frames to its sensors, and opens the bus again when it goes away."""

import logging
import threading
import time
from collections import Counter
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import Any

from tactiled.bus.assembler import BUSY_S, SILENCE_S, Assembler
from tactiled.bus.polling import Poller
from tactiled.bus.reader import Reader, only, open_bus
from tactiled.bus.router import Frames, Router
from tactiled.bus.socketcan import MAX_FRAMES
from tactiled.errors import BusError
from tactiled.frames import Loss
from tactiled.live.sensor import Sensor
from tactiled.threads import FRAME_LOCK, join_started

MAX_FULL_BATCHES = 8  # full batches in a row, after which a frame is restored although newer messages wait
BACK_OFF_S = (0.2, 5.0)  # first and longest wait before a lost bus is opened again
LOG = logging.getLogger(__name__)


class BusThread:
    """One bus and the thread that reads it; the bus is opened again, with back-off, when it goes away."""

    def __init__(self, name: str, settings: dict[str, Any], sensors: dict[str, Sensor]) -> None:
        self.name, self._sensors, self._bus_settings = name, sensors, settings
        self._next_sensors: dict[str, Sensor] | None = None  # set by another thread, taken by this one
        self._exchanged = threading.Event()  # it has them
        self._route()
        self._counts: Counter[str] = Counter()  # of readers before this one
        self._kinds: Counter[str] = Counter()  # of their error frames
        self._reader_lock = threading.Lock()
        self._down: str | None = None
        self.turns = 0  # of its thread's loop; it stands still only if the thread hangs
        self._poller = Poller(each.codec.polling for each in sensors.values())
        self._offered: dict[str, Sensor] = {}  # sensors with a frame that waits to be restored
        self._stop = threading.Event()
        self._reader: Reader | None = None
        self._thread = self._new_thread()

    def open(self) -> None:
        """Open the bus; BusError where it cannot be."""
        self._reader = open_bus(**self._settings)

    def start(self) -> None:
        """Open the bus (BusError where it cannot be), unless it is open, and start to read it."""
        if self._reader is None:
            self.open()
        self._thread.start()

    def resume(self) -> None:
        """Go on after a stop; a bus that cannot be opened again is down until it can."""
        self._stop.clear()
        self._thread = self._new_thread()
        with suppress(BusError):  # the thread gets the same error and tries again
            self.open()
        self._thread.start()

    def stop(self) -> None:
        """Stop reading and close the bus, whether it was started or not."""
        self._stop.set()
        join_started(self._thread)
        if self._reader is not None:
            self._poller.stop(self._reader.send)
        self._close_reader()

    def introduce(self, sensor: Sensor) -> None:
        """Give a new sensor the counts of the bus, so that they never fall."""
        sensor.health.counts, sensor.health.errors = lambda: Loss(**self._bus_counts()), self._error_kinds

    def exchange(self, sensors: dict[str, Sensor]) -> None:
        """Read for these sensors from now on; those that stay lose no frame. Called by another thread.

        On return its thread has taken them, unless the bus is down or the thread hangs.
        """
        for sensor in sensors.values():
            sensor.health.down = self._down
        self._exchanged.clear()
        self._next_sensors = sensors
        if self._reader is not None and self._thread.is_alive():
            self._exchanged.wait(BACK_OFF_S[1])

    def _new_thread(self) -> threading.Thread:
        return threading.Thread(target=self._run, name=f"bus {self.name}", daemon=True)

    def _route(self, before: Mapping[str, Assembler] | None = None) -> None:
        """Hand messages to the present sensors; assemblers of `before` go on."""
        codecs = {each.name: each.codec for each in self._sensors.values()}
        self._router = Router(codecs, self._bus_counts, before)
        self._settings = only(self._bus_settings, self._router.ids)
        for name, sensor in self._sensors.items():
            sensor.health.counts, sensor.health.errors = (
                partial(self._loss, self._router.assemblers[name]),
                self._error_kinds,
            )

    def _exchange(self) -> None:
        """Take the sensors that another thread has asked for, between two messages."""
        sensors, self._next_sensors = self._next_sensors, None
        if sensors is None:
            return
        kept = {
            name: self._router.assemblers[name] for name in sensors if self._sensors.get(name) is sensors[name]
        }
        self._sensors, filters = sensors, self._settings.get("can_filters")
        self._route(kept)
        polling = (each.codec.polling for each in sensors.values())
        self._set_down(self._down)
        if self._reader is None:
            self._poller = Poller(polling)
            self._exchanged.set()
            return
        self._poller = self._poller.exchanged(polling, self._reader.send, time.monotonic())
        if self._settings.get("can_filters") != filters:
            self._reader.set_filters(self._settings["can_filters"])
        for sensor in sensors.values():
            sensor.health.clock = self._reader.clock
        self._exchanged.set()

    def _run(self) -> None:
        wait, last_reason = BACK_OFF_S[0], ""
        while not self._stop.is_set():
            self.turns += 1
            began, fault = time.monotonic(), None
            try:
                self._exchange()
                self._reader = self._reader or open_bus(**self._settings)
                self._set_down(None)
                for sensor in self._sensors.values():
                    sensor.health.clock = self._reader.clock
                self._read(self._reader)
            except BusError as error:
                reason = str(error)
            except Exception as error:  # a fault of this program must not end the thread
                reason = f"bus {self.name}: the service failed at it: {type(error).__name__}: {error}"
                fault = error
            else:
                return
            if time.monotonic() - began > BACK_OFF_S[1]:
                wait, last_reason = BACK_OFF_S[0], ""
            if fault and reason != last_reason:
                LOG.error("bus %s failed, and is opened again", self.name, exc_info=fault)
            self._set_down(reason)
            self._close_reader()
            self._stop.wait(wait)
            wait, last_reason = min(2 * wait, BACK_OFF_S[1]), reason

    def _read(self, reader: Reader) -> None:
        """Take messages until the stop; BusError if the bus fails."""
        self._poller.start(time.monotonic())
        full = 0  # full batches in a row: newer messages may wait
        while not self._stop.is_set():
            self.turns += 1
            self._exchange()
            now = time.monotonic()
            reader.unsent += self._poller.send_due(reader.send, now)
            needed = self._router.needed
            batch = reader.batch(min(SILENCE_S, self._poller.wait_s(now)), needed)  # bounds a stop's delay, too
            now = time.monotonic()
            if len(batch):
                with FRAME_LOCK:
                    frames = self._router.push(batch, now)
                self._offer(frames)
            self._offer(self._router.flush(now - (BUSY_S if len(batch) else SILENCE_S)))
            full = full + 1 if len(batch) >= MAX_FRAMES and len(batch) > needed else 0
            if full % MAX_FULL_BATCHES == 0:
                self._restore_offered()
            if reader.off != self._down:
                self._set_down(reader.off)

    def _offer(self, frames: Frames) -> None:
        for name, frame in frames:
            sensor = self._offered[name] = self._sensors[name]
            sensor.offer(frame, wake=False)

    def _restore_offered(self) -> None:
        """Restore the newest frame of every sensor that was offered some, unless its own thread does."""
        for sensor in self._offered.values():
            sensor.hand_over.take_turn()
        self._offered.clear()

    def _bus_counts(self) -> Mapping[str, int]:
        """Losses that the bus itself counted since the start, however often it was opened."""
        with self._reader_lock:
            return self._counts + Counter(self._reader.counts() if self._reader else {})

    def _error_kinds(self) -> Mapping[str, int]:
        """Error frames since the start, by kind; any thread."""
        with self._reader_lock:
            return self._kinds + Counter(self._reader.kinds if self._reader else {})

    def _loss(self, assembler: Assembler) -> Loss:
        """Losses of a sensor until now; any thread."""
        return replace(assembler.loss, **self._bus_counts())

    def _set_down(self, reason: str | None) -> None:
        self._down = reason
        for sensor in self._sensors.values():
            sensor.health.down = reason

    def _close_reader(self) -> None:
        if self._reader is not None:
            self._reader.close()
            with self._reader_lock:
                self._counts += Counter(self._reader.counts())
                self._kinds += Counter(self._reader.kinds)
                self._reader = None
