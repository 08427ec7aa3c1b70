"""The running service: every sensor and every bus, started and stopped together."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import Lock
from typing import Any

from tactiled.build import sensor_plan, sensor_plans
from tactiled.bus.replay import Replay
from tactiled.calibrate.calibration_file import CalibrationFile, former, save
from tactiled.config import Config
from tactiled.errors import ConfigError, StateError, TactileError, UnknownSensorError
from tactiled.restore.methods import METHODS, require
from tactiled.runtime.bus_thread import BusThread
from tactiled.runtime.events import Events, Faults, duration
from tactiled.runtime.sensor import Sensor
from tactiled.runtime.state import KeptTare, StateFile
from tactiled.runtime.watch import Watch


class Service:
    """Every sensor of a configuration, on its bus or on what `listen` puts in a bus's place."""

    def __init__(
        self,
        config: Config,
        listen: Callable[[str, dict[str, Any], dict[str, Sensor]], BusThread | Replay] = BusThread,
        state: StateFile | None = None,
        replayed: bool = False,  # whether recordings are in the buses' place: none is open then
    ) -> None:
        self.config, self.state, self.replayed, self.events = config, state, replayed, Events()
        self.faults = Faults(self.events)
        self._set_lock = Lock()  # the method that is kept is the one that runs, whoever sets at once
        self.buses = {name: bus.settings() for name, bus in config.bus.items()}
        history = config.server.history_s, int(config.server.history_mb * 1e6 / max(len(config.sensor), 1))
        plans = sensor_plans(config)
        try:
            self.sensors = {plan.name: Sensor(plan, history=history) for plan in plans}
        except MemoryError as error:
            setting = f"server.history_mb = {config.server.history_mb:g}"
            raise ConfigError(f"{setting}: this machine has less memory: give less") from error
        self._apply_lock = Lock()  # one calibration is applied at a time
        self._watch = Watch(self.sensors.values(), self.events, self.faults, self._keep_tare)
        self._set_kept_methods()
        self._set_kept_tares()
        self._note_missing_calibrations()
        self._sources = [
            listen(name, settings, {key: each for key, each in self.sensors.items() if each.plan.bus == name})
            for name, settings in self.buses.items()
        ]

    def sensor(self, name: str) -> Sensor:
        """The sensor of that name; UnknownSensorError if it is not configured."""
        try:
            return self.sensors[name]
        except KeyError as error:
            raise UnknownSensorError.among(name, self.sensors) from error

    def set_method(self, name: str, method: str, keep: bool = False) -> None:
        """Restore by another method from the next frame on, and with `keep` after a restart, too.

        ConfigError where there is no such method, StateError where it cannot be kept; then nothing has changed.
        """
        sensor = self.sensor(name)
        require(method)
        with self._set_lock:
            if keep:
                if self.state is None:
                    raise StateError("keep = true: this service keeps no state: `tactiled run` does")
                self.state.keep(name, None if method == sensor.plan.method else method)
            sensor.pipeline.set_method(method)
            self.events.add("method_set", f"{method}{', kept' if keep else ''}", name)

    def tare(self, name: str, force: bool = False) -> None:
        """Take the mean of a sensor's next frames as the unloaded array; raises as `Sensor.tare`."""
        self.sensor(name).tare(force)
        forced = " (forced)" if force else ""
        self.events.add("tare_asked", f"the next frames are taken as no load{forced}", name)

    def undo_tare(self, name: str) -> None:
        """Take the zero from before a sensor's last tare again; TareStateError where there is none."""
        sensor = self.sensor(name)
        sensor.undo_tare()
        self.events.add("tare_undone", f"the zero from before the tare; {self._keep_tare(sensor)}", name)

    def apply_calibration(self, name: str, file: CalibrationFile) -> None:
        """Calibrate a sensor by `file` from the next frame on, and write it where the configuration names one.

        ConfigError where it does not fit, StateError where it cannot be written; then nothing has changed. Solving
        a cover takes seconds, in which frames go on.
        """
        sensor, settings = self.sensor(name), self.config.sensor[name]
        path = settings.calibration.file
        with self._apply_lock:
            plan = sensor_plan(name, settings, file)
            sensor.recalibrate(plan, lambda: save(path, file) if path else None)
            kept = f"written to {path.name}" if path else "until the service ends: calibration.file is not set"
            self.events.add("calibration_applied", f"{file.id}: {', '.join(file.sections)}; {kept}", name)

    def former_calibrations(self, name: str) -> dict[int, CalibrationFile | str]:
        """The files before a sensor's present one by number, 1 the newest; of one that cannot be read, why."""
        path = self.config.sensor[self.sensor(name).name].calibration.file
        return former(path) if path else {}

    def _note_missing_calibrations(self) -> None:
        for name, sensor in self.config.sensor.items():
            if sensor.calibration.file and not self.sensors[name].plan.file:
                text = f"{sensor.calibration.file.name}: not there yet: the configuration holds"
                self.events.add("calibration_missing", text, name)

    def _keep_tare(self, sensor: Sensor) -> str:
        """Keep a sensor's zero over a restart where there is a state file; in words whether it is kept."""
        if self.state is None:
            return "not kept: this service keeps no state"
        zero = sensor.pipeline.zero
        try:
            self.state.keep_tare(
                sensor.name, None if zero.time is None else KeptTare.of(zero, sensor.plan.codec_name)
            )
        except StateError as error:
            return str(error)
        return "kept"

    def _set_kept_tares(self) -> None:
        """Take over the tares of the state file; an event says how old they are, or why one is ignored."""
        for name, tare in self.state.tares.items() if self.state else ():
            sensor = self.sensors.get(name)
            if sensor is None or tare is None or not tare.fits(sensor.plan.codec_name, sensor.array.size):
                self.events.add("tare_ignored", f"sensor {name}: of another array", name if sensor else None)
            elif tare.time < sensor.plan.no_load_time:
                self.events.add("tare_ignored", "older than the calibration file's no load", name)
            else:
                sensor.set_zero(tare.zero)
                self.events.add("tare_kept", f"tared {duration(time.time() - tare.time)} ago", name)

    def _set_kept_methods(self) -> None:
        """Set the methods of the state file; an event names those that no longer apply."""
        for name, method in self.state.methods.items() if self.state else ():
            sensor = self.sensors.get(name)
            if sensor is None or method not in METHODS:
                self.events.add("state_ignored", f"sensor {name}, method {method}: no longer there")
                continue
            sensor.pipeline.set_method(method)
            self.events.add("method_kept", f"{method}, where the configuration says {sensor.plan.method}", name)

    def start(self) -> None:
        """Start everything; a TactileError, with nothing left running, where a bus cannot be opened."""
        for sensor in self.sensors.values():
            sensor.start()
        try:
            for source in self._sources:
                source.start()
        except TactileError:
            self.stop()
            raise
        self._watch.start()

    @contextmanager
    def running(self) -> Iterator[None]:
        """Run meanwhile."""
        try:
            self.start()
            yield
        finally:
            self.stop()

    def turns(self) -> dict[str, int | None]:
        """Turns by now of every thread that must move, by its name; None for one that waits for work."""
        buses = {f"bus {each.name}": each.turns for each in self._sources if isinstance(each, BusThread)}
        sensors = {f"restore {name}": each.turns for name, each in self.sensors.items()}
        return {**buses, **sensors, "watch": self._watch.turns}

    def stop(self) -> None:
        """Stop everything that runs."""
        self._watch.stop()
        for each in (*self._sources, *self.sensors.values()):
            each.stop()
