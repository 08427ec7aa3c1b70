"""The running service: every sensor and every bus, started and stopped together."""

import time
from collections.abc import Callable, Collection, Iterator, Mapping
from concurrent.futures import Future
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from pathlib import Path
from threading import Lock, Thread
from types import MappingProxyType
from typing import Any

import numpy as np

from tactiled import systemd
from tactiled.arrays import Reals
from tactiled.build import SensorPlan, sensor_plan, sensor_plans, without_file
from tactiled.bus.codecs.pushed import Pushed
from tactiled.bus.pusher import Pusher
from tactiled.bus.replay import Replay
from tactiled.calibrate.calibration_file import FILES_KEPT, CalibrationFile, former, save
from tactiled.config import Config, load
from tactiled.errors import (
    BusError,
    ConfigError,
    NotPushedError,
    ReloadError,
    StateError,
    TactileError,
    UnknownSensorError,
)
from tactiled.live.budget import budget_share
from tactiled.live.bus_thread import BusThread
from tactiled.live.events import Events, Faults, duration
from tactiled.live.kept_regions import KeptRegions
from tactiled.live.reload import Reload, compare, new_plans
from tactiled.live.sensor import Sensor
from tactiled.live.state_file import KeptTare, StateFile
from tactiled.live.watch import Watch
from tactiled.restore.methods import METHODS, OLD_NAMES, named


