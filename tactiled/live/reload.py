"""What another configuration changes of one that runs."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from tactiled.build import SensorPlan, check_buses, configured_file, make_codec, sensor_plan
from tactiled.config import Config, schema
from tactiled.errors import ConfigError
from tactiled.frames import CONFIGURED


@dataclass(frozen=True, slots=True)
class Names:
    """Names of sensors, or of buses, by what a reload does with them."""

    added: tuple[str, ...]
    removed: tuple[str, ...]
    restarted: tuple[str, ...]
    unchanged: tuple[str, ...]

    @classmethod
    def compare(
        cls, before: Mapping[str, object], after: Mapping[str, object], same: Callable[[str], bool]
    ) -> "Names":
        """By names before and after; `same` tells of one that is in both whether it runs on as it is."""
        both = {name: same(name) for name in after if name in before}
        return cls(
            tuple(name for name in after if name not in before),
            tuple(name for name in before if name not in after),
            tuple(name for name, runs_on in both.items() if not runs_on),
            tuple(name for name, runs_on in both.items() if runs_on),
        )

    @property
    def ending(self) -> tuple[str, ...]:
        """Those that end."""
        return self.removed + self.restarted

    @property
    def beginning(self) -> tuple[str, ...]:
        """Those that begin."""
        return self.added + self.restarted

    def __str__(self) -> str:
        kinds = {"added": self.added, "removed": self.removed, "restarted": self.restarted}
        changes = [f"{kind} {', '.join(names)}" for kind, names in kinds.items() if names]
        return "; ".join([*changes, f"{len(self.unchanged)} unchanged"])


@dataclass(frozen=True, slots=True)
class Reload:
    """What a reload does."""

    sensors: Names
    buses: Names
    certificate: str | None = None
    """Name of the file of TLS's certificate, if that was renewed."""

    def __str__(self) -> str:
        renewed = f"; TLS: {self.certificate} renewed" if self.certificate else ""
        return f"sensors: {self.sensors}; buses: {self.buses}{renewed}"


def compare(running: Mapping[str, SensorPlan], before: Config, after: Config) -> Reload:
    """What changes from one configuration to another, `running` by plans; ConfigError where it cannot.

    A sensor also restarts if its bus does, or if a file that its table names has changed.
    """
    _check_server(before.server, after.server)
    for table in Config.model_fields.keys() - {"server", "bus", "sensor"}:
        if getattr(before, table) != getattr(after, table):
            raise ConfigError(f"{table}: cannot change while the service runs: restart it")
    buses = Names.compare(before.bus, after.bus, lambda name: before.bus[name] == after.bus[name])

    def same(name: str) -> bool:
        sensor = after.sensor[name]
        same_table = before.sensor[name] == sensor and sensor.bus in buses.unchanged
        return same_table and _same_files(running[name], sensor)

    return Reload(Names.compare(before.sensor, after.sensor, same), buses)


def _check_server(before: schema.Server, after: schema.Server) -> None:
    """ConfigError, a line a key, where the table of the server has changed."""
    changed = [key for key in schema.Server.model_fields if getattr(before, key) != getattr(after, key)]
    lines = []
    for key in changed:
        value = getattr(after, key)
        equals = f" = {value!r}" if isinstance(value, str | int | float) else ""  # no token, no path
        lines.append(f"server.{key}{equals}: cannot change while the service runs: restart it")
    if lines:
        raise ConfigError("\n".join(lines))


def _same_files(plan: SensorPlan, sensor: schema.Sensor) -> bool:
    """Whether the files that a sensor's table names hold what it runs with; a ConfigError names the sensor."""
    try:
        if make_codec(sensor).source != plan.codec.source:
            return False
        file = configured_file(sensor)
    except ConfigError as error:
        raise ConfigError(f"sensor.{plan.name}: {error}") from error
    if sensor.calibration.file is None:
        return True
    return plan.calibration_id == (file.id if file else CONFIGURED)


def new_plans(running: Mapping[str, SensorPlan], config: Config, names: Names) -> dict[str, SensorPlan]:
    """The plans of sensors that begin, kernels solved; ConfigError also where two want the same messages."""
    beginning = {name: sensor_plan(name, config.sensor[name]) for name in names.beginning}
    every = {**{name: running[name] for name in names.unchanged}, **beginning}
    check_buses(config, every.values())
    return beginning