class Service:
    """Every sensor of a configuration, on its bus or on what `listen` puts in a bus's place."""

    def __init__(
        self,
        config: Config,
        listen: Callable[[str, dict[str, Any], dict[str, Sensor]], BusThread | Replay] = BusThread,
        state: StateFile | None = None,
        replayed: bool = False,  # whether recordings are in the buses' place: none is open then
        path: Path | None = None,  # of the configuration file, to reload it
        report: Callable[[str], object] = lambda _: None,  # gets a line before what may take seconds
    ) -> None:
        self.config, self.state, self.replayed, self.events = config, state, replayed, Events()
        self.faults, self.path = Faults(self.events), path
        self.renew_tls: Callable[[], str | None] = lambda: None  # name of a renewed certificate; ConfigError
        self._reload_lock = Lock()  # one reload at a time, which may take long
        self._change_lock, self._stopped = Lock(), False  # what runs is changed, or stopped
        self._set_lock = Lock()  # two requests at once keep the method that runs
        self.buses = {name: bus.settings() for name, bus in config.bus.items()}
        plans = {plan.name: plan for plan in sensor_plans(config, report)}
        self._pushers: dict[str, Pusher] = {}
        self.sensors = self._make_sensors(plans)  # replaced by a reload, never changed
        self._apply_lock = Lock()  # one calibration is applied at a time
        self._share_time()
        self._watch = Watch(self.sensors.values(), self.events, self.faults, self._keep_tare)
        self.regions = KeptRegions(state, self.events, self.sensor)
        self._take_state()
        self._sources = {name: listen(name, bus, _on(name, self.sensors)) for name, bus in self.buses.items()}

    def _make_sensors(
        self, plans: dict[str, SensorPlan], beside: Mapping[str, Sensor] = MappingProxyType({})
    ) -> dict[str, Sensor]:
        """Sensors that share the memory for past images that those `beside` them leave; none runs yet."""
        server = self.config.server
        free_bytes = server.history_mb * 1e6 - sum(each.history.bytes for each in beside.values())
        history = server.history_s, int(max(free_bytes, 0.0) / max(len(plans), 1))
        try:
            return {name: Sensor(plan, history=history) for name, plan in plans.items()}
        except MemoryError as error:
            setting = f"server.history_mb = {server.history_mb:g}"
            raise ConfigError(f"{setting}: this machine has less memory: give less") from error

    def sensor(self, name: str) -> Sensor:
        """The sensor of that name; UnknownSensorError if it is not configured."""
        try:
            return self.sensors[name]
        except KeyError as error:
            raise UnknownSensorError.among(name, self.sensors) from error

    def push_frame(
        self, name: str, values: Reals, sequence: int | None = None, time_s: float | None = None
    ) -> int:
        """Take a frame, of the array's shape or (N,), NaN: unknown; gives its sequence number.

        NotPushedError where the sensor reads a bus or a recording, ConfigError for another shape, BusError where
        the service does not keep up.
        """
        sensor, codec = self.sensor(name), self.need_pushed(name)
        if values.shape not in ((codec.size,), sensor.array.frame_shape):
            shape = " x ".join(map(str, sensor.array.frame_shape))
            raise ConfigError(
                f"values: shape {values.shape} for sensor {name}: give {shape}, or {codec.size} in a list"
            )
        with self._change_lock:
            if self._stopped:
                raise BusError("the service ends")
            if name not in self._pushers:
                self._pushers[name] = Pusher(str(self.buses[sensor.plan.bus]["channel"]))
        counts = values.ravel().astype(np.float32)
        return self._pushers[name].push(codec, counts, sequence, time.time() if time_s is None else time_s)

    def need_pushed(self, name: str) -> Pushed:
        """The codec of a sensor that takes frames; NotPushedError where it reads a bus or a recording."""
        sensor = self.sensor(name)
        if self.replayed or not isinstance(sensor.codec, Pushed):
            source = "a recording" if self.replayed else f"bus {sensor.plan.bus}"
            raise NotPushedError(f"sensor {name!r}: reads {source}: only one without bus and codec takes frames")
        return sensor.codec

    def set_method(self, name: str, method: str, keep: bool = False) -> None:
        """Restore by another method from the next frame on, and with `keep` after a restart, too.

        ConfigError where there is no such method, StateError where it cannot be kept; then nothing has changed.
        """
        method = named(method)
        with self._set_lock:
            sensor = self.sensor(name)
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
        self.events.add(
            "tare_undone", f"the zero from before the tare holds again; {self._keep_tare(sensor)}", name
        )

    def apply_calibration(self, name: str, file: CalibrationFile | None) -> None:
        """Calibrate a sensor by `file` from the next frame on, and write it where the configuration names one.

        None: as configured, without a file; a written one is removed. ConfigError where it does not fit,
        StateError where it cannot be written; then nothing has changed. Solving a cover takes seconds, in which
        frames go on.
        """
        with self._apply_lock:
            sensor, settings = self.sensor(name), self.config.sensor[name]
            path = settings.calibration.file
            plan = sensor_plan(name, settings if file else without_file(settings), file)
            before = sensor.plan.file
            with self._set_lock:  # the method goes with it
                sensor.recalibrate(plan, lambda: save(path, file) if path else None)
            if before and not path:
                sensor.former = (before, *sensor.former)[:FILES_KEPT]
            if file:
                kept = f"written to {path.name}" if path else "until the service ends: calibration.file is not set"
                text = f"{', '.join(file.sections)}; {kept}"
            else:
                text = "the values of the configuration hold" + (f"; {path.name} is removed" if path else "")
            self.events.add("calibration_applied", f"{plan.calibration_id}: {text}", name)

    def former_calibrations(self, name: str) -> dict[int, CalibrationFile | str | None]:
        """What was before a sensor's present file by number, 1 the newest; of one that cannot be read, why.

        0 is None: the configured calibration, without a file.
        """
        sensor = self.sensor(name)
        path = self.config.sensor[name].calibration.file
        files = former(path) if path else dict(enumerate(sensor.former, 1))
        return {**files, 0: None} if sensor.plan.file else {**files}

    def _note_missing_calibration(self, name: str) -> None:
        file = self.config.sensor[name].calibration.file
        if file and not self.sensors[name].plan.file:
            text = f"{file.name}: not there yet: the configuration holds"
            self.events.add("calibration_missing", text, name)

    def _keep_tare(self, sensor: Sensor) -> str:
        """Keep a sensor's zero over a restart where there is a state file; in words whether it is kept."""
        if self.state is None:
            return "a restart forgets it: this service keeps no state"
        zero = sensor.pipeline.zero
        try:
            self.state.keep_tare(
                sensor.name, None if zero.time is None else KeptTare.of(zero, sensor.plan.codec_name)
            )
        except StateError as error:
            return str(error)
        return "kept"

    def _take_state(self, names: Collection[str] | None = None) -> None:
        """Take what is kept of these sensors, None: of all; events say what is taken, and what does not apply."""
        self._set_kept_methods(names)
        self._set_kept_tares(names)
        self.regions.take(names)
        for name in self.sensors if names is None else names:
            self._note_missing_calibration(name)

    def _set_kept_tares(self, names: Collection[str] | None) -> None:
        """Take over the tares of the state file; an event says how old they are, or why one is ignored."""
        for name, tare in self.state.tares.items() if self.state else ():
            if names is not None and name not in names:
                continue
            sensor = self.sensors.get(name)
            if sensor is None or tare is None or not tare.fits(sensor.plan.codec_name, sensor.array.size):
                self.events.add("tare_ignored", f"sensor {name}: of another array", name if sensor else None)
            elif tare.time < sensor.plan.no_load_time:
                self.events.add("tare_ignored", "older than the calibration file's no load", name)
            else:
                sensor.set_zero(tare.zero)
                self.events.add("tare_kept", f"tared {duration(time.time() - tare.time)} ago", name)

    def _set_kept_methods(self, names: Collection[str] | None) -> None:
        """Set the methods of the state file; an event names those that no longer apply."""
        for name, method in self.state.methods.items() if self.state else ():
            if names is not None and name not in names:
                continue
            sensor, method = self.sensors.get(name), OLD_NAMES.get(method, method)
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
            for source in self._sources.values():
                source.start()
        except TactileError:
            self.stop()
            raise
        self._watch.start()

    @contextmanager
    def running(self) -> Iterator[None]:
        """Run meanwhile; ConfigError where another service has the state file."""
        with self.state.alone() if self.state else nullcontext():
            try:
                self.start()
                yield
            finally:
                self.stop()

    def _share_time(self) -> None:
        """Give every sensor its share of the time for restoring: all together do not fill a core."""
        for each in self.sensors.values():
            each.budget_share = budget_share(len(self.sensors))

    def turns(self) -> dict[str, int | None]:
        """Turns by now of every thread that must move, by its name; None for one that waits for work."""
        buses = {f"bus {each.name}": each.turns for each in self._sources.values() if isinstance(each, BusThread)}
        sensors = {f"restore {name}": each.hand_over.turns for name, each in self.sensors.items()}
        return {**buses, **sensors, "watch": self._watch.turns}

    def stop(self) -> None:
        """Stop everything that runs."""
        with self._change_lock:
            self._stopped = True
        self._watch.stop()
        for each in (*self._sources.values(), *self.sensors.values()):
            each.stop()
        for pusher in self._pushers.values():
            pusher.close()

    def reload(self) -> Reload:
        """Read the configuration file again, and change what it changes; frames of the rest go on.

        ReloadError where there is none or the service ends, another TactileError where the file is wrong or a bus
        cannot be opened; then nothing has changed. Of two calls at once one waits.
        """
        if self.path is None:
            raise ReloadError("this service has no configuration file to read again: `tactiled run` has")
        with self._reload_lock, systemd.reloading():
            try:
                outcome = self._reload(load(self.path))
            except Exception as error:
                ours = not isinstance(error, TactileError)
                text = f"{type(error).__name__}: {error}" if ours else "; ".join(str(error).splitlines())
                self.events.add("config_refused", text, error=error if ours else None)
                raise
            self.events.add("config_reloaded", str(outcome))
            return outcome

    def start_reload(self) -> Future[Reload]:
        """Start `reload` on a thread that does not keep the process from ending."""
        future: Future[Reload] = Future()

        def work() -> None:
            future.set_running_or_notify_cancel()
            try:
                future.set_result(self.reload())
            except Exception as error:
                future.set_exception(error)

        Thread(target=work, name="reload", daemon=True).start()
        return future

    def _reload(self, config: Config) -> Reload:
        """Make all that another configuration adds, and then exchange it."""
        running = {name: sensor.plan for name, sensor in self.sensors.items()}
        outcome = compare(running, self.config, config)
        kept = {name: self.sensors[name] for name in outcome.sensors.unchanged}
        made = self._make_sensors(new_plans(running, config, outcome.sensors), kept)
        sensors = {name: (kept | made)[name] for name in config.sensor}
        with self._apply_lock, self._set_lock, self._change_lock:
            if self._stopped:
                raise ReloadError("the service ends")
            if any(self.sensors[name].plan is not running[name] for name in outcome.sensors.restarted):
                raise ReloadError("a calibration was applied meanwhile: reload again")
            certificate = self.renew_tls()
            self._exchange(outcome, config, sensors)
        return replace(outcome, certificate=certificate)

    def _exchange(self, outcome: Reload, config: Config, sensors: dict[str, Sensor]) -> None:
        """Go on by another configuration; BusError, and everything as before, where a bus cannot be opened."""
        buses = {name: bus.settings() for name, bus in config.bus.items()}
        threads = {name: each for name, each in self._sources.items() if isinstance(each, BusThread)}
        kept = {name: threads[name] for name in outcome.buses.unchanged}
        opened = {name: BusThread(name, buses[name], _on(name, sensors)) for name in outcome.buses.beginning}
        _exchange_buses([threads[name] for name in outcome.buses.ending], opened.values())
        self._sources = {name: (kept | opened)[name] for name in buses}
        before = self.sensors
        for name in outcome.sensors.ending:
            before[name].health.down = "restarts" if name in sensors else "is no longer in the configuration"
        for name in outcome.sensors.beginning:
            if bus := kept.get(sensors[name].plan.bus):
                bus.introduce(sensors[name])
        self.sensors, self.config = sensors, config
        self._share_time()
        self._watch.sensors = tuple(sensors.values())
        self.buses.update(buses)
        for name in outcome.buses.removed:
            del self.buses[name]
        self._take_state(outcome.sensors.beginning)
        for name in outcome.sensors.beginning:
            sensors[name].start()
        for source in opened.values():
            source.start()
        for name, source in kept.items():
            if (on_it := _on(name, sensors)) != _on(name, before):
                source.exchange(on_it)
        for name in outcome.sensors.ending:
            before[name].stop()


def _exchange_buses(ended: Collection[BusThread], opened: Collection[BusThread]) -> None:
    """Close some buses and open others; BusError, and those that were closed go on, where one cannot be."""
    for each in ended:  # first: two may be one device
        each.stop()
    try:
        for each in opened:
            each.open()
    except BusError:
        for each in opened:
            each.stop()
        for each in ended:
            each.resume()
        raise


def _on(bus: str, sensors: dict[str, Sensor]) -> dict[str, Sensor]:
    """The sensors on a bus."""
    return {name: each for name, each in sensors.items() if each.plan.bus == bus}
